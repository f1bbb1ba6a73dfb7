//! Teleports: stays at unrelated positions, so that no two views share fine chunks.

use super::{Motion, PathRandom, REACH_M};
use std::f64::consts::TAU;
use terrain::hash::hash2;

/// Mean time between two jumps, seconds.
const MEAN_STAY_S: f64 = 2.0;

/// A jump comes up to this long after its slot of [`MEAN_STAY_S`] begins, seconds: a stay lasts 0.5
/// to 3.5 s.
const LATE_S: f64 = 1.5;

#[derive(Clone, Copy, Debug)]
pub(super) struct Stays {
    seed: u32,
}

impl Stays {
    pub(super) const fn new(random: PathRandom) -> Self {
        Self { seed: random.0 }
    }

    pub(super) fn motion(&self, seconds: f64) -> Motion {
        let random = PathRandom(hash2(self.seed, self.stay(seconds), 0));
        let heading = random.between(3, 0.0, TAU);
        Motion { place_m: random.place_m((1, 2), REACH_M), velocity: (0.0, 0.0), heading }
    }

    /// Number of the stay at a time: that of the slot, or the previous one before the jump.
    fn stay(&self, seconds: f64) -> i32 {
        let slot = (seconds / MEAN_STAY_S).floor();
        let number = slot as i32;
        let jump = slot * MEAN_STAY_S + PathRandom(hash2(self.seed, number, 1)).between(4, 0.0, LATE_S);
        if number > 0 && seconds < jump { number - 1 } else { number }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn stays_last_as_long_as_promised_and_jumps_are_at_each_clients_own_times() {
        let jumps = |seed| {
            let stays = Stays { seed };
            let mut jumps = Vec::new();
            for step in 1..60_000u32 {
                let (before, now) = (f64::from(step - 1) * 0.01, f64::from(step) * 0.01);
                if stays.motion(now) != stays.motion(before) {
                    jumps.push(now);
                }
            }
            jumps
        };
        let (one, other) = (jumps(1), jumps(2));
        assert!(one.len() == 299 && one != other);
        for pair in one.windows(2) {
            assert!((0.48..=3.52).contains(&(pair[1] - pair[0])), "{pair:?}");
        }
        let lengths = one.windows(2).map(|pair| pair[1] - pair[0]);
        let (shortest, longest) =
            lengths.fold((f64::MAX, 0.0f64), |(low, high), s| (low.min(s), high.max(s)));
        assert!(shortest < 1.0 && longest > 3.0, "the control: a clock would have one length");
    }
}
