//! Twin of `wgsl/bound/placement.wesl`: where the clumps of a field stand, and up to which distance
//! each of them is drawn.
//!
//! Integers only: every client places the same clumps.

use super::clump_cell::{SQUARE_BITS, clump_cell, shared_number};
use super::surface::{FINE_BITS, GRID_BITS, NOWHERE, Slots, Surface};
use crate::layout::{Culling, KIND_GRASS, Planting};
use terrain::hash::{hash2, mix};
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

/// Sixteenths of a clump's height and hue that are those of its clump cell.
const HEIGHT_SHARE: u32 = 9;
const HUE_SHARE: u32 = 12;
/// Of the place of the first clump of a cell.
const SPREAD_SEED: u32 = 0x6a58;
/// Fine units, a power of two less one: 1/8 m.
const SPREAD_JITTER: u32 = 511;

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

/// Place of a clump of grass in its cell, fine units modulo the cell's side: a sequence that
/// spreads the first clumps of a cell as evenly as all of them, so that no gap is wide and thinning
/// leaves none (Roberts, "The Unreasonable Effectiveness of Quasirandom Sequences", 2018), from a
/// place of the cell's own, plus up to an eighth of a metre.
fn spread_place(planting: &Planting, first: u32, index: u32, random: [u32; 2]) -> [u32; 2] {
    let even = [
        first.wrapping_add(index.wrapping_mul(0xc13f_a9a9)),
        (first << 16).wrapping_add(index.wrapping_mul(0x91e1_0da5)),
    ];
    return [0, 1].map(|axis| (even[axis] >> (32 - planting.cell_bits)) + (random[axis] & SPREAD_JITTER));
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
    let mut place = [random.place, random.place >> 16];
    if planting.kind == KIND_GRASS {
        let first = hash2(SPREAD_SEED, planting.cell_x + column, planting.cell_z + row);
        place = spread_place(planting, first, index, place);
    }
    let x = (column << planting.cell_bits) + (place[0] & mask) as i32;
    let z = (row << planting.cell_bits) + (place[1] & mask) as i32;
    if (random.survival & 255) >= density_near(surface, planting, x, z, mix(random.survival)) {
        return None;
    }
    let y = surface.height_at(x, z);
    if y <= NOWHERE << FINE_BITS {
        return None;
    }
    let rank = (index * 256 + (random.survival >> 8 & 255)) / planting.per_cell.max(1);
    let (mut height, mut hue) = (random.height >> 26, random.hue >> 26);
    if planting.kind == KIND_GRASS {
        let squares = planting.cell_bits - SQUARE_BITS;
        let cell = clump_cell([planting.cell_x << squares, planting.cell_z << squares], [x, z]);
        height = shared_number(height, cell.height, HEIGHT_SHARE);
        hue = shared_number(hue, cell.hue, HUE_SHARE);
    }
    let attributes =
        (random.width >> 26) | height << 6 | hue << 12 | (random.phase >> 26) << 18 | rank.min(255) << 24;
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

#[cfg(test)]
mod tests {
    use super::*;
    use bytemuck::Zeroable;

    /// The widest free circle's radius around any of 16 x 16 points of a cell, metres, where
    /// `places` repeat in all cells around it.
    fn widest_gap_m(places: &[[u32; 2]]) -> f32 {
        let distance = |at: [i32; 2], place: [u32; 2]| {
            let along = [0, 1].map(|axis| {
                let apart = (at[axis] - (place[axis] & 8191) as i32).abs();
                apart.min(8192 - apart) as f32 / 4096.0
            });
            along[0].hypot(along[1])
        };
        let points = (0..256).map(|n| [512 * (n % 16), 512 * (n / 16)]);
        let free = points.map(|at| places.iter().map(|place| distance(at, *place)).fold(9.0, f32::min));
        free.fold(0.0, f32::max)
    }

    #[test]
    fn clumps_of_grass_leave_no_wide_gap_in_a_cell() {
        let planting = Planting { cell_bits: 13, ..Planting::zeroed() };
        let (mut even, mut random) = ([0.0f32; 2], 0.0);
        for cell in 0..200 {
            let own = |index: u32| {
                let place = mix(cell * 64 + index);
                [place, place >> 16]
            };
            let spread = |index| spread_place(&planting, mix(cell), index, own(index));
            let all: Vec<[u32; 2]> = (0..32).map(spread).collect();
            even = [even[0].max(widest_gap_m(&all)), even[1].max(widest_gap_m(&all[..8]))];
            // The control: places that know nothing of each other.
            random += widest_gap_m(&(0..32).map(own).collect::<Vec<_>>()) / 200.0;
        }
        assert!(even[0] < 0.36 && even[1] < 0.62 && random > 0.42, "{even:?} {random}");
    }
}
