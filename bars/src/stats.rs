//! Order statistics.

/// The nearest-rank quantile `q` (0 to 1) of sorted values; none if there are none.
pub fn quantile<T: Copy>(sorted: &[T], q: f64) -> Option<T> {
    // `q * n` may exceed a whole rank by its rounding.
    let rank = (q * sorted.len() as f64 - 1e-9).ceil() as usize;
    sorted.get(rank.saturating_sub(1)).copied()
}

/// The median, the upper one of an even number; none if there are no values.
pub fn median(values: impl IntoIterator<Item = f64>) -> Option<f64> {
    let mut sorted: Vec<f64> = values.into_iter().collect();
    sorted.sort_unstable_by(f64::total_cmp);
    sorted.get(sorted.len() / 2).copied()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn quantiles_are_nearest_ranks_and_the_median_is_the_upper_one() {
        let values: Vec<u32> = (1..=100).collect();
        assert_eq!([0.0, 0.5, 0.99, 1.0].map(|q| quantile(&values, q)), [1, 50, 99, 100].map(Some));
        assert_eq!((median([5.0, 1.0, 2.0, 3.0]), median([3.0, 1.0, 2.0])), (Some(3.0), Some(2.0)));
        assert_eq!((quantile::<u32>(&[], 0.5), median([])), (None, None));
    }
}
