//! A walk: a round of straight legs at a walking pace, turning where one leg ends.

use super::{Motion, PathRandom, REACH_M};
use std::f64::consts::TAU;

/// Walking pace, metres a second: what people prefer on even ground (Browning et al., J. Appl.
/// Physiol. 100, 2006).
const PACE: f64 = 1.4;

/// Corners of a round.
const CORNERS: usize = 16;

/// How far a corner is from the middle of the round, metres.
const RADIUS_M: (f64, f64) = (40.0, 160.0);

#[derive(Clone, Copy, Debug)]
pub(super) struct Round {
    /// East and south of the origin, metres; the round leads back to the first.
    corners_m: [(f64, f64); CORNERS],
    /// Way from the first corner to the end of each leg, metres.
    ends_m: [f64; CORNERS],
}

impl Round {
    pub(super) fn new(random: PathRandom) -> Self {
        let middle = random.place_m((5, 6), REACH_M);
        let start = random.between(7, 0.0, TAU);
        let direction = if random.share(4) < 0.5 { -1.0 } else { 1.0 };
        let corners_m = std::array::from_fn(|corner| {
            let angle = start + direction * TAU * corner as f64 / CORNERS as f64;
            let radius = random.between(0x100 + corner as u32, RADIUS_M.0, RADIUS_M.1);
            (middle.0 + radius * angle.cos(), middle.1 + radius * angle.sin())
        });
        let mut way = 0.0;
        let ends_m = std::array::from_fn(|leg| {
            let (from, to) = (corners_m[leg], corners_m[(leg + 1) % CORNERS]);
            way += (to.0 - from.0).hypot(to.1 - from.1);
            way
        });
        Self { corners_m, ends_m }
    }

    pub(super) fn motion(&self, seconds: f64) -> Motion {
        let way = (PACE * seconds).rem_euclid(self.ends_m[CORNERS - 1]);
        // Rounding may leave the way at the very end of the round.
        let leg = self.ends_m.iter().position(|end| way < *end).unwrap_or(CORNERS - 1);
        let began = if leg == 0 { 0.0 } else { self.ends_m[leg - 1] };
        let (from, to) = (self.corners_m[leg], self.corners_m[(leg + 1) % CORNERS]);
        let length = self.ends_m[leg] - began;
        let along = ((to.0 - from.0) / length, (to.1 - from.1) / length);
        Motion::along(
            (from.0 + along.0 * (way - began), from.1 + along.1 * (way - began)),
            (along.0 * PACE, along.1 * PACE),
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_pace_is_kept_and_the_way_turns() {
        for seed in 0..200 {
            let round = Round::new(PathRandom(seed));
            let mut turns = 0;
            let mut before = round.motion(0.0);
            for step in 1..6000 {
                let now = round.motion(f64::from(step) * 0.1);
                let moved = (now.place_m.0 - before.place_m.0).hypot(now.place_m.1 - before.place_m.1);
                assert!(moved <= PACE * 0.1 + 1e-9, "{moved}");
                assert!((now.velocity.0.hypot(now.velocity.1) - PACE).abs() < 1e-9);
                turns += usize::from((now.heading - before.heading).abs() > 1e-6);
                before = now;
            }
            assert!(turns >= 5, "{turns} turns in 840 m");
        }
    }
}
