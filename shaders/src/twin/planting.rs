//! Twin of `wgsl/bound/planting.wesl`: which clumps of a field stand where, and which of them are
//! kept for a picture.
//!
//! Integers only, so every client grows the same field and keeps the same part of it.

use super::march::{Ground, is_hidden_by_vertices, marched_is_hidden};
use super::sight::{Target, is_hidden};
use super::surface::{FINE_BITS, NOWHERE, SQUARE_BITS, STEP_BITS, Slots, Surface, TILE_BITS};
use crate::layout::{
    CULL_DISTANCE, CULL_EXACT, CULL_HIERARCHICAL, CULL_MARCH, CULL_NOISE, Culling, KIND_GRASS, Planting,
    SQUARE_TILES,
};
use terrain::hash::mix;
use terrain::streams::streams;

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

/// A clump of a field, before it is asked whether it is seen.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct Clump {
    /// Place of the root in the square, fine units.
    pub x: i32,
    /// The same, south.
    pub z: i32,
    /// The root on the drawn surface, fine units above the sea.
    pub y: i32,
    /// Width, height, hue and phase, 6 bits each, and rank, 8 bits: as `shared/clump.wesl` reads
    /// them.
    pub looks: u32,
}

/// A thing to be seen: a clump or a block of them.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Extent {
    /// The highest point and how far it reaches sideways.
    pub target: Target,
    /// The lowest point, fine units.
    pub bottom: i32,
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

/// Whether a ball touches the inside of all four planes of the view; errs on the side of yes.
#[must_use]
pub fn may_be_in_view(culling: &Culling, extent: &Extent) -> bool {
    let middle = extent.bottom + ((extent.target.top - extent.bottom) >> 1);
    let east = (extent.target.x - culling.eye[0]) >> COARSE_BITS;
    let up = (middle - culling.eye[1]) >> COARSE_BITS;
    let south = (extent.target.z - culling.eye[2]) >> COARSE_BITS;
    if east.abs().max(up.abs()).max(south.abs()) >= FARTHEST {
        return true;
    }
    let half = (extent.target.top - extent.bottom) >> (COARSE_BITS + 1);
    let radius = ((extent.target.radius + extent.target.skirt) >> COARSE_BITS) + half + 2;
    // What the normals (Q14) and places are rounded by.
    let slack = east.abs() + up.abs() + south.abs() + (3 << 14);
    let reach = (radius.min(FARTHEST) << 14) + slack;
    for plane in culling.planes {
        if plane[0] * east + plane[1] * up + plane[2] * south < -reach {
            return false;
        }
    }
    return true;
}

/// Whether a thing passes the tests of the chosen path but those of the land.
fn is_in_view(culling: &Culling, extent: &Extent) -> bool {
    return culling.path == CULL_DISTANCE || may_be_in_view(culling, extent);
}

/// How much a plant of the kind is widened at a distance that is no farther than this, Q8.
fn widening_at(planting: &Planting, bound: i32) -> i32 {
    let from = (planting.thin_from >> COARSE_BITS).max(1);
    return ((bound.min(FARTHEST) << 8) as u32 / from as u32).clamp(256, planting.widest) as i32;
}

