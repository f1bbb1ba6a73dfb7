//! A stampede: all clients at the start of the world at the same time, then dispersing inland.

use super::{Motion, PathRandom};
use std::f64::consts::FRAC_PI_2;
use terrain::Start;
use terrain::constants::UNITS_PER_METRE;

/// Time at the spawn point, seconds.
pub(super) const STAY_S: f64 = 3.0;

/// Final distance, metres: minimum and maximum.
const FAR_M: (f64, f64) = (500.0, 2_500.0);

/// Initial speed, metres a second: minimum and maximum.
const SPEED: (f64, f64) = (10.0, 40.0);

#[derive(Clone, Copy, Debug)]
pub(super) struct Dispersal {
    /// East and south of the origin, metres; the same for all.
    spawn_m: (f64, f64),
    /// Direction as a vector of length 1.
    away: (f64, f64),
    far_m: f64,
    speed: f64,
}

impl Dispersal {
    /// From the start of a world, in a direction within a right angle of the way inland.
    pub(super) fn new(start: Start, own: PathRandom) -> Self {
        let metres = |units: i32| f64::from(units) / f64::from(UNITS_PER_METRE);
        let inland = f64::from(start.inland.1).atan2(f64::from(start.inland.0));
        let (sin, cos) = (inland + own.between(7, -FRAC_PI_2, FRAC_PI_2)).sin_cos();
        Self {
            spawn_m: (metres(start.x), metres(start.z)),
            away: (cos, sin),
            far_m: own.between(1, FAR_M.0, FAR_M.1),
            speed: own.between(2, SPEED.0, SPEED.1),
        }
    }

    /// The speed is proportional to the remaining distance, so the motion is smooth.
    pub(super) fn motion(&self, seconds: f64) -> Motion {
        let left = (-self.speed * (seconds - STAY_S).max(0.0) / self.far_m).exp();
        let (gone, speed) = (self.far_m * (1.0 - left), self.speed * left);
        let heading = self.away.0.atan2(-self.away.1);
        let speed = if seconds < STAY_S { 0.0 } else { speed };
        Motion {
            place_m: (self.spawn_m.0 + self.away.0 * gone, self.spawn_m.1 + self.away.1 * gone),
            velocity: (self.away.0 * speed, self.away.1 * speed),
            heading,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::path::{FlightPath, PathKind};

    #[test]
    fn all_clients_start_at_the_start_of_the_world_and_disperse_inland() {
        let start = Start { x: -600 * 256, z: 1500 * 256, inland: (19_661, -26_214) };
        let clients: Vec<_> =
            (0..100).map(|index| FlightPath::new(PathKind::Spawn, 5, index, start)).collect();
        let place = (-600.0, 1500.0);
        for path in &clients {
            assert_eq!((path.place_m(0.0), path.place_m(STAY_S)), (place, place));
        }
        let far = |seconds: f64| {
            let from = |path: &FlightPath| {
                let (east, south) = path.place_m(seconds);
                (east - place.0).hypot(south - place.1)
            };
            clients.iter().map(from).fold(f64::MAX, f64::min)
        };
        assert!(far(10.0) > 50.0 && far(10.0) < far(60.0), "{} {}", far(10.0), far(60.0));
        let inland = |path: &FlightPath| {
            let (east, south) = path.place_m(60.0);
            (east - place.0) * 0.6 - (south - place.1) * 0.8
        };
        assert!(clients.iter().all(|path| inland(path) >= -0.1), "no client disperses into the sea");
        let turned = |sign: f64| clients.iter().filter(|path| inland(path) * sign > 100.0).count();
        assert!(turned(1.0) > 50 && turned(-1.0) == 0, "{}", turned(1.0));
    }
}
