//! The position of a client over time: deterministic paths over the home island.
//!
//! A pose is a function of path and time alone, so a slow client skips poses instead of falling
//! behind, and a second flight needs the same chunks as the first. Each kind of path is a file; the
//! paths are horizontal, and this module adds the height from the land.

mod fly;
mod spawn;
mod teleport;
mod walk;

use clap::ValueEnum;
use std::f64::consts::TAU;
use terrain::constants::UNITS_PER_METRE;
use terrain::hash::{hash2, mix};
use terrain::{Land, Position, Start};

/// How clients move.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum PathKind {
    /// 1.4 m/s on the ground around a place of each client's own, with turns
    Walk,
    /// Circles of 0.5 to 2.5 km at 50 to 120 m/s, 100 to 400 m above the ground
    Fly,
    /// A new position on the island about every 2 s, at different times for each client
    Teleport,
    /// All begin on the shore where the viewer begins, stay for 3 s and then disperse inland at 10
    /// to 40 m/s
    Spawn,
}

impl PathKind {
    /// All of them, in the order of `--help`.
    pub const ALL: [Self; 4] = [Self::Walk, Self::Fly, Self::Teleport, Self::Spawn];

    /// As it is written on the command line.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Walk => "walk",
            Self::Fly => "fly",
            Self::Teleport => "teleport",
            Self::Spawn => "spawn",
        }
    }
}

/// Centres of paths are within this distance of the origin on each axis, metres. With the farthest
/// that a path leads from its middle (2,500 m) it stays where the home island of every world may
/// lie (4,540 m on each axis).
const REACH_M: f64 = 2_000.0;

/// Height of a standing person's eyes, metres.
const EYES_M: f64 = 1.7;

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

/// Movement on the map at one moment.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Motion {
    /// East and south of the origin, metres.
    place_m: (f64, f64),
    /// Metres a second, same axes.
    velocity: (f64, f64),
    /// 0 is north, clockwise, radians.
    heading: f64,
}

impl Motion {
    /// With the heading of the velocity.
    fn along(place_m: (f64, f64), velocity: (f64, f64)) -> Self {
        Self { place_m, velocity, heading: velocity.0.atan2(-velocity.1) }
    }
}

/// Random numbers of one path, by stream.
#[derive(Clone, Copy, Debug)]
struct PathRandom(u32);

impl PathRandom {
    /// From 0 to 1.
    fn share(self, stream: u32) -> f64 {
        f64::from(mix(self.0 ^ stream)) / f64::from(u32::MAX)
    }

    fn between(self, stream: u32, low: f64, high: f64) -> f64 {
        low + self.share(stream) * (high - low)
    }

    /// A place within a distance of the origin on each axis, metres.
    fn place_m(self, streams: (u32, u32), reach_m: f64) -> (f64, f64) {
        (self.between(streams.0, -reach_m, reach_m), self.between(streams.1, -reach_m, reach_m))
    }
}

/// One client's path.
#[derive(Clone, Copy, Debug)]
pub struct FlightPath {
    course: Course,
    /// Height above the ground, or above the sea where that is higher, metres.
    clearance_m: f64,
}

#[derive(Clone, Copy, Debug)]
#[expect(
    clippy::large_enum_variant,
    reason = "there is one a client, and 0.4 KiB is little beside its buffers"
)]
enum Course {
    Walk(walk::Round),
    Fly(fly::Circle),
    Teleport(teleport::Stays),
    Spawn(spawn::Dispersal),
}

impl FlightPath {
    /// The path of client `index` in a world that begins at a start. The same arguments give the
    /// same path.
    #[must_use]
    pub fn new(kind: PathKind, seed: u32, index: u32, start: Start) -> Self {
        let random = PathRandom(hash2(mix(seed), index as i32, 0x70));
        let (course, clearance_m) = match kind {
            PathKind::Walk => (Course::Walk(walk::Round::new(random)), EYES_M),
            PathKind::Fly => (Course::Fly(fly::Circle::new(random)), random.between(3, 100.0, 400.0)),
            PathKind::Teleport => {
                (Course::Teleport(teleport::Stays::new(random)), random.between(3, 10.0, 200.0))
            }
            PathKind::Spawn => (Course::Spawn(spawn::Dispersal::new(start, random)), EYES_M),
        };
        Self { course, clearance_m }
    }