/// How much of its width the thinning leaves to a rank at a distance of at least `near`, 1/16 m;
/// Q8, never too little. Integers for `field::field_presence`.
fn presence_at(planting: &Planting, near: i32, rank: u32) -> i32 {
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
/// little. Integers for `field::field_standing`.
fn standing_at(planting: &Planting, near: i32) -> i32 {
    let into = near - (planting.range - planting.collapse);
    if into <= 0 {
        return 256;
    }
    let part = ((((into as u32) << 8) / planting.collapse as u32) as i32).min(256);
    // 1 - part² (3 - 2 part).
    return 256 - ((part * part * (768 - 2 * part)) >> 16) + 1;
}

/// Slope of the ground around a place, east and south, Q14, over 4 m: that by which a clump is
/// drawn. None where the land ends.
#[must_use]
pub fn gradient_at<S: Slots>(surface: &Surface<'_, S>, x: i32, z: i32) -> Option<[i32; 2]> {
    let step = 1 << STEP_BITS;
    let last = (1 << SQUARE_BITS) - 1;
    let west = surface.height_at((x - step).max(0), z);
    let east = surface.height_at((x + step).min(last), z);
    let north = surface.height_at(x, (z - step).max(0));
    let south = surface.height_at(x, (z + step).min(last));
    if west.min(east).min(north).min(south) <= NOWHERE << FINE_BITS {
        return None;
    }
    return Some([east - west, south - north]);
}

/// The same; none also where it may be steeper than 1, which is more than a foot follows.
#[must_use]
pub fn slope_at<S: Slots>(surface: &Surface<'_, S>, x: i32, z: i32) -> Option<[i32; 2]> {
    return gradient_at(surface, x, z).filter(|[along, across]| steepness(*along, *across) <= 1 << 14);
}

/// No less than the length of a vector: the hypotenuse is at most the long side and half of the
/// short one.
fn steepness(along: i32, across: i32) -> i32 {
    let (along, across) = (along.abs(), across.abs());
    return along.max(across) + (along.min(across) >> 1);
}

/// How far the tip of a stem may be beside its root, on ground so steep (Q14), pushed aside by so
/// much (Q8). The horizontal part of its direction goes evenly from 0.45 of the ground's at the
/// root to that and the push at the tip, 0.75 at most, so on the way it is half of their sum.
fn lean_of(height: i32, steep: i32, push: i32) -> i32 {
    let tip = (push + ((116 * steep) >> 14) + 1).min(192);
    return ((height * tip) >> 9) + ((((15 * height) >> 6) * steep) >> 14) + (height >> 6) + 2;
}

/// What is added to the direction of a tip at most, Q8: how the clump has grown, by its hue in
/// 64ths, the wind, and leaning away from an eye that is higher by a part `tilt` (Q8) of the
/// distance. That last one goes with sine and cosine of the eye's height, whose product is at most
/// 1/2.
fn push_of(planting: &Planting, hue: i32, tilt: i32) -> i32 {
    return 21
        + ((41 * (hue + 1)) >> 6)
        + planting.wind_reach
        + ((planting.lean_reach * tilt.min(128)) >> 8)
        + 2;
}

/// [`Planting::wind_reach`] of a wind, 0 to 1: `clump::wind_push` is at most 0.55 of it.
#[must_use]
pub fn wind_reach(wind: f32) -> i32 {
    (0.55 * 256.0 * wind).ceil() as i32
}

/// [`Planting::lean_reach`] of a lean, 0 to 1: `clump::lean_push` is at most 0.9 of it times sine
/// and cosine of the eye's height.
#[must_use]
pub fn lean_reach(lean: f32) -> i32 {
    (0.9 * 256.0 * lean).ceil() as i32
}

/// By how much of the distance the eye is above a place, Q8, never too little; `near` is no more
/// than the distance, 1/16 m.
fn tilt_of(culling: &Culling, y: i32, near: i32) -> i32 {
    let up = ((culling.eye[1] - y) >> COARSE_BITS) + 1;
    return (((up.clamp(0, FARTHEST) << 8) as u32 / near.max(1) as u32).min(256)) as i32 + 1;
}

/// Length of the longest of the six blades of a clump in the third level of detail, Q8, never too
/// little, by its phase modulo 9: lengths follow `tuft_number`, which repeats with a ninth of a
/// phase. A test of `twin::tuft` compares.
pub const LONGEST: [i32; 9] = [251, 253, 245, 254, 256, 255, 247, 250, 241];

/// By how much a clump in the third level of detail surely sinks into the ground, fine units:
/// `tuft_vertex` takes the lesser of 0.04 heights and 0.14 widths. Widths are known to 12 % where
/// the thinning leaves them whole, of which distances within a third of a metre, at more than 32 m,
/// tell as much.
fn sink_of(half: i32, height: i32, near: i32, presence: i32) -> i32 {
    if near <= 512 || presence < 256 {
        return 0;
    }
    return ((height * 10) >> 8).min((half * 56) >> 8);
}

/// What a plant takes up, from its root, fine units: see [`Target`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Shape {
    radius: i32,
    follow: i32,
    skirt: i32,
    fall: i32,
    /// Its highest point over its root; of grass, over the plane through the root that has the
    /// slope of the ground.
    over: i32,
}

