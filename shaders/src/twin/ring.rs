//! Twin of `wgsl/shared/ring.wesl`, which has to do without 64-bit integers; `terrain::ring` is
//! what both must equal.

/// See [`terrain::ring::mul_hi_u`].
#[must_use]
pub const fn mul_hi_u(a: u32, b: u32) -> u32 {
    let a_low = a & 0xffff;
    let a_high = a >> 16;
    let b_low = b & 0xffff;
    let b_high = b >> 16;
    // Plain operators: overflow checks prove that no sum wraps.
    let first = a_high * b_low + ((a_low * b_low) >> 16);
    let second = a_low * b_high + (first & 0xffff);
    return a_high * b_high + (first >> 16) + (second >> 16);
}

/// See [`terrain::ring::mul_hi`].
#[must_use]
pub const fn mul_hi(a: i32, b: i32) -> i32 {
    let product = mul_hi_u(a as u32, b as u32) as i32;
    return product.wrapping_sub((a >> 31) & b).wrapping_sub((b >> 31) & a);
}

const fn unsigned_abs(v: i32) -> u32 {
    let bits = v as u32;
    return if v < 0 { bits.wrapping_neg() } else { bits };
}

/// See [`terrain::ring::mod_trunc`].
#[must_use]
pub const fn mod_trunc(a: i32, m: i32) -> i32 {
    if m == 0 {
        return 0;
    }
    let magnitude = unsigned_abs(a) % unsigned_abs(m);
    return (if a < 0 { magnitude.wrapping_neg() } else { magnitude }) as i32;
}

/// See [`terrain::ring::mod_floor`].
#[must_use]
pub const fn mod_floor(a: i32, m: i32) -> i32 {
    let remainder = mod_trunc(a, m);
    return if remainder < 0 { (remainder as u32).wrapping_add(unsigned_abs(m)) as i32 } else { remainder };
}

#[cfg(test)]
mod tests {
    use super::*;
    use terrain::hash::mix;
    use terrain::ring;

    fn check(a: i32, b: i32) {
        assert_eq!(mul_hi_u(a as u32, b as u32), ring::mul_hi_u(a as u32, b as u32), "mul_hi_u({a}, {b})");
        assert_eq!(mul_hi(a, b), ring::mul_hi(a, b), "mul_hi({a}, {b})");
        assert_eq!(mod_trunc(a, b), ring::mod_trunc(a, b), "mod_trunc({a}, {b})");
        assert_eq!(mod_floor(a, b), ring::mod_floor(a, b), "mod_floor({a}, {b})");
    }

    #[test]
    fn products_of_halves_equal_64_bit_arithmetic() {
        let powers = (0..32).map(|bit| 1u32 << bit);
        let edges: Vec<i32> = powers
            .flat_map(|power| [power.wrapping_sub(1), power, power.wrapping_add(1)])
            .flat_map(|value| [value as i32, (value as i32).wrapping_neg()])
            .collect();
        for a in &edges {
            for b in &edges {
                check(*a, *b);
            }
        }
        for n in 0..100_000 {
            check(mix(2 * n) as i32, mix(2 * n + 1) as i32);
        }
    }
}
