//! Trees beyond the range of per-tree culling: which patches of cells are looked at in a frame.
//!
//! A patch is left out only if it is out of range, outside the view, or has no density. Nothing is
//! tested for occlusion: far trees are a quad each, and the depth test is cheaper.

use crate::cache::{ChunkCache, Resident};
use crate::camera::Eye;
use crate::features::terrain::instance::chunk_words;
use crate::frustum::Frustum;
use crate::lod::Drawn;
use glam::DVec3;
use shaders::layout::{
    Culling, FAR_PATCH_CELLS, FarTrees, Field, KIND_TREES, MAX_FAR_PATCHES, OccluderChunk, Planting,
};
use shaders::twin::surface::{FINE_BITS, STEP_BITS};
use std::ops::Range;
use terrain::constants::{BLOCK_CELLS, GRASS_GRID, SPACING_BITS, UNITS_PER_METRE};

/// Capacity for trees: 8 MB. More are dropped, farthest first, and counted.
pub const MAX_FAR_TREES: u32 = 1 << 18;

/// Side of a patch, units: cells of trees are 8 m wide.
const PATCH: i32 = FAR_PATCH_CELLS << (STEP_BITS + 2 - FINE_BITS);

/// Most drawn chunks under the patches; the patches of others are dropped and counted.
pub const MAX_FAR_CHUNKS: usize = 8_192;

/// Sides of the grid that patches and places are counted in, patches. It reaches 16 km from the
/// eye.
const GRID_PATCHES: i32 = 512;

/// How far the block of a tree's density may lie from its place, units: 4 m.
const DENSITY_REACH: i32 = 4 * UNITS_PER_METRE;

/// The far trees of a frame.
#[derive(Clone, Debug, PartialEq)]
pub struct FarTreeFrame {
    /// The eye in the grid of the patches; nothing else is used.
    pub culling: Culling,
    /// Placement.
    pub planting: Planting,
    /// Sizes and thinning.
    pub field: Field,
    /// Where they begin, how many patches there are.
    pub params: FarTrees,
    /// The drawn chunks under the patches.
    pub chunks: Vec<OccluderChunk>,
    /// Of each patch, nearest first: its chunk, its column and row in the grid (16 bits each).
    pub patches: Vec<[u32; 2]>,
    /// Patches without room: the farthest ones beyond [`MAX_FAR_PATCHES`], and all those of drawn
    /// chunks beyond [`MAX_FAR_CHUNKS`].
    pub patches_lost: u32,
}

/// The view and the drawn land of a frame.
#[derive(Clone, Copy, Debug)]
pub struct FarTreeView<'a> {
    /// The eye.
    pub eye: &'a Eye,
    /// The view; none if patches outside of it count too.
    pub frustum: Option<&'a Frustum>,
    /// The resident chunks.
    pub cache: &'a ChunkCache,
    /// Those that are drawn.
    pub drawn: &'a [Drawn],
}

impl FarTreeFrame {
    /// The trees of a range of distances, metres; none if there are none. `margin_m` is how far a
    /// tree reaches aside of its root, and above it.
    #[must_use]
    pub fn new(
        view: &FarTreeView<'_>,
        range_m: [f64; 2],
        margin_m: [f64; 2],
        (field, planting): (Field, Planting),
    ) -> Option<Self> {
        let low = |at: i32| (at.div_euclid(PATCH) - GRID_PATCHES / 2).saturating_mul(PATCH);
        let corner = [low(view.eye.units[0]), low(view.eye.units[2])];
        let eye = eye_in(view.eye, corner);
        let mut frame = Self {
            culling: Culling { eye, corner, ..bytemuck::Zeroable::zeroed() },
            planting: Planting {
                kind: KIND_TREES,
                cell_x: corner[0] >> (planting.cell_bits - FINE_BITS),
                cell_z: corner[1] >> (planting.cell_bits - FINE_BITS),
                ..planting
            },
            field: Field { eye_x: eye[0], eye_y: eye[1], eye_z: eye[2], ..field },
            params: FarTrees { begin_m: range_m[0] as f32, room: MAX_FAR_TREES, ..FarTrees::default() },
            chunks: Vec::new(),
            patches: Vec::new(),
            patches_lost: 0,
        };
        let mut found = Vec::new();
        for drawn in view.drawn {
            frame.put(view, drawn, range_m, margin_m, &mut found);
        }
        found.sort_unstable();
        frame.patches_lost += found.len().saturating_sub(MAX_FAR_PATCHES) as u32;
        frame.patches = found.into_iter().take(MAX_FAR_PATCHES).map(|(_, patch)| patch).collect();
        frame.params.patches = frame.patches.len() as u32;
        (!frame.patches.is_empty()).then_some(frame)
    }

