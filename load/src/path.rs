//! Where a client is at a time: deterministic paths over the home island.
//!
//! A pose is a function of the path and the time alone, so that a slow client skips poses instead of falling behind.

use clap::ValueEnum;
use std::f64::consts::TAU;
use terrain::constants::UNITS_PER_METRE;
use terrain::hash::{hash2, mix};
use terrain::{Land, Position};

/// How clients move.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum PathKind {
    /// Circles of 0.5 to 2.5 km at 50 to 120 m/s, 100 to 400 m above the ground.
    Fly,
    /// Circles of 50 to 300 m at 1 to 3 m/s, 2 m above the ground.
    Walk,
    /// A new place every [`TELEPORT_S`] seconds: no two views share fine chunks.
    Teleport,
}

/// Seconds that a teleporting client stays.
pub const TELEPORT_S: f64 = 2.0;

/// Circles' centres lie within this distance of the origin on each axis, metres. With the largest radius that keeps every
/// path over the home island (6,656 m).
const REACH_M: f64 = 3_000.0;

/// A camera at one moment.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Pose {
    /// Eye in units: east, up, south.
    pub eye: [i32; 3],
    /// Units a second, same axes.
    pub velocity: [i32; 3],
    /// Heading in 1/1000 degree, 0 is north, clockwise.
    pub yaw_mdeg: i32,
}

/// One client's path.
#[derive(Clone, Copy, Debug)]
pub struct FlightPath {
    kind: PathKind,
    /// Chooses the places of a teleporting client.
    seed: u32,
    /// Centre of the circle, metres east and south of the origin.
    centre_m: (f64, f64),
    radius_m: f64,
    /// Height above the ground, or above the sea where that is higher, metres.
    clearance_m: f64,
    /// Radians a second, signed: half of the clients turn left.
    turn: f64,
    /// Angle at time zero, radians.
    start: f64,
}

impl FlightPath {
    /// The path of client `index`. The same three arguments give the same path.
    #[must_use]
    pub fn new(kind: PathKind, seed: u32, index: u32) -> Self {
        let seed = hash2(mix(seed), index as i32, 0x70);
        let share = |stream: u32| f64::from(mix(seed ^ stream)) / f64::from(u32::MAX);
        let between = |stream: u32, low: f64, high: f64| low + share(stream) * (high - low);
        let (radius_m, speed_m, clearance_m) = match kind {
            PathKind::Fly => (between(1, 500.0, 2_500.0), between(2, 50.0, 120.0), between(3, 100.0, 400.0)),
            PathKind::Walk => (between(1, 50.0, 300.0), between(2, 1.0, 3.0), 2.0),
            // The circle only says which way a standing client looks.
            PathKind::Teleport => (1.0, 0.0, between(3, 10.0, 200.0)),
        };
        let direction = if share(4) < 0.5 { -1.0 } else { 1.0 };
        Self {
            kind,
            seed,
            centre_m: (between(5, -REACH_M, REACH_M), between(6, -REACH_M, REACH_M)),
            radius_m,
            clearance_m,
            turn: direction * speed_m / radius_m,
            start: between(7, 0.0, TAU),
        }
    }

    /// The place at a time in seconds, metres east and south of the origin.
    #[must_use]
    pub fn place_m(&self, seconds: f64) -> (f64, f64) {
        if self.kind == PathKind::Teleport {
            let stay = (seconds / TELEPORT_S) as i32;
            let axis = |stream| {
                let share = f64::from(hash2(self.seed, stay, stream)) / f64::from(u32::MAX);
                (share * 2.0 - 1.0) * REACH_M
            };
            return (axis(0), axis(1));
        }
        let (sin, cos) = (self.start + self.turn * seconds).sin_cos();
        (self.centre_m.0 + self.radius_m * cos, self.centre_m.1 + self.radius_m * sin)
    }

