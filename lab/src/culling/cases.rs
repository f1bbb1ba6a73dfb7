//! Where culling is tried: valleys, ridges, peaks, level borders and morphs, a person's height
//! above the ground or a tower's, stretched land, near the origin and 10^6 m from it.

use client::camera::{Lens, Pose};
use client::frame::Shot;
use client::looks::Looks;
use client::plants::PlantKnobs;
use client::world::stretch;
use glam::DVec3;
use terrain::hash::mix;
use terrain::{Land, Position};

/// A pose that is tried.
#[derive(Clone, Debug)]
pub struct Trial {
    /// What makes it worth trying, for people.
    pub name: String,
    /// Where the eye is.
    pub place: Place,
    /// The shot.
    pub shot: Shot,
    /// How much higher the land is drawn than it is, Q8.
    pub stretch: i32,
}

/// Where an eye is on the land.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Place {
    /// On a local peak.
    Peak,
    /// On the ground of a local valley.
    Valley,
    /// Anywhere between.
    Land,
}

/// Lens of all trials.
pub const LENS: Lens = Lens { fov_deg: 70.0, width: 640, height: 360 };

/// How far land is drawn, metres: beyond all plants.
const VIEW_M: u32 = 2600;

/// Where land is looked for: the home island, and 10^6 m east and south of it.
const REGIONS_M: [(f64, f64); 2] = [(0.0, 0.0), (1e6, 1e6)];

/// `count` seeded poses. Of six one is on a peak, one in a valley, the others anywhere between
/// beach and rock; every third is over land that is stretched, 1.8 or 4 times; every fifth is far
/// from the origin. Tolerances differ, so that level borders and morphs lie elsewhere each time.
#[must_use]
pub fn seeded(land: &Land, count: u32, plants: PlantKnobs) -> Vec<Trial> {
    (0..count).map(|index| trial(land, index, plants)).collect()
}

fn trial(land: &Land, index: u32, plants: PlantKnobs) -> Trial {
    let lot = |n: u32| mix(index.wrapping_mul(0x9e37_79b9).wrapping_add(n));
    let share = |n: u32| f64::from(lot(n)) / f64::from(u32::MAX);
    let scale = [256, 256, [461, 1024][(lot(7) % 2) as usize]][(index % 3) as usize];
    let height = |(x, z): (f64, f64)| {
        let at = Position::new((x * 256.0) as i32, (z * 256.0) as i32);
        at.map_or(0.0, |at| f64::from(stretch::times(land.height_at(at), scale)) / 256.0)
    };
    let (region, spread_m) = if index % 5 == 4 { (REGIONS_M[1], 60_000.0) } else { (REGIONS_M[0], 9000.0) };
    // The first place in a row of lots that is land where something grows.
    let places = (0..4000).map(|n| {
        (region.0 + (share(2 * n + 10) - 0.5) * spread_m, region.1 + (share(2 * n + 11) - 0.5) * spread_m)
    });
    let times = f64::from(scale) / 256.0;
    let grows = |at: &(f64, f64)| (6.0..170.0).contains(&(height(*at) / times));
    let mut at = places.into_iter().find(grows).unwrap_or((300.0, 900.0));
    let kind = (index / 2) % 6;
    if kind < 2 {
        // Up to the next peak, or down into the next valley.
        let sign = if kind == 0 { 1.0 } else { -1.0 };
        for _ in 0..200 {
            let around = (0..8).map(|n| {
                let angle = f64::from(n) * std::f64::consts::FRAC_PI_4;
                (at.0 + 8.0 * angle.cos(), at.1 + 8.0 * angle.sin())
            });
            let Some(best) = around.max_by(|a, b| (sign * height(*a)).total_cmp(&(sign * height(*b)))) else {
                break;
            };
            if sign * height(best) <= sign * height(at) || height(best) < 5.0 {
                break;
            }
            at = best;
        }
    }
    let above = [1.7, 1.7, 1.7, 6.0, 25.0][(lot(3) % 5) as usize];
    let pose = Pose {
        position_m: DVec3::new(at.0, height(at) + above, at.1),
        yaw_deg: 360.0 * share(4),
        pitch_deg: -12.0 + 14.0 * share(5),
    };
    let place = [Place::Peak, Place::Valley, Place::Land][kind.min(2) as usize];
    let tolerance_px = [0.7, 1.0, 2.0, 4.0][(lot(6) % 4) as usize];
    Trial {
        name: format!("{index}: {place:?}, {above} m up, x {times:.1}, {tolerance_px} px, {pose}"),
        place,
        shot: Shot {
            pose,
            lens: LENS,
            view_distance_m: VIEW_M,
            tolerance_px,
            time_s: 0.0,
            looks: Looks { plants, ..Looks::default() },
        },
        stretch: scale,
    }
}
