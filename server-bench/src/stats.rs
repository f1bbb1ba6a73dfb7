//! Small statistics.

use std::time::Duration;

/// The quantile `q` (0 to 1) of the values; none if there are no values. Sorts the values.
pub fn quantile<T: Copy + Ord>(values: &mut [T], q: f64) -> Option<T> {
    values.sort_unstable();
    let last = values.len().checked_sub(1)?;
    values.get((last as f64 * q).round() as usize).copied()
}

/// The median; none if there are no values.
#[must_use]
pub fn median(mut values: Vec<f64>) -> Option<f64> {
    values.sort_unstable_by(f64::total_cmp);
    values.get(values.len() / 2).copied()
}

/// Jain's fairness index: 1 if all shares are equal, 1/n if one client has everything (Jain, Chiu
/// and Hawe, DEC TR-301, 1984).
#[must_use]
pub fn jain(shares: &[f64]) -> f64 {
    let (sum, squares) =
        shares.iter().fold((0.0, 0.0), |(sum, squares), share| (sum + share, squares + share * share));
    sum * sum / (shares.len() as f64 * squares)
}

/// Milliseconds of a duration.
#[must_use]
pub fn ms(duration: Duration) -> f64 {
    duration.as_secs_f64() * 1000.0
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn quantiles_and_medians_of_known_values() {
        let mut values: Vec<u32> = (0..=100).rev().collect();
        assert_eq!([0.0, 0.5, 0.99, 1.0].map(|q| quantile(&mut values, q)), [0, 50, 99, 100].map(Some));
        assert_eq!(quantile::<u32>(&mut [], 0.5), None);
        assert_eq!((median(vec![3.0, 1.0, 2.0]), median(Vec::new())), (Some(2.0), None));
    }

    #[test]
    fn equal_shares_have_index_1_and_a_monopoly_1_over_n() {
        assert!((jain(&[5.0; 7]) - 1.0).abs() < 1e-12);
        assert!((jain(&[0.0, 0.0, 9.0, 0.0]) - 0.25).abs() < 1e-12);
    }
}
