//! Estimates of job costs, learned from finished jobs. The fair queue and the admission control use
//! them.

use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Duration;
use terrain::ChunkKey;
use terrain::constants::TOP_LEVEL;

/// Initial estimates, nanoseconds: level 0, and levels whose error is measured.
const INITIAL_COST_NS: [u64; 2] = [100_000, 1_000_000];

/// Window of the moving average, jobs.
const EWMA_WINDOW: u64 = 32;

/// A job counts for at most this multiple of its estimate.
pub const MAX_OUTLIER: u64 = 8;

/// Moving averages. Relaxed atomics: a lost update changes an estimate by 1/32 of one job.
#[derive(Debug)]
pub struct JobCosts {
    by_level: [AtomicU64; TOP_LEVEL as usize + 1],
    all: AtomicU64,
}

impl Default for JobCosts {
    fn default() -> Self {
        let by_level = std::array::from_fn(|level| AtomicU64::new(INITIAL_COST_NS[usize::from(level > 0)]));
        Self { by_level, all: AtomicU64::new(INITIAL_COST_NS[0]) }
    }
}

impl JobCosts {
    /// Records the duration of a job.
    pub fn record(&self, key: ChunkKey, took: Duration) {
        let took = u64::try_from(took.as_nanos()).unwrap_or(u64::MAX);
        for mean in [&self.by_level[usize::from(key.level())], &self.all] {
            let before = mean.load(Ordering::Relaxed);
            // Clamped, so that a suspended machine or a descheduled thread does not make the server
            // reject requests: one job changes an estimate by a quarter at most.
            let after = before - before / EWMA_WINDOW + took.min(MAX_OUTLIER * before) / EWMA_WINDOW;
            mean.store(after.max(1), Ordering::Relaxed);
        }
    }

    /// Expected cost of a job for this key, microseconds, at least 1.
    #[must_use]
    pub fn expected_us(&self, key: ChunkKey) -> i64 {
        (self.by_level[usize::from(key.level())].load(Ordering::Relaxed) / 1000).max(1) as i64
    }

    /// Mean cost of a job over the recent mix of levels, microseconds, at least 1.
    #[must_use]
    pub fn mean_us(&self) -> i64 {
        (self.all.load(Ordering::Relaxed) / 1000).max(1) as i64
    }

    /// Jobs that `threads` threads finish within a time for each of `flows` flows, over the recent
    /// mix of levels.
    #[must_use]
    pub fn jobs_within(&self, time: Duration, threads: usize, flows: usize) -> usize {
        let mean_ns = u128::from(self.all.load(Ordering::Relaxed).max(1));
        let jobs = time.as_nanos() * threads as u128 / (mean_ns * flows.max(1) as u128);
        usize::try_from(jobs).unwrap_or(usize::MAX)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn estimates_follow_the_measurements_and_clamp_an_outlier() {
        let (costs, key) = (JobCosts::default(), ChunkKey::new(0, 1, 1).unwrap());
        for _ in 0..300 {
            costs.record(key, Duration::from_micros(40));
        }
        assert!((40..=42).contains(&costs.expected_us(key)), "{}", costs.expected_us(key));
        costs.record(key, Duration::from_secs(3600));
        assert!(costs.expected_us(key) <= 51, "{}", costs.expected_us(key));
        for _ in 0..30 {
            costs.record(key, Duration::from_millis(4));
        }
        assert!(costs.expected_us(key) > 1000, "repeated values count: {}", costs.expected_us(key));
    }

    #[test]
    fn a_share_falls_with_the_flows_and_rises_with_the_threads() {
        let costs = JobCosts::default();
        let second = Duration::from_secs(1);
        assert_eq!(costs.jobs_within(second, 1, 1), 10_000);
        assert_eq!(costs.jobs_within(second, 2, 10), 2_000);
        assert_eq!(costs.jobs_within(second, 1, 0), 10_000);
        assert_eq!(costs.jobs_within(Duration::ZERO, 1, 1), 0);
    }
}