    /// The pose at a time in seconds.
    #[must_use]
    pub fn pose(&self, land: &Land, seconds: f64) -> Pose {
        let (east_m, south_m) = self.place_m(seconds);
        let (east, south) = (units(east_m), units(south_m));
        // Paths stay far inside the world; beyond it there would be only sea.
        let ground = Position::new(east, south).map_or(0, |place| land.height_at(place));
        let speed_m = self.turn * self.radius_m;
        let (sin, cos) = (self.start + self.turn * seconds).sin_cos();
        let (v_east, v_south) = (-sin * speed_m, cos * speed_m);
        let heading = if self.turn == 0.0 { self.start } else { v_east.atan2(-v_south) };
        Pose {
            eye: [east, ground.max(0) + units(self.clearance_m), south],
            velocity: [units(v_east), 0, units(v_south)],
            yaw_mdeg: (heading.to_degrees() * 1000.0) as i32,
        }
    }
}

fn units(metres: f64) -> i32 {
    (metres * f64::from(UNITS_PER_METRE)).round() as i32
}

#[cfg(test)]
mod tests {
    use super::*;
    use terrain::constants::{HOME_RADIUS_STEPS, ISLAND_RADIUS_STEP_M};

    const KINDS: [PathKind; 3] = [PathKind::Fly, PathKind::Walk, PathKind::Teleport];

    #[test]
    fn the_same_seed_flies_the_same_path_and_another_client_another() {
        let land = Land::new(1);
        for kind in KINDS {
            let pose = |seed, index| FlightPath::new(kind, seed, index).pose(&land, 12.5);
            assert_eq!(pose(7, 3), pose(7, 3));
            assert_ne!(pose(7, 3), pose(7, 4));
            assert_ne!(pose(7, 3), pose(8, 3));
        }
    }

    #[test]
    fn every_path_stays_over_the_home_island_and_above_ground() {
        let land = Land::new(1);
        let radius_m = f64::from(HOME_RADIUS_STEPS) * f64::from(ISLAND_RADIUS_STEP_M);
        for kind in KINDS {
            for index in 0..200 {
                let path = FlightPath::new(kind, 1, index);
                for step in 0..20 {
                    let seconds = f64::from(step) * 7.3;
                    let (east, south) = path.place_m(seconds);
                    assert!(east.hypot(south) <= radius_m + 100.0, "{kind:?} {index}: {east} {south}");
                    let pose = path.pose(&land, seconds);
                    let ground = land.height_at(Position::new(pose.eye[0], pose.eye[2]).unwrap());
                    assert!(pose.eye[1] >= ground + units(2.0));
                }
            }
        }
    }

    #[test]
    fn velocity_is_the_motion_between_poses_and_yaw_points_along_it() {
        let land = Land::new(1);
        let path = FlightPath::new(PathKind::Fly, 1, 0);
        let (now, next) = (path.pose(&land, 5.0), path.pose(&land, 5.01));
        for axis in [0, 2] {
            let moved = f64::from(next.eye[axis] - now.eye[axis]) * 100.0;
            assert!((moved - f64::from(now.velocity[axis])).abs() < 500.0, "{moved} {:?}", now.velocity);
        }
        let yaw = (f64::from(now.yaw_mdeg) / 1000.0).to_radians();
        let speed = f64::from(now.velocity[0]).hypot(f64::from(now.velocity[2]));
        assert!((yaw.sin() * speed - f64::from(now.velocity[0])).abs() < speed * 0.001);
        assert!((-yaw.cos() * speed - f64::from(now.velocity[2])).abs() < speed * 0.001);
    }

    #[test]
    fn a_teleporting_client_stays_and_then_is_elsewhere() {
        let path = FlightPath::new(PathKind::Teleport, 1, 0);
        assert_eq!(path.place_m(0.1), path.place_m(1.9));
        assert_ne!(path.place_m(1.9), path.place_m(2.1));
    }
}
