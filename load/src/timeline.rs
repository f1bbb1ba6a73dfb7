//! Figures of every second of a run.
//!
//! One histogram suffices: the clock only moves forward, so a second is closed by the first event
//! of a later one.

use crate::latency::Latencies;
use serde::Serialize;
use std::sync::{Mutex, MutexGuard, PoisonError};
use std::time::Duration;
use tokio::time::Instant;

/// One second. A second without arrivals has zeros and no latencies, so a stall is visible.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct Second {
    /// Seconds since the start of the run.
    pub second: u64,
    /// Chunks received.
    pub chunks: u64,
    /// Bytes of their frames.
    pub bytes: u64,
    /// Answers in this second, whenever they were requested.
    pub answers: u64,
    /// Median of their latencies, milliseconds.
    pub p50_ms: Option<f64>,
    /// 99th percentile, milliseconds.
    pub p99_ms: Option<f64>,
    /// Longest, milliseconds.
    pub max_ms: Option<f64>,
}

#[derive(Debug)]
struct Seconds {
    done: Vec<Second>,
    current: Second,
    latencies: Latencies,
}

/// See the module. Time zero is its creation.
#[derive(Debug)]
pub struct Timeline {
    started: Instant,
    /// A mutex suffices: its sections are short and nothing awaits while it is held.
    seconds: Mutex<Seconds>,
}

impl Timeline {
    /// An empty timeline that starts now.
    #[must_use]
    pub fn starting_now() -> Self {
        let seconds =
            Seconds { done: Vec::new(), current: Second::default(), latencies: Latencies::default() };
        Self { started: Instant::now(), seconds: Mutex::new(seconds) }
    }

    /// Time since the start.
    #[must_use]
    pub fn elapsed(&self) -> Duration {
        self.started.elapsed()
    }

    /// A chunk arrived.
    pub fn chunk(&self, bytes: usize) {
        let mut seconds = self.advanced();
        seconds.current.chunks += 1;
        seconds.current.bytes += bytes as u64;
    }

    /// A request was answered.
    pub fn answered(&self, latency: Duration) {
        let mut seconds = self.advanced();
        seconds.current.answers += 1;
        seconds.latencies.record(latency);
    }

    /// All seconds until now. The last one is incomplete.
    #[must_use]
    pub fn seconds(&self) -> Vec<Second> {
        let seconds = self.advanced();
        let mut all = seconds.done.clone();
        all.push(seconds.so_far());
        all
    }

    /// The last complete second, if any.
    #[must_use]
    pub fn last(&self) -> Option<Second> {
        self.advanced().done.last().copied()
    }

    /// The state, advanced to the current second.
    fn advanced(&self) -> MutexGuard<'_, Seconds> {
        let mut seconds = self.seconds.lock().unwrap_or_else(PoisonError::into_inner);
        let now = self.started.elapsed().as_secs();
        while seconds.current.second < now {
            let over = seconds.so_far();
            seconds.done.push(over);
            seconds.latencies.clear();
            seconds.current = Second { second: over.second + 1, ..Second::default() };
        }
        seconds
    }
}

impl Seconds {
    fn so_far(&self) -> Second {
        if self.latencies.is_empty() {
            return self.current;
        }
        let quantiles = self.latencies.quantiles();
        Second { p50_ms: quantiles.p50, p99_ms: quantiles.p99, max_ms: quantiles.max, ..self.current }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[tokio::test(start_paused = true)]
    async fn every_second_has_a_row_and_an_idle_second_is_empty() {
        let timeline = Timeline::starting_now();
        timeline.chunk(100);
        timeline.answered(Duration::from_millis(5));
        tokio::time::advance(Duration::from_millis(2500)).await;
        timeline.chunk(7);
        timeline.chunk(8);
        let rows = timeline.seconds();
        assert_eq!(
            rows.iter().map(|row| (row.second, row.chunks, row.bytes)).collect::<Vec<_>>(),
            [(0, 1, 100), (1, 0, 0), (2, 2, 15)]
        );
        assert_eq!((rows[0].answers, rows[0].p50_ms.map(f64::round)), (1, Some(5.0)));
        assert_eq!((rows[1].answers, rows[1].max_ms), (0, None), "latencies of earlier seconds are cleared");
        assert_eq!(timeline.last(), Some(rows[1]));
    }
}