    /// The place at a time in seconds, metres east and south of the origin.
    #[must_use]
    pub fn place_m(&self, seconds: f64) -> (f64, f64) {
        self.motion(seconds).place_m
    }

    /// The pose at a time in seconds.
    #[must_use]
    pub fn pose(&self, land: &Land, seconds: f64) -> Pose {
        let Motion { place_m, velocity, heading } = self.motion(seconds);
        let (east, south) = (units(place_m.0), units(place_m.1));
        // Paths stay far inside the world; beyond it there would be only sea.
        let ground = Position::new(east, south).map_or(0, |place| land.height_at(place));
        Pose {
            eye: [east, ground.max(0) + units(self.clearance_m), south],
            velocity: [units(velocity.0), 0, units(velocity.1)],
            yaw_mdeg: (heading.rem_euclid(TAU).to_degrees() * 1000.0) as i32,
        }
    }

    fn motion(&self, seconds: f64) -> Motion {
        match &self.course {
            Course::Walk(round) => round.motion(seconds),
            Course::Fly(circle) => circle.motion(seconds),
            Course::Teleport(stays) => stays.motion(seconds),
            Course::Spawn(dispersal) => dispersal.motion(seconds),
        }
    }
}

fn units(metres: f64) -> i32 {
    (metres * f64::from(UNITS_PER_METRE)).round() as i32
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use std::sync::LazyLock;

    static START: LazyLock<Start> = LazyLock::new(|| Land::new(1).start());

    fn kinds() -> impl Strategy<Value = PathKind> {
        prop::sample::select(PathKind::ALL.to_vec())
    }

    proptest! {
        #[test]
        fn a_pose_is_a_function_of_kind_seed_client_and_time(
            kind in kinds(), seed: u32, index in 0..100_000u32, seconds in 0.0..86_400.0f64,
        ) {
            let land = Land::new(1);
            let pose = |index| FlightPath::new(kind, seed, index, *START).pose(&land, seconds);
            prop_assert_eq!(pose(index), pose(index));
            // Only at the spawn point do clients share a position.
            if kind != PathKind::Spawn {
                prop_assert_ne!(pose(index).eye, pose(index + 1).eye);
            }
        }

        #[test]
        fn every_path_stays_over_the_home_island_and_above_ground(
            kind in kinds(), seed: u32, index in 0..100_000u32, seconds in 0.0..86_400.0f64,
        ) {
            let land = Land::new(1);
            let path = FlightPath::new(kind, seed, index, *START);
            let (east, south) = path.place_m(seconds);
            prop_assert!(east.hypot(south) <= 6_400.0, "{east} {south}");
            prop_assert!(!land.archipelago().is_open_sea(units(east), units(south), 0), "{east} {south}");
            let pose = path.pose(&land, seconds);
            let ground = land.height_at(Position::new(pose.eye[0], pose.eye[2]).unwrap());
            prop_assert!(pose.eye[1] >= ground.max(0) + units(EYES_M));
        }

        #[test]
        fn velocity_is_the_motion_between_poses_and_yaw_points_along_it(
            kind in kinds(), seed: u32, index in 0..1000u32, seconds in 0.0..1000.0f64,
        ) {
            let path = FlightPath::new(kind, seed, index, *START);
            let (now, next) = (path.motion(seconds), path.motion(seconds + 1e-3));
            // At the end of a leg or stay the motion changes between the two poses.
            let is_curved = kind == PathKind::Fly || kind == PathKind::Spawn;
            prop_assume!(now.velocity == path.motion(seconds + 2e-3).velocity || is_curved);
            let moved = (next.place_m.0 - now.place_m.0, next.place_m.1 - now.place_m.1);
            let speed = now.velocity.0.hypot(now.velocity.1);
            let jumped = kind == PathKind::Teleport && moved != (0.0, 0.0);
            let departed = speed == 0.0 && next.velocity != (0.0, 0.0);
            prop_assume!(!jumped && !departed);
            prop_assert!((moved.0 * 1e3 - now.velocity.0).abs() < 0.02 + speed * 1e-3, "{moved:?} {now:?}");
            prop_assert!((moved.1 * 1e3 - now.velocity.1).abs() < 0.02 + speed * 1e-3, "{moved:?} {now:?}");
            prop_assert!((now.heading.sin() * speed - now.velocity.0).abs() < 1e-6 + speed * 1e-6);
            prop_assert!((-now.heading.cos() * speed - now.velocity.1).abs() < 1e-6 + speed * 1e-6);
        }
    }
}
