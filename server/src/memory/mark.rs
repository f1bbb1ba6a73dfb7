//! The memory mark: while the process uses more of its memory than a share, no further session
//! begins, and the server selects no further views and sends no further chunks. The rest is for what
//! open sessions hold.
//!
//! Where few sessions have room below the mark, the caches are cleared; at the mark sessions end, too,
//! if that was done within seconds and did not help. Open sessions may still take more memory, for
//! what they have requested already. If the memory stays beyond the mark, sessions end, few at a time;
//! close to the limit, many: otherwise the system would end the process, and with it every session.
//! Those of the sites that have the most end first.

use super::limit::{MemoryLimit, OpenFiles};
use super::reclaim::{Pressure, Reclaim, Reclaimer};
use crate::limits::networks::client_site;
use crate::metrics::Metrics;
use crate::open_sessions::OpenSessions;
use std::collections::HashMap;
use std::net::IpAddr;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

/// The share of the limit beyond which no session begins, in eighths.
const MARK_EIGHTHS: u64 = 6;

/// The share below which the server is ready again, in eighths. Between both sessions begin as far
/// as there is room below the mark.
const READY_EIGHTHS: u64 = 5;

/// The share beyond which many sessions end, in eighths.
const CRITICAL_EIGHTHS: u64 = 7;

/// Polling interval. A poll takes some microseconds; views of many sessions that are selected at
/// once take some 10 MiB in this time.
const INTERVAL: Duration = Duration::from_millis(25);

/// Memory that a session may take before the server notices.
const SESSION_BYTES: u64 = 2 << 20;

/// Sessions that have room below the mark, whatever the caches hold: with less room the caches are
/// cleared. With a small limit fewer, a sixteenth of it.
const LEAST_ROOM: u64 = 4;

/// The time in which as many sessions begin as have room below the mark.
const ADMISSION: Duration = Duration::from_millis(250);

/// Sessions that end at once beyond the mark, as a divisor of the open ones, and the time until the
/// next ones.
const SHED: (usize, Duration) = (8, Duration::from_secs(1));

/// The same beyond the critical share, while memory grows. In this time the memory of the first ones
/// is given back.
const SHED_CRITICAL: (usize, Duration) = (2, Duration::from_millis(100));

/// See the module.
#[derive(Debug)]
pub struct MemoryMark {
    limit: Option<MemoryLimit>,
    /// Whether the server is not ready: from the mark until the lower share.
    is_reached: AtomicBool,
    /// Whether the memory in use is beyond the mark now.
    is_exceeded: AtomicBool,
    room: Mutex<Room>,
}

/// Sessions that may begin until the next [`ADMISSION`].
#[derive(Debug)]
struct Room {
    left: u64,
    /// Those that began, by site. At most one entry for each.
    taken: HashMap<IpAddr, u64>,
}

impl MemoryMark {
    /// The mark of a limit; without one it is never reached.
    #[must_use]
    pub fn new(limit: Option<MemoryLimit>) -> Self {
        Self {
            limit,
            is_reached: AtomicBool::new(false),
            is_exceeded: AtomicBool::new(false),
            room: Mutex::new(Room { left: u64::MAX, taken: HashMap::new() }),
        }
    }

    /// Whether `/readyz` answers 503 for lack of memory.
    #[must_use]
    pub fn is_reached(&self) -> bool {
        self.is_reached.load(Ordering::Relaxed)
    }

    /// Whether no session may begin, and open ones may take no more memory.
    #[must_use]
    pub fn is_exceeded(&self) -> bool {
        self.is_exceeded.load(Ordering::Relaxed)
    }

    /// Takes the room of a session that begins; false if there is none. A site gets no
    /// more than remains for others, as with [`crate::limits::per_ip::PerIpLimiter::fair_share`].
    #[must_use]
    pub fn admits(&self, client: Option<IpAddr>) -> bool {
        if self.is_exceeded() {
            return false;
        }
        let mut room = self.room();
        let Some(left) = room.left.checked_sub(1) else { return false };
        if let Some(client) = client.filter(|_| self.limit.is_some()) {
            let taken = room.taken.entry(client_site(client)).or_default();
            if *taken > left {
                return false;
            }
            *taken += 1;
        }
        room.left = left;
        true
    }

    /// Makes room for the sessions of the next [`ADMISSION`].
    fn make_room(&self, used: u64, limit: u64) {
        let mut room = self.room();
        room.taken.clear();
        room.left = room_below(used, limit);
    }

