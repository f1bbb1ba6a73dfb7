//! Refusal back-off: a session is not read for a while after many of its requests were rejected.
//! Plain data; the driver has the clock.
//!
//! Reading and rejecting a request takes processor time that no queue accounts for. A client that
//! repeats rejected requests at once could occupy a core. The back-off bounds this work to the
//! session's fair share: each rejection adds its cost, multiplied by the flows that share a thread,
//! to a debt in time, and the session is not read while the debt lasts. Pending chunks are still
//! sent. Unread input stays in the socket buffers, so TCP slows the client down.

use std::time::Duration;
use tokio::time::Instant;

/// Cost of one rejection to a thread: reading, parsing and writing. An upper estimate.
const REFUSAL_COST: Duration = Duration::from_micros(4);

/// The longest pause, so that a cancellation or a view behind rejected requests is read soon.
const MAX_PAUSE: Duration = Duration::from_millis(100);

/// The shortest pause; less is not worth a timer. Smaller debts accumulate until time pays them.
const MIN_PAUSE: Duration = Duration::from_millis(10);

/// See the module.
#[derive(Clone, Copy, Debug)]
pub struct RefusalBackoff {
    /// When the debt of rejections is paid.
    debt_until: Instant,
    /// When a pause that has begun ends.
    pause: Option<Instant>,
}

impl RefusalBackoff {
    /// No debt.
    #[must_use]
    pub const fn new(now: Instant) -> Self {
        Self { debt_until: now, pause: None }
    }

    /// Records `count` rejections while `sharers` flows share a thread. Returns whether a pause
    /// begins.
    pub fn record(&mut self, count: u64, sharers: usize, now: Instant) -> bool {
        let times = u32::try_from(count.saturating_mul(sharers.max(1) as u64)).unwrap_or(u32::MAX);
        let debt = self.debt_until.saturating_duration_since(now) + REFUSAL_COST.saturating_mul(times);
        self.debt_until = now + debt.min(MAX_PAUSE);
        let was_paused = self.paused_until(now).is_some();
        if debt >= MIN_PAUSE {
            self.pause = Some(self.debt_until);
        }
        !was_paused && self.pause.is_some()
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

    #[test]
    fn a_pause_lasts_as_long_as_the_refusals_of_all_sharers() {
        let now = Instant::now();
        for (count, sharers, expected_us) in [(6000, 1, 24_000), (600, 10, 24_000), (6000, 0, 24_000)] {
            let mut backoff = RefusalBackoff::new(now);
            backoff.record(count, sharers, now);
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
            backoff.record(u64::MAX, usize::MAX, now);
            assert_eq!(backoff.paused_until(now), Some(now + MAX_PAUSE));
        }
        assert_eq!(backoff.paused_until(now + MAX_PAUSE), None);
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
                backoff.record(1, 10, now);
                pauses += u32::from(backoff.paused_until(now).is_some());
            }
            assert_eq!(pauses > 0, is_paused, "one in {every_us} us: {pauses}");
        }
    }
}