/// What a plant takes up of half a width and a height. `slope` is that of the ground, none if it is
/// not known or steeper than 1.
///
/// A tree is a cone: at a share `y` of its height no vertex of it is farther from the vertical than
/// 1.08 - 0.89 y half widths, sway and all; `twin::conifer` proves it by trying.
///
/// Grass: feet follow the ground; its normal travels in bytes, hence the 64th. What leans by a part
/// l of its height does not follow it: downhill it is above the slope by g l, but lower by l² / 2
/// for having leant, so by no more than g² / 2. Near by the blades spread up to their tips, which
/// stand 0.49 of the width from the middle. In the third level of detail they close in: feet reach
/// half the width, tips stand 0.3 (77/256) of it from the middle and lean; what is between is on
/// straight lines from foot to tip, which the skirt holds.
fn shape_of(
    planting: &Planting,
    half: i32,
    height: i32,
    is_far: bool,
    slope: Option<[i32; 2]>,
    push: i32,
) -> Shape {
    if planting.kind != KIND_GRASS {
        let radius = ((half * 49) >> 8) + 1;
        return Shape {
            radius,
            follow: radius,
            skirt: ((half * 277) >> 8) + 1 - radius,
            fall: height,
            over: height + 1,
        };
    }
    let steep = slope.map_or(1 << 14, |slope| steepness(slope[0], slope[1]));
    let lean = lean_of(height, steep, push);
    // Of a slope that is not known nothing is taken off: it is at most 1.
    let foot = if slope.is_some() { (((height * steep) >> 14) * steep) >> 15 } else { half };
    let above = (half >> 6) + 2;
    let over = height + foot + above;
    let spread = if is_far { ((half * 154) >> 8) + 1 } else { half };
    if is_far && slope.is_some() && spread + lean < half {
        let radius = spread + lean;
        return Shape { radius, follow: spread, skirt: half - radius, fall: height + foot, over };
    }
    let radius = if is_far { half.max(spread + lean) } else { half + lean };
    return Shape { radius, follow: half, skirt: 0, fall: 0, over };
}

/// What a clump takes up, as wide as its distance makes it, on ground of a slope.
#[must_use]
pub fn extent_of(culling: &Culling, planting: &Planting, clump: &Clump, slope: Option<[i32; 2]>) -> Extent {
    let width = planting.width_low + ((planting.width_span * ((clump.looks & 63) as i32 + 1)) >> 6);
    let height = planting.height_low + ((planting.height_span * ((clump.looks >> 6 & 63) as i32 + 1)) >> 6);
    let bound = distance_bound(culling, clump.x, clump.y, clump.z);
    // The bound is at most five too large.
    let near = bound - 5;
    let presence = presence_at(planting, near, clump.looks >> 24);
    let widening = (widening_at(planting, bound) * presence) >> 8;
    let half = ((width * widening) >> 9) + 2;
    let height = ((height * standing_at(planting, near)) >> 8) + 1;
    let is_far = distance_squared(culling, clump.x, clump.y, clump.z) > planting.detail[1];
    let is_low = is_far && planting.kind == KIND_GRASS;
    let longest = if is_low { LONGEST[((clump.looks >> 18 & 63) % 9) as usize] } else { 256 };
    let sink = if is_low { sink_of(half, height, near, presence) } else { 0 };
    let push = push_of(planting, (clump.looks >> 12 & 63) as i32, tilt_of(culling, clump.y, near));
    let shape = shape_of(planting, half, ((height * longest) >> 8) + 1, is_far, slope, push);
    let known = slope.filter(|_| planting.kind == KIND_GRASS).unwrap_or([0, 0]);
    return Extent {
        target: Target {
            x: clump.x,
            top: clump.y + shape.over - sink,
            z: clump.z,
            radius: shape.radius,
            follow: shape.follow,
            skirt: shape.skirt,
            fall: shape.fall,
            east_rise: known[0],
            south_rise: known[1],
        },
        bottom: clump.y - half,
    };
}

