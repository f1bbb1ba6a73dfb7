//! What a server gives back where memory lacks: the caches at the memory mark, and from the lower
//! share on the free pages of its threads.

use super::heaps;
use std::time::{Duration, Instant};
use tokio::runtime::Handle;

/// Longest time that an idle worker of the runtime is kept from the tasks of another.
const WAKE: Duration = Duration::from_millis(1);

/// Time between two clears of the caches.
const CLEAR_INTERVAL: Duration = Duration::from_secs(1);

/// Time between two requests for free pages below the mark, where each takes the threads some
/// milliseconds, and sessions fill the pages again.
const RETURN_INTERVAL: Duration = Duration::from_secs(5);

/// A server with memory that it can do without.
pub trait Reclaim: Send + Sync + 'static {
    /// Clears the caches in memory.
    fn clear_caches(&self);

    /// Has threads that are no workers of the runtime call [`heaps::return_if_requested`].
    fn return_pages(&self);
}

/// When memory is given back.
#[derive(Debug, Default)]
pub(super) struct Reclaimer {
    cleared: Option<Instant>,
    returned: Option<Instant>,
}

/// What is given back.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Due {
    Nothing,
    Pages,
    CachesAndPages,
}

impl Reclaimer {
    /// Gives back what is due where the memory in use is above the lower share (`is_near`), or
    /// beyond the mark too.
    pub(super) fn look(&mut self, is_near: bool, is_exceeded: bool, now: Instant, server: &impl Reclaim) {
        match self.due(is_near, is_exceeded, now) {
            Due::Nothing => return,
            Due::Pages => {}
            Due::CachesAndPages => server.clear_caches(),
        }
        heaps::request_return();
        server.return_pages();
        // A worker that waits looks at the request when it waits again. Each task takes one for a
        // moment, so that no worker takes them all.
        for _ in 0..Handle::current().metrics().num_workers() {
            tokio::spawn(async { std::thread::sleep(WAKE) });
        }
    }

    fn due(&mut self, is_near: bool, is_exceeded: bool, now: Instant) -> Due {
        let is_after = |last: Option<Instant>, interval| last.is_none_or(|last| now >= last + interval);
        if is_exceeded && is_after(self.cleared, CLEAR_INTERVAL) {
            (self.cleared, self.returned) = (Some(now), Some(now));
            Due::CachesAndPages
        } else if is_near && is_after(self.returned, RETURN_INTERVAL) {
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
    fn caches_are_cleared_at_the_mark_and_pages_returned_from_the_lower_share_on() {
        let start = Instant::now();
        let mut reclaimer = Reclaimer::default();
        let mut due = |used, ms| reclaimer.due(used >= 500, used >= 600, start + Duration::from_millis(ms));
        assert_eq!(due(499, 0), Due::Nothing);
        assert_eq!(due(500, 0), Due::Pages);
        assert_eq!(due(599, 4999), Due::Nothing);
        assert_eq!(due(599, 5000), Due::Pages);
        assert_eq!(due(600, 5025), Due::CachesAndPages, "the mark does not wait for the interval");
        assert_eq!(due(700, 6024), Due::Nothing);
        assert_eq!(due(700, 6025), Due::CachesAndPages);
        assert_eq!(due(599, 11_024), Due::Nothing);
        assert_eq!(due(599, 11_025), Due::Pages);
        assert_eq!(due(600, 11_050), Due::CachesAndPages);
    }
}
