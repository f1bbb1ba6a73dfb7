//! How many sessions end beyond the memory mark, and when.

use super::room::mark;
use crate::open_sessions::Shed;
use std::time::{Duration, Instant};

/// The share beyond which many sessions end, in eighths.
const CRITICAL_EIGHTHS: u64 = 7;

/// Sessions that end at once beyond the mark, as a divisor of the open ones, and the time until the
/// next ones.
const SHED: (usize, Duration) = (8, Duration::from_secs(1));

/// The same beyond the critical share, while memory grows. In this time the memory of the first
/// ones is given back.
const SHED_CRITICAL: (usize, Duration) = (2, Duration::from_millis(100));

/// When sessions end.
#[derive(Debug, Default)]
pub(super) struct Shedding {
    /// When sessions ended, or the memory came beyond the mark, and the memory in use then. None
    /// below the mark.
    last: Option<(Instant, u64)>,
    /// When sessions ended.
    ended: Option<Instant>,
}

impl Shedding {
    /// Which of the open sessions end now. With `is_refilled` the caches were cleared, not long
    /// after the last time, which did not help.
    pub(super) fn due(
        &mut self,
        used: u64,
        limit: u64,
        open: usize,
        is_refilled: bool,
        now: Instant,
    ) -> Shed {
        if used < mark(limit) {
            self.last = None;
            return Shed::default();
        }
        // The allocator gives memory back late: what does not grow is not critical. Memory that was
        // below the mark at the last sample has grown.
        let has_grown = self.last.is_none_or(|(_, before)| used > before);
        let is_critical = used >= limit / 8 * CRITICAL_EIGHTHS && has_grown;
        let (divisor, pause) = if is_critical { SHED_CRITICAL } else { SHED };
        let is_due = match self.last {
            None => is_critical,
            Some((last, _)) => now >= last + pause,
        };
        // Sessions that hold the memory below the mark must not keep the caches empty.
        let is_refilled = is_refilled && self.ended.is_none_or(|ended| now >= ended + SHED.1);
        if is_due || is_refilled {
            (self.last, self.ended) = (Some((now, used)), Some(now));
            return Shed { count: open.div_ceil(divisor), is_critical };
        }
        self.last.get_or_insert((now, used));
        Shed::default()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Samples at a limit of 800 bytes.
    fn samples() -> impl FnMut(u64, usize, bool, u64) -> (usize, bool) {
        let (start, mut shedding) = (Instant::now(), Shedding::default());
        move |used, open, is_refilled, ms| {
            let now = start + Duration::from_millis(ms);
            let Shed { count, is_critical } = shedding.due(used, 800, open, is_refilled, now);
            (count, is_critical)
        }
    }

    #[test]
    fn more_sessions_end_sooner_where_memory_grows_close_to_the_limit() {
        let mut sample = samples();
        let mut due = |used, open, ms| sample(used, open, false, ms);
        let none = (0, false);
        assert_eq!(due(600, 100, 0), none, "the mark was reached just now");
        assert_eq!(due(600, 100, 1000), (13, false));
        assert_eq!(due(650, 87, 1500), none);
        assert_eq!(due(700, 87, 1500), (44, true));
        assert_eq!(due(720, 43, 1550), none);
        assert_eq!(due(720, 43, 1600), (22, true));
        assert_eq!(due(720, 21, 1700), none, "it does not grow");
        assert_eq!(due(720, 21, 2600), (3, false));
        assert_eq!(due(730, 0, 2700), (0, true));
        assert_eq!(due(599, 18, 9000), none, "below the mark");
        assert_eq!(due(699, 18, 9100), none, "it was exceeded again just now");
        assert_eq!(due(699, 18, 10_099), none);
        assert_eq!(due(699, 18, 10_100), (3, false));
    }

    #[test]
    fn memory_that_grows_beyond_the_critical_share_between_two_samples_ends_sessions_at_once() {
        let mut sample = samples();
        assert_eq!(sample(599, 18, false, 0), (0, false));
        assert_eq!(sample(700, 18, false, 25), (9, true));
        assert_eq!(sample(710, 9, false, 50), (0, false));
    }

    #[test]
    fn sessions_end_once_a_second_where_the_caches_fill_the_memory_again() {
        let mut sample = samples();
        let mut due = |used, is_refilled, ms| sample(used, 80, is_refilled, ms).0;
        assert_eq!(due(600, true, 0), 10, "at once");
        assert_eq!(due(600, false, 999), 0);
        assert_eq!(due(600, true, 999), 0, "sessions ended within the second");
        assert_eq!(due(600, false, 1000), 10);
        assert_eq!(due(599, false, 2100), 0, "below the mark");
        assert_eq!(due(600, false, 2200), 0, "it was exceeded again just now");
        assert_eq!(due(600, true, 2300), 10, "the caches do not wait for that");
        assert_eq!(due(600, false, 3200), 0, "sessions ended within the second");
        assert_eq!(due(600, false, 3300), 10);
    }
}
