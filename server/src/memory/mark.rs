//! The memory mark: while the process uses more of its memory than a share, no further session begins,
//! and open ones get nothing that takes more. What remains is for what they hold already.
//!
//! What many sessions hold together may still grow. If the memory stays beyond the mark, the newest
//! sessions end, few at a time; close to the limit, many: otherwise the system would end the process,
//! and with it every session.

use super::MemoryLimit;
use crate::metrics::Metrics;
use crate::stats::LiveStats;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::time::{Duration, Instant};

/// The share of the limit beyond which no session begins, and the one below which sessions begin
/// again; in eighths.
const MARK: (u64, u64) = (6, 5);

/// The share beyond which many sessions end, in eighths.
const DANGER: u64 = 7;

/// Time between two looks. A look takes some microseconds; views of many sessions that are selected at
/// once take some 10 MiB in this time.
const INTERVAL: Duration = Duration::from_millis(25);

/// Memory that a session may take before the server notices, and the time in which as many sessions
/// begin as have room below the mark.
const SESSION_BYTES: u64 = 2 << 20;
const ADMISSION: Duration = Duration::from_millis(250);

/// Sessions that end at once, as a divisor of the open ones, and the time until the next ones: beyond
/// the mark, and in danger. In the second time the memory of the first ones is given back.
const SHED: (usize, Duration) = (8, Duration::from_secs(1));
const SHED_IN_DANGER: (usize, Duration) = (2, Duration::from_millis(100));

/// See the module.
#[derive(Debug)]
pub struct MemoryMark {
    limit: Option<MemoryLimit>,
    is_reached: AtomicBool,
    /// Sessions that may begin until the next [`ADMISSION`].
    admitted: AtomicU64,
}

impl MemoryMark {
    /// The mark of a limit; without one it is never reached.
    #[must_use]
    pub const fn new(limit: Option<MemoryLimit>) -> Self {
        Self { limit, is_reached: AtomicBool::new(false), admitted: AtomicU64::new(u64::MAX) }
    }

    /// Whether no session may begin, and none may take more memory.
    #[must_use]
    pub fn is_reached(&self) -> bool {
        self.is_reached.load(Ordering::Relaxed)
    }

    /// Takes the room of a session that begins; false if there is none.
    #[must_use]
    pub fn admits(&self) -> bool {
        let take = |room: u64| room.checked_sub(1);
        !self.is_reached() && self.admitted.fetch_update(Ordering::Relaxed, Ordering::Relaxed, take).is_ok()
    }

    /// Makes room for the sessions of the next [`ADMISSION`].
    fn make_room(&self, used: u64, limit: u64) {
        let room = (limit / 8 * MARK.0).saturating_sub(used) / SESSION_BYTES;
        self.admitted.store(room, Ordering::Relaxed);
    }

    /// Records the memory in use, bytes; true if that changes whether sessions may begin.
    fn record(&self, used: u64, limit: u64) -> bool {
        let was_reached = self.is_reached();
        let mark = if was_reached { MARK.1 } else { MARK.0 };
        let is_reached = used >= limit / 8 * mark;
        self.is_reached.store(is_reached, Ordering::Relaxed);
        is_reached != was_reached
    }
}

/// When sessions ended, and the memory in use then.
#[derive(Debug)]
struct Pace {
    last: Instant,
    used: u64,
}

impl Pace {
    /// How many of the open sessions end now.
    fn due(&mut self, used: u64, limit: u64, open: usize, now: Instant) -> usize {
        // The allocator gives memory back late: what does not grow is not in danger.
        let is_in_danger = used >= limit / 8 * DANGER && used > self.used;
        let (divisor, pause) = if is_in_danger { SHED_IN_DANGER } else { SHED };
        if now < self.last + pause {
            return 0;
        }
        *self = Self { last: now, used };
        open.div_ceil(divisor)
    }
}

