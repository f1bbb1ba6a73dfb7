//! Curves that the height formula is built from, on fixed-point numbers.
//!
//! A number in Q*n* counts 2^-*n*. All functions round every product towards minus infinity.

use crate::ring::mul_hi;

/// One in Q30, less the smallest step: the largest share that stays below 2^30.
pub const ALMOST_ONE_Q30: i32 = (1 << 30) - 1;

/// The quintic fade `6t⁵ - 15t⁴ + 10t³` of a Q31 number in `[0, 1)`, Q31 (Perlin, "Improving
/// Noise", 2002). The result stays below 2^31 (tested for fractions of 22 bits).
#[must_use]
#[inline]
pub const fn fade(t: i32) -> i32 {
    let t2 = mul_hi(t, t) << 1;
    let t3 = mul_hi(t2, t) << 1;
    let inner_q27 = (10 << 27) - 15 * (t >> 4) + 6 * (t2 >> 4);
    mul_hi(t3, inner_q27) << 5
}

/// The derivative `30 t² (1 - t)²` of [`fade`], Q29, at most 1.875. The factor `1 - t` is one step
/// less than exact, so that it fits in 31 bits.
#[must_use]
#[inline]
pub const fn fade_slope(t: i32) -> i32 {
    let product_q31 = mul_hi(t, i32::MAX - t) << 1;
    let four_q31 = product_q31 << 2;
    15 * (mul_hi(four_q31, four_q31) >> 4)
}

/// `a + (b - a) t` for a Q31 share `t`. `b - a` must fit in 32 bits.
#[must_use]
#[inline]
pub const fn lerp(a: i32, b: i32, t_q31: i32) -> i32 {
    a + (mul_hi(b - a, t_q31) << 1)
}

/// The square of a Q30 number of magnitude below 1, Q30.
#[must_use]
#[inline]
pub const fn square(x_q30: i32) -> i32 {
    mul_hi(x_q30 << 1, x_q30 << 1)
}

/// The smoothstep `3x² - 2x³` of a Q30 number in `[0, 1)`, Q30.
#[must_use]
#[inline]
pub const fn smoothstep(x_q30: i32) -> i32 {
    mul_hi(square(x_q30) << 1, (3 << 29) - x_q30) << 2
}

/// The window `(1 - x²)²` of a Q30 number of magnitude below 1, Q30.
#[must_use]
#[inline]
pub const fn window(x_q30: i32) -> i32 {
    square(ALMOST_ONE_Q30 - square(x_q30))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The fractions of the finest lattice, 22 bits, thinned out; the last ones included.
    fn shares() -> impl Iterator<Item = i32> {
        (0..1 << 22).step_by(13).chain((1 << 22) - 99..1 << 22).map(|n| n << 9)
    }

    fn near(got: i32, bits: i32, exact: f64, steps: f64) -> bool {
        (f64::from(got) / 2f64.powi(bits) - exact).abs() <= steps * 2f64.powi(-30)
    }

    #[test]
    fn fade_and_its_slope_are_the_stated_polynomials() {
        for t in shares() {
            let x = f64::from(t) / 2f64.powi(31);
            let exact = x * x * x * (x * (x * 6.0 - 15.0) + 10.0);
            assert!(fade(t) >= 0 && near(fade(t), 31, exact, 128.0), "fade({t})");
            let slope = 30.0 * x * x * (1.0 - x) * (1.0 - x);
            assert!(near(fade_slope(t), 29, slope, 256.0), "fade_slope({t})");
        }
        assert_eq!((fade(0), fade_slope(0)), (0, 0));
    }

    #[test]
    fn curves_of_shares_are_the_stated_polynomials() {
        for x in shares().map(|t| t >> 1) {
            let exact = f64::from(x) / 2f64.powi(30);
            assert!(near(square(x), 30, exact * exact, 2.0));
            assert!(near(smoothstep(x), 30, exact * exact * (3.0 - 2.0 * exact), 16.0));
            assert!(near(window(x), 30, (1.0 - exact * exact).powi(2), 8.0));
            assert_eq!((square(-x), window(-x)), (square(x), window(x)));
        }
    }

    #[test]
    fn lerp_meets_its_ends() {
        assert_eq!(lerp(-5, 1 << 30, 0), -5);
        assert!((lerp(-(1 << 29), 1 << 29, i32::MAX) - (1 << 29)).abs() <= 2);
    }
}
