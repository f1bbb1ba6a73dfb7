//! Remainders and lattice cells at both signs, over the edges of i32 and pseudo-random numbers,
//! against 64-bit arithmetic where nothing can overflow.

use super::check::Check;
use crate::sample::word;
use terrain::ring::{mod_floor, mod_trunc};

/// Pseudo-random pairs tested in addition to the edges.
const RANDOM_PAIRS: u32 = 200_000;

/// Checks both remainders and the lattice rule `cell = p >> s, inside = p & (2^s - 1)`.
pub fn check() -> Vec<Check> {
    let mut trunc = Check::new("mod_trunc keeps the dividend's sign over all of i32");
    let mut floor = Check::new("mod_floor stays within its divisor over all of i32");
    let mut lattice = Check::new("lattice cells keep their width across zero");
    let edges = edges();
    let pairs = edges.iter().flat_map(|a| edges.iter().map(move |m| (*a, *m)));
    let random = (0..RANDOM_PAIRS).map(|n| {
        let (a, m) = (word(11, 2 * n) as i32, word(11, 2 * n + 1) as i32);
        // Small divisors are the usual ones.
        (a, m >> (n % 31))
    });
    for (a, m) in pairs.chain(random) {
        let (wide_a, wide_m) = (i64::from(a), i64::from(m));
        let expected = if m == 0 { (0, 0) } else { (wide_a % wide_m, wide_a.rem_euclid(wide_m)) };
        trunc.expect_equal(mod_trunc(a, m).into(), expected.0, format_args!("({a}, {m})"));
        // Past 2^31 - 1 the non-negative remainder does not fit: read as unsigned.
        let got = i64::from(mod_floor(a, m) as u32);
        floor.expect_equal(got, expected.1, format_args!("({a}, {m})"));
    }
    for p in edges {
        for s in 1..=22 {
            let rebuilt = (i64::from(p >> s) << s) + i64::from(p & ((1 << s) - 1));
            lattice.expect_equal(rebuilt, p.into(), format_args!("{p} >> {s}"));
            lattice.expect_equal(
                (p >> s).into(),
                i64::from(p).div_euclid(1 << s),
                format_args!("{p} >> {s}"),
            );
        }
    }
    vec![trunc, floor, lattice]
}

/// Control: truncation towards zero gives cells of double width around zero.
pub fn truncating_control() -> Check {
    let mut lattice = Check::new("cells cut towards zero");
    for p in edges() {
        lattice.expect_equal(i64::from(p / 256), i64::from(p).div_euclid(256), format_args!("{p}"));
    }
    lattice
}

/// 0, the extremes, and `2^k - 1`, `2^k`, `2^k + 1` at both signs.
fn edges() -> Vec<i32> {
    let mut edges = vec![0, i32::MIN, i32::MIN + 1, i32::MAX, i32::MAX - 1];
    for k in 0..31 {
        for near in [-1, 0, 1] {
            edges.extend([(1 << k) + near, -(1 << k) + near]);
        }
    }
    edges.sort_unstable();
    edges.dedup();
    edges
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn remainders_and_cells_are_right_and_truncation_is_detected() {
        for check in check() {
            assert!(check.holds() && check.cases > 3_000, "{check:?}");
        }
        assert!(!truncating_control().holds());
    }
}