/// The one point that the tests ask for that are kept to be measured against: the tip over the
/// root, as high as it is drawn.
#[must_use]
pub fn tip_of(culling: &Culling, planting: &Planting, clump: &Clump) -> Target {
    let whole = planting.height_low + ((planting.height_span * ((clump.looks >> 6 & 63) as i32 + 1)) >> 6);
    let near = distance_bound(culling, clump.x, clump.y, clump.z) - 5;
    let height = (whole * standing_at(planting, near)) >> 8;
    return Target {
        x: clump.x,
        top: clump.y + height,
        z: clump.z,
        radius: 0,
        follow: 0,
        skirt: 0,
        fall: 0,
        east_rise: 0,
        south_rise: 0,
    };
}

/// Density of a field at a place that is off by lot, so that its edges are soft: 0 to 256.
fn density_near<S: Slots>(surface: &Surface<'_, S>, planting: &Planting, x: i32, z: i32, lot: u32) -> u32 {
    let last = (1 << SQUARE_BITS) - 1;
    // Half a texel of a level-0 chunk each way.
    let east = (x + ((lot & 255) as i32 - 128) * 128).clamp(0, last);
    let south = (z + ((lot >> 8 & 255) as i32 - 128) * 128).clamp(0, last);
    let share = surface.density_at(east, south);
    let full = share + (share >> 7);
    if planting.kind == KIND_GRASS {
        return full;
    }
    // Trees need less of a meadow than grass does; where the land is drawn without woods, they are
    // not drawn either.
    return (2 * full).min(256);
}

/// Clump number `index` of a cell of the square, if one stands there.
#[must_use]
pub fn clump_at<S: Slots>(
    surface: &Surface<'_, S>,
    planting: &Planting,
    column: i32,
    row: i32,
    index: u32,
) -> Option<Clump> {
    let lots = streams(planting.seed, planting.kind, planting.cell_x + column, planting.cell_z + row, index);
    let mask = (1 << planting.cell_bits) - 1;
    let x = (column << planting.cell_bits) + (lots.place & mask) as i32;
    let z = (row << planting.cell_bits) + (lots.place >> 16 & mask) as i32;
    if (lots.fate & 255) >= density_near(surface, planting, x, z, mix(lots.fate)) {
        return None;
    }
    let y = surface.height_at(x, z);
    if y <= NOWHERE << FINE_BITS {
        return None;
    }
    let rank = (index * 256 + (lots.fate >> 8 & 255)) / planting.per_cell.max(1);
    let looks = (lots.width >> 26)
        | (lots.height >> 26) << 6
        | (lots.hue >> 26) << 12
        | (lots.phase >> 26) << 18
        | rank.min(255) << 24;
    return Some(Clump { x, z, y, looks });
}

/// Distance up to which a rank stands, squared.
fn stands_within(planting: &Planting, rank: u32) -> u32 {
    return planting.stands_within[(rank >> 2) as usize][(rank & 3) as usize];
}

/// Whether thinning leaves a clump standing at a squared distance.
#[must_use]
pub fn stands_at(planting: &Planting, clump: &Clump, far: u32) -> bool {
    return far <= stands_within(planting, clump.looks >> 24);
}