/// Looks at the memory in use until it is dropped. Ends at once without a limit.
pub async fn watch(mark: Arc<MemoryMark>, metrics: Arc<Metrics>, stats: LiveStats) {
    let Some(limit) = &mark.limit else { return };
    metrics.memory_limit_bytes.set(i64::try_from(limit.bytes()).unwrap_or(i64::MAX));
    let mut ticks = tokio::time::interval(INTERVAL);
    ticks.set_missed_tick_behavior(tokio::time::MissedTickBehavior::Delay);
    let mut pace = Pace { last: Instant::now(), used: 0 };
    let mut room_at = Instant::now();
    loop {
        ticks.tick().await;
        let Some(used) = limit.used_bytes() else { continue };
        metrics.memory_used_bytes.set(i64::try_from(used).unwrap_or(i64::MAX));
        let now = Instant::now();
        if mark.record(used, limit.bytes()) {
            let (used_mib, is_reached) = (used >> 20, mark.is_reached());
            if is_reached {
                pace = Pace { last: now, used };
                tracing::warn!(used_mib, %limit, "memory is nearly used up: no further sessions begin");
            } else {
                tracing::info!(used_mib, %limit, "memory is free again: sessions begin");
            }
        }
        if now >= room_at {
            mark.make_room(used, limit.bytes());
            room_at = now + ADMISSION;
        }
        // Below the mark, what was reached is only not free again.
        if used >= limit.bytes() / 8 * MARK.0 {
            let count = pace.due(used, limit.bytes(), stats.count(), now);
            if count > 0 {
                let used_mib = used >> 20;
                tracing::warn!(used_mib, %limit, count, "memory is nearly used up: sessions end");
                stats.shed(count);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sessions_begin_again_below_a_lower_share() {
        const LIMIT: u64 = 800 << 20;
        let mark = MemoryMark::new(Some(MemoryLimit::of_machine(LIMIT)));
        assert!(!mark.is_reached());
        for (used_mib, is_reached, changes) in [
            (599, false, false),
            (600, true, true),
            (799, true, false),
            (500, true, false),
            (499, false, true),
            (599, false, false),
        ] {
            assert_eq!(mark.record(used_mib << 20, LIMIT), changes, "{used_mib} MiB");
            assert_eq!(mark.is_reached(), is_reached, "{used_mib} MiB");
        }
    }

    #[test]
    fn as_many_sessions_begin_as_have_room_below_the_mark() {
        let mark = MemoryMark::new(None);
        let admitted = |mark: &MemoryMark| (0..100).filter(|_| mark.admits()).count();
        assert_eq!(admitted(&mark), 100, "without a look there is room");
        mark.make_room(590 << 20, 800 << 20);
        assert_eq!(admitted(&mark), 5);
        mark.make_room(700 << 20, 800 << 20);
        assert_eq!(admitted(&mark), 0);
        mark.make_room(0, 800 << 20);
        mark.record(700, 800);
        assert_eq!(admitted(&mark), 0);
    }

    #[test]
    fn more_sessions_end_sooner_where_memory_grows_close_to_the_limit() {
        let start = Instant::now();
        let mut pace = Pace { last: start, used: 600 };
        let at = |ms| start + Duration::from_millis(ms);
        assert_eq!(pace.due(600, 800, 100, at(0)), 0, "the mark was reached just now");
        assert_eq!(pace.due(600, 800, 100, at(1000)), 13);
        assert_eq!(pace.due(650, 800, 87, at(1500)), 0);
        assert_eq!(pace.due(700, 800, 87, at(1500)), 44);
        assert_eq!(pace.due(720, 800, 43, at(1550)), 0);
        assert_eq!(pace.due(720, 800, 43, at(1600)), 22);
        assert_eq!(pace.due(720, 800, 21, at(1700)), 0, "it does not grow");
        assert_eq!(pace.due(720, 800, 21, at(2600)), 3);
        assert_eq!(pace.due(730, 800, 0, at(2700)), 0);
    }
}
