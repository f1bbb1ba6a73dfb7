//! The ring profile: the only arithmetic allowed on the way to a height.
//!
//! Wrapping add, subtract and multiply, bitwise operations, shifts by constants below 32, compare,
//! select, minimum and maximum. All of them mean the same in Rust, in WGSL (integer overflow is
//! modulo 2^32 there) and in every SIMD instruction set. No float, and no signed `/` or `%`:
//! drivers are known to get those wrong for negative operands, and `%` means different things in
//! different languages.
//!
//! The high halves of products below belong to the ring profile because they can be composed from
//! 16-bit products; Rust computes them from a 64-bit product.

/// High 32 bits of the signed 64-bit product: `floor(a * b / 2^32)`.
#[must_use]
#[inline]
pub const fn mul_hi(a: i32, b: i32) -> i32 {
    ((a as i64 * b as i64) >> 32) as i32
}

/// High 32 bits of the unsigned 64-bit product: `floor(a * b / 2^32)`.
#[must_use]
#[inline]
pub const fn mul_hi_u(a: u32, b: u32) -> u32 {
    ((a as u64 * b as u64) >> 32) as u32
}

/// Remainder of truncated division: the result keeps the sign of the dividend `a`, as `%` does in
/// JavaScript, HLSL and WGSL ("sign-preserving mod").
///
/// Total over all of i32: the sign of `m` does not matter, and `m == 0` gives 0 (WGSL defines
/// `x % 0` so). Built on an unsigned remainder of magnitudes because a signed `%` is not portable
/// across GPU drivers; `i32::MIN` works because its magnitude fits in u32.
#[must_use]
pub const fn mod_trunc(a: i32, m: i32) -> i32 {
    if m == 0 {
        return 0;
    }
    let magnitude = a.unsigned_abs() % m.unsigned_abs();
    if a < 0 { (magnitude as i32).wrapping_neg() } else { magnitude as i32 }
}

/// Remainder of floored division by the magnitude of `m`: the result lies in `[0, |m|)`, so that
/// cells keep their width across zero.
///
/// Total over all of i32: `m == 0` gives 0, a negative `m` acts like its magnitude (`|i32::MIN|`
/// included: the result is then `a` for `a >= 0`, and for `a < 0` the value `a + 2^31`).
#[must_use]
pub const fn mod_floor(a: i32, m: i32) -> i32 {
    let remainder = mod_trunc(a, m);
    if remainder < 0 { (remainder as u32).wrapping_add(m.unsigned_abs()) as i32 } else { remainder }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    const EDGES: [i32; 13] =
        [i32::MIN, i32::MIN + 1, -65_536, -256, -2, -1, 0, 1, 2, 255, 65_536, i32::MAX - 1, i32::MAX];

    /// The same two functions in 128-bit arithmetic, where nothing can overflow.
    fn naive(a: i32, m: i32) -> (i128, i128) {
        let (a, m) = (i128::from(a), i128::from(m).abs());
        if m == 0 { (0, 0) } else { (a % m, a.rem_euclid(m)) }
    }

    fn check(a: i32, m: i32) {
        let (trunc, floor) = naive(a, m);
        assert_eq!(i128::from(mod_trunc(a, m)), trunc, "mod_trunc({a}, {m})");
        assert_eq!(i128::from(mod_floor(a, m)), floor, "mod_floor({a}, {m})");
    }

    #[test]
    fn mods_equal_wide_arithmetic_at_every_pair_of_edges() {
        for a in EDGES {
            for m in EDGES {
                check(a, m);
            }
        }
    }

    #[test]
    fn the_two_mods_differ_exactly_where_signs_matter() {
        assert_eq!((mod_trunc(-1, 768), mod_floor(-1, 768)), (-1, 767));
        assert_eq!((mod_trunc(1, 768), mod_floor(1, 768)), (1, 1));
    }

    #[test]
    fn high_products_equal_wide_arithmetic_at_edges() {
        for a in EDGES {
            for b in EDGES {
                assert_eq!(i64::from(mul_hi(a, b)), (i64::from(a) * i64::from(b)).div_euclid(1 << 32));
                let (ua, ub) = (a as u32, b as u32);
                assert_eq!(u64::from(mul_hi_u(ua, ub)), u64::from(ua) * u64::from(ub) / (1 << 32));
            }
        }
    }

    proptest! {
        #[test]
        fn mods_equal_wide_arithmetic(a: i32, m: i32) {
            check(a, m);
        }
    }
}
