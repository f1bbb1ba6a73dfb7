//! What a server gives back when memory is short: the caches where few sessions have room below the
//! memory mark, and from a lower share on the free pages of its threads.

use super::heaps;
use std::time::{Duration, Instant};
use tokio::runtime::Handle;

/// Time for which a worker of the runtime that has returned its pages leaves the next task to
/// another one.
const WAKE: Duration = Duration::from_millis(1);

/// Time between two clears of the caches beyond the mark; below it [`REFILL`].
const CLEAR_INTERVAL: Duration = Duration::from_secs(1);

/// Caches that are cleared again within this time were not what filled the memory, unless less was
/// in use between.
const REFILL: Duration = Duration::from_secs(10);

/// Time between two requests for free pages where sessions have no room: if several threads return
/// pages at the same time, mimalloc lets one of them give its pages to the system, and the others
/// at their next request.
const RETURN_INTERVAL: Duration = Duration::from_millis(250);

/// The same where they have room: each request takes the threads some milliseconds, and sessions
/// fill the pages again.
const EARLY_RETURN_INTERVAL: Duration = Duration::from_secs(5);

/// A server with memory that it can do without.
pub trait Reclaim: Send + Sync + 'static {
    /// Stops the selection of views, or has it go on.
    fn stop_views(&self, is_stopped: bool);

    /// Clears the caches in memory.
    fn clear_caches(&self);

    /// Has threads that are no workers of the runtime call [`heaps::return_if_requested`].
    fn return_pages(&self);
}

/// How scarce memory is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Pressure {
    /// The memory in use is below the lower share.
    Low,
    /// It is above the lower share.
    Near,
    /// Few sessions have room below the mark.
    NoRoom,
    /// It is beyond the mark.
    Exceeded,
}

/// When memory is given back.
#[derive(Debug, Default)]
pub(super) struct Reclaimer {
    cleared: Option<Instant>,
    returned: Option<Instant>,
    /// Whether the memory was above the lower share ever since the caches were cleared.
    stayed: bool,
}

/// What is given back.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Due {
    Nothing,
    Pages,
    /// The caches too.
    Caches {
        /// Whether that happened not long ago, and the memory has stayed above the lower share.
        is_again: bool,
    },
}

impl Reclaimer {
    /// Gives back what is due. Returns whether caches were cleared that had been cleared not long
    /// ago, which did not help.
    pub(super) fn update(&mut self, pressure: Pressure, now: Instant, server: &impl Reclaim) -> bool {
        let due = self.due(pressure, now);
        match due {
            Due::Nothing => return false,
            Due::Pages => {}
            Due::Caches { .. } => server.clear_caches(),
        }
        heaps::request_return();
        server.return_pages();
        // A worker that waits does not see the request. Each worker sleeps once at most, so that
        // none takes the tasks of all.
        for _ in 0..Handle::current().metrics().num_workers() {
            tokio::spawn(async {
                if heaps::return_if_requested() {
                    std::thread::sleep(WAKE);
                }
            });
        }
        due == Due::Caches { is_again: true }
    }

    fn due(&mut self, pressure: Pressure, now: Instant) -> Due {
        let (clear_interval, return_interval) = match pressure {
            Pressure::Low => {
                self.stayed = false;
                return Due::Nothing;
            }
            Pressure::Near => (None, EARLY_RETURN_INTERVAL),
            // Seldom: sessions may hold the memory, and caches are worth something in this time.
            Pressure::NoRoom => (Some(REFILL), RETURN_INTERVAL),
            Pressure::Exceeded => (Some(CLEAR_INTERVAL), RETURN_INTERVAL),
        };
        let is_after = |last: Option<Instant>, interval| last.is_none_or(|last| now >= last + interval);
        if clear_interval.is_some_and(|interval| is_after(self.cleared, interval)) {
            let is_again = self.stayed && !is_after(self.cleared, REFILL);
            *self = Self { cleared: Some(now), returned: Some(now), stayed: true };
            Due::Caches { is_again }
        } else if is_after(self.returned, return_interval) {
            self.returned = Some(now);
            Due::Pages
        } else {
            Due::Nothing
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn caches_are_cleared_where_room_lacks_and_pages_returned_from_the_lower_share_on() {
        use Pressure::{Exceeded, Low, Near, NoRoom};
        let start = Instant::now();
        let mut reclaimer = Reclaimer::default();
        let mut due = |pressure, ms| reclaimer.due(pressure, start + Duration::from_millis(ms));
        let (first, again) = (Due::Caches { is_again: false }, Due::Caches { is_again: true });
        assert_eq!(due(Low, 0), Due::Nothing);
        assert_eq!(due(Near, 0), Due::Pages);
        assert_eq!(due(Near, 4999), Due::Nothing);
        assert_eq!(due(Near, 5000), Due::Pages);
        assert_eq!(due(Exceeded, 5025), first, "the mark does not wait for the interval");
        assert_eq!(due(Exceeded, 5250), Due::Nothing);
        assert_eq!(due(Exceeded, 5275), Due::Pages);
        assert_eq!(due(Near, 6000), Due::Nothing);
        assert_eq!(due(Exceeded, 6025), again);
        assert_eq!(due(Near, 11_024), Due::Nothing);
        assert_eq!(due(Near, 11_025), Due::Pages);
        assert_eq!(due(NoRoom, 11_275), Due::Pages, "below the mark the caches stay for a while");
        assert_eq!(due(Exceeded, 16_024), again);
        assert_eq!(due(NoRoom, 26_024), first);
        assert_eq!(due(Low, 26_100), Due::Nothing);
        assert_eq!(due(Exceeded, 27_024), first, "the caches were what had filled the memory");
        assert_eq!(due(Exceeded, 28_024), again);
        assert_eq!(due(Near, 90_000), Due::Pages, "with room the caches stay");
    }
}
