//! Delays between attempts to reconnect: exponential, capped, with jitter.

use std::time::Duration;

const FIRST: Duration = Duration::from_millis(250);
const LONGEST: Duration = Duration::from_secs(10);

/// The delays of one run of failures.
#[derive(Clone, Debug)]
pub struct Backoff {
    attempt: u32,
    /// State of a small generator: jitter needs to differ between viewers, not to be unpredictable.
    seed: u64,
}

impl Backoff {
    /// Starts over; viewers with different seeds spread their attempts.
    #[must_use]
    pub fn new(seed: u64) -> Self {
        Self { attempt: 0, seed: seed | 1 }
    }

    /// Forgets the failures: a session succeeded.
    pub fn reset(&mut self) {
        self.attempt = 0;
    }

    /// How long to wait before the next attempt: doubled each time, then between half and all of
    /// it, so that the viewers of a server that restarts do not all return at once.
    pub fn next_delay(&mut self) -> Duration {
        let full = FIRST.saturating_mul(1 << self.attempt.min(16)).min(LONGEST);
        self.attempt += 1;
        // xorshift64 (Marsaglia, "Xorshift RNGs", 2003).
        self.seed ^= self.seed << 13;
        self.seed ^= self.seed >> 7;
        self.seed ^= self.seed << 17;
        let share = (self.seed >> 40) as f64 / f64::from(1 << 24);
        full.mul_f64(0.5 + 0.5 * share)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn delays_double_up_to_the_cap_and_are_never_longer() {
        let mut backoff = Backoff::new(7);
        for attempt in 0..40 {
            let full = FIRST.saturating_mul(1 << attempt.min(16)).min(LONGEST);
            let delay = backoff.next_delay();
            assert!(delay >= full / 2 && delay <= full, "attempt {attempt}: {delay:?}");
        }
        backoff.reset();
        assert!(backoff.next_delay() <= FIRST);
    }

    #[test]
    fn two_viewers_do_not_return_together() {
        let delays = |seed| {
            let mut backoff = Backoff::new(seed);
            (0..8).map(|_| backoff.next_delay()).collect::<Vec<_>>()
        };
        assert_ne!(delays(2), delays(40));
    }
}
