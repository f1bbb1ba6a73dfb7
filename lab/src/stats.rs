//! Statistics of measured values: quantiles, medians, error figures, interleaved timings.

use serde::Serialize;
use std::time::Duration;

/// Figures of a set of errors.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Figures {
    /// Number of errors.
    pub count: usize,
    /// The largest.
    pub max: f64,
    /// 99th percentile.
    pub p99: f64,
    /// Root mean square.
    pub rms: f64,
}

impl Figures {
    /// Figures of absolute errors; not a number if there are none.
    pub fn of(errors: Vec<f64>) -> Self {
        let count = errors.len();
        let rms = mean(errors.iter().map(|error| error * error)).sqrt();
        let [max, p99] = quantiles(errors, [1.0, 0.99]);
        Self { count, max, p99, rms }
    }
}

/// The nearest-rank quantile of sorted values; not a number if there are none.
pub fn quantile(sorted: &[f64], q: f64) -> f64 {
    bars::stats::quantile(sorted, q).unwrap_or(f64::NAN)
}

/// Quantiles of values in any order.
pub fn quantiles<const N: usize>(values: impl IntoIterator<Item = f64>, qs: [f64; N]) -> [f64; N] {
    let mut sorted: Vec<f64> = values.into_iter().collect();
    sorted.sort_unstable_by(f64::total_cmp);
    qs.map(|q| quantile(&sorted, q))
}

/// The median, the upper one of an even number; not a number if there is none.
pub fn median(values: impl IntoIterator<Item = f64>) -> f64 {
    bars::stats::median(values).unwrap_or(f64::NAN)
}

/// Median of durations in seconds.
pub fn median_s(times: &[Duration]) -> f64 {
    median(times.iter().map(Duration::as_secs_f64))
}

/// The arithmetic mean; not a number if there is no value.
pub fn mean(values: impl IntoIterator<Item = f64>) -> f64 {
    let (sum, count) = values.into_iter().fold((0.0, 0u32), |(sum, count), value| (sum + value, count + 1));
    sum / f64::from(count)
}

/// The largest of values that are at least 0; 0 if there is none, not a number if one is not.
pub fn worst(values: impl IntoIterator<Item = f64>) -> f64 {
    values.into_iter().fold(0.0, |worst, value| if value > worst || value.is_nan() { value } else { worst })
}

/// Within which a share lies with 95 % certainty, of which `found` of `count` independent cases
/// were found: the score interval (Wilson, JASA 22, 1927). If none was found, 0 to 3 / n (rule of
/// three: Hanley and Lippman-Hand, JAMA 249(13), 1983); of no case, 0 to 1.
pub fn share_interval(found: u64, count: u64) -> [f64; 2] {
    /// The normal distribution's quantile of 97.5 %.
    const Z: f64 = 1.959_963_984_540_054;
    let n = count as f64;
    if count == 0 {
        return [0.0, 1.0];
    }
    if found == 0 {
        return [0.0, (3.0 / n).min(1.0)];
    }
    let share = found as f64 / n;
    let scale = 1.0 / (1.0 + Z * Z / n);
    let middle = scale * (share + Z * Z / (2.0 * n));
    let half = scale * Z * (share * (1.0 - share) / n + Z * Z / (4.0 * n * n)).sqrt();
    [(middle - half).max(0.0), (middle + half).min(1.0)]
}

/// Times of `count` alternatives, each run once a round: a change of the machine's speed that lasts
/// longer than a round affects all of them.
///
/// # Errors
/// A run failed.
pub fn interleaved<E>(
    rounds: usize,
    count: usize,
    mut run: impl FnMut(usize) -> Result<Duration, E>,
) -> Result<Vec<Vec<Duration>>, E> {
    let mut times = vec![Vec::with_capacity(rounds); count];
    for _ in 0..rounds {
        for (index, times) in times.iter_mut().enumerate() {
            times.push(run(index)?);
        }
    }
    Ok(times)
}

/// Medians of each alternative's time over that of the first one in the same round.
pub fn ratios(times: &[Vec<Duration>]) -> Vec<f64> {
    let first = times.first().map_or(&[][..], Vec::as_slice);
    let ratio = |(own, first): (&Duration, &Duration)| own.as_secs_f64() / first.as_secs_f64().max(1e-9);
    times.iter().map(|own| median(own.iter().zip(first).map(ratio))).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn figures_are_those_of_a_known_set() {
        let figures = Figures::of((1..=200).map(f64::from).collect());
        assert_eq!((figures.count, figures.max, figures.p99), (200, 200.0, 198.0));
        assert!((Figures::of(vec![3.0, 4.0]).rms - 12.5f64.sqrt()).abs() < 1e-12);
        assert!(Figures::of(Vec::new()).max.is_nan());
    }

    #[test]
    fn quantiles_are_nearest_ranks() {
        let values: Vec<f64> = (1..=100).map(f64::from).collect();
        assert_eq!((quantile(&values, 0.99), quantile(&values, 0.0)), (99.0, 1.0));
        assert_eq!(quantiles([3.0, 1.0, 2.0], [0.5, 1.0]), [2.0, 3.0]);
        assert!(quantile(&[], 0.5).is_nan() && median([]).is_nan());
        assert_eq!((median([5.0, 1.0, 2.0, 3.0]), worst([2.0, 7.0]), mean([1.0, 2.0])), (3.0, 7.0, 1.5));
    }

    #[test]
    fn intervals_of_shares_are_those_of_the_literature() {
        // Newcombe, Statistics in Medicine 17, 1998, table I, method 3.
        for (found, count, expected) in
            [(81, 263, [0.2553, 0.3662]), (15, 148, [0.0624, 0.1605]), (1, 29, [0.0061, 0.1718])]
        {
            let interval = share_interval(found, count);
            for (end, expected) in interval.into_iter().zip(expected) {
                assert!((end - expected).abs() < 5e-5, "{found} of {count}: {interval:?}");
            }
        }
        assert_eq!(share_interval(0, 2_000_000), [0.0, 1.5e-6]);
        assert_eq!((share_interval(0, 0), share_interval(5, 5)[1]), ([0.0, 1.0], 1.0));
        // The control: ten times the cases narrow it.
        let width = |[low, high]: [f64; 2]| high - low;
        assert!(width(share_interval(180, 2_000_000)) < 0.4 * width(share_interval(18, 200_000)));
    }

    #[test]
    fn ratios_ignore_a_change_of_speed_between_rounds() {
        let times =
            [[2, 20, 20], [3, 3, 30], [8, 80, 80]].map(|times| times.map(Duration::from_secs).to_vec());
        assert_eq!(ratios(&times), [1.0, 1.5, 4.0]);
        let medians = times.each_ref().map(|times| median_s(times));
        assert_ne!(medians[1] / medians[0], 1.5, "the control: a ratio of medians");
    }

    #[test]
    fn every_alternative_runs_once_a_round() {
        let mut order = Vec::new();
        let times = interleaved(2, 3, |index| {
            order.push(index);
            Ok::<_, ()>(Duration::from_secs(index as u64))
        });
        assert_eq!(order, [0, 1, 2, 0, 1, 2]);
        assert_eq!(times.unwrap()[2], [Duration::from_secs(2); 2]);
    }
}
