//! Refusal back-off: a session is not read for a while after many of its requests were rejected.
//! Plain data; the driver has the clock.
//!
//! Reading and rejecting a request takes processor time that no queue accounts for. A client that
//! repeats rejected requests at once could occupy a core. The back-off bounds this work to the
//! session's fair share: each rejection makes the back-off longer by its cost, multiplied by the
//! sharers of a thread, and the session is not read until the back-off ends. A long back-off has
//! several pauses, with one small read after each. Pending chunks are still sent. Unread input
//! stays in the socket buffers, so TCP slows the client down.

use protocol::message::RefusalReason;
use protocol::server::SessionCounts;
use std::time::Duration;
use tokio::time::Instant;

/// Cost of one rejection to a thread: reading, parsing and writing. An upper estimate.
const REFUSAL_COST: Duration = Duration::from_micros(4);

/// Cost of a view that was superseded or refused. About eight times what it takes, so that views of
/// all sessions together get an eighth of a thread: no client needs more views than frames, and
/// each takes time from generation. 60 a second of each of two hundred sessions on a thread, all
/// superseded, cause no pause.
const VIEW_COST: Duration = Duration::from_micros(32);

/// Bytes that are read at once of a session that has been paused for its views: about 30 of them,
/// so that its turns on the thread are short. For so long after a pause.
const SMALL_READ: usize = 2048;
const CAUTION: Duration = Duration::from_secs(1);

/// Bytes that are read at once between two pauses: some 110 keys, which take a thread 0.4 ms of
/// each 0.1 s for each such session. A client that sends 120 views a second still sends less, and a
/// message of 8 KiB arrives within 0.8 s, a sixth of the 5 s that it may take.
const READ_BETWEEN_PAUSES: usize = 1024;

/// The longest pause, so that a cancellation or a view behind rejected requests is read soon.
const MAX_PAUSE: Duration = Duration::from_millis(100);

/// The longest back-off; the rest of a cost is dropped. One full read of invalid keys costs more
/// beyond 700 sharers.
const MAX_BACKOFF: Duration = Duration::from_secs(5);

/// The shortest pause; less is not worth a timer. A shorter back-off causes none unless further
/// rejections come before its end.
const MIN_PAUSE: Duration = Duration::from_millis(10);

/// A session that is paused for half of such a time, or longer, is named in the log. A client that
/// waits after refusals, as the protocol asks, is paused for less, unless hundreds of sessions
/// share a thread.
const LOG_WINDOW: Duration = Duration::from_secs(10);

/// The rejections of a session.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Rejections {
    /// Requested keys and grants; cancelled ones in generation, too, whose charge is returned.
    pub requests: u64,
    /// Views, superseded ones included.
    pub views: u64,
}

impl Rejections {
    /// Those between two counts of a session.
    #[must_use]
    pub fn since(before: &SessionCounts, now: &SessionCounts) -> Self {
        let refusals = |counts: &SessionCounts| counts.refusals.iter().sum::<u64>();
        let invalid = |counts: &SessionCounts| counts.refusals[RefusalReason::InvalidView.index()];
        let invalid_views = invalid(now) - invalid(before);
        Self {
            requests: refusals(now) - refusals(before) - invalid_views + now.cancelled - before.cancelled,
            views: now.superseded_views - before.superseded_views + invalid_views,
        }
    }

    /// Their cost, as time of a thread.
    fn cost(self) -> Duration {
        let times = |count: u64| u32::try_from(count).unwrap_or(u32::MAX);
        REFUSAL_COST.saturating_mul(times(self.requests)) + VIEW_COST.saturating_mul(times(self.views))
    }
}

/// See the module.
#[derive(Clone, Copy, Debug)]
pub struct RefusalBackoff {
    /// When the back-off ends.
    until: Instant,
    /// When a pause that has begun ends.
    pause: Option<Instant>,
    /// Until when little is read at once.
    cautious_until: Instant,
    /// The end of the current [`LOG_WINDOW`], and the pauses in it that the log does not have yet.
    window_end: Instant,
    paused: Duration,
}

impl RefusalBackoff {
    /// A back-off that has ended.
    #[must_use]
    pub const fn new(now: Instant) -> Self {
        Self { until: now, pause: None, cautious_until: now, window_end: now, paused: Duration::ZERO }
    }

