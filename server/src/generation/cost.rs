//! What jobs cost, learned from those that ran: the currency of fairness, and the base of every
//! promise about waiting.

use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Duration;
use terrain::ChunkKey;
use terrain::constants::TOP_LEVEL;

/// Nanoseconds that a level costs before one of it was made: a chunk of level 0, and one with its
/// error measured.
const FIRST_GUESS: [u64; 2] = [100_000, 1_000_000];

/// Weight of the past against one job: a mean over about the last 32.
const MEMORY: u64 = 32;

/// A job counts for at most so many times what was expected of it.
const MOST: u64 = 8;

/// Running means. Relaxed atomics: a lost update changes an estimate by a thirtieth of one job.
#[derive(Debug)]
pub struct Costs {
    by_level: [AtomicU64; TOP_LEVEL as usize + 1],
    all: AtomicU64,
}

impl Default for Costs {
    fn default() -> Self {
        let by_level = std::array::from_fn(|level| AtomicU64::new(FIRST_GUESS[usize::from(level > 0)]));
        Self { by_level, all: AtomicU64::new(FIRST_GUESS[0]) }
    }
}

impl Costs {
    /// Learns what a job took.
    pub fn learn(&self, key: ChunkKey, took: Duration) {
        let took = u64::try_from(took.as_nanos()).unwrap_or(u64::MAX);
        for mean in [&self.by_level[usize::from(key.level())], &self.all] {
            let before = mean.load(Ordering::Relaxed);
            // Neither a machine that was suspended nor a thread that had to wait for its core,
            // which takes a hundred jobs' time, may close the doors: one job moves an estimate by a
            // quarter at most.
            let after = before - before / MEMORY + took.min(MOST * before) / MEMORY;
            mean.store(after.max(1), Ordering::Relaxed);
        }
    }

    /// What a job of this key will take, microseconds, at least 1.
    #[must_use]
    pub fn expected_us(&self, key: ChunkKey) -> i64 {
        (self.by_level[usize::from(key.level())].load(Ordering::Relaxed) / 1000).max(1) as i64
    }

    /// What a job takes by the recent mix of levels, microseconds, at least 1.
    #[must_use]
    pub fn mean_us(&self) -> i64 {
        (self.all.load(Ordering::Relaxed) / 1000).max(1) as i64
    }

    /// Jobs that `threads` threads finish within a time for each of `flows` flows, by the recent
    /// mix of levels.
    #[must_use]
    pub fn within(&self, time: Duration, threads: usize, flows: usize) -> usize {
        let mean_ns = u128::from(self.all.load(Ordering::Relaxed).max(1));
        let jobs = time.as_nanos() * threads as u128 / (mean_ns * flows.max(1) as u128);
        usize::try_from(jobs).unwrap_or(usize::MAX)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn estimates_follow_what_was_measured_and_one_outlier_does_not_carry_them_away() {
        let (costs, key) = (Costs::default(), ChunkKey::new(0, 1, 1).unwrap());
        for _ in 0..300 {
            costs.learn(key, Duration::from_micros(40));
        }
        assert!((40..=42).contains(&costs.expected_us(key)), "{}", costs.expected_us(key));
        costs.learn(key, Duration::from_secs(3600));
        assert!(costs.expected_us(key) <= 51, "{}", costs.expected_us(key));
        for _ in 0..30 {
            costs.learn(key, Duration::from_millis(4));
        }
        assert!(
            costs.expected_us(key) > 1000,
            "what all jobs take is what a job takes: {}",
            costs.expected_us(key)
        );
    }

    #[test]
    fn a_share_shrinks_with_the_flows_and_grows_with_the_threads() {
        let costs = Costs::default();
        let second = Duration::from_secs(1);
        assert_eq!(costs.within(second, 1, 1), 10_000);
        assert_eq!(costs.within(second, 2, 10), 2_000);
        assert_eq!(costs.within(second, 1, 0), 10_000);
        assert_eq!(costs.within(Duration::ZERO, 1, 1), 0);
    }
}
