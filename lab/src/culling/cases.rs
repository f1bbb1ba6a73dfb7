//! Seeded test cases of culling: valleys, ridges, peaks, level borders and morphs, eye heights from
//! 1.7 to 25 m, vertically stretched land, near the origin and 10^6 m from it.

use client::cache::vertical_scale;
use client::camera::{Pose, Projection};
use client::features::vegetation::VegetationSettings;
use client::scene::Scene;
use client::settings::RenderSettings;
use client::view::ViewParams;
use glam::DVec3;
use terrain::hash::mix;
use terrain::{Land, Position};

/// A test case.
#[derive(Clone, Debug)]
pub struct Case {
    /// Its parameters, for messages.
    pub name: String,
    /// Shape of the ground under the eye.
    pub site: Site,
    /// The shot.
    pub shot: ViewParams,
    /// Vertical stretch of the land, Q8.
    pub stretch: i32,
}

impl Case {
    /// A scene of the viewer where it starts, as a picture of a size.
    pub fn at_start(start: Scene, (width, height): (u32, u32), plants: VegetationSettings) -> Self {
        Self {
            name: format!("the scene `{start:?}`"),
            site: Site::Valley,
            shot: shot(start.start(), Projection { width, height, ..LENS }, 2.0, plants),
            stretch: (start.vertical_scale() * f64::from(vertical_scale::ONE)).round() as i32,
        }
    }
}

fn shot(pose: Pose, projection: Projection, tolerance_px: f64, plants: VegetationSettings) -> ViewParams {
    let settings = RenderSettings { plants, ..RenderSettings::default() };
    ViewParams { pose, projection, view_distance_m: VIEW_M, tolerance_px, time_s: 0.0, settings }
}

/// Shape of the ground under an eye.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Site {
    /// On a local peak.
    Peak,
    /// On the ground of a local valley.
    Valley,
    /// Neither.
    Slope,
}

/// Random streams of a case; candidate positions take all numbers from the last one on.
const EYE_HEIGHT: u32 = 3;
const YAW: u32 = 4;
const PITCH: u32 = 5;
const TOLERANCE: u32 = 6;
const STRETCH: u32 = 7;
const CANDIDATES: u32 = 10;

/// Projection of all cases.
pub const LENS: Projection = Projection { fov_deg: 70.0, width: 640, height: 360 };

/// How far land is drawn, metres: beyond all plants.
const VIEW_M: u32 = 2600;

/// Centres of the searched regions: the home island, and 10^6 m east and south of it.
const REGIONS_M: [(f64, f64); 2] = [(0.0, 0.0), (1e6, 1e6)];

/// `count` seeded poses. Of six one is on a peak, one in a valley, the others between beach and
/// rock; every third is over land stretched 1.8 or 4 times; every fifth is far from the origin.
/// Tolerances differ, so that level borders and morphs lie elsewhere in each case.
pub fn seeded(land: &Land, count: u32, plants: VegetationSettings) -> Vec<Case> {
    (0..count).map(|index| case(land, index, plants)).collect()
}

fn case(land: &Land, index: u32, plants: VegetationSettings) -> Case {
    let random = |stream: u32| mix(index.wrapping_mul(0x9e37_79b9).wrapping_add(stream));
    let unit = |stream: u32| f64::from(random(stream)) / f64::from(u32::MAX);
    let scale = [256, 256, [461, 1024][(random(STRETCH) % 2) as usize]][(index % 3) as usize];
    let height = |(x, z): (f64, f64)| {
        let at = Position::new((x * 256.0) as i32, (z * 256.0) as i32);
        at.map_or(0.0, |at| f64::from(vertical_scale::scaled_height(land.height_at(at), scale)) / 256.0)
    };
    let (region, spread_m) = if index % 5 == 4 { (REGIONS_M[1], 60_000.0) } else { (REGIONS_M[0], 9000.0) };
    // Rejection sampling: the first candidate on land where plants grow.
    let candidates = (0..4000).map(|n| {
        let offset_m = |axis: u32| (unit(CANDIDATES + 2 * n + axis) - 0.5) * spread_m;
        (region.0 + offset_m(0), region.1 + offset_m(1))
    });
    let times = f64::from(scale) / 256.0;
    let grows = |at: &(f64, f64)| (6.0..170.0).contains(&(height(*at) / times));
    let mut at = candidates.into_iter().find(grows).unwrap_or((300.0, 900.0));
    let kind = (index / 2) % 6;
    if kind < 2 {
        // Hill climbing to the next peak, or down to the next valley.
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
    let above = [1.7, 1.7, 1.7, 6.0, 25.0][(random(EYE_HEIGHT) % 5) as usize];
    let pose = Pose {
        position_m: DVec3::new(at.0, height(at) + above, at.1),
        yaw_deg: 360.0 * unit(YAW),
        pitch_deg: -12.0 + 14.0 * unit(PITCH),
    };
    let site = [Site::Peak, Site::Valley, Site::Slope][kind.min(2) as usize];
    let tolerance_px = [0.7, 1.0, 2.0, 4.0][(random(TOLERANCE) % 4) as usize];
    Case {
        name: format!("{index}: {site:?}, {above} m up, x {times:.1}, {tolerance_px} px, {pose}"),
        site,
        shot: shot(pose, LENS, tolerance_px, plants),
        stretch: scale,
    }
}