    /// Adds the patches of a drawn chunk, each with its squared distance.
    fn put(
        &mut self,
        view: &FarTreeView<'_>,
        drawn: &Drawn,
        [begin_m, end_m]: [f64; 2],
        [aside_m, above_m]: [f64; 2],
        found: &mut Vec<(u64, [u32; 2])>,
    ) {
        let Some(chunk) = view.cache.get(drawn.key) else { return };
        if chunk.grass.density.iter().all(|density| *density == 0) {
            return;
        }
        let parent = drawn.key.parent().and_then(|parent| view.cache.get(parent)).unwrap_or(chunk);
        let (x, z) = drawn.key.origin();
        let corner = self.culling.corner;
        let columns = patches_of(x, drawn.key.side(), corner[0], view.eye.units[0], end_m);
        let rows = patches_of(z, drawn.key.side(), corner[1], view.eye.units[2], end_m);
        let index = self.chunks.len() as u32;
        let heights_m = [chunk.min.min(parent.min), chunk.max.max(parent.max)]
            .map(|units| (f64::from(units) - f64::from(view.eye.units[1])) / f64::from(UNITS_PER_METRE));
        let before = found.len();
        let from_eye = |low: [i32; 2]| {
            [0, 1].map(|axis| {
                let units = i64::from(low[axis]) - i64::from(view.eye.units[2 * axis]);
                units as f64 / f64::from(UNITS_PER_METRE)
            })
        };
        // Whether trees on a square of the chunk may be in the view.
        let may_be_seen = |[east, south]: [f64; 2], side_m: f64| {
            let low = DVec3::new(east - aside_m, heights_m[0] - aside_m, south - aside_m);
            let across_m = side_m + aside_m;
            let high = DVec3::new(east + across_m, heights_m[1] + above_m, south + across_m);
            view.frustum.is_none_or(|frustum| frustum.may_hold(low, high))
        };
        // Most chunks lie beside the view: their patches need no look.
        if !may_be_seen(from_eye([x, z]), f64::from(drawn.key.side()) / f64::from(UNITS_PER_METRE)) {
            return;
        }
        for row in rows {
            for column in columns.clone() {
                let low = [corner[0] + column * PATCH, corner[1] + row * PATCH];
                let from_eye = from_eye(low);
                let side_m = f64::from(PATCH / UNITS_PER_METRE);
                let nearest = from_eye.map(|low| low.max(-low - side_m).max(0.0));
                let farthest = from_eye.map(|low| low.abs().max((low + side_m).abs()));
                let deepest = heights_m[0].abs().max(heights_m[1].abs());
                let is_near = farthest[0].hypot(farthest[1]).hypot(deepest) < begin_m;
                // The range is measured with the height of the eye.
                let above = heights_m[0].max(-heights_m[1]).max(0.0);
                if nearest[0].hypot(nearest[1]).hypot(above) > end_m + 1.0 || is_near {
                    continue;
                }
                if !has_density(chunk, [low[0] - x, low[1] - z], drawn.key.spacing()) {
                    continue;
                }
                if !may_be_seen(from_eye, side_m) {
                    continue;
                }
                let far = (nearest[0] * nearest[0] + nearest[1] * nearest[1]) as u64;
                found.push((far, [index, column as u32 | (row as u32) << 16]));
            }
        }
        if found.len() > before && self.chunks.len() >= MAX_FAR_CHUNKS {
            self.patches_lost += (found.len() - before) as u32;
            found.truncate(before);
        } else if found.len() > before {
            let words = chunk_words(drawn, chunk, parent);
            let steps = |low: i32, corner: i32| ((i64::from(low) - i64::from(corner)) >> SPACING_BITS) as i32;
            self.chunks.push(OccluderChunk { words, x: steps(x, corner[0]), z: steps(z, corner[1]) });
        }
    }
}