/// The level of detail at which a clump is drawn, if it is kept. `noise` is the height between
/// vertices too, fine units: for T2.
#[must_use]
pub fn kept<S: Slots>(
    surface: &Surface<'_, S>,
    noise: &impl Ground,
    culling: &Culling,
    planting: &Planting,
    clump: &Clump,
) -> Option<u32> {
    let far = distance_squared(culling, clump.x, clump.y, clump.z);
    if !stands_at(planting, clump, far) {
        return None;
    }
    let extent = extent_of(culling, planting, clump, slope_at(surface, clump.x, clump.z));
    if !is_in_view(culling, &extent) {
        return None;
    }
    if culling.sees_land != 0 {
        let is_hidden = match culling.path {
            CULL_NOISE => marched_is_hidden(noise, culling, &tip_of(culling, planting, clump), 0),
            CULL_MARCH => is_hidden_by_vertices(surface, culling, &tip_of(culling, planting, clump)),
            CULL_EXACT | CULL_HIERARCHICAL => is_hidden(surface, culling.eye, &extent.target, culling.start),
            _ => false,
        };
        if is_hidden {
            return None;
        }
    }
    return Some(u32::from(far > planting.detail[0]) + u32::from(far > planting.detail[1]));
}

/// The highest and the lowest drawn point of a square of side `2^bits`, at most that of a block,
/// fine units; none where nothing is drawn.
fn bounds_of<S: Slots>(surface: &Surface<'_, S>, bits: u32, column: i32, row: i32) -> Option<(i32, i32)> {
    let node = surface.node(bits, column, row);
    if node.top <= NOWHERE {
        return None;
    }
    if bits >= node.finest || surface.is_rough_near(column << bits, row << bits) {
        return Some((node.top << FINE_BITS, node.bottom << FINE_BITS));
    }
    // Smaller than what has bounds of its own: the vertices of level 0 in it, which hold those of
    // all coarser levels and, along borders, all that may have been moved.
    let steps = 1 << (bits - STEP_BITS);
    let last = (SQUARE_TILES << TILE_BITS) - 1;
    let mut top = NOWHERE << FINE_BITS;
    let mut bottom = i32::MAX;
    for z in 0..=steps {
        for x in 0..=steps {
            let east = ((column << bits) + (x << STEP_BITS)).min(last);
            let south = ((row << bits) + (z << STEP_BITS)).min(last);
            let height = surface.height_at(east, south);
            top = top.max(height);
            // Land under one corner alone.
            bottom = bottom.min(height.max(node.bottom << FINE_BITS));
        }
    }
    // Heights are rounded down.
    return Some((top + 2, bottom));
}

/// What all clumps take up that may stand in a block.
#[must_use]
pub fn block_extent<S: Slots>(
    surface: &Surface<'_, S>,
    culling: &Culling,
    planting: &Planting,
    column: i32,
    row: i32,
) -> Option<Extent> {
    let bits = planting.cell_bits + BLOCK_CELL_BITS;
    let (top, bottom) = bounds_of(surface, bits, column, row)?;
    let half = 1 << (bits - 1);
    let (x, z) = ((column << bits) + half, (row << bits) + half);
    // Half the diagonal, by which roots are farther away or nearer than the middle.
    let diagonal = (half >> 5) * 46;
    let far = distance_bound(culling, x, top, z).max(distance_bound(culling, x, bottom, z));
    let apart = ((diagonal + top - bottom) >> COARSE_BITS) + 2;
    let wide = (planting.width_low + planting.width_span) * widening_at(planting, far + apart);
    let leaf = (wide >> 9) + 2;
    let tall = planting.height_low + planting.height_span;
    let height = ((tall * standing_at(planting, far - apart - 5)) >> 8) + 1;
    // Land may rise by kilometres within a block: squares of what is farther do not fit.
    let near = (far - apart - 5).clamp(0, 0xffff) as u32;
    let is_far = near * near > planting.detail[1];
    let shape = shape_of(planting, leaf, height, is_far, None, push_of(planting, 63, 128));
    return Some(Extent {
        target: Target {
            x,
            top: top + shape.over,
            z,
            radius: diagonal + shape.radius,
            follow: diagonal + shape.radius,
            skirt: shape.skirt,
            fall: shape.fall,
            east_rise: 0,
            south_rise: 0,
        },
        bottom: bottom - leaf,
    });
}

