//! What all clients count, together, while they run.

use crate::report::{LatencyMs, Report};
use hdrhistogram::Histogram;
use protocol::Delivery;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Mutex, PoisonError};
use std::time::Duration;

/// Distinct troubles that are kept in words; all of them are counted.
const MAX_PROBLEMS: usize = 8;

/// Longest latency that is told apart, microseconds (10 minutes); longer ones count as this.
const MAX_LATENCY_US: u64 = 600_000_000;

/// Live counters. Relaxed atomics: nobody orders anything by them.
#[derive(Debug)]
pub struct Tally {
    chunks: AtomicU64,
    bytes: AtomicU64,
    mismatches: AtomicU64,
    dropped: AtomicU64,
    refused: AtomicU64,
    regenerated: AtomicU64,
    views_settled: AtomicU64,
    requests: AtomicU64,
    unanswered: AtomicU64,
    /// A mutex is right: a few hundred records a second, nothing awaits under it.
    latency_us: Mutex<Histogram<u64>>,
    problems: Mutex<Vec<String>>,
}

impl Default for Tally {
    fn default() -> Self {
        Self {
            chunks: AtomicU64::default(),
            bytes: AtomicU64::default(),
            mismatches: AtomicU64::default(),
            dropped: AtomicU64::default(),
            refused: AtomicU64::default(),
            regenerated: AtomicU64::default(),
            views_settled: AtomicU64::default(),
            requests: AtomicU64::default(),
            unanswered: AtomicU64::default(),
            latency_us: Mutex::new(latency_histogram()),
            problems: Mutex::default(),
        }
    }
}

/// One microsecond to [`MAX_LATENCY_US`] at three significant digits, about 200 KiB.
fn latency_histogram() -> Histogram<u64> {
    Histogram::new_with_bounds(1, MAX_LATENCY_US, 3).unwrap_or_else(|_| {
        // Unreachable with these constants; a histogram that grows by itself would serve as well.
        let mut growing = Histogram::new(3).unwrap_or_else(|_| unreachable!("3 digits are allowed"));
        growing.auto(true);
        growing
    })
}

impl Tally {
    /// A chunk arrived, right or wrong.
    pub fn chunk(&self, bytes: usize) {
        add(&self.chunks);
        self.bytes.fetch_add(bytes as u64, Ordering::Relaxed);
    }

    /// A chunk is compared with local generation.
    pub fn regenerated(&self) {
        add(&self.regenerated);
    }

    /// Something arrived that is not what it should be.
    pub fn mismatch(&self, problem: &str) {
        add(&self.mismatches);
        self.note(problem);
    }

    /// A session ended before its time.
    pub fn dropped(&self, problem: &str) {
        add(&self.dropped);
        self.note(problem);
    }

    /// A session was not admitted, or something asked for was refused.
    pub fn refused(&self, problem: &str) {
        add(&self.refused);
        self.note(problem);
    }

    /// A view was reported complete.
    pub fn view_settled(&self) {
        add(&self.views_settled);
    }

    /// An explicit request was sent.
    pub fn request(&self) {
        add(&self.requests);
    }

    /// An explicit request was answered after this time.
    pub fn answered(&self, latency: Duration) {
        let us = u64::try_from(latency.as_micros()).unwrap_or(u64::MAX);
        let mut histogram = self.latency_us.lock().unwrap_or_else(PoisonError::into_inner);
        histogram.saturating_record(us.clamp(1, MAX_LATENCY_US));
    }

    /// A session ended with this many requests open.
    pub fn unanswered(&self, requests: usize) {
        self.unanswered.fetch_add(requests as u64, Ordering::Relaxed);
    }

    /// Chunks, bytes and faults (mismatches and dropped sessions) so far, for a progress bar.
    #[must_use]
    pub fn progress(&self) -> (u64, u64, u64) {
        (get(&self.chunks), get(&self.bytes), get(&self.mismatches) + get(&self.dropped))
    }

    /// Everything counted, for a run of so many clients and seconds with this delivery.
    #[must_use]
    pub fn report(&self, clients: u32, seconds: f64, delivery: Delivery) -> Report {
        let histogram = self.latency_us.lock().unwrap_or_else(PoisonError::into_inner);
        // No answer is not a latency of zero.
        let quantile = |q| (!histogram.is_empty()).then(|| histogram.value_at_quantile(q) as f64 / 1000.0);
        Report {
            clients,
            seconds,
            delivery: delivery.name(),
            chunks: get(&self.chunks),
            bytes: get(&self.bytes),
            mismatches: get(&self.mismatches),
            dropped: get(&self.dropped),
            refused: get(&self.refused),
            latency_ms: LatencyMs { p50: quantile(0.5), p99: quantile(0.99), p999: quantile(0.999) },
            regenerated: get(&self.regenerated),
            views_settled: get(&self.views_settled),
            requests: get(&self.requests),
            unanswered: get(&self.unanswered),
            problems: self.problems.lock().unwrap_or_else(PoisonError::into_inner).clone(),
        }
    }

    fn note(&self, problem: &str) {
        let mut problems = self.problems.lock().unwrap_or_else(PoisonError::into_inner);
        if problems.len() < MAX_PROBLEMS && !problems.iter().any(|known| known == problem) {
            problems.push(problem.into());
        }
    }
}

fn add(counter: &AtomicU64) {
    counter.fetch_add(1, Ordering::Relaxed);
}

fn get(counter: &AtomicU64) -> u64 {
    counter.load(Ordering::Relaxed)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn quantiles_are_in_milliseconds_and_absent_without_answers() {
        let tally = Tally::default();
        assert_eq!(
            tally.report(1, 1.0, Delivery::Exact).latency_ms,
            LatencyMs { p50: None, p99: None, p999: None }
        );
        for ms in 1..=1000 {
            tally.answered(Duration::from_millis(ms));
        }
        let latency = tally.report(1, 1.0, Delivery::Exact).latency_ms;
        let near = |value: Option<f64>, ms: f64| value.is_some_and(|value| (value - ms).abs() < ms * 0.002);
        assert!(
            near(latency.p50, 500.0) && near(latency.p99, 990.0) && near(latency.p999, 999.0),
            "{latency:?}"
        );
    }

    #[test]
    fn absurd_latencies_are_kept_at_the_bound() {
        let tally = Tally::default();
        tally.answered(Duration::MAX);
        assert!(tally.report(1, 1.0, Delivery::Exact).latency_ms.p50.is_some_and(|ms| ms >= 599_000.0));
    }

    #[test]
    fn the_same_problem_is_told_once_and_counted_always() {
        let tally = Tally::default();
        for index in 0..100 {
            tally.dropped("gone");
            tally.refused(&format!("refusal {index}"));
        }
        let report = tally.report(1, 1.0, Delivery::Exact);
        assert_eq!((report.dropped, report.refused), (100, 100));
        assert_eq!(report.problems.len(), MAX_PROBLEMS);
        assert_eq!(report.problems.iter().filter(|problem| *problem == "gone").count(), 1);
    }
}