    fn room(&self) -> MutexGuard<'_, Room> {
        // Nothing under the lock panics in the middle of a change.
        self.room.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// How scarce memory is.
    fn pressure(&self, used: u64, limit: u64) -> Pressure {
        if self.is_exceeded() {
            Pressure::Exceeded
        } else if room_below(used, limit) < (limit / 16 / SESSION_BYTES).clamp(1, LEAST_ROOM) {
            Pressure::NoRoom
        } else if used < limit / 8 * READY_EIGHTHS {
            Pressure::Low
        } else if self.is_reached() {
            Pressure::Unready
        } else {
            Pressure::Near
        }
    }

    /// Records the memory in use, bytes; true if that changes whether the server is ready.
    fn record(&self, used: u64, limit: u64) -> bool {
        let was_reached = self.is_reached();
        let mark = if was_reached { READY_EIGHTHS } else { MARK_EIGHTHS };
        let is_reached = used >= limit / 8 * mark;
        self.is_reached.store(is_reached, Ordering::Relaxed);
        self.is_exceeded.store(used >= limit / 8 * MARK_EIGHTHS, Ordering::Relaxed);
        is_reached != was_reached
    }

    /// Records that the memory in use is not known: no session begins, and open ones go on.
    fn record_unknown(&self) {
        self.is_reached.store(true, Ordering::Relaxed);
        self.is_exceeded.store(false, Ordering::Relaxed);
        let mut room = self.room();
        room.taken.clear();
        room.left = 0;
    }
}

/// Sessions that have room below the mark.
fn room_below(used: u64, limit: u64) -> u64 {
    (limit / 8 * MARK_EIGHTHS).saturating_sub(used) / SESSION_BYTES
}

/// When sessions end.
#[derive(Debug, Default)]
struct Shedding {
    /// When sessions ended, or the memory came beyond the mark, and the memory in use then. None
    /// below the mark.
    last: Option<(Instant, u64)>,
    /// When sessions ended.
    ended: Option<Instant>,
}

impl Shedding {
    /// How many of the open sessions end now. With `is_refilled` the caches were cleared, not long
    /// after the last time, which did not help.
    fn due(&mut self, used: u64, limit: u64, open: usize, is_refilled: bool, now: Instant) -> usize {
        if used < limit / 8 * MARK_EIGHTHS {
            self.last = None;
            return 0;
        }
        // Sessions that hold the memory below the mark must not keep the caches empty.
        let (refill_divisor, refill_pause) = SHED;
        if is_refilled && self.ended.is_none_or(|ended| now >= ended + refill_pause) {
            (self.last, self.ended) = (Some((now, used)), Some(now));
            return open.div_ceil(refill_divisor);
        }
        let (last, used_then) = *self.last.get_or_insert((now, used));
        // The allocator gives memory back late: what does not grow is not critical.
        let is_critical = used >= limit / 8 * CRITICAL_EIGHTHS && used > used_then;
        let (divisor, pause) = if is_critical { SHED_CRITICAL } else { SHED };
        if now < last + pause {
            return 0;
        }
        (self.last, self.ended) = (Some((now, used)), Some(now));
        open.div_ceil(divisor)
    }
}

