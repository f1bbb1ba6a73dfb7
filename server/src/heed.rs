//! How long a session is not listened to after it was refused something. Plain data: the socket has
//! the clock.
//!
//! To read, judge and refuse a request is work as well, and no turn of the generation service
//! bounds it: a client that asks again the moment it is refused could keep a core busy with nothing
//! else, at the cost of everybody's chunks. So a session gets its share of that work too. What it
//! was refused is counted in time, that of all who share the server, and for as long nothing is
//! read from it; what it is owed it gets meanwhile. The rest waits in the socket's buffers, and in
//! the end in the client.

use std::time::Duration;
use tokio::time::Instant;

/// What one refusal costs a thread: reading, judging and writing. Rather too much than too little:
/// it is a client's part not to ask again at once.
const REFUSAL: Duration = Duration::from_micros(4);

/// The longest pause. A cancellation or a new view behind the refused requests should not wait for
/// longer.
const MOST: Duration = Duration::from_millis(100);

/// Shorter pauses are not worth a timer, and whoever asks a hundred times a second hardly notices
/// them. They are not forgotten: they add up as long as time does not pass over them.
const LEAST: Duration = Duration::from_millis(10);

/// See the module.
#[derive(Clone, Copy, Debug)]
pub struct Heed {
    /// Until when what was refused is not made good by time.
    owes_until: Instant,
    /// From when on it is read again, once a pause has begun.
    pause: Option<Instant>,
}

impl Heed {
    /// Nothing was refused.
    #[must_use]
    pub const fn new(now: Instant) -> Self {
        Self { owes_until: now, pause: None }
    }

    /// So many requests were refused, while `sharers` share a thread. Tells whether a pause begins.
    pub fn refused(&mut self, count: u64, sharers: usize, now: Instant) -> bool {
        let times = u32::try_from(count.saturating_mul(sharers.max(1) as u64)).unwrap_or(u32::MAX);
        let debt = self.owes_until.saturating_duration_since(now) + REFUSAL.saturating_mul(times);
        self.owes_until = now + debt.min(MOST);
        let was_paused = self.pause(now).is_some();
        if debt >= LEAST {
            self.pause = Some(self.owes_until);
        }
        !was_paused && self.pause.is_some()
    }

    /// Until when nothing is to be read; none if there is no pause.
    pub fn pause(&mut self, now: Instant) -> Option<Instant> {
        self.pause = self.pause.filter(|end| *end > now);
        self.pause
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_pause_is_as_long_as_all_sharers_refusals_would_take() {
        let now = Instant::now();
        for (count, sharers, expected_us) in [(6000, 1, 24_000), (600, 10, 24_000), (6000, 0, 24_000)] {
            let mut heed = Heed::new(now);
            heed.refused(count, sharers, now);
            let end = now + Duration::from_micros(expected_us);
            assert_eq!(heed.pause(now), Some(end));
            assert_eq!(heed.pause(end), None, "and then it is over");
        }
    }

    #[test]
    fn no_pause_is_endless_whatever_was_refused() {
        let now = Instant::now();
        let mut heed = Heed::new(now);
        for _ in 0..3 {
            heed.refused(u64::MAX, usize::MAX, now);
            assert_eq!(heed.pause(now), Some(now + MOST));
        }
        assert_eq!(heed.pause(now + MOST), None);
    }

    #[test]
    fn whoever_is_refused_now_and_then_is_always_heard_and_whoever_is_refused_without_end_is_not() {
        let start = Instant::now();
        // A refusal among ten sharers takes 40 us from everybody: one in 50 us is within its share,
        // one in 30 is not.
        for (every_us, is_paused) in [(50, false), (30, true)] {
            let (mut heed, mut pauses) = (Heed::new(start), 0);
            for number in 0..1000 {
                let now = start + Duration::from_micros(every_us * number);
                heed.refused(1, 10, now);
                pauses += u32::from(heed.pause(now).is_some());
            }
            assert_eq!(pauses > 0, is_paused, "one in {every_us} us: {pauses}");
        }
    }
}
