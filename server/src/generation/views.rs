//! View selection on the generation threads.
//!
//! The selection of a view's chunks is scheduled like generation: it waits for the session's turn,
//! runs within the turn's budget, and is charged by its duration. Threads that accept connections
//! and answer probes never run it.

use super::work_time::WorkClock;
use crate::limits::rate_limit::TokenBucket;
use crate::memory::room::ViewRoom;
use protocol::server::ViewSelection;
use std::time::Duration;
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
    /// Its room below the memory mark, free when the selection has ended.
    pub room: Option<ViewRoom>,
    /// Receives the finished selection; dropped without one if the selection panicked.
    pub completion: oneshot::Sender<ViewSelection>,
}

impl ViewJob {
    /// Continues for about `budget_us` microseconds, or until another flow must not wait. Returns
    /// whether the selection is finished or its session has ended, and the time that this call
    /// took.
    pub fn run(
        &mut self,
        clock: &dyn WorkClock,
        budget_us: i64,
        must_stop: impl Fn() -> bool,
    ) -> (bool, Duration) {
        #[cfg(test)]
        assert_ne!(self.selection.view().id, 666, "this view panics");
        let started = clock.clock();
        let elapsed = || clock.clock().saturating_sub(started);
        let budget = Duration::from_micros(budget_us.max(0).unsigned_abs());
        let mut is_done = self.completion.is_closed();
        while !is_done && elapsed() < budget {
            is_done = self.selection.step(&self.land, STEP_CHUNKS);
            if must_stop() {
                break;
            }
        }
        let spent = elapsed();
        self.spent += spent;
        (is_done, spent)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::generation::test_source::view_selection;
    use crate::generation::work_time::SystemClock;

    #[test]
    fn a_view_makes_one_step_a_turn_while_another_flow_must_not_wait() {
        let (completion, _receiver) = oneshot::channel();
        let (land, bucket) = (Land::new(1), TokenBucket::default());
        let selection = view_selection(1);
        let mut job = ViewJob { selection, land, bucket, spent: Duration::ZERO, room: None, completion };
        let (clock, mut turns) = (SystemClock::default(), 1);
        while !job.run(&clock, i64::MAX, || true).0 {
            turns += 1;
        }
        assert!(turns > 2, "{turns}");

        // The control: without another flow one turn is enough.
        let (completion, _receiver) = oneshot::channel();
        let mut job = ViewJob { selection: view_selection(1), completion, ..job };
        assert!(job.run(&clock, i64::MAX, || false).0);
    }
}
