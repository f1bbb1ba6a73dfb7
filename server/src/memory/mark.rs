//! The memory mark: while the process uses more of its memory than a share, no further session
//! begins, the selection of views stops, and the server sends no further chunks. The rest is for
//! what open sessions hold. Below the mark as many sessions begin, and as many views are selected
//! at once, as have room.
//!
//! Where few sessions have room below the mark, the caches are cleared; at the mark sessions end,
//! too, if that was done within seconds and did not help. Open sessions may still take more memory,
//! for what they have requested already. If the memory stays beyond the mark, sessions end, few at
//! a time; close to the limit, many: otherwise the system would end the process, and with it every
//! session. Those of the sites that have the most end first.

use super::limit::{MemoryLimit, OpenFiles};
use super::reclaim::{Pressure, Reclaim, Reclaimer};
use super::room::{Room, ViewRoom, least, mark, room_below};
use super::shedding::Shedding;
use crate::metrics::Metrics;
use crate::open_sessions::OpenSessions;
use std::net::IpAddr;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

/// The share above which threads return free pages, in eighths.
const NEAR_EIGHTHS: u64 = 5;

/// Polling interval. A poll takes some microseconds; views of many sessions that are selected at
/// once take some 10 MiB in this time.
const INTERVAL: Duration = Duration::from_millis(25);

/// The time in which as many sessions begin as have room below the mark.
const ADMISSION: Duration = Duration::from_millis(250);

/// Time with room for some sessions until a server that had none is ready again. A load balancer
/// would otherwise send its clients there and away for each session that ends.
const READY_AFTER: Duration = Duration::from_secs(10);

/// See the module.
#[derive(Debug)]
pub struct MemoryMark {
    limit: Option<MemoryLimit>,
    has_room: AtomicBool,
    is_unknown: AtomicBool,
    /// Whether the memory in use is beyond the mark now.
    is_exceeded: AtomicBool,
    room: Room,
}

impl MemoryMark {
    /// The mark of a limit; without one it is never reached.
    #[must_use]
    pub fn new(limit: Option<MemoryLimit>) -> Self {
        Self {
            limit,
            has_room: AtomicBool::new(true),
            is_unknown: AtomicBool::new(false),
            is_exceeded: AtomicBool::new(false),
            room: Room::unlimited(),
        }
    }

    /// Whether sessions have room, for some seconds if they had none. Otherwise `/readyz` answers
    /// 503.
    #[must_use]
    pub fn is_ready(&self) -> bool {
        self.has_room.load(Ordering::Relaxed) && !self.is_unknown.load(Ordering::Relaxed)
    }

    /// Whether no session may begin, and open ones may take no more memory.
    #[must_use]
    pub fn is_exceeded(&self) -> bool {
        self.is_exceeded.load(Ordering::Relaxed)
    }

    /// Takes the room of a session that begins, of a client whose site has `held` sessions; false
    /// if there is none. A site gets no more than remains for others.
    #[must_use]
    pub fn admits(&self, client: Option<IpAddr>, held: usize) -> bool {
        self.is_below() && self.room.begin_session(client, held)
    }

    /// Whether the memory in use is known and below the mark.
    #[must_use]
    pub fn is_below(&self) -> bool {
        !self.is_exceeded() && !self.is_unknown.load(Ordering::Relaxed)
    }

    /// The same, and no session has room.
    #[must_use]
    pub fn is_full(&self) -> bool {
        self.is_below() && self.room.is_full()
    }

    /// Takes the room of a view that a session of a site selects; none if there is none, or beyond
    /// the mark.
    #[must_use]
    pub fn room_for_view(&self, site: Option<IpAddr>) -> Option<ViewRoom> {
        if self.is_exceeded() { None } else { self.room.begin_view(site) }
    }

    /// How scarce memory is.
    fn pressure(&self, used: u64, limit: u64) -> Pressure {
        if self.is_exceeded() {
            Pressure::Exceeded
        } else if room_below(used, limit) < least(limit) {
            Pressure::NoRoom
        } else if used < limit / 8 * NEAR_EIGHTHS {
            Pressure::Low
        } else {
            Pressure::Near
        }
    }

    /// Records the memory in use, bytes. With `is_next` the next [`ADMISSION`] begins.
    fn record(&self, used: u64, limit: u64, is_next: bool) {
        self.is_unknown.store(false, Ordering::Relaxed);
        self.is_exceeded.store(used >= mark(limit), Ordering::Relaxed);
        self.room.record(used, limit, is_next);
    }

    /// Records that the memory in use is not known: no session begins, and open ones go on.
    fn record_unknown(&self) {
        self.is_unknown.store(true, Ordering::Relaxed);
        self.is_exceeded.store(false, Ordering::Relaxed);
    }
}

/// When a server is ready.
#[derive(Debug, Default)]
struct Readiness {
    /// Since when sessions have room; only while the server is not ready.
    since: Option<Instant>,
}

impl Readiness {
    /// Whether the server is ready, with room for so many sessions.
    fn update(&mut self, was_ready: bool, room: u64, least: u64, now: Instant) -> bool {
        if was_ready {
            self.since = None;
            return room > 0;
        }
        if room < least {
            self.since = None;
            return false;
        }
        now >= *self.since.get_or_insert(now) + READY_AFTER
    }
}

