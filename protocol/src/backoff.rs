//! Delays between attempts to reconnect: exponential, capped, with jitter.

use std::time::Duration;

/// The delays after consecutive failures.
#[derive(Clone, Debug)]
pub struct Backoff {
    first: Duration,
    longest: Duration,
    attempt: u32,
    /// State of the generator: jitter must differ between clients, but may be predictable.
    seed: u64,
}

impl Backoff {
    /// Delays from `first`, doubled after each failure, to at most `longest`. Clients with
    /// different seeds spread their attempts.
    #[must_use]
    pub const fn new(first: Duration, longest: Duration, seed: u64) -> Self {
        Self { first, longest, attempt: 0, seed: seed | 1 }
    }

    /// Starts over with the shortest delay, after a success.
    pub const fn reset(&mut self) {
        self.attempt = 0;
    }

    /// The delay before the next attempt: doubled each time, then between half and all of it, so
    /// that the clients of a restarted server do not all return at once.
    pub fn next_delay(&mut self) -> Duration {
        let full = self.first.saturating_mul(1 << self.attempt.min(16)).min(self.longest);
        self.attempt = self.attempt.saturating_add(1);
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

    const FIRST: Duration = Duration::from_millis(250);
    const LONGEST: Duration = Duration::from_secs(10);

    #[test]
    fn delays_double_up_to_the_cap_and_are_never_longer() {
        let mut backoff = Backoff::new(FIRST, LONGEST, 7);
        for attempt in 0..40 {
            let full = FIRST.saturating_mul(1 << attempt.min(16)).min(LONGEST);
            let delay = backoff.next_delay();
            assert!(delay >= full / 2 && delay <= full, "attempt {attempt}: {delay:?}");
        }
        backoff.reset();
        assert!(backoff.next_delay() <= FIRST);
    }

    #[test]
    fn two_clients_do_not_return_together() {
        let delays = |seed| {
            let mut backoff = Backoff::new(FIRST, LONGEST, seed);
            (0..8).map(|_| backoff.next_delay()).collect::<Vec<_>>()
        };
        assert_ne!(delays(2), delays(40));
    }

    /// States of xorshift64 with the shifts 13, 7 and 17. The upper 24 bits of a state are the
    /// share of the second half of a delay.
    #[test]
    fn the_share_of_a_delay_is_the_next_number_of_the_generator() {
        let two = Duration::from_secs(2);
        let mut backoff = Backoff::new(two, two, 0x9e37_79b9_7f4a_7c15);
        for state in [0xdc1b_77ae_0bf3_4dad_u64, 0x64f0_eeb9_026e_6076, 0x7b07_ce91_e590_6136] {
            let share = (backoff.next_delay().as_secs_f64() - 1.0) * f64::from(1 << 24);
            assert_eq!(share.round() as u64, state >> 40);
        }
    }
}
