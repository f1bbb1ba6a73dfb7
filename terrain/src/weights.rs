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

use crate::constants::{FRACTION_BITS, SPLIT_BITS};
use crate::ring::{mul_hi, mul_hi_u};

/// The weights of the two sides of a cell, low side first.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Weights {
    /// `t (1 - s)` and `(t - 1) s` in Q24; magnitudes below 0.28.
    pub line: [i32; 2],
    /// `-(1 - s)` and `-s` in Q23, from -1 to 0; their sum is exactly -1.
    pub step: [i32; 2],
}

/// The weights at a fraction (Q18, `[0, 2^18)`) of a cell.
#[must_use]
#[inline]
pub fn weights(fraction: i32) -> Weights {
    const ONE_Q31: u32 = 1 << 31;
    let high = fade(fraction);
    let low = ONE_Q31 - high as u32;
    // At fraction 0 the second distance wraps from 2^32 to 0; its factor `high` is 0 there.
    let from_low = (fraction as u32) << (32 - FRACTION_BITS);
    let from_high = from_low.wrapping_neg();
    let line = [(mul_hi_u(from_low, low) >> 7) as i32, -((mul_hi_u(from_high, high as u32) >> 7) as i32)];
    let step = [(high >> 8) - (1 << 23), -(high >> 8)];
    Weights { line, step }
}

/// The quintic fade 6t^5 - 15t^4 + 10t^3 of a Q18 fraction, in Q31. Every step rounds down, so the
/// result stays below 2^31 (tested over all 2^18 fractions).
#[inline]
#[must_use]
pub fn fade(fraction: i32) -> i32 {
    let t = fraction << (31 - FRACTION_BITS);
    let t2 = mul_hi(t, t) << 1;
    let t3 = mul_hi(t2, t) << 1;
    let inner_q27 = (10 << 27) - 15 * (t >> 4) + 6 * (t2 >> 4);
    mul_hi(t3, inner_q27) << 5
}

/// An operand with [`SPLIT_BITS`] extra bits, as two numbers of 16 bits: high part (signed) and low
/// part (`[0, 256)`).
#[inline]
#[must_use]
pub const fn split(wide: i32) -> (i32, i32) {
    (wide >> SPLIT_BITS, wide & ((1 << SPLIT_BITS) - 1))
}

/// An operand without its extra bits, rounded to nearest.
#[inline]
#[must_use]
pub const fn narrow(wide: i32) -> i32 {
    (wide + (1 << (SPLIT_BITS - 1))) >> SPLIT_BITS
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn fade_is_the_quintic_over_every_fraction_and_never_reaches_one() {
        let mut previous = -1;
        for fraction in 0..1 << FRACTION_BITS {
            let t = f64::from(fraction) / f64::from(1 << FRACTION_BITS);
            let exact = t * t * t * (t * (t * 6.0 - 15.0) + 10.0);
            let got = fade(fraction);
            assert!(got >= 0, "fade({fraction}) wrapped");
            assert!((f64::from(got) / 2f64.powi(31) - exact).abs() < 2f64.powi(-24), "fade({fraction})");
            assert!(got >= previous - 128, "fade({fraction}) falls by more than its rounding");
            previous = got;
        }
        assert_eq!(fade(0), 0);
    }

    #[test]
    fn weights_are_the_stated_products_and_fit_sixteen_bits() {
        for fraction in 0..1 << FRACTION_BITS {
            let t = f64::from(fraction) / f64::from(1 << FRACTION_BITS);
            let s = t * t * t * (t * (t * 6.0 - 15.0) + 10.0);
            let Weights { line, step } = weights(fraction);
            let near = |got: i32, bits: i32, exact: f64| {
                (f64::from(got) / 2f64.powi(bits) - exact).abs() < 2f64.powi(-22)
            };
            assert!(
                near(line[0], 24, t * (1.0 - s)) && near(line[1], 24, (t - 1.0) * s),
                "line at {fraction}"
            );
            assert!(near(step[0], 23, s - 1.0) && near(step[1], 23, -s), "step at {fraction}");
            assert_eq!(step[0] + step[1], -1 << 23);
            for wide in line.into_iter().chain(step) {
                assert!(i16::try_from(split(wide).0).is_ok() && i16::try_from(narrow(wide)).is_ok());
            }
        }
    }
}