/// Looks at the memory in use until it is dropped. Ends at once without a limit.
pub async fn watch(
    mark: Arc<MemoryMark>,
    metrics: Arc<Metrics>,
    sessions: OpenSessions,
    server: Arc<impl Reclaim>,
) {
    let Some(limit) = &mark.limit else { return };
    metrics.limits.memory_limit_bytes.set(i64::try_from(limit.bytes()).unwrap_or(i64::MAX));
    let mut ticks = tokio::time::interval(INTERVAL);
    ticks.set_missed_tick_behavior(tokio::time::MissedTickBehavior::Delay);
    let (mut shedding, mut reclaimer) = (Shedding::default(), Reclaimer::default());
    let mut room_at = Instant::now();
    let (files, mut is_unknown) = (OpenFiles::default(), false);
    loop {
        ticks.tick().await;
        let Some(used) = limit.used_bytes(&files) else {
            if !std::mem::replace(&mut is_unknown, true) {
                tracing::error!(%limit, "the memory in use cannot be read: no further sessions begin");
            }
            mark.record_unknown();
            continue;
        };
        if std::mem::replace(&mut is_unknown, false) {
            tracing::info!(%limit, "the memory in use can be read again");
        }
        metrics.limits.memory_used_bytes.set(i64::try_from(used).unwrap_or(i64::MAX));
        let now = Instant::now();
        if mark.record(used, limit.bytes()) {
            let (used_mib, is_reached) = (used >> 20, mark.is_reached());
            if is_reached {
                tracing::warn!(used_mib, %limit, "memory is nearly used up: no further sessions begin");
            } else {
                tracing::info!(used_mib, %limit, "memory is free again");
            }
        }
        let is_refilled = reclaimer.look(mark.pressure(used, limit.bytes()), now, &*server);
        if now >= room_at {
            mark.make_room(used, limit.bytes());
            room_at = now + ADMISSION;
        }
        let count = sessions.shed(shedding.due(used, limit.bytes(), sessions.count(), is_refilled, now));
        if count > 0 {
            let used_mib = used >> 20;
            tracing::warn!(used_mib, %limit, count, "memory is nearly used up: sessions end");
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_server_is_ready_again_below_a_lower_share() {
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
        let admitted = |mark: &MemoryMark| (0..100).filter(|_| mark.admits(None)).count();
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
    fn room_lacks_below_four_sessions_or_a_sixteenth_of_the_limit() {
        use Pressure::{Exceeded, Low, Near, NoRoom, Unready};
        const MIB: u64 = 1 << 20;
        let mark = MemoryMark::new(None);
        for (limit, most) in [(800, 592), (128, 88), (64, 44), (16, 10)] {
            assert_ne!(mark.pressure(most * MIB, limit * MIB), NoRoom, "{limit} MiB");
            assert_eq!(mark.pressure(most * MIB + 1, limit * MIB), NoRoom, "{limit} MiB");
        }
        let pressures = [499, 500, 593, 600, 500, 599, 499, 500].map(|used| {
            mark.record(used * MIB, 800 * MIB);
            mark.pressure(used * MIB, 800 * MIB)
        });
        assert_eq!(pressures, [Low, Near, NoRoom, Exceeded, Unready, NoRoom, Low, Near]);
    }

    #[test]
    fn one_site_gets_no_more_room_than_remains_for_others() {
        let mark = MemoryMark::new(Some(MemoryLimit::of_machine(800 << 20)));
        let admitted = |last: u8| (0..100).filter(|_| mark.admits(Some([10, 0, 0, last].into()))).count();
        for _ in 0..2 {
            mark.make_room(560 << 20, 800 << 20);
            assert_eq!([admitted(1), admitted(2), admitted(1), admitted(3)], [10, 5, 0, 3]);
        }
    }

    #[test]
    fn open_sessions_go_on_below_the_mark_before_the_server_is_ready() {
        let mark = MemoryMark::new(Some(MemoryLimit::of_machine(800 << 20)));
        let states = [590, 600, 599, 500, 499].map(|used| {
            mark.record(used, 800);
            (mark.is_reached(), mark.is_exceeded())
        });
        assert_eq!(states, [(false, false), (true, true), (true, false), (true, false), (false, false)]);
    }

    #[test]
    fn where_the_memory_is_not_known_no_session_begins_and_open_ones_go_on() {
        let mark = MemoryMark::new(Some(MemoryLimit::of_machine(800 << 20)));
        mark.make_room(0, 800 << 20);
        mark.record(700, 800);
        mark.record_unknown();
        assert_eq!((mark.is_reached(), mark.is_exceeded(), mark.admits(None)), (true, false, false));
        assert!(mark.record(499, 800), "it is known again");
        assert!(!mark.is_reached());
    }

    #[test]
    fn more_sessions_end_sooner_where_memory_grows_close_to_the_limit() {
        let start = Instant::now();
        let mut shedding = Shedding::default();
        let at = |ms| start + Duration::from_millis(ms);
        assert_eq!(shedding.due(600, 800, 100, false, at(0)), 0, "the mark was reached just now");
        assert_eq!(shedding.due(600, 800, 100, false, at(1000)), 13);
        assert_eq!(shedding.due(650, 800, 87, false, at(1500)), 0);
        assert_eq!(shedding.due(700, 800, 87, false, at(1500)), 44);
        assert_eq!(shedding.due(720, 800, 43, false, at(1550)), 0);
        assert_eq!(shedding.due(720, 800, 43, false, at(1600)), 22);
        assert_eq!(shedding.due(720, 800, 21, false, at(1700)), 0, "it does not grow");
        assert_eq!(shedding.due(720, 800, 21, false, at(2600)), 3);
        assert_eq!(shedding.due(730, 800, 0, false, at(2700)), 0);
        // The server is not ready between: this is above the lower share.
        assert_eq!(shedding.due(599, 800, 18, false, at(9000)), 0, "below the mark");
        assert_eq!(shedding.due(760, 800, 18, false, at(9100)), 0, "it was exceeded again just now");
        assert_eq!(shedding.due(760, 800, 18, false, at(10_099)), 0);
        assert_eq!(shedding.due(760, 800, 18, false, at(10_100)), 3);
    }
    #[test]
    fn sessions_end_once_a_second_where_the_caches_fill_the_memory_again() {
        let start = Instant::now();
        let mut shedding = Shedding::default();
        let mut due = |used, is_refilled, ms| {
            shedding.due(used, 800, 80, is_refilled, start + Duration::from_millis(ms))
        };
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