/// Samples the memory in use until it is dropped. Ends at once without a limit.
pub async fn watch(
    mark: Arc<MemoryMark>,
    metrics: Arc<Metrics>,
    sessions: OpenSessions,
    server: Arc<impl Reclaim>,
) {
    let Some(limit) = &mark.limit else { return };
    let bytes = limit.bytes();
    metrics.limits.memory_limit_bytes.set(i64::try_from(bytes).unwrap_or(i64::MAX));
    let mut ticks = tokio::time::interval(INTERVAL);
    ticks.set_missed_tick_behavior(tokio::time::MissedTickBehavior::Delay);
    let (mut shedding, mut reclaimer, mut readiness) =
        (Shedding::default(), Reclaimer::default(), Readiness::default());
    let mut room_at = Instant::now();
    let files = OpenFiles::default();
    loop {
        ticks.tick().await;
        let was_unknown = mark.is_unknown.load(Ordering::Relaxed);
        let Some(used) = limit.used_bytes(&files) else {
            if !was_unknown {
                tracing::error!(%limit, "the memory in use cannot be read: no further sessions begin");
            }
            mark.record_unknown();
            server.stop_views(false);
            continue;
        };
        if was_unknown {
            tracing::info!(%limit, "the memory in use can be read again");
        }
        let (now, used_mib) = (Instant::now(), used >> 20);
        let is_next = now >= room_at;
        if is_next {
            room_at = now + ADMISSION;
        }
        mark.record(used, bytes, is_next);
        server.stop_views(mark.is_exceeded());
        metrics.limits.memory_used_bytes.set(i64::try_from(used).unwrap_or(i64::MAX));

        let was_ready = mark.has_room.load(Ordering::Relaxed);
        let is_ready = readiness.update(was_ready, room_below(used, bytes), least(bytes), now);
        mark.has_room.store(is_ready, Ordering::Relaxed);
        if was_ready && !is_ready {
            tracing::warn!(used_mib, %limit, "memory is nearly used up: no further sessions begin");
        } else if is_ready && !was_ready {
            tracing::info!(used_mib, %limit, "memory is free again");
        }

        let is_refilled = reclaimer.update(mark.pressure(used, bytes), now, &*server);
        let count = sessions.shed(shedding.due(used, bytes, sessions.count(), is_refilled, now));
        if count > 0 {
            tracing::warn!(used_mib, %limit, count, "memory is nearly used up: sessions end");
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const MIB: u64 = 1 << 20;

    fn new_mark() -> MemoryMark {
        MemoryMark::new(Some(MemoryLimit::of_machine(800 * MIB)))
    }

    #[test]
    fn a_server_without_room_is_ready_again_when_it_had_room_for_some_seconds() {
        let (start, mut readiness, mut is_ready) = (Instant::now(), Readiness::default(), true);
        for (ms, room, expected) in [
            (0, 1, true),
            (1, 0, false),
            (2, 4, false),
            (10_001, 4, false),
            (10_002, 4, true),
            (10_003, 0, false),
            (10_100, 9, false),
            (15_000, 3, false),
            (20_100, 9, false),
            (30_099, 9, false),
            (30_100, 9, true),
            (30_200, 3, true),
        ] {
            is_ready = readiness.update(is_ready, room, 4, start + Duration::from_millis(ms));
            assert_eq!(is_ready, expected, "{ms} ms");
        }
    }

    #[test]
    fn sessions_begin_and_views_are_selected_below_the_mark() {
        let mark = new_mark();
        assert!(mark.is_ready() && mark.admits(None, 0));
        mark.record(590 * MIB, 800 * MIB, true);
        assert_eq!((0..100).filter(|_| mark.admits(None, 0)).count(), 5);
        let views: Vec<_> = (0..100).map_while(|_| mark.room_for_view(None)).collect();
        assert_eq!(views.len(), 3, "one more would leave the site more than others");
        drop(views);
        mark.record(600 * MIB, 800 * MIB, true);
        assert!(mark.is_exceeded() && !mark.admits(None, 0) && mark.room_for_view(None).is_none());
        assert!(!mark.is_full(), "sessions end anyway");
        mark.record(599 * MIB, 800 * MIB, true);
        assert!(mark.is_full());
        assert!(!mark.is_exceeded() && !mark.admits(None, 0) && mark.room_for_view(None).is_some());
    }

    #[test]
    fn pressure_grows_with_the_memory_in_use() {
        use Pressure::{Exceeded, Low, Near, NoRoom};
        let mark = new_mark();
        let pressures = [499, 500, 593, 600, 500, 599, 499].map(|used| {
            mark.record(used * MIB, 800 * MIB, true);
            mark.pressure(used * MIB, 800 * MIB)
        });
        assert_eq!(pressures, [Low, Near, NoRoom, Exceeded, Near, NoRoom, Low]);
    }

    #[test]
    fn where_the_memory_is_not_known_no_session_begins_and_open_ones_go_on() {
        let mark = new_mark();
        mark.record(700 * MIB, 800 * MIB, true);
        mark.record_unknown();
        assert_eq!((mark.is_ready(), mark.is_exceeded(), mark.admits(None, 0)), (false, false, false));
        assert!(mark.room_for_view(None).is_some());
        mark.record(499 * MIB, 800 * MIB, true);
        assert!(mark.is_ready() && mark.admits(None, 0), "one sample is enough");
    }
}
