//! The second reference: visibility of a point in f64. Every drawn triangle along the line of sight
//! is clipped against it. No code is shared with the tests: no pyramid, no rounding, no bound.

use crate::lod::drawn::DrawnChunk;
use client::cache::ChunkCache;
use client::camera::Pose;
use client::lod::Drawn;
use std::collections::HashMap;
use terrain::ChunkKey;
use terrain::constants::{CELLS, UNITS_PER_METRE};

/// The drawn terrain.
#[derive(Debug)]
pub struct VisibilityReference {
    chunks: HashMap<ChunkKey, DrawnChunk>,
    finest: u8,
    coarsest: u8,
    /// Terrain nearer to the eye than this occludes nothing, metres.
    near_m: f64,
}

/// A point in metres: east, up, south.
pub type Point = [f64; 3];

/// A ray below the terrain by less than this, metres, counts as clear: rounding.
const TOUCH_M: f64 = 1e-6;

impl VisibilityReference {
    /// Of a drawn selection.
    pub fn new(world: &ChunkCache, drawn: &[Drawn]) -> Self {
        let chunks: HashMap<ChunkKey, DrawnChunk> =
            drawn.iter().filter_map(|drawn| Some((drawn.key, DrawnChunk::new(world, drawn)?))).collect();
        let levels = || chunks.keys().map(|key| key.level());
        let (finest, coarsest) = (levels().min().unwrap_or(0), levels().max().unwrap_or(0));
        Self { chunks, finest, coarsest, near_m: f64::from(client::camera::NEAR_M) }
    }

    /// Whether a point is visible from an eye.
    pub fn sees(&self, eye: Point, point: Point) -> bool {
        self.first_in_the_way(eye, point).is_none()
    }

    /// The share of the way to a point where the land is first found above it.
    fn first_in_the_way(&self, eye: Point, point: Point) -> Option<f64> {
        let (east, south) = (point[0] - eye[0], point[2] - eye[2]);
        let length = east.hypot(south).hypot(point[1] - eye[1]);
        if length <= self.near_m {
            return None;
        }
        // Crossings of the ground track with lines of the finest drawn grid: between two of them
        // lies one cell of one chunk.
        let spacing = f64::from(2 << self.finest);
        let mut crossings = vec![self.near_m / length, 1.0];
        for (from, by) in [(eye[0], east), (eye[2], south)] {
            if by == 0.0 {
                continue;
            }
            let (low, high) = (from.min(from + by), from.max(from + by));
            let mut line = (low / spacing).floor() * spacing + spacing;
            while line < high {
                crossings.push((line - from) / by);
                line += spacing;
            }
        }
        crossings.retain(|at| (self.near_m / length..=1.0).contains(at));
        crossings.sort_unstable_by(f64::total_cmp);
        let blocked = crossings.windows(2).find(|pair| self.blocks(eye, point, (pair[0], pair[1])));
        blocked.map(|pair| 0.5 * (pair[0] + pair[1]))
    }

    /// Whether any of some points is visible. `hint_m`: horizontal distance of the last occluder,
    /// metres. It is tested first, because it mostly occludes the next point of a plant too.
    pub fn sees_any(&self, eye: Point, points: &[Point], hint_m: &mut f64) -> bool {
        points.iter().any(|point| {
            let length = (point[0] - eye[0]).hypot(point[2] - eye[2]).max(1e-9);
            let (from, to) = ((*hint_m - 1.0) / length, (*hint_m + 1.0) / length);
            let least = self.near_m / length.hypot(point[1] - eye[1]);
            if from > least && to < 1.0 && self.blocks(eye, *point, (from, to)) {
                return false;
            }
            match self.first_in_the_way(eye, *point) {
                Some(part) => {
                    *hint_m = part * length;
                    false
                }
                None => true,
            }
        })
    }

