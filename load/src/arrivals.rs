//! The times at which an open loop acts. They are fixed before the run and do not depend on the
//! server.
//!
//! A closed loop waits for an answer before the next request, so a stalled server gets fewer
//! requests and the stall counts once ("coordinated omission", a term of G. Tene). Here the times
//! are a Poisson process, as of many independent users. Latency counts from them, also if a request
//! was sent late.

use std::time::Duration;
use terrain::hash::{hash2, mix};
use tokio::time::Instant;

/// One client's share of the arrivals, in order.
#[derive(Clone, Debug)]
pub struct Arrivals {
    seed: u32,
    /// Arrivals so far.
    number: u32,
    /// Mean time between two, seconds.
    mean_s: f64,
    epoch: Instant,
    /// Time of the next arrival.
    next_s: f64,
    /// No arrival is at this time or after it.
    end: Instant,
}

impl Arrivals {
    /// The arrivals of client `index` from `epoch` to `end`, `rate` a second on average. Poisson
    /// processes add up: all clients together have the sum of their rates.
    #[must_use]
    pub fn new(seed: u32, index: u32, rate: f64, epoch: Instant, end: Instant) -> Self {
        let seed = hash2(mix(seed ^ 0x6f70_656e), index as i32, 0);
        let mut arrivals = Self { seed, number: 0, mean_s: 1.0 / rate, epoch, next_s: 0.0, end };
        arrivals.next_s = arrivals.gap_s();
        arrivals
    }

    /// Time of the next arrival; none if it would be after the end.
    #[must_use]
    pub fn next(&self) -> Option<Instant> {
        let at =
            Duration::try_from_secs_f64(self.next_s).ok().and_then(|after| self.epoch.checked_add(after))?;
        (at < self.end).then_some(at)
    }

    /// Moves on to the next arrival.
    pub fn advance(&mut self) {
        self.number = self.number.wrapping_add(1);
        self.next_s += self.gap_s();
    }

    /// A time between two arrivals: exponentially distributed, by inversion of its distribution.
    fn gap_s(&self) -> f64 {
        // Never 0, which has no logarithm.
        let share = (f64::from(hash2(self.seed, self.number as i32, 1)) + 0.5) / (f64::from(u32::MAX) + 1.0);
        -share.ln() * self.mean_s
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn times(seed: u32, index: u32, rate: f64, seconds: u64) -> Vec<f64> {
        let epoch = Instant::now();
        let mut arrivals = Arrivals::new(seed, index, rate, epoch, epoch + Duration::from_secs(seconds));
        std::iter::from_fn(|| {
            let at = arrivals.next()?;
            arrivals.advance();
            Some((at - epoch).as_secs_f64())
        })
        .collect()
    }

    proptest! {
        #[test]
        fn arrivals_are_ordered_and_depend_on_seed_and_client_only(
            seed: u32, index in 0..100_000u32, rate in 0.1..200.0f64,
        ) {
            let once = times(seed, index, rate, 5);
            prop_assert_eq!(&once, &times(seed, index, rate, 5));
            prop_assert!(once.windows(2).all(|pair| pair[0] <= pair[1]));
            prop_assert!(once.iter().all(|at| (0.0..5.0).contains(at)));
        }
    }

    #[test]
    fn arrivals_are_a_poisson_process_of_the_rate() {
        // 1,000 clients of 10 a second for 100 s: a million expected, with a standard deviation of
        // a thousand.
        let n: usize = (0..1000).map(|index| times(1, index, 10.0, 100).len()).sum();
        assert!((996_000..1_004_000).contains(&n), "{n}");
        // Variance and mean of the counts in one second are equal; a clock would have no variance.
        let all: Vec<Vec<f64>> = (0..100).map(|index| times(1, index, 10.0, 20)).collect();
        let mut counts = vec![0.0f64; 2000];
        for (index, times) in all.iter().enumerate() {
            for at in times {
                counts[index * 20 + *at as usize] += 1.0;
            }
        }
        let mean = counts.iter().sum::<f64>() / 2000.0;
        let variance = counts.iter().map(|count| (count - mean).powi(2)).sum::<f64>() / 2000.0;
        assert!((0.85..1.15).contains(&(variance / mean)), "{variance} / {mean}");
        assert_ne!(all[0], all[1]);
    }
}
