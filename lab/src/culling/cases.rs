//! Seeded test cases of culling: valleys, ridges, peaks, morphs, eyes exactly on borders of chunks
//! and of levels, eye heights from 1.7 to 25 m, pitches from -89 to +60 degrees, wind at any time,
//! chunks that have not arrived, vertically stretched land, near the origin and 10^6 m from it.

use client::cache::vertical_scale;
use client::camera::{Pose, Projection};
use client::features::vegetation::VegetationSettings;
use client::scene::Scene;
use client::settings::RenderSettings;
use client::view::ViewParams;
use glam::DVec3;
use terrain::constants::UNITS_PER_METRE;
use terrain::hash::mix;
use terrain::{ChunkKey, Land, Position};

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
    /// Chunks of the view that have not arrived.
    pub absent: Absent,
}

/// Chunks of a view that have not arrived. Those of its top level always have: without them nothing
/// is drawn.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Absent {
    /// None.
    None,
    /// A share of all, 0 to 1, chosen by a seed.
    Random {
        /// The share.
        share: f64,
        /// The seed.
        seed: u32,
    },
    /// The children of one chunk, which is therefore drawn coarser than its neighbours.
    ChildrenOf(ChunkKey),
}

impl Absent {
    /// Whether a chunk has arrived, other than one of the top level.
    #[must_use]
    pub fn has_arrived(&self, key: ChunkKey) -> bool {
        match self {
            Self::None => true,
            Self::Random { share, seed } => {
                let (x, z) = key.origin();
                let word = mix(mix(mix(seed ^ u32::from(key.level())) ^ x as u32) ^ z as u32);
                f64::from(word) >= share * f64::from(u32::MAX)
            }
            Self::ChildrenOf(parent) => key.parent() != Some(*parent),
        }
    }
}

impl Case {
    /// A scene of the viewer where it starts, as a picture of a size.
    pub fn at_start(start: Scene, (width, height): (u32, u32), plants: VegetationSettings) -> Self {
        Self {
            name: format!("the scene `{start:?}`"),
            site: Site::Valley,
            shot: shot(start.start(), Projection { width, height, ..LENS }, 2.0, plants),
            stretch: (start.vertical_scale() * f64::from(vertical_scale::ONE)).round() as i32,
            absent: Absent::None,
        }
    }

