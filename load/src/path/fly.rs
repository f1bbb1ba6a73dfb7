//! Flight: a circle at one speed.

use super::{Motion, PathRandom, REACH_M};
use std::f64::consts::TAU;

#[derive(Clone, Copy, Debug)]
pub(super) struct Circle {
    /// East and south of the origin, metres.
    centre_m: (f64, f64),
    radius_m: f64,
    /// Radians a second, signed: half of the clients turn left.
    turn: f64,
    /// Angle at time zero, radians.
    start: f64,
}

impl Circle {
    pub(super) fn new(random: PathRandom) -> Self {
        let (radius_m, speed_m) = (random.between(1, 500.0, 2_500.0), random.between(2, 50.0, 120.0));
        let direction = if random.share(4) < 0.5 { -1.0 } else { 1.0 };
        Self {
            centre_m: random.place_m((5, 6), REACH_M),
            radius_m,
            turn: direction * speed_m / radius_m,
            start: random.between(7, 0.0, TAU),
        }
    }

    pub(super) fn motion(&self, seconds: f64) -> Motion {
        let (sin, cos) = (self.start + self.turn * seconds).sin_cos();
        let speed = self.turn * self.radius_m;
        Motion::along(
            (self.centre_m.0 + self.radius_m * cos, self.centre_m.1 + self.radius_m * sin),
            (-sin * speed, cos * speed),
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn speeds_and_radii_are_within_what_is_promised() {
        for seed in 0..1000 {
            let circle = Circle::new(PathRandom(seed));
            let speed = (circle.turn * circle.radius_m).abs();
            assert!((50.0..=120.0).contains(&speed) && (500.0..=2500.0).contains(&circle.radius_m));
        }
    }
}