    /// Records rejections of a session with one of `sharers` equal shares of a thread. Returns
    /// whether a pause begins.
    pub fn record(&mut self, rejections: Rejections, sharers: usize, now: Instant) -> bool {
        let sharers = u32::try_from(sharers.max(1)).unwrap_or(u32::MAX);
        let cost = rejections.cost().saturating_mul(sharers);
        self.until = now + self.remaining(now).saturating_add(cost).min(MAX_BACKOFF);
        if self.remaining(now) >= MIN_PAUSE && rejections.views > 0 {
            self.cautious_until = self.until + CAUTION;
        }
        self.pause(now)
    }

    /// Begins a pause if the back-off goes on, unless one has begun: to be called after each read.
    /// Returns whether one begins.
    pub fn pause(&mut self, now: Instant) -> bool {
        let remaining = self.remaining(now);
        let begins = remaining >= MIN_PAUSE && self.paused_until(now).is_none();
        if begins {
            let length = remaining.min(MAX_PAUSE);
            self.pause = Some(now + length);
            if now >= self.window_end {
                (self.window_end, self.paused) = (now + LOG_WINDOW, Duration::ZERO);
            }
            self.paused += length;
        }
        begins
    }

    /// Whether the session was paused for 5 s of 10 s since this was last true.
    pub fn take_excess(&mut self) -> bool {
        let is_excess = self.paused >= LOG_WINDOW / 2;
        if is_excess {
            self.paused = Duration::ZERO;
        }
        is_excess
    }

    /// When the back-off ends; at most 5 s from the last rejection.
    #[must_use]
    pub const fn until(&self) -> Instant {
        self.until
    }

    fn remaining(&self, now: Instant) -> Duration {
        self.until.saturating_duration_since(now)
    }

    /// Bytes to read at once; at most what the socket reads.
    #[must_use]
    pub fn read_size(&self, now: Instant) -> usize {
        // Nothing remains at the end of the last pause.
        if self.remaining(now) >= MIN_PAUSE {
            READ_BETWEEN_PAUSES
        } else if now < self.cautious_until {
            SMALL_READ
        } else {
            usize::MAX
        }
    }