    /// Whether the view is steeper than those of a walk.
    #[must_use]
    pub fn is_steep(&self) -> bool {
        !LEVEL_PITCH_DEG.contains(&self.shot.pose.pitch_deg)
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
const BORDER: u32 = 8;
const CANDIDATES: u32 = 10;
// Beyond the streams of the candidates.
const TIME: u32 = 100_000;
const STEEP: u32 = 100_001;
const ABSENT: u32 = 100_002;
const ABSENT_SHARE: u32 = 100_003;
const ABSENT_SEED: u32 = 100_004;
const BORDER_LEVEL: u32 = 100_005;
const BORDER_AXES: u32 = 100_006;

/// Pitches of a walk, degrees.
const LEVEL_PITCH_DEG: std::ops::RangeInclusive<f64> = -12.0..=2.0;

/// Steepest pitches, degrees.
const STEEPEST_DEG: (f64, f64) = (-89.0, 60.0);

/// Latest time of a case, seconds: an hour of gusts.
const LATEST_S: f64 = 3600.0;

/// Side of a chunk of level 0, metres.
const CHUNK_M: f64 = 128.0;

/// Where an eye stands among the borders of chunks.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Standing {
    /// Anywhere.
    Free,
    /// Exactly on lines between chunks of a level: east, south or both.
    ChunkBorder { axes: [bool; 2], side_m: f64 },
    /// Exactly on a line between two chunks of level 1 along an axis, of which one is drawn
    /// coarser, because its children are absent.
    LevelBorder { axis: usize },
}

impl Standing {
    fn snapped(self, (x, z): (f64, f64)) -> (f64, f64) {
        let to = |at: f64, side: f64| (at / side).round() * side;
        match self {
            Self::Free => (x, z),
            Self::ChunkBorder { axes, side_m } => {
                (if axes[0] { to(x, side_m) } else { x }, if axes[1] { to(z, side_m) } else { z })
            }
            Self::LevelBorder { axis: 0 } => (to(x, 2.0 * CHUNK_M), z),
            Self::LevelBorder { .. } => (x, to(z, 2.0 * CHUNK_M)),
        }
    }
}

/// Projection of all cases.
pub const LENS: Projection = Projection { fov_deg: 70.0, width: 640, height: 360 };

/// How far land is drawn, metres: beyond all plants.
const VIEW_M: u32 = 2600;

/// Centres of the searched regions: the home island, and 10^6 m east and south of it.
const REGIONS_M: [(f64, f64); 2] = [(0.0, 0.0), (1e6, 1e6)];

/// `count` seeded poses. Of six one is on a peak, one in a valley, the others between beach and
/// rock; every third is over land stretched 1.8 or 4 times; every fifth is far from the origin.
/// Tolerances differ, so that level borders and morphs lie elsewhere in each case. Of six eyes one
/// is on a border of chunks and one on a border of levels; half of the pitches are those of a walk,
/// half from straight down to 60 degrees up; of three views one lacks 5 to 60 % of its chunks.
pub fn seeded(land: &Land, count: u32, plants: VegetationSettings) -> Vec<Case> {
    seeded_from(land, 0, count, plants)
}

/// As [`seeded`], from a number of a pose on.
pub fn seeded_from(land: &Land, first: u32, count: u32, plants: VegetationSettings) -> Vec<Case> {
    (first..first + count).map(|index| case(land, index, plants)).collect()
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
    let standing = match random(BORDER) % 6 {
        0 => {
            let axes = [[true, false], [false, true], [true, true]][(random(BORDER_AXES) % 3) as usize];
            Standing::ChunkBorder { axes, side_m: CHUNK_M * f64::from(1 << (random(BORDER_LEVEL) % 3)) }
        }
        1 => Standing::LevelBorder { axis: (random(BORDER_AXES) % 2) as usize },
        _ => Standing::Free,
    };
    let grows = |at: &(f64, f64)| (6.0..400.0).contains(&(height(*at) / times));
    let mut at =
        candidates.map(|at| standing.snapped(at)).find(grows).unwrap_or(standing.snapped((300.0, 900.0)));
    // A climb would leave the border.
    let kind = if standing == Standing::Free { (index / 2) % 6 } else { 2 };
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
    let (low, high) = (LEVEL_PITCH_DEG.start(), LEVEL_PITCH_DEG.end());
    let pitch_deg = if random(STEEP).is_multiple_of(2) {
        low + (high - low) * unit(PITCH)
    } else {
        // A twentieth of these poses has either end exactly.
        let (low, high) = STEEPEST_DEG;
        let beyond = (high - low) / 18.0;
        (low - beyond + (high - low + 2.0 * beyond) * unit(PITCH)).clamp(low, high)
    };
    let pose = Pose {
        position_m: DVec3::new(at.0, height(at) + above, at.1),
        yaw_deg: 360.0 * unit(YAW),
        pitch_deg,
    };
    let absent = match standing {
        Standing::LevelBorder { axis } => {
            let mut beside = [at.0, at.1].map(|metres| (metres * f64::from(UNITS_PER_METRE)) as i32);
            // A unit to the west or north is the other chunk.
            beside[axis] -= (random(ABSENT) & 1) as i32;
            Absent::ChildrenOf(ChunkKey::containing(1, beside[0], beside[1]))
        }
        _ if random(ABSENT).is_multiple_of(3) => {
            Absent::Random { share: 0.05 + 0.55 * unit(ABSENT_SHARE), seed: random(ABSENT_SEED) }
        }
        _ => Absent::None,
    };
    let time_s = (LATEST_S * unit(TIME)) as f32;
    let site = [Site::Peak, Site::Valley, Site::Slope][kind.min(2) as usize];
    let tolerance_px = [0.7, 1.0, 2.0, 4.0][(random(TOLERANCE) % 4) as usize];
    Case {
        name: format!(
            "{index}: {site:?}, {above} m up, x {times:.1}, {tolerance_px} px, {pose}, {time_s:.0} s, \
             {standing:?}, {absent:?}"
        ),
        site,
        shot: ViewParams { time_s, ..shot(pose, LENS, tolerance_px, plants) },
        stretch: scale,
        absent,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn seeded_cases_have_every_pitch_border_and_share_of_absent_chunks() {
        let cases = seeded(&Land::new(1), 300, VegetationSettings::STANDARD);
        let count = |is: fn(&Case) -> bool| cases.iter().filter(|case| is(case)).count();
        assert!((120..200).contains(&count(Case::is_steep)));
        assert!(count(|case| case.shot.pose.pitch_deg == STEEPEST_DEG.0) >= 3);
        assert!(count(|case| case.shot.pose.pitch_deg == STEEPEST_DEG.1) >= 3);
        assert!(count(|case| matches!(case.absent, Absent::Random { .. })) >= 50);
        let is_on_line = |metres: f64| metres.rem_euclid(CHUNK_M) == 0.0;
        let is_on_border =
            |case: &Case| is_on_line(case.shot.pose.position_m.x) || is_on_line(case.shot.pose.position_m.z);
        let borders = cases.iter().filter(|case| is_on_border(case)).count();
        assert!((70..140).contains(&borders), "{borders}");
        for case in cases.iter().filter(|case| matches!(case.absent, Absent::ChildrenOf(_))) {
            assert!(is_on_border(case), "{}", case.name);
        }
        for site in [Site::Peak, Site::Valley] {
            assert!(cases.iter().filter(|case| case.site == site).count() >= 20, "{site:?}");
        }
        let mut times: Vec<f32> = cases.iter().map(|case| case.shot.time_s).collect();
        times.sort_unstable_by(f32::total_cmp);
        times.dedup();
        assert!(times.len() > 290 && times[0] >= 0.0 && f64::from(times[times.len() - 1]) <= LATEST_S);
    }

    #[test]
    fn absent_chunks_are_the_share_that_is_asked_for() {
        let keys = || (0..40).flat_map(|z| (0..50).filter_map(move |x| ChunkKey::new(0, x, z).ok()));
        let lost = |absent: Absent| keys().filter(|key| !absent.has_arrived(*key)).count();
        assert_eq!(lost(Absent::None), 0);
        assert!((900..1100).contains(&lost(Absent::Random { share: 0.5, seed: 3 })));
        let parent = ChunkKey::new(1, 3, 4).unwrap();
        assert_eq!(lost(Absent::ChildrenOf(parent)), 4);
        assert!(Absent::ChildrenOf(parent).has_arrived(parent));
    }
}