/// Columns, or rows, of the patches of a chunk within the grid and so many metres of the eye.
fn patches_of(low: i32, side: u32, corner: i32, eye: i32, end_m: f64) -> Range<i32> {
    let reach = (end_m * f64::from(UNITS_PER_METRE)).ceil() as i64;
    let column = |at: i64| (at - i64::from(corner)).div_euclid(i64::from(PATCH));
    let (first, end) = (column(i64::from(low)), column(i64::from(low) + i64::from(side)));
    let (nearest, farthest) = (column(i64::from(eye) - reach), column(i64::from(eye) + reach) + 1);
    let within = |at: i64| at.clamp(0, i64::from(GRID_PATCHES)) as i32;
    within(first.max(nearest))..within(end.min(farthest))
}

/// Whether trees may stand on a patch: any block of the density record that a tree there may ask.
fn has_density(chunk: &Resident, [east, south]: [i32; 2], spacing: i32) -> bool {
    let block = spacing * BLOCK_CELLS as i32;
    let last = GRASS_GRID as i32 - 1;
    let blocks = |low: i32| {
        let first = (low - DENSITY_REACH).div_euclid(block).clamp(0, last);
        first..=(low + PATCH + DENSITY_REACH).div_euclid(block).clamp(0, last)
    };
    blocks(south)
        .any(|row| blocks(east).any(|column| chunk.grass.density[(row * (last + 1) + column) as usize] > 0))
}

/// The eye from a corner: east, up, south in fine units, rounded.
fn eye_in(eye: &Eye, corner: [i32; 2]) -> [i32; 3] {
    let fine = f64::from(UNITS_PER_METRE << FINE_BITS);
    let fraction = eye.fraction_m.as_dvec3() * fine;
    // Cannot overflow: heights are within 20 km, places within 16.5 km of the corner; 2^27 fine
    // units.
    let axis = |units: i32, low: i32, fraction: f64| ((units - low) << FINE_BITS) + fraction.round() as i32;
    [
        axis(eye.units[0], corner[0], fraction.x),
        axis(eye.units[1], 0, fraction.y),
        axis(eye.units[2], corner[1], fraction.z),
    ]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn patches_of_a_chunk_are_those_in_reach() {
        let eye = 1_000 * UNITS_PER_METRE;
        let corner = (eye.div_euclid(PATCH) - GRID_PATCHES / 2) * PATCH;
        let columns = |low_m: i32, side_m: u32, end_m: f64| {
            patches_of(low_m * UNITS_PER_METRE, side_m * UNITS_PER_METRE as u32, corner, eye, end_m)
        };
        assert_eq!(columns(1_024, 128, 8_000.0).len(), 2, "a chunk of level 0");
        assert_eq!(columns(0, 8_192, 20_000.0).len(), 128, "one of level 6");
        // Only what may lie within 100 m of 1,000 m: from 896 m to 1,152 m.
        assert_eq!(columns(0, 8_192, 100.0).len(), 4);
        assert!(columns(4_096, 1_024, 100.0).is_empty() && columns(-4_096, 1_024, 100.0).is_empty());
    }
}