/// Square of the least distance between the eye and a block, (1/16 m)², rounded down.
fn block_distance_squared(culling: &Culling, planting: &Planting, column: i32, row: i32) -> u32 {
    let bits = planting.cell_bits + BLOCK_CELL_BITS;
    let (west, north) = (column << bits, row << bits);
    let side = 1 << bits;
    let x = culling.eye[0].clamp(west, west + side);
    let z = culling.eye[2].clamp(north, north + side);
    return distance_squared(culling, x, culling.eye[1], z);
}

/// Whether a block of the square may hold clumps that are seen.
#[must_use]
pub fn block_is_kept<S: Slots>(
    surface: &Surface<'_, S>,
    culling: &Culling,
    planting: &Planting,
    column: i32,
    row: i32,
) -> bool {
    if block_distance_squared(culling, planting, column, row) > stands_within(planting, 0) {
        return false;
    }
    let Some(extent) = block_extent(surface, culling, planting, column, row) else { return false };
    if !is_in_view(culling, &extent) {
        return false;
    }
    return culling.path != CULL_HIERARCHICAL
        || culling.sees_land == 0
        || !is_hidden(surface, culling.eye, &extent.target, culling.start);
}

#[cfg(test)]
mod tests {
    use super::super::clump::tests::{any_level, unit};
    use super::super::clump::{add, lean_push, root_offset_m, standing, unpacked_clump, wind_push};
    use super::super::conifer::conifer_vertex;
    use super::super::field::{field_keeps, field_size_m, field_standing, field_widening};
    use super::super::tuft::tuft_vertex;
    use super::*;
    use crate::layout::{Field, GRASS_VERTICES, KIND_TREES, TREE_VERTICES};
    use bytemuck::Zeroable;

    const FINE: f32 = 4096.0;
    const EYE: [i32; 3] = [1 << 23, 100 << 12, 1 << 23];
    /// Half a millimetre for floats, two fine units for what is rounded down.
    const ROUNDING_M: f32 = 0.001;

    /// A kind of plants as the shaders are told of it, twice.
    fn kind(kind: u32, thin_from_m: f32, wind: f32, lean: f32) -> (Planting, Field) {
        let is_grass = kind == KIND_GRASS;
        let width_m = if is_grass { [0.16, 0.36] } else { [2.6, 5.0] };
        let height_m = if is_grass { [0.22, 0.62] } else { [6.0, 14.0] };
        let (widest, range_m) = if is_grass { (6.0, 260.0) } else { (1.0, 1500.0) };
        let lod_m: [f32; 2] = if is_grass { [12.0, 45.0] } else { [90.0, 1e6] };
        let fine = |metres: f32| (metres * FINE).round() as i32;
        let squared = |metres: f32| ((metres * 16.0 + 2.0).powi(2)).clamp(0.0, 3e9) as u32;
        let planting = Planting {
            kind,
            width_low: fine(width_m[0]),
            width_span: fine(width_m[1]) - fine(width_m[0]),
            height_low: fine(height_m[0]),
            height_span: fine(height_m[1]) - fine(height_m[0]),
            thin_from: fine(thin_from_m),
            widest: (widest * 256.0) as u32,
            range: (range_m * 16.0) as i32,
            collapse: (range_m * 4.0) as i32,
            detail: lod_m.map(squared),
            wind_reach: wind_reach(wind),
            lean_reach: lean_reach(lean),
            ..Planting::zeroed()
        };
        let field = Field {
            eye_x: EYE[0],
            eye_y: EYE[1],
            eye_z: EYE[2],
            kind,
            width_low_m: width_m[0],
            width_high_m: width_m[1],
            height_low_m: height_m[0],
            height_high_m: height_m[1],
            thin_from_m,
            widest,
            range_m,
            collapse_m: 0.25 * range_m,
            lod_m,
            wind,
            lean,
        };
        (planting, field)
    }

