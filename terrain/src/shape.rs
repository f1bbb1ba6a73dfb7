//! The coast: land near sea level becomes a beach or a cliff, by its exposure.

use crate::constants::{BEACH_M, CLIFF_FOOT_M, CLIFF_M, FINE_BITS, UNIT_BITS};
use crate::curves::smoothstep;
use crate::ring::mul_hi;

// The beach's coefficients in Q30; products with Q31 powers are Q29. 0.2, 1.6, 0.8 rounded to
// nearest.
pub(crate) const LINEAR_Q29: i32 = 107_374_182;
pub(crate) const CUBIC_Q30: i32 = 1_717_986_918;
pub(crate) const QUINTIC_Q30: i32 = 858_993_459;

/// The height of a vertex, units, from the height without coasts (2^-16 m) and the exposure (Q15).
#[must_use]
#[inline]
pub fn coast(raw: i32, exposure: i32) -> i32 {
    let low = beach(raw);
    let difference = raw + cliff(raw) - low;
    round_to_units(low + mul_hi(difference << 8, exposure << 9))
}

/// Flattens the land within [`BEACH_M`] of sea level: the odd polynomial `0.2 r + 1.6 r³ - 0.8 r⁵`
/// (`r` in beach heights) has slope 0.2 at the water line and joins the untouched land with equal
/// value and slope at `|r| = 1`.
fn beach(fine: i32) -> i32 {
    const EDGE: i32 = BEACH_M << FINE_BITS;
    if fine.abs() >= EDGE {
        return fine;
    }
    let r = fine << (31 - FINE_BITS - BEACH_M.trailing_zeros());
    let r2 = mul_hi(r, r) << 1;
    let r4 = mul_hi(r2, r2) << 1;
    let slope_q29 = LINEAR_Q29 + mul_hi(r2, CUBIC_Q30) - mul_hi(r4, QUINTIC_Q30);
    mul_hi(fine << 3, slope_q29)
}

/// The rise of a fully exposed coast, 2^-16 m: a smoothstep of [`CLIFF_M`] from [`CLIFF_FOOT_M`]
/// below the sea to [`BEACH_M`] above that.
fn cliff(fine: i32) -> i32 {
    const WIDTH: i32 = BEACH_M << FINE_BITS;
    let x = (fine + (CLIFF_FOOT_M << FINE_BITS)).clamp(0, WIDTH - 1);
    mul_hi(smoothstep(x << (30 - FINE_BITS - BEACH_M.trailing_zeros())), CLIFF_M << (FINE_BITS + 2))
}

const fn round_to_units(fine: i32) -> i32 {
    const DROPPED: u32 = FINE_BITS - UNIT_BITS;
    (fine + (1 << (DROPPED - 1))) >> DROPPED
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_beach_is_the_stated_polynomial_and_joins_smoothly() {
        let edge = BEACH_M << FINE_BITS;
        for fine in (-edge - 10..=edge + 10).step_by(7) {
            let r = f64::from(fine) / f64::from(edge);
            let exact = if r.abs() >= 1.0 { r } else { 0.2 * r + 1.6 * r.powi(3) - 0.8 * r.powi(5) };
            assert!((f64::from(beach(fine)) - exact * f64::from(edge)).abs() < 2.0, "at {fine}");
        }
        assert_eq!(beach(0), 0);
    }

    #[test]
    fn a_cliff_is_the_stated_smoothstep() {
        let metre = f64::from(1 << FINE_BITS);
        for fine in (-6 << FINE_BITS..12 << FINE_BITS).step_by(61) {
            let x =
                ((f64::from(fine) / metre + f64::from(CLIFF_FOOT_M)) / f64::from(BEACH_M)).clamp(0.0, 1.0);
            let exact = f64::from(CLIFF_M) * x * x * (3.0 - 2.0 * x) * metre;
            assert!((f64::from(cliff(fine)) - exact).abs() < 3.0, "at {fine}");
        }
    }

    #[test]
    fn exposure_blends_beach_and_cliff() {
        let at = |exposure: i32| coast(4 << FINE_BITS, exposure);
        assert_eq!(at(0), round_to_units(beach(4 << FINE_BITS)));
        assert!(at(1 << 14) > at(0) + (10 << UNIT_BITS) && at(32_767) > at(1 << 14) + (10 << UNIT_BITS));
        for far in [-64, 300] {
            let cliff = if far > 0 { CLIFF_M } else { 0 };
            assert_eq!(coast(far << FINE_BITS, 0), far << UNIT_BITS);
            assert!((coast(far << FINE_BITS, 32_767) - ((far + cliff) << UNIT_BITS)).abs() <= 1);
        }
    }
}
