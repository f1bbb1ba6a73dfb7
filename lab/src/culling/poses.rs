//! Where culling is tried: valleys, ridges, peaks, level borders, one eye's height above the ground or many, near the origin and far from it.

use client::camera::{Lens, Pose};
use client::frame::Shot;
use client::looks::Looks;
use client::plants::PlantKnobs;
use glam::DVec3;
use terrain::hash::mix;
use terrain::{Land, Position};

/// A pose that is tried.
#[derive(Clone, Debug)]
pub struct Trial {
    /// What makes it worth trying, for people.
    pub name: String,
    /// The shot.
    pub shot: Shot,
}

/// Lens of all trials.
pub const LENS: Lens = Lens { fov_deg: 70.0, width: 640, height: 360 };

/// `count` seeded poses over the home island: every sixth on a peak, every sixth in a valley, the others anywhere on land between beach and rock; at the
/// height of a person, of a roof or of a tower.
#[must_use]
pub fn seeded(land: &Land, count: u32, plants: PlantKnobs) -> Vec<Trial> {
    (0..count).map(|index| trial(land, index, plants)).collect()
}

fn trial(land: &Land, index: u32, plants: PlantKnobs) -> Trial {
    let lot = |n: u32| mix(index.wrapping_mul(0x9e37_79b9).wrapping_add(n));
    let height = |x: f64, z: f64| {
        let at = Position::new((x * 256.0) as i32, (z * 256.0) as i32);
        at.map_or(0.0, |at| f64::from(land.height_at(at)) / 256.0)
    };
    // The first place in a row of lots that is land where something grows.
    let places = (0..400).map(|n| {
        let spread = |word: u32| (f64::from(word) / f64::from(u32::MAX) - 0.5) * 9000.0;
        (spread(lot(2 * n + 10)), spread(lot(2 * n + 11)))
    });
    let mut at = places
        .filter(|(x, z)| (6.0..170.0).contains(&height(*x, *z)))
        .next()
        .unwrap_or((300.0, 900.0));
    let kind = index % 6;
    if kind < 2 {
        // Up to the next peak, or down into the next valley.
        let sign = if kind == 0 { 1.0 } else { -1.0 };
        for _ in 0..200 {
            let around = (0..8).map(|n| {
                let angle = f64::from(n) * std::f64::consts::FRAC_PI_4;
                (at.0 + 8.0 * angle.cos(), at.1 + 8.0 * angle.sin())
            });
            let best = around.max_by(|a, b| (sign * height(a.0, a.1)).total_cmp(&(sign * height(b.0, b.1))));
            let Some(best) = best else { break };
            if sign * height(best.0, best.1) <= sign * height(at.0, at.1) || height(best.0, best.1) < 5.0 {
                break;
            }
            at = best;
        }
    }
    let above = [1.7, 1.7, 1.7, 6.0, 25.0][(lot(3) % 5) as usize];
    let share = |n: u32| f64::from(lot(n)) / f64::from(u32::MAX);
    let pose = Pose {
        position_m: DVec3::new(at.0, height(at.0, at.1) + above, at.1),
        yaw_deg: 360.0 * share(4),
        pitch_deg: -12.0 + 14.0 * share(5),
    };
    let place = ["peak", "valley", "slope"][kind.min(2) as usize];
    // Several tolerances: level borders and morphs lie elsewhere with each.
    let tolerance_px = [0.7, 1.0, 2.0, 4.0][(lot(6) % 4) as usize];
    Trial {
        name: format!("{index}: {place}, {above} m up, {tolerance_px} px"),
        shot: Shot {
            pose,
            lens: LENS,
            view_distance_m: 4000,
            tolerance_px,
            time_s: 0.0,
            looks: Looks { plants, ..Looks::default() },
        },
    }
}
