//! Viewpoints of a world's home island, found by a search, for measurements and tests.

use client::camera::Pose;
use client::scene::Scene;
use glam::DVec3;
use terrain::constants::UNITS_PER_METRE;
use terrain::{Land, Octaves, Position};

/// Half the side of the square that is searched for the summit, metres, and the grid of the search.
const REACH_M: i32 = 3072;
const GRID_M: i32 = 64;

/// The ground at a place, metres east and south of the origin; the sea floor outside the world.
#[must_use]
pub fn ground_m(land: &Land, [east, south]: [f64; 2]) -> f64 {
    height_m(land, [east, south], Octaves::ALL)
}

fn height_m(land: &Land, place: [f64; 2], octaves: Octaves) -> f64 {
    let [x, z] = place.map(|metres| (metres * f64::from(UNITS_PER_METRE)) as i32);
    let height = Position::new(x, z).map_or(terrain::land::SEA_FLOOR, |at| land.height_keeping(at, octaves));
    f64::from(height) / f64::from(UNITS_PER_METRE)
}

/// The highest place of the home island to 8 m, metres.
#[must_use]
pub fn summit(land: &Land) -> DVec3 {
    // Of a coarse level, whose base field is no spline: a ninth of the cost.
    let coarse = highest(land, [0.0; 2], (REACH_M, GRID_M), Octaves::at_level(6));
    let [east, south] = highest(land, coarse, (GRID_M, 8), Octaves::ALL);
    DVec3::new(east, ground_m(land, [east, south]), south)
}

/// The highest point of a grid around a place.
fn highest(land: &Land, middle: [f64; 2], (reach_m, step_m): (i32, i32), octaves: Octaves) -> [f64; 2] {
    let steps = || (-reach_m..=reach_m).step_by(step_m as usize).map(f64::from);
    let places = steps().flat_map(|south| steps().map(move |east| [middle[0] + east, middle[1] + south]));
    let height = |place: &[f64; 2]| height_m(land, *place, octaves);
    places.max_by(|one, other| height(one).total_cmp(&height(other))).unwrap_or(middle)
}

/// The summit and the mountains beyond it, from 1,200 m south-south-west and above it.
#[must_use]
pub fn over_mountains(land: &Land) -> Pose {
    let summit = summit(land);
    let (yaw_deg, away_m) = (20.0_f64, 1200.0);
    let (sin, cos) = yaw_deg.to_radians().sin_cos();
    let eye = summit + DVec3::new(-sin * away_m, 0.0, cos * away_m);
    let up = (summit.y + 120.0).max(ground_m(land, [eye.x, eye.z]) + 60.0);
    tenths(Pose { position_m: eye.with_y(up), yaw_deg, pitch_deg: -12.0 })
}

/// A coast, seen along it from 25 m above the water.
#[must_use]
pub fn along_shore(land: &Land) -> Pose {
    let start = Scene::Island.start_in(land);
    tenths(Pose { yaw_deg: start.yaw_deg + 60.0, pitch_deg: -8.0, ..start })
}

/// A beach and the water before it, from 3 m above it.
#[must_use]
pub fn beach(land: &Land) -> Pose {
    let start = Scene::Island.start_in(land);
    let up = ground_m(land, [start.position_m.x, start.position_m.z]).max(0.0) + 3.0;
    tenths(Pose { position_m: start.position_m.with_y(up), pitch_deg: -12.0, ..start })
}

/// The sea before that beach, from 8 m above water of more than 10 m, looking away from it.
#[must_use]
pub fn off_shore(land: &Land) -> Pose {
    let start = Scene::Island.start_in(land);
    let out = -start.forward().with_y(0.0).normalize();
    let at = |step: u32| (start.position_m + out * 20.0 * f64::from(step)).with_y(8.0);
    let is_deep = |place: &DVec3| ground_m(land, [place.x, place.z]) < -10.0;
    let eye = (0..200).map(at).find(is_deep).unwrap_or(at(200));
    tenths(Pose { position_m: eye, yaw_deg: (start.yaw_deg + 180.0).rem_euclid(360.0), pitch_deg: -20.0 })
}

/// The middle of the island from 1,500 m above the sea.
#[must_use]
pub fn above() -> Pose {
    Pose { position_m: DVec3::new(0.0, 1500.0, 1200.0), yaw_deg: -20.0, pitch_deg: -60.0 }
}

/// Content of a written pose.
fn tenths(pose: Pose) -> Pose {
    let round = |value: f64| (value * 10.0).round() / 10.0;
    Pose {
        position_m: DVec3::from_array(pose.position_m.to_array().map(round)),
        yaw_deg: round(pose.yaw_deg),
        pitch_deg: round(pose.pitch_deg),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn places_have_what_they_are_named_for() {
        for seed in 1..4 {
            let land = Land::new(seed);
            let summit = summit(&land);
            assert!(summit.y > 250.0, "world {seed}: {summit}");
            for pose in [over_mountains(&land), along_shore(&land), beach(&land), off_shore(&land)] {
                let [x, y, z] = pose.position_m.to_array();
                assert!(y > ground_m(&land, [x, z]) + 2.0 && y > 2.0, "world {seed}: {pose}");
                assert_eq!(pose.to_string().parse::<Pose>(), Ok(pose));
            }
            let eye = over_mountains(&land).position_m;
            assert!(eye.y > summit.y && (eye - summit).length() < 1300.0, "world {seed}: {eye}");
            let beach = beach(&land).position_m;
            let sea = off_shore(&land).position_m;
            assert!(ground_m(&land, [sea.x, sea.z]) < -10.0 && (sea - beach).length() < 2000.0, "{sea}");
        }
    }
}