    /// Vertices of a clump as `draw_grass` and `draw_trees` place them, from its root, with what
    /// each of them is of the way from foot to tip; and the level of detail.
    fn drawn(
        planting: &Planting,
        field: &Field,
        clump: &Clump,
        slope: [i32; 2],
        seed: u32,
    ) -> Vec<([f32; 3], f32)> {
        let slope = slope.map(|rise| rise as f32 / 16_384.0);
        let length = (1.0 + slope[0] * slope[0] + slope[1] * slope[1]).sqrt();
        let byte = |part: f32| (((-127.0 * part / length).round() as i32) as u32) << 24;
        let words =
            [clump.x as u32 | byte(slope[0]), clump.z as u32 | byte(slope[1]), clump.y as u32, clump.looks];
        let packed = unpacked_clump(words);
        let root_m = root_offset_m(field, &packed, [0.0; 3]);
        let far_m = root_m.iter().map(|axis| axis * axis).sum::<f32>().sqrt();
        if !field_keeps(field, packed.rank, far_m) {
            return Vec::new();
        }
        let [width, height] = field_size_m(field, packed.width, packed.height);
        let size_m =
            [width * field_widening(field, packed.rank, far_m), height * field_standing(field, far_m)];
        let wind =
            wind_push(field.wind, [unit(seed, 20), unit(seed, 21)], 100.0 * unit(seed, 22), packed.phase);
        let culling = Culling { eye: EYE, ..Culling::zeroed() };
        let far = distance_squared(&culling, clump.x, clump.y, clump.z);
        let level = u32::from(far > planting.detail[0]) + u32::from(far > planting.detail[1]);
        if planting.kind != KIND_GRASS {
            let vertices = 0..TREE_VERTICES[level.min(1) as usize];
            return vertices
                .map(|index| (conifer_vertex(level, index, size_m, packed.phase, wind), 1.0))
                .collect();
        }
        let grown = 0.08 + 0.16 * packed.hue;
        let own = [(40.0 * packed.phase).cos() * grown, (40.0 * packed.phase).sin() * grown];
        let push = add(add(own, wind), lean_push(field.lean, root_m, far_m));
        let stand = standing(packed.normal, push);
        (0..GRASS_VERTICES[level as usize])
            .map(|index| tuft_vertex(level, index, size_m, packed.phase, &stand))
            .map(|vertex| (vertex.offset_m, vertex.along))
            .collect()
    }

    fn any_clump(seed: u32, far_m: f32) -> (Clump, [i32; 2]) {
        let way = any_level(seed, 0, 1.0);
        let length = way[0].hypot(way[1]).max(1e-3);
        let at = |axis: usize| EYE[2 * axis] + (way[axis] / length * far_m * FINE) as i32;
        let up = (unit(seed, 2) - 0.7) * far_m * 0.8;
        let slope = any_level(seed, 3, 1.3).map(|rise| (rise * 16_384.0) as i32);
        let looks = (unit(seed, 5) * 16_777_215.0) as u32;
        let rank = (256.0 * unit(seed, 6).powi(2)) as u32;
        (Clump { x: at(0), z: at(1), y: EYE[1] + (up * FINE) as i32, looks: looks | rank << 24 }, slope)
    }

    /// How far a vertex is outside what a target is said to take up, as it is seen along a
    /// horizontal direction, metres: beside it, and above it.
    fn outside(target: &Target, root_y: i32, (offset, along): ([f32; 3], f32), angle: f32) -> [f32; 2] {
        let metres = |fine: i32| fine as f32 / FINE;
        let (radius, skirt, follow) = (metres(target.radius), metres(target.skirt), metres(target.follow));
        let down = if target.skirt > 0 { 1.0 - along } else { 0.0 };
        let beside = offset[0].hypot(offset[2]) - (radius + down * skirt);
        // Behind and beside the root, as it is seen.
        let turned = |x: f32, z: f32| [x * angle.cos() + z * angle.sin(), z * angle.cos() - x * angle.sin()];
        let [behind, across] = turned(offset[0], offset[2]);
        let [ahead, tilt] = turned(target.east_rise as f32 / 16_384.0, target.south_rise as f32 / 16_384.0);
        let spread = follow + down * (radius + skirt - follow);
        let lean = radius - follow;
        let (least, most) = ((behind - lean).max(-spread), (behind + lean).min(spread));
        let planar = if ahead > 0.0 { most } else { least };
        let limit = metres(target.top - root_y) + tilt * across + ahead * planar - down * metres(target.fall);
        [beside, offset[1] - limit]
    }

