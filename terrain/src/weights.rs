//! Interpolation weights of the two sides of a lattice cell.
//!
//! Gradient noise is separable. With the quintic fade `s` of a fraction `t`, the side at the low
//! end of a cell has the *step* `1 - s` and the *line* `t (1 - s)`, the side at the high end `s`
//! and `(t - 1) s`, and the noise is
//!
//! `sum over the four corners of  gx * line_x * step_z + gz * step_x * line_z`.
//!
//! Steps are kept negated, because -1 fits a signed fixed-point number and +1 does not. Every
//! product has one step, so the sum is the negative of that noise: hills for valleys, the same
//! family of lands.

use crate::constants::FRACTION_BITS;
use crate::curves::fade;
use crate::ring::mul_hi_u;

/// The weights of the two sides of a cell, low side first: 16-bit factors.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Weights {
    /// `t (1 - s)` and `(t - 1) s` in Q16; magnitudes below 0.28.
    pub line: [i32; 2],
    /// `-(1 - s)` and `-s` in Q15, from -1 to 0.
    pub step: [i32; 2],
}

/// The weights at a fraction (Q15, `[0, 2^15)`) of a cell.
#[must_use]
#[inline]
pub fn weights(fraction: i32) -> Weights {
    const ONE_Q31: u32 = 1 << 31;
    let high = fade(fraction << (31 - FRACTION_BITS));
    let low = ONE_Q31 - high as u32;
    // At fraction 0 the second distance wraps from 2^32 to 0; its factor `high` is 0 there.
    let from_low = (fraction as u32) << (32 - FRACTION_BITS);
    let from_high = from_low.wrapping_neg();
    let line = [(mul_hi_u(from_low, low) >> 7) as i32, -((mul_hi_u(from_high, high as u32) >> 7) as i32)];
    let step = [(high >> 8) - (1 << 23), -(high >> 8)];
    Weights { line: line.map(narrow), step: step.map(narrow) }
}

/// Bits of a weight that are rounded away.
pub(crate) const DROPPED_BITS: u32 = 8;

/// A weight of 16 bits, rounded to nearest.
#[inline]
const fn narrow(wide: i32) -> i32 {
    (wide + (1 << (DROPPED_BITS - 1))) >> DROPPED_BITS
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn weights_are_the_stated_products_and_fit_sixteen_bits() {
        for fraction in 0..1 << FRACTION_BITS {
            let t = f64::from(fraction) / f64::from(1 << FRACTION_BITS);
            let s = t * t * t * (t * (t * 6.0 - 15.0) + 10.0);
            let Weights { line, step } = weights(fraction);
            let near = |got: i32, bits: i32, exact: f64| {
                (f64::from(got) / 2f64.powi(bits) - exact).abs() <= 0.51 / 2f64.powi(bits)
            };
            assert!(
                near(line[0], 16, t * (1.0 - s)) && near(line[1], 16, (t - 1.0) * s),
                "line at {fraction}"
            );
            assert!(near(step[0], 15, s - 1.0) && near(step[1], 15, -s), "step at {fraction}");
            assert!(line.into_iter().chain(step).all(|weight| i16::try_from(weight).is_ok()));
        }
    }
}
