//! Delays between attempts to reconnect: exponential, capped, with jitter.

use std::time::Duration;

/// The delays after consecutive failures.
#[derive(Clone, Debug)]
pub struct Backoff {
    first: Duration,
    longest: Duration,
    attempt: u32,
    /// State of the generator: jitter must differ between clients, but may be predictable.
    state: u64,
}

impl Backoff {
    /// Delays from `first`, doubled after each failure, to at most `longest`. Clients with
    /// different seeds spread their attempts; seeds may be small and consecutive.
    #[must_use]
    pub const fn new(first: Duration, longest: Duration, seed: u64) -> Self {
        Self { first, longest, attempt: 0, state: seed }
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
        let share = (self.next_bits() >> 40) as f64 / f64::from(1 << 24);
        full.mul_f64(0.5 + 0.5 * share)
    }

    /// SplitMix64 (Steele, Lea and Flood, "Fast Splittable Pseudorandom Number Generators", OOPSLA
    /// 2014): its finaliser spreads every bit of a seed over the first number.
    const fn next_bits(&mut self) -> u64 {
        self.state = self.state.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut mixed = self.state;
        mixed = (mixed ^ mixed >> 30).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        mixed = (mixed ^ mixed >> 27).wrapping_mul(0x94d0_49bb_1331_11eb);
        mixed ^ mixed >> 31
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

    /// Clients number themselves: their first delays fill all sixteenths of the second half alike.
    #[test]
    fn consecutive_small_seeds_spread_the_first_delays() {
        let two = Duration::from_secs(2);
        let mut parts = [0; 16];
        for seed in 0..1600 {
            let delay = Backoff::new(two, two, seed).next_delay();
            parts[((delay.as_secs_f64() - 1.0) * 16.0) as usize] += 1;
        }
        assert!(parts.iter().all(|count| (60..140).contains(count)), "{parts:?}");
    }

    /// The first numbers for the seed 1234567, <https://prng.di.unimi.it/splitmix64.c>. Their upper
    /// 24 bits are the share of the second half of a delay.
    #[test]
    fn the_share_of_a_delay_is_the_next_number_of_the_generator() {
        let two = Duration::from_secs(2);
        let mut backoff = Backoff::new(two, two, 1_234_567);
        for number in [6_457_827_717_110_365_317_u64, 3_203_168_211_198_807_973] {
            let share = (backoff.next_delay().as_secs_f64() - 1.0) * f64::from(1 << 24);
            assert_eq!(share.round() as u64, number >> 40);
        }
    }
}