    /// Height of the drawn land at a place, metres, if any is drawn there.
    pub fn height(&self, x: f64, z: f64) -> Option<f64> {
        // A ray a little off the vertical: the test needs a ground track.
        let (low, high) = (-200.0, 3000.0);
        let mut bounds = (low, high);
        if !self.blocks([x, low, z], [x + 1e-9, low, z + 1e-9], (0.0, 1.0)) {
            return None;
        }
        for _ in 0..60 {
            let middle = 0.5 * (bounds.0 + bounds.1);
            let is_below = self.blocks([x, middle, z], [x + 1e-9, middle, z + 1e-9], (0.0, 1.0));
            if is_below { bounds.0 = middle } else { bounds.1 = middle }
        }
        Some(bounds.0)
    }

    /// Whether the land over the cell between two parts of the way rises above the ray there.
    fn blocks(&self, eye: Point, point: Point, (from, to): (f64, f64)) -> bool {
        let at = |part: f64, axis: usize| eye[axis] + (point[axis] - eye[axis]) * part;
        let middle = 0.5 * (from + to);
        let units = |axis: usize| (at(middle, axis) * f64::from(UNITS_PER_METRE)).floor() as i32;
        let (x, z) = (units(0), units(2));
        let found = (self.finest..=self.coarsest)
            .find_map(|level| self.chunks.get(&ChunkKey::containing(level, x, z)));
        let Some(chunk) = found else { return false };
        let (x0, z0) = chunk.key().origin();
        let spacing = i64::from(chunk.key().spacing());
        let cell = |at: i32, low: i32| {
            ((i64::from(at) - i64::from(low)) / spacing).clamp(0, CELLS as i64 - 1) as usize
        };
        let metres = |units: i64| units as f64 / f64::from(UNITS_PER_METRE);
        chunk.triangles_over((cell(x, x0), cell(z, z0))).any(|triangle| {
            let corners = triangle.map(|(column, row, height)| {
                [
                    metres(i64::from(x0) + column * spacing),
                    metres(height),
                    metres(i64::from(z0) + row * spacing),
                ]
            });
            rises_above(&corners, eye, point, (from, to))
        })
    }
}

/// Whether a triangle rises above the ray somewhere between two parts of the way.
fn rises_above([a, b, c]: &[Point; 3], eye: Point, point: Point, (from, to): (f64, f64)) -> bool {
    let area = (b[0] - a[0]) * (c[2] - a[2]) - (c[0] - a[0]) * (b[2] - a[2]);
    if area == 0.0 {
        return false;
    }
    // The track inside the triangle: three half planes.
    let (mut low, mut high) = (from, to);
    for (p, q) in [(a, b), (b, c), (c, a)] {
        let side = |x: f64, z: f64| ((q[0] - p[0]) * (z - p[2]) - (x - p[0]) * (q[2] - p[2])) * area.signum();
        let (at_eye, at_point) = (side(eye[0], eye[2]), side(point[0], point[2]));
        let change = at_point - at_eye;
        if change == 0.0 {
            if at_eye < 0.0 {
                return false;
            }
        } else if change > 0.0 {
            low = low.max(-at_eye / change);
        } else {
            high = high.min(-at_eye / change);
        }
    }
    if low >= high {
        return false;
    }
    let over = |part: f64| {
        let (x, z) = (eye[0] + (point[0] - eye[0]) * part, eye[2] + (point[2] - eye[2]) * part);
        let of_b = ((x - a[0]) * (c[2] - a[2]) - (c[0] - a[0]) * (z - a[2])) / area;
        let of_c = ((b[0] - a[0]) * (z - a[2]) - (x - a[0]) * (b[2] - a[2])) / area;
        let land = a[1] + of_b * (b[1] - a[1]) + of_c * (c[1] - a[1]);
        land - (eye[1] + (point[1] - eye[1]) * part)
    };
    over(low).max(over(high)) > TOUCH_M
}

/// The eye of a pose, metres.
pub fn eye_of(pose: &Pose) -> Point {
    pose.position_m.to_array()
}