    /// The end of the current pause; none if the session may be read.
    pub fn paused_until(&mut self, now: Instant) -> Option<Instant> {
        self.pause = self.pause.filter(|end| *end > now);
        self.pause
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const fn requests(requests: u64) -> Rejections {
        Rejections { requests, views: 0 }
    }

    #[test]
    fn a_pause_lasts_as_long_as_the_refusals_of_all_sharers() {
        let now = Instant::now();
        for (count, sharers, expected_us) in [(6000, 1, 24_000), (600, 10, 24_000), (6000, 0, 24_000)] {
            let mut backoff = RefusalBackoff::new(now);
            backoff.record(requests(count), sharers, now);
            let end = now + Duration::from_micros(expected_us);
            assert_eq!(backoff.paused_until(now), Some(end));
            assert_eq!(backoff.paused_until(end), None, "the pause ends");
        }
    }

    #[test]
    fn a_pause_is_bounded_for_any_number_of_refusals() {
        let now = Instant::now();
        let mut backoff = RefusalBackoff::new(now);
        for _ in 0..3 {
            backoff.record(Rejections { requests: u64::MAX, views: u64::MAX }, usize::MAX, now);
            assert_eq!(backoff.paused_until(now), Some(now + MAX_PAUSE));
        }
        assert_eq!(backoff.paused_until(now + MAX_PAUSE), None);
    }

    #[test]
    fn views_of_every_frame_never_pause_and_a_flood_of_them_does() {
        let start = Instant::now();
        // 60 a second and 20,000 a second, where two hundred sessions share a thread.
        for (every_us, is_paused) in [(16_667, false), (50, true)] {
            let (mut backoff, mut pauses) = (RefusalBackoff::new(start), 0);
            for number in 0..1000 {
                let now = start + Duration::from_micros(every_us * number);
                backoff.record(Rejections { requests: 0, views: 1 }, 200, now);
                pauses += u32::from(backoff.paused_until(now).is_some());
            }
            assert_eq!(pauses > 0, is_paused, "one in {every_us} us: {pauses}");
            let end = start + Duration::from_micros(every_us * 1000);
            assert_eq!(backoff.read_size(end) < usize::MAX, is_paused);
            assert_eq!(backoff.read_size(end + MAX_BACKOFF + 2 * CAUTION), usize::MAX);
        }
        let mut flood = RefusalBackoff::new(start);
        flood.record(Rejections { requests: 0, views: u64::MAX }, 1, start);
        let end = start + MAX_BACKOFF;
        assert_eq!(flood.read_size(end), SMALL_READ, "little for a while after the back-off");
        assert_eq!(flood.read_size(end + CAUTION - Duration::from_micros(1)), SMALL_READ);
        assert_eq!(flood.read_size(end + CAUTION), usize::MAX);
        let mut of_requests = RefusalBackoff::new(start);
        assert!(of_requests.record(requests(10_000), 1, start), "a pause");
        let end = of_requests.paused_until(start).unwrap();
        assert_eq!(of_requests.read_size(end), usize::MAX, "requests are read whole");
    }

    #[test]
    fn a_long_backoff_has_several_pauses_with_a_small_read_after_each() {
        let start = Instant::now();
        // One read of 16 KiB, of keys outside the world.
        let (keys, sharers) = (1800, 200);
        let whole = REFUSAL_COST * keys * sharers;
        assert!(whole > 14 * MAX_PAUSE && whole < MAX_BACKOFF);
        let mut backoff = RefusalBackoff::new(start);
        backoff.record(requests(keys.into()), sharers as usize, start);
        let (mut now, mut pauses) = (start, 0);
        while let Some(end) = backoff.paused_until(now) {
            assert!(end - now <= MAX_PAUSE);
            (now, pauses) = (end, pauses + 1);
            assert_eq!(backoff.paused_until(now), None, "a read");
            assert_eq!(backoff.read_size(now) < usize::MAX, now < start + whole);
            // Without a rejection.
            assert_eq!(backoff.pause(now), now < start + whole);
        }
        assert_eq!((now, pauses), (start + whole, 15));

        // The cost beyond the bound is dropped.
        backoff.record(requests(u64::MAX), usize::MAX, now);
        assert_eq!(backoff.read_size(now + MAX_BACKOFF), usize::MAX);
        assert!(!backoff.pause(now + MAX_BACKOFF));
    }

    #[test]
    fn a_session_that_does_not_stop_is_logged_and_one_that_does_is_not() {
        let start = Instant::now();
        // Refused keys at once, again as soon as they are read or after the waits of the protocol:
        // 50 ms, doubled up to 5 s.
        for (is_polite, expected) in [(false, 6), (true, 0)] {
            let (mut backoff, mut now, mut wait) = (RefusalBackoff::new(start), start, Duration::ZERO);
            let mut logged = 0;
            while now < start + 3 * LOG_WINDOW {
                backoff.record(requests(512), 50, now);
                while let Some(end) = backoff.paused_until(now) {
                    logged += u32::from(backoff.take_excess());
                    now = end;
                    backoff.pause(now);
                }
                wait = (2 * wait).clamp(Duration::from_millis(50), Duration::from_secs(5));
                now += if is_polite { wait } else { Duration::ZERO };
            }
            assert_eq!(logged, expected, "polite: {is_polite}");
        }
    }

    #[test]
    fn a_rejection_in_a_pause_does_not_make_it_longer() {
        let start = Instant::now();
        let mut backoff = RefusalBackoff::new(start);
        backoff.record(requests(10_000), 1, start);
        let end = backoff.paused_until(start).unwrap();
        let later = start + MIN_PAUSE;
        assert!(!backoff.record(requests(10_000), 1, later));
        assert_eq!(backoff.paused_until(later), Some(end));
        assert!(backoff.pause(end), "another one follows a read");
    }

    #[test]
    fn invalid_views_count_as_views() {
        let before = SessionCounts { superseded_views: 5, ..SessionCounts::default() };
        let mut now = SessionCounts { superseded_views: 7, ..before };
        now.refusals[RefusalReason::InvalidView.index()] = 3;
        now.refusals[RefusalReason::Overloaded.index()] = 4;
        now.cancelled = 2;
        assert_eq!(Rejections::since(&before, &now), Rejections { requests: 6, views: 5 });
        assert_eq!(Rejections::since(&now, &now), Rejections::default());
    }

    #[test]
    fn rare_refusals_never_pause_and_frequent_ones_do() {
        let start = Instant::now();
        // With ten sharers a refusal costs 40 us: one in 50 us is within the share of a session,
        // one in 30 us is not.
        for (every_us, is_paused) in [(50, false), (30, true)] {
            let (mut backoff, mut pauses) = (RefusalBackoff::new(start), 0);
            for number in 0..1000 {
                let now = start + Duration::from_micros(every_us * number);
                backoff.record(requests(1), 10, now);
                pauses += u32::from(backoff.paused_until(now).is_some());
            }
            assert_eq!(pauses > 0, is_paused, "one in {every_us} us: {pauses}");
        }
    }
}
