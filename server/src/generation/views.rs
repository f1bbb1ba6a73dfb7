//! View selection on the generation threads.
//!
//! The selection of a view's chunks is scheduled like generation: it waits for the session's turn,
//! runs within the turn's budget, and is charged by its duration. Threads that accept connections
//! and answer probes never run it.

use crate::limits::rate_limit::TokenBucket;
use protocol::server::ViewSelection;
use std::time::{Duration, Instant};
use terrain::Land;
use tokio::sync::oneshot;

/// Chunks examined between two clock readings: some 50 us.
const STEP_CHUNKS: usize = 256;

/// The selection of one session's view.
#[derive(Debug)]
pub struct ViewJob {
    /// The selection so far.
    pub selection: ViewSelection,
    /// The terrain.
    pub land: Land,
    /// The bucket that is charged.
    pub bucket: TokenBucket,
    /// Time spent so far.
    pub spent: Duration,
    /// Receives the finished selection; dropped without one if the selection panicked.
    pub completion: oneshot::Sender<ViewSelection>,
}

impl ViewJob {
    /// Continues for about `budget_us` microseconds. Returns whether the selection is finished or
    /// its session has ended, and the time that this call took.
    pub fn run(&mut self, budget_us: i64) -> (bool, Duration) {
        #[cfg(test)]
        assert_ne!(self.selection.view().id, 666, "this view panics");
        let started = Instant::now();
        let budget = Duration::from_micros(budget_us.max(0).unsigned_abs());
        let mut is_done = self.completion.is_closed();
        while !is_done && started.elapsed() < budget {
            is_done = self.selection.step(&self.land, STEP_CHUNKS);
        }
        let spent = started.elapsed();
        self.spent += spent;
        (is_done, spent)
    }
}
