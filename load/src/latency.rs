//! Latencies as HDR histograms (G. Tene, HdrHistogram): all values, with three significant digits.

use hdrhistogram::Histogram;
use serde::Serialize;
use std::time::Duration;

/// Upper bound of the histogram, microseconds (an hour); longer latencies count as this.
const MAX_US: u64 = 3_600_000_000;

/// A histogram of latencies. About 200 KiB, independent of the number of values.
#[derive(Clone, Debug)]
pub struct Latencies(Histogram<u64>);

impl Default for Latencies {
    fn default() -> Self {
        Self(Histogram::new_with_bounds(1, MAX_US, 3).unwrap_or_else(|_| {
            // Unreachable with these constants; a growing histogram would serve as well.
            let mut growing = Histogram::new(3).unwrap_or_else(|_| unreachable!("3 digits are allowed"));
            growing.auto(true);
            growing
        }))
    }
}

impl Latencies {
    /// Adds one latency.
    pub fn record(&mut self, latency: Duration) {
        let us = u64::try_from(latency.as_micros()).unwrap_or(u64::MAX);
        self.0.saturating_record(us.clamp(1, MAX_US));
    }

    /// Adds all of another histogram.
    pub fn add(&mut self, others: &Self) {
        // Both have the same bounds, so this cannot fail.
        let _ = self.0.add(&others.0);
    }

    /// Number of latencies.
    #[must_use]
    pub fn len(&self) -> u64 {
        self.0.len()
    }

    /// Whether there are none.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.0.is_empty()
    }

    /// Removes all.
    pub fn clear(&mut self) {
        self.0.reset();
    }

    /// The quantiles, in milliseconds.
    #[must_use]
    pub fn quantiles(&self) -> LatencyMs {
        // Without answers there is no latency, not a latency of zero.
        let known = |value: u64| (!self.0.is_empty()).then(|| value as f64 / 1000.0);
        let quantile = |q| known(self.0.value_at_quantile(q));
        LatencyMs {
            p50: quantile(0.5),
            p90: quantile(0.9),
            p99: quantile(0.99),
            p999: quantile(0.999),
            max: known(self.0.max()),
        }
    }
}

/// Quantiles of a latency, milliseconds; none without answers.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct LatencyMs {
    /// Median.
    pub p50: Option<f64>,
    /// 90th percentile.
    pub p90: Option<f64>,
    /// 99th percentile.
    pub p99: Option<f64>,
    /// 99.9th percentile.
    pub p999: Option<f64>,
    /// Longest.
    pub max: Option<f64>,
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn quantiles_are_in_milliseconds_and_absent_without_answers() {
        let mut latencies = Latencies::default();
        assert_eq!(latencies.quantiles(), LatencyMs::default());
        for ms in 1..=1000 {
            latencies.record(Duration::from_millis(ms));
        }
        let LatencyMs { p50, p90, p99, p999, max } = latencies.quantiles();
        for (value, ms) in [(p50, 500.0), (p90, 900.0), (p99, 990.0), (p999, 999.0), (max, 1000.0)] {
            assert!(value.is_some_and(|value| (value - ms).abs() < ms * 0.002), "{value:?} for {ms}");
        }
    }

    #[test]
    fn latencies_beyond_the_bound_count_as_the_bound() {
        let mut latencies = Latencies::default();
        latencies.record(Duration::MAX);
        assert!(latencies.quantiles().max.is_some_and(|ms| ms >= 3_590_000.0));
        latencies.clear();
        assert!(latencies.is_empty());
    }

    #[test]
    fn a_sum_has_the_values_of_both() {
        let (mut one, mut other) = (Latencies::default(), Latencies::default());
        one.record(Duration::from_millis(1));
        other.record(Duration::from_millis(100));
        one.add(&other);
        assert_eq!((one.len(), one.quantiles().max.map(f64::round)), (2, Some(100.0)));
    }
}
