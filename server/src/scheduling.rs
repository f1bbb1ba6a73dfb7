//! Sharing of a processor between the threads of connections and of generation.
//!
//! Where two busy threads share a processor, the scheduler of Linux changes between them at its
//! tick, 4 ms apart at 250 Hz, and a chunk needs both kinds of threads twice. Each thread therefore
//! yields after [`YIELD_INTERVAL`] of work without a wait. Threads that wait for work more often do
//! not yield: the scheduler charges a yield, and their next work would wait for it.

use crate::mechanism::Mechanism;
use std::cell::Cell;
use std::time::{Duration, Instant};

/// Time of work after which a thread yields.
pub const YIELD_INTERVAL: Duration = Duration::from_micros(400);

thread_local! {
    /// When this thread last waited or yielded; none before.
    static WORKING_SINCE: Cell<Option<Instant>> = const { Cell::new(None) };
}

/// Notes that this thread has waited for work.
pub fn waited() {
    WORKING_SINCE.set(Some(Instant::now()));
}

/// Between two pieces of work: lets another thread run if this one has worked for
/// [`YIELD_INTERVAL`], unless a measurement turns that off. Nothing in shuttle, which changes
/// threads at each lock.
pub fn yield_if_due(without: Option<Mechanism>) {
    if without != Some(Mechanism::ThreadYields) && is_due(WORKING_SINCE.get(), Instant::now()) {
        #[cfg(not(shuttle))]
        std::thread::yield_now();
        waited();
    }
}

fn is_due(working_since: Option<Instant>, now: Instant) -> bool {
    working_since.is_none_or(|since| now.duration_since(since) >= YIELD_INTERVAL)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_thread_yields_after_its_interval_of_work() {
        let now = Instant::now();
        assert!(is_due(None, now));
        assert!(!is_due(Some(now), now + YIELD_INTERVAL / 2));
        assert!(is_due(Some(now), now + YIELD_INTERVAL));
    }

    #[test]
    fn only_a_yield_and_a_wait_begin_the_interval_again() {
        WORKING_SINCE.set(None);
        yield_if_due(Some(Mechanism::ThreadYields));
        assert_eq!(WORKING_SINCE.get(), None, "turned off");
        yield_if_due(None);
        assert!(WORKING_SINCE.get().is_some(), "a yield");
        WORKING_SINCE.set(None);
        waited();
        assert!(WORKING_SINCE.get().is_some(), "a wait");
    }
}
