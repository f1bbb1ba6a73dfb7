//! A histogram of durations: an observation costs two relaxed additions, and quantiles are
//! available for the interval between any two readings.
//!
//! Buckets are eighths of octaves from 16 us to 69 s, so the error of a quantile is at most 6 %.
//! The metrics merge them to octaves.

use prometheus_client::encoding::{EncodeMetric, MetricEncoder, NoLabelSet};
use prometheus_client::metrics::MetricType;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Duration;

/// log2 of the first bound in nanoseconds; shorter durations count in the first bucket.
const FIRST_BITS: u32 = 14;
const OCTAVES: usize = 22;
/// log2 of the buckets per octave.
const FINE_BITS: u32 = 3;
const BUCKETS: usize = OCTAVES << FINE_BITS;

/// Counts of all buckets at one moment.
pub type BucketCounts = [u64; BUCKETS];

/// Cheap to clone; clones share their counts.
#[derive(Clone, Debug)]
pub struct LatencyHistogram {
    shared: Arc<Buckets>,
}

#[derive(Debug)]
struct Buckets {
    counts: [AtomicU64; BUCKETS],
    total_ns: AtomicU64,
}

impl Default for LatencyHistogram {
    fn default() -> Self {
        let counts = std::array::from_fn(|_| AtomicU64::new(0));
        Self { shared: Arc::new(Buckets { counts, total_ns: AtomicU64::new(0) }) }
    }
}

impl LatencyHistogram {
    /// Records `times` events of the same duration.
    pub fn observe(&self, took: Duration, times: u64) {
        let nanoseconds = u64::try_from(took.as_nanos()).unwrap_or(u64::MAX);
        self.shared.counts[bucket(nanoseconds)].fetch_add(times, Ordering::Relaxed);
        self.shared.total_ns.fetch_add(nanoseconds.saturating_mul(times), Ordering::Relaxed);
    }

    /// All counts so far.
    #[must_use]
    pub fn counts(&self) -> BucketCounts {
        std::array::from_fn(|index| self.shared.counts[index].load(Ordering::Relaxed))
    }
}

/// A quantile of the events between two readings, milliseconds; none without events.
#[must_use]
pub fn quantile_ms(before: &BucketCounts, after: &BucketCounts, share: f64) -> Option<f64> {
    let between = || before.iter().zip(after).map(|(before, after)| after.saturating_sub(*before));
    let count: u64 = between().sum();
    let rank = ((count as f64 * share).ceil() as u64).max(1);
    let mut sum = 0;
    let index = between().position(|in_bucket| {
        sum += in_bucket;
        sum >= rank
    })?;
    // The middle of the bucket.
    Some((low_ns(index) + low_ns(index + 1)) / 2.0 / 1e6)
}

/// Events between two readings.
#[must_use]
pub fn count(before: &BucketCounts, after: &BucketCounts) -> u64 {
    before.iter().zip(after).map(|(before, after)| after.saturating_sub(*before)).sum()
}

fn bucket(nanoseconds: u64) -> usize {
    let value = nanoseconds.max(1 << FIRST_BITS);
    let octave = value.ilog2();
    let fine = (value >> (octave - FINE_BITS)) & ((1 << FINE_BITS) - 1);
    ((((octave - FIRST_BITS) << FINE_BITS) as u64 + fine) as usize).min(BUCKETS - 1)
}

/// Lower bound of a bucket, nanoseconds.
fn low_ns(index: usize) -> f64 {
    let (octave, fine) = (index >> FINE_BITS, index & ((1 << FINE_BITS) - 1));
    let eighths = (1 << FINE_BITS) + fine;
    f64::from(1u32 << octave) * f64::from(1u32 << (FIRST_BITS - FINE_BITS)) * eighths as f64
}

impl EncodeMetric for LatencyHistogram {
    fn encode(&self, mut encoder: MetricEncoder<'_>) -> Result<(), std::fmt::Error> {
        let counts = self.counts();
        let octaves: Vec<(f64, u64)> = (0..OCTAVES)
            .map(|octave| {
                let range = octave << FINE_BITS..(octave + 1) << FINE_BITS;
                // The last bucket is open; OpenMetrics requires the bound +Inf.
                let bound = if octave + 1 == OCTAVES { f64::INFINITY } else { low_ns(range.end) / 1e9 };
                (bound, counts[range].iter().sum())
            })
            .collect();
        let total_s = self.shared.total_ns.load(Ordering::Relaxed) as f64 / 1e9;
        encoder.encode_histogram::<NoLabelSet>(total_s, counts.iter().sum(), &octaves, None)
    }

    fn metric_type(&self) -> MetricType {
        MetricType::Histogram
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_duration_lies_between_the_bounds_of_its_bucket() {
        assert_eq!((bucket(0), bucket(1 << FIRST_BITS), bucket(u64::MAX)), (0, 0, BUCKETS - 1));
        for nanoseconds in (15..34).flat_map(|bits| [1u64 << bits, (1 << bits) * 3 / 2, (1 << bits) - 1]) {
            let index = bucket(nanoseconds);
            let value = nanoseconds as f64;
            assert!(low_ns(index) <= value && value < low_ns(index + 1), "{nanoseconds} in {index}");
            assert!(low_ns(index + 1) / low_ns(index) <= 1.125);
        }
    }

    #[test]
    fn quantiles_cover_the_events_between_two_readings() {
        let latency = LatencyHistogram::default();
        latency.observe(Duration::from_secs(5), 1000);
        let before = latency.counts();
        for milliseconds in 1..=100 {
            latency.observe(Duration::from_millis(milliseconds), 1);
        }
        let after = latency.counts();
        assert_eq!(count(&before, &after), 100);
        for (share, expected) in [(0.5, 50.0), (0.9, 90.0), (0.99, 99.0)] {
            let got = quantile_ms(&before, &after, share).unwrap();
            assert!((got / expected - 1.0).abs() < 0.07, "{share}: {got}");
        }
        assert_eq!(quantile_ms(&after, &after, 0.5), None);
        // The control: the median with the earlier events differs.
        assert!(quantile_ms(&[0; BUCKETS], &after, 0.5).unwrap() > 4000.0);
    }
}
