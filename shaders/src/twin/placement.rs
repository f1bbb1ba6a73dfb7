//! Twin of `wgsl/bound/placement.wesl`: where the clumps of a field stand, and up to which distance
//! each of them is drawn.
//!
//! Integers only: every client places the same clumps.

use super::surface::{FINE_BITS, GRID_BITS, NOWHERE, Slots, Surface};
use crate::layout::{Culling, KIND_GRASS, Planting};
use terrain::hash::mix;
use terrain::random_attributes::random_attributes;

/// Blocks along a side of a patch.
pub const PATCH_BLOCKS: u32 = 16;

/// log2 of the cells along a side of a block.
pub const BLOCK_CELL_BITS: u32 = 2;

/// Cells of a block.
pub const BLOCK_CELLS: u32 = 16;

/// log2 of the fine units in 1/16 m, in which distances are squared and planes are tested.
pub const COARSE_BITS: u32 = 8;

/// Distances beyond this, 1/16 m, are outside every field: their squares fit.
pub const FARTHEST: i32 = 1 << 15;

/// A clump of a field, visible or not.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct Clump {
    /// Place of the root in the grid, fine units.
    pub x: i32,
    /// The same, south.
    pub z: i32,
    /// The root on the drawn surface, fine units above the sea.
    pub y: i32,
    /// Width, height, hue and phase, 6 bits each, and rank, 8 bits: as `shared/clump.wesl` reads
    /// them.
    pub attributes: u32,
}

/// Square of the distance between the eye and a place, (1/16 m)²; `u32::MAX` beyond [`FARTHEST`]
/// along any axis.
#[must_use]
pub fn distance_squared(culling: &Culling, x: i32, y: i32, z: i32) -> u32 {
    let east = ((x - culling.eye[0]) >> COARSE_BITS).abs();
    let up = ((y - culling.eye[1]) >> COARSE_BITS).abs();
    let south = ((z - culling.eye[2]) >> COARSE_BITS).abs();
    if east.max(up).max(south) >= FARTHEST {
        return u32::MAX;
    }
    return (east * east) as u32 + (up * up) as u32 + (south * south) as u32;
}

/// The root of a square, rounded up.
#[must_use]
pub fn root_of(square: u32) -> i32 {
    let mut root = 0u32;
    for bit in 0..16 {
        let more = root | (1 << (15 - bit));
        if more * more <= square {
            root = more;
        }
    }
    return root as i32 + i32::from(root * root < square);
}

/// An upper bound of the distance between the eye and a place, 1/16 m: two more than the distance,
/// which is counted in whole ones along each axis.
#[must_use]
pub fn distance_bound(culling: &Culling, x: i32, y: i32, z: i32) -> i32 {
    return root_of(distance_squared(culling, x, y, z)) + 2;
}

/// How much a plant of the kind is widened at a distance that is no farther than this, Q8.
pub(super) fn widening_at(planting: &Planting, bound: i32) -> i32 {
    let from = (planting.thin_from >> COARSE_BITS).max(1);
    return ((bound.min(FARTHEST) << 8) as u32 / from as u32).clamp(256, planting.widest) as i32;
}

/// How much of its width the thinning leaves to a rank at a distance of at least `near`, 1/16 m;
/// Q8, never too little. Integers for `field::field_presence`.
pub(super) fn presence_at(planting: &Planting, near: i32, rank: u32) -> i32 {
    let begin = ((planting.thin_from >> COARSE_BITS) as u32) << 16;
    let share = ((begin / near.max(1) as u32) as i32).min(1 << 16);
    let band = (share >> 2).max(256).min(2 * ((1 << 16) - share));
    let inside = share + (band >> 1) - (rank as i32 * 256 + 128) + 16;
    if inside >= band {
        return 256;
    }
    return ((((inside.max(0) as u32) << 8) / band.max(1) as u32) as i32 + 1).min(256);
}

/// How much of its height a plant still has at a distance of at least `near`, 1/16 m; Q8, never too
/// little. Integers for `field::field_height_scale`.
pub(super) fn height_scale_at(planting: &Planting, near: i32) -> i32 {
    let into = near - (planting.range - planting.collapse);
    if into <= 0 {
        return 256;
    }
    let part = ((((into as u32) << 8) / planting.collapse as u32) as i32).min(256);
    // 1 - part² (3 - 2 part).
    return 256 - ((part * part * (768 - 2 * part)) >> 16) + 1;
}

/// Density of a field at a place with a random offset, so that its edges are soft: 0 to 256.
fn density_near<S: Slots>(
    surface: &Surface<'_, S>,
    planting: &Planting,
    x: i32,
    z: i32,
    random_word: u32,
) -> u32 {
    let last = (1 << GRID_BITS) - 1;
    // Half a texel of a level-0 chunk each way.
    let east = (x + ((random_word & 255) as i32 - 128) * 128).clamp(0, last);
    let south = (z + ((random_word >> 8 & 255) as i32 - 128) * 128).clamp(0, last);
    let share = surface.density_at(east, south);
    let full = share + (share >> 7);
    if planting.kind == KIND_GRASS {
        return full;
    }
    // Trees need less of a meadow than grass does; where the land is drawn without woods, they are
    // not drawn either.
    return (2 * full).min(256);
}

/// Clump number `index` of a cell of the grid, if there is one.
#[must_use]
pub fn clump_at<S: Slots>(
    surface: &Surface<'_, S>,
    planting: &Planting,
    column: i32,
    row: i32,
    index: u32,
) -> Option<Clump> {
    let random = random_attributes(
        planting.seed,
        planting.kind,
        planting.cell_x + column,
        planting.cell_z + row,
        index,
    );
    let mask = (1 << planting.cell_bits) - 1;
    let x = (column << planting.cell_bits) + (random.place & mask) as i32;
    let z = (row << planting.cell_bits) + (random.place >> 16 & mask) as i32;
    if (random.survival & 255) >= density_near(surface, planting, x, z, mix(random.survival)) {
        return None;
    }
    let y = surface.height_at(x, z);
    if y <= NOWHERE << FINE_BITS {
        return None;
    }
    let rank = (index * 256 + (random.survival >> 8 & 255)) / planting.per_cell.max(1);
    let attributes = (random.width >> 26)
        | (random.height >> 26) << 6
        | (random.hue >> 26) << 12
        | (random.phase >> 26) << 18
        | rank.min(255) << 24;
    return Some(Clump { x, z, y, attributes });
}

/// Square of the draw distance of a rank, (1/16 m)².
pub(super) fn draw_distance_squared(planting: &Planting, rank: u32) -> u32 {
    return planting.draw_distance_squared[(rank >> 2) as usize][(rank & 3) as usize];
}

/// Whether thinning draws a clump at a squared distance.
#[must_use]
pub fn is_within_draw_distance(planting: &Planting, clump: &Clump, far: u32) -> bool {
    return far <= draw_distance_squared(planting, clump.attributes >> 24);
}