    #[test]
    fn every_vertex_that_is_drawn_lies_inside_what_sight_is_tested_for() {
        let culling = Culling { eye: EYE, ..Culling::zeroed() };
        let (mut tested, mut skirts, mut closest) = (0, 0, [f32::MIN; 2]);
        for seed in 0..30_000 {
            let [wind, lean] = [unit(seed, 10).round(), unit(seed, 11)];
            let thin_from_m = [14.0, 42.0, 80.0][(3.0 * unit(seed, 12)) as usize % 3];
            let (planting, field) = kind(KIND_GRASS, thin_from_m, wind, lean);
            let (clump, gradient) = any_clump(seed, 1.0 + 250.0 * unit(seed, 13).powi(2));
            let slope = Some(gradient).filter(|[east, south]| steepness(*east, *south) <= 1 << 14);
            let target = extent_of(&culling, &planting, &clump, slope).target;
            skirts += u32::from(target.skirt > 0);
            for vertex in drawn(&planting, &field, &clump, gradient, seed) {
                for turn in 0..6 {
                    let out = outside(&target, clump.y, vertex, turn as f32);
                    assert!(
                        out[0].max(out[1]) <= ROUNDING_M,
                        "{out:?} m: {seed} {clump:?} {gradient:?} {target:?}"
                    );
                    closest = [closest[0].max(out[0]), closest[1].max(out[1])];
                }
                tested += 1;
            }
        }
        assert!(tested > 100_000 && skirts > 1000, "{tested} {skirts}");
        // A bound that nothing comes near to would be a wasteful one; one a little smaller, the
        // control, is left.
        assert!(closest.iter().all(|out| *out > -0.02), "{closest:?}");
    }

    #[test]
    fn every_vertex_of_a_tree_lies_inside_its_cone_and_not_inside_a_thinner_one() {
        let culling = Culling { eye: EYE, ..Culling::zeroed() };
        let mut left = 0;
        for seed in 0..4000 {
            let (planting, field) = kind(KIND_TREES, 1500.0, 1.0, 0.0);
            let (clump, _) = any_clump(seed, 5.0 + 1000.0 * unit(seed, 13));
            let target = extent_of(&culling, &planting, &clump, Some([0, 0])).target;
            let top = (target.top - clump.y) as f32 / FINE;
            let reach = |y: f32, thinner: f32| {
                let share = ((top - y) / (target.fall as f32 / FINE)).max(0.0);
                (target.radius as f32 + share * target.skirt as f32) / FINE * thinner
            };
            for ([x, y, z], _) in drawn(&planting, &field, &clump, [0, 0], seed) {
                let out = x.hypot(z);
                assert!(y <= top && out <= reach(y, 1.0) + ROUNDING_M, "{out} at {y} of {top}: {seed}");
                left += u32::from(out > reach(y, 0.9));
            }
        }
        assert!(left > 100, "the control: {left}");
    }

    #[test]
    fn the_longest_blade_is_no_longer_than_the_table_says() {
        for phase in 0..64u32 {
            let stand = standing([0.0, 1.0, 0.0], [0.0; 2]);
            let tips = (0..GRASS_VERTICES[2])
                .map(|index| tuft_vertex(2, index, [0.0, 1.0], phase as f32 / 63.0, &stand))
                .filter(|vertex| vertex.along == 1.0);
            // A blade leans out of its own: its length is that of the stem.
            let longest = tips.map(|tip| {
                let [x, y, z] = tip.offset_m;
                x.hypot(y).hypot(z)
            });
            let longest = longest.fold(0.0, f32::max);
            let told = LONGEST[(phase % 9) as usize] as f32 / 256.0;
            assert!((longest..longest + 0.02).contains(&told), "{phase}: {longest} of {told}");
        }
    }
}
