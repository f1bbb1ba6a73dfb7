//! Twin of `wgsl/bound/visibility.wesl`: bounds of clumps and blocks, and the tests that decide
//! which of them are drawn: distance, frustum, occlusion by terrain.
//!
//! Integers only: every client draws the same clumps.

use super::placement::{
    BLOCK_CELL_BITS, COARSE_BITS, Clump, FARTHEST, clump_at, distance_bound, distance_squared,
    draw_distance_squared, height_scale_at, is_within_draw_distance, presence_at, widening_at,
};
use super::raymarch_occlusion::{Ground, raymarch_occlusion, raymarch_occlusion_by_vertices};
use super::surface::{FINE_BITS, GRID_BITS, NOWHERE, STEP_BITS, Slots, Surface, TILE_BITS};
use super::terrain_occlusion::{Occludee, is_occluded, point_occludee};
use crate::layout::{
    CULL_DISTANCE, CULL_EXACT, CULL_HIERARCHICAL, CULL_MARCH, CULL_NOISE, Culling, GRID_TILES, KIND_GRASS,
    Planting,
};

/// Most clumps of a quarter that are tried; after these it may hold one.
const MAX_TRIES: u32 = 256;

/// Bounds of a clump or a block of clumps.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Extent {
    /// The highest point and how far it reaches sideways.
    pub occludee: Occludee,
    /// The lowest point, fine units.
    pub bottom: i32,
}

/// Whether a bounding sphere touches the inside of all four planes of the frustum; conservative.
#[must_use]
pub fn may_be_in_view(culling: &Culling, extent: &Extent) -> bool {
    let middle = extent.bottom + ((extent.occludee.top - extent.bottom) >> 1);
    let east = (extent.occludee.x - culling.eye[0]) >> COARSE_BITS;
    let up = (middle - culling.eye[1]) >> COARSE_BITS;
    let south = (extent.occludee.z - culling.eye[2]) >> COARSE_BITS;
    if east.abs().max(up.abs()).max(south.abs()) >= FARTHEST {
        return true;
    }
    let half = (extent.occludee.top - extent.bottom) >> (COARSE_BITS + 1);
    let radius = ((extent.occludee.radius + extent.occludee.taper) >> COARSE_BITS) + half + 2;
    // The rounding error of the normals (Q14) and places.
    let slack = east.abs() + up.abs() + south.abs() + (3 << 14);
    let reach = (radius.min(FARTHEST) << 14) + slack;
    for plane in culling.planes {
        if plane[0] * east + plane[1] * up + plane[2] * south < -reach {
            return false;
        }
    }
    return true;
}

/// Whether bounds pass the frustum test of the chosen path.
fn is_in_view(culling: &Culling, extent: &Extent) -> bool {
    return culling.path == CULL_DISTANCE || may_be_in_view(culling, extent);
}

/// Slope of the ground around a place, east and south, Q14, by central differences over 4 m. None
/// where the terrain ends.
#[must_use]
pub fn gradient_at<S: Slots>(surface: &Surface<'_, S>, x: i32, z: i32) -> Option<[i32; 2]> {
    let step = 1 << STEP_BITS;
    let last = (1 << GRID_BITS) - 1;
    let west = surface.height_at((x - step).max(0), z);
    let east = surface.height_at((x + step).min(last), z);
    let north = surface.height_at(x, (z - step).max(0));
    let south = surface.height_at(x, (z + step).min(last));
    if west.min(east).min(north).min(south) <= NOWHERE << FINE_BITS {
        return None;
    }
    return Some([east - west, south - north]);
}

/// The same; none also where it may be steeper than 1, which the foot of a clump does not follow.
#[must_use]
pub fn slope_at<S: Slots>(surface: &Surface<'_, S>, x: i32, z: i32) -> Option<[i32; 2]> {
    return gradient_at(surface, x, z).filter(|[along, across]| steepness(*along, *across) <= 1 << 14);
}

/// Upper bound of the length of a vector: the long side and half of the short one.
fn steepness(along: i32, across: i32) -> i32 {
    let (along, across) = (along.abs(), across.abs());
    return along.max(across) + (along.min(across) >> 1);
}

/// Upper bound of the horizontal distance from root to tip of a stem, on ground of a steepness
/// (Q14), pushed aside by `push` (Q8). The horizontal part of its direction grows linearly from
/// 0.45 of that of the ground at the root to that plus the push at the tip, 0.75 at most; its mean
/// is half of their sum.
fn lean_of(height: i32, steep: i32, push: i32) -> i32 {
    let tip = (push + ((116 * steep) >> 14) + 1).min(192);
    return ((height * tip) >> 9) + ((((15 * height) >> 6) * steep) >> 14) + (height >> 6) + 2;
}

/// Upper bound of the push at a tip, Q8: growth by the hue in 64ths, the wind, and leaning away
/// from an eye that is higher by a share `tilt` (Q8) of the distance. Leaning goes with sine times
/// cosine of the elevation of the eye, at most 1/2.
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

/// Upper bound of the height of the eye over a place as a share of the distance, Q8; `near` is no
/// more than the distance, 1/16 m.
fn tilt_of(culling: &Culling, y: i32, near: i32) -> i32 {
    let up = ((culling.eye[1] - y) >> COARSE_BITS) + 1;
    return (((up.clamp(0, FARTHEST) << 8) as u32 / near.max(1) as u32).min(256)) as i32 + 1;
}

/// Upper bound of the longest of the six blades of a clump in the third level of detail, Q8, by its
/// phase modulo 9: lengths follow `tuft_number`, which repeats with a ninth of a phase. A test
/// compares.
pub const LONGEST: [i32; 9] = [251, 253, 245, 254, 256, 255, 247, 250, 241];

/// Lower bound of how far a clump in the third level of detail sinks into the ground, fine units:
/// `tuft_vertex` takes the lesser of 0.04 heights and 0.14 widths. Where the thinning leaves widths
/// whole they are known to 12 %, from distances known to a third of a metre at more than 32 m.
fn sink_of(half: i32, height: i32, near: i32, presence: i32) -> i32 {
    if near <= 512 || presence < 256 {
        return 0;
    }
    return ((height * 10) >> 8).min((half * 56) >> 8);
}

/// How much farther than half its width a plant reaches, fine units: blades of grass do so in the
/// first two levels of detail, by [`crate::layout::GRASS_SPREAD_M`].
#[must_use]
pub fn spread_of(kind: u32, is_far: bool) -> i32 {
    return if kind == KIND_GRASS && !is_far { 902 } else { 0 };
}

/// Bounds of a plant, from its root, fine units: see [`Occludee`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Shape {
    radius: i32,
    slope_radius: i32,
    taper: i32,
    taper_drop: i32,
    /// Highest point over the root; of grass, over the plane through the root that has the slope of
    /// the ground.
    over: i32,
}

/// Bounds of a plant of half a width and a height. `slope` is that of the ground, none if it is not
/// known or steeper than 1. `docs/vegetation-occlusion.md` derives the constants.
fn shape_of(
    planting: &Planting,
    half: i32,
    height: i32,
    is_far: bool,
    slope: Option<[i32; 2]>,
    push: i32,
) -> Shape {
    if planting.kind != KIND_GRASS {
        let radius = ((half * 84) >> 8) + 1;
        return Shape {
            radius,
            slope_radius: radius,
            taper: ((half * 277) >> 8) + 1 - radius,
            taper_drop: (height * 84) >> 8,
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
        return Shape { radius, slope_radius: spread, taper: half - radius, taper_drop: height + foot, over };
    }
    let radius = if is_far { half.max(spread + lean) } else { half + lean };
    return Shape { radius, slope_radius: half, taper: 0, taper_drop: 0, over };
}

/// Bounds of a clump at its distance, on ground of a slope.
#[must_use]
pub fn extent_of(culling: &Culling, planting: &Planting, clump: &Clump, slope: Option<[i32; 2]>) -> Extent {
    let width = planting.width_low + ((planting.width_span * ((clump.attributes & 63) as i32 + 1)) >> 6);
    let height =
        planting.height_low + ((planting.height_span * ((clump.attributes >> 6 & 63) as i32 + 1)) >> 6);
    let bound = distance_bound(culling, clump.x, clump.y, clump.z);
    // The bound is at most five too large.
    let near = bound - 5;
    let presence = presence_at(planting, near, clump.attributes >> 24);
    let widening = (widening_at(planting, bound) * presence) >> 8;
    let is_far = distance_squared(culling, clump.x, clump.y, clump.z) > planting.detail[1];
    let half = ((width * widening) >> 9) + 2 + spread_of(planting.kind, is_far);
    let height = ((height * height_scale_at(planting, near)) >> 8) + 1;
    let is_low = is_far && planting.kind == KIND_GRASS;
    let longest = if is_low { LONGEST[((clump.attributes >> 18 & 63) % 9) as usize] } else { 256 };
    let sink = if is_low { sink_of(half, height, near, presence) } else { 0 };
    let push = push_of(planting, (clump.attributes >> 12 & 63) as i32, tilt_of(culling, clump.y, near));
    let shape = shape_of(planting, half, ((height * longest) >> 8) + 1, is_far, slope, push);
    let known = slope.filter(|_| planting.kind == KIND_GRASS).unwrap_or([0, 0]);
    return Extent {
        occludee: Occludee {
            x: clump.x,
            top: clump.y + shape.over - sink,
            z: clump.z,
            radius: shape.radius,
            slope_radius: shape.slope_radius,
            taper: shape.taper,
            taper_drop: shape.taper_drop,
            slope_east: known[0],
            slope_south: known[1],
        },
        bottom: clump.y - half,
    };
}

/// The point that the reference methods test: the tip over the root, as high as it is drawn.
#[must_use]
pub fn tip_occludee(culling: &Culling, planting: &Planting, clump: &Clump) -> Occludee {
    let whole =
        planting.height_low + ((planting.height_span * ((clump.attributes >> 6 & 63) as i32 + 1)) >> 6);
    let near = distance_bound(culling, clump.x, clump.y, clump.z) - 5;
    let height = (whole * height_scale_at(planting, near)) >> 8;
    return point_occludee(clump.x, clump.y + height, clump.z);
}

/// The level of detail of a visible clump. `noise` is the height between vertices too, fine units:
/// for T2.
#[must_use]
pub fn visible_level<S: Slots>(
    surface: &Surface<'_, S>,
    noise: &impl Ground,
    culling: &Culling,
    planting: &Planting,
    clump: &Clump,
) -> Option<u32> {
    let far = distance_squared(culling, clump.x, clump.y, clump.z);
    if !is_within_draw_distance(planting, clump, far) {
        return None;
    }
    let extent = extent_of(culling, planting, clump, slope_at(surface, clump.x, clump.z));
    if !is_in_view(culling, &extent) {
        return None;
    }
    if culling.occlusion_enabled != 0 {
        let is_occluded = match culling.path {
            CULL_NOISE => raymarch_occlusion(noise, culling, &tip_occludee(culling, planting, clump), 0),
            CULL_MARCH => {
                raymarch_occlusion_by_vertices(surface, culling, &tip_occludee(culling, planting, clump))
            }
            CULL_EXACT | CULL_HIERARCHICAL => {
                is_occluded(surface, culling.eye, &extent.occludee, culling.start)
            }
            _ => false,
        };
        if is_occluded {
            return None;
        }
    }
    return Some(u32::from(far > planting.detail[0]) + u32::from(far > planting.detail[1]));
}

/// The highest and the lowest drawn point of a square of side `2^bits`, no larger than a block,
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
    let last = (GRID_TILES << TILE_BITS) - 1;
    let mut top = NOWHERE << FINE_BITS;
    let mut bottom = i32::MAX;
    for z in 0..=steps {
        for x in 0..=steps {
            let east = ((column << bits) + (x << STEP_BITS)).min(last);
            let south = ((row << bits) + (z << STEP_BITS)).min(last);
            let height = surface.height_at(east, south);
            // The end of the drawn land: the height of its border is not known.
            if height <= NOWHERE << FINE_BITS {
                return Some((node.top << FINE_BITS, node.bottom << FINE_BITS));
            }
            top = top.max(height);
            bottom = bottom.min(height);
        }
    }
    // Heights are rounded down.
    return Some((top + 2, bottom));
}

/// Bounds of all clumps of a block or of a quarter of one.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct BlockExtent {
    /// The bounds, whatever the slope of the ground.
    pub extent: Extent,
    /// Half the width of the widest clump and the height of the highest, fine units.
    half: i32,
    height: i32,
    /// Whether all clumps are in the third level of detail.
    is_far: bool,
}

/// Half the diagonal of a square of side `2^bits`, by which roots are farther away or nearer than
/// the middle.
fn half_diagonal(bits: u32) -> i32 {
    return (1 << (bits - 6)) * 46;
}

/// Bounds of all clumps of a square of side `2^bits`, a block or a quarter of one.
#[must_use]
pub fn block_extent<S: Slots>(
    surface: &Surface<'_, S>,
    culling: &Culling,
    planting: &Planting,
    bits: u32,
    column: i32,
    row: i32,
) -> Option<BlockExtent> {
    let (top, bottom) = bounds_of(surface, bits, column, row)?;
    let middle = 1 << (bits - 1);
    let (x, z) = ((column << bits) + middle, (row << bits) + middle);
    let diagonal = half_diagonal(bits);
    let far = distance_bound(culling, x, top, z).max(distance_bound(culling, x, bottom, z));
    let apart = ((diagonal + top - bottom) >> COARSE_BITS) + 2;
    let wide = (planting.width_low + planting.width_span) * widening_at(planting, far + apart);
    // Land may rise by kilometres within a block: squares of what is farther do not fit.
    let near = (far - apart - 5).clamp(0, 0xffff) as u32;
    let is_far = near * near > planting.detail[1];
    let half = (wide >> 9) + 2 + spread_of(planting.kind, is_far);
    let tall = planting.height_low + planting.height_span;
    let height = ((tall * height_scale_at(planting, far - apart - 5)) >> 8) + 1;
    let shape = shape_of(planting, half, height, is_far, None, push_of(planting, 63, 128));
    let occludee = Occludee {
        x,
        top: top + shape.over,
        z,
        radius: diagonal + shape.radius,
        slope_radius: diagonal + shape.radius,
        taper: shape.taper,
        taper_drop: shape.taper_drop,
        slope_east: 0,
        slope_south: 0,
    };
    return Some(BlockExtent { extent: Extent { occludee, bottom: bottom - half }, half, height, is_far });
}

/// The object of the occlusion test of a quarter of a block of grass: its top is a plane of the
/// mean slope of the ground. As [`block_extent`] has it where the ground is not known between its
/// vertices, or is too steep.
#[must_use]
pub fn sloped_occludee<S: Slots>(
    surface: &Surface<'_, S>,
    planting: &Planting,
    bits: u32,
    column: i32,
    row: i32,
    block: &BlockExtent,
) -> Occludee {
    let flat = block.extent.occludee;
    let (west, north, side) = (column << bits, row << bits, 1 << bits);
    if bits >= surface.node(bits, column, row).finest || surface.is_rough_near(west, north) {
        return flat;
    }
    let last = (GRID_TILES << TILE_BITS) - 1;
    let place = |x: i32, z: i32| ((west + x).clamp(0, last), (north + z).clamp(0, last));
    let step = 1 << STEP_BITS;
    // In blocks with moved vertices the ground has other diagonals: its slopes may be greatest
    // within a cell.
    for across in [-step, step, side + step] {
        for along in [-step, step, side + step] {
            let (x, z) = place(along, across);
            if surface.is_rough_at(x, z) {
                return flat;
            }
        }
    }
    let height = |along: i32, across: i32| {
        let (x, z) = place(along, across);
        surface.height_at(x, z)
    };
    let corners = [height(0, 0), height(side, 0), height(0, side), height(side, side)];
    // Twice the rise over the side, which has at least 2^13 fine units.
    let east = ((corners[1] + corners[3]) - (corners[0] + corners[2])) >> (bits - 13);
    let south = ((corners[2] + corners[3]) - (corners[0] + corners[1])) >> (bits - 13);
    let plane_steep = steepness(east, south);
    if plane_steep > 1 << 15 {
        return flat;
    }
    let steps = 1 << (bits - STEP_BITS);
    let mut plane = NOWHERE << FINE_BITS;
    let mut lowest = corners[0];
    // Greatest slope of the ground, and greatest difference from that of the plane.
    let (mut steep, mut apart) = (0, 0);
    for z in 0..=steps {
        for x in 0..=steps {
            let (along, across) = (x << STEP_BITS, z << STEP_BITS);
            let sides = [
                height(along - step, across),
                height(along + step, across),
                height(along, across - step),
                height(along, across + step),
            ];
            let rise = (east * (along - (side >> 1)) + south * (across - (side >> 1))) >> 14;
            plane = plane.max(height(along, across) - rise);
            lowest = lowest.min(sides[0].min(sides[1]).min(sides[2].min(sides[3])));
            let slope = [sides[1] - sides[0], sides[3] - sides[2]];
            steep = steep.max(steepness(slope[0], slope[1]) + 4);
            apart = apart.max(steepness(slope[0] - east, slope[1] - south) + 4);
        }
    }
    // Where land ends, slopes are not known.
    if lowest <= NOWHERE << FINE_BITS {
        return flat;
    }
    let push = push_of(planting, 63, 128);
    let (over, reach) = if steep > 1 << 14 {
        // Clumps of which nothing is known but their height over the root.
        let shape = shape_of(planting, block.half, block.height, block.is_far, None, push);
        (shape.over + ((plane_steep * shape.radius) >> 14), shape.radius)
    } else {
        let lean = lean_of(block.height, steep, push);
        let radius = block.half + lean;
        let foot = (((block.height * steep) >> 14) * steep) >> 15;
        let raised = ((apart * radius) >> 14) + ((steep * lean) >> 14);
        (block.height + foot + (block.half >> 6) + 2 + raised, radius)
    };
    let radius = half_diagonal(bits) + reach;
    // Heights are rounded down.
    let top = plane + 2 + over + 2;
    return Occludee { top, radius, slope_radius: radius, slope_east: east, slope_south: south, ..flat };
}

/// Whether a clump of a quarter of a block may be within its draw distance and in the frustum.
fn has_clump<S: Slots>(
    surface: &Surface<'_, S>,
    culling: &Culling,
    planting: &Planting,
    column: i32,
    row: i32,
) -> bool {
    let bits = planting.cell_bits + BLOCK_CELL_BITS - 1;
    let last = (1 << GRID_BITS) - 1;
    // Clumps take the density of up to half a texel of a chunk of level 0 away, as wide as a
    // quarter.
    let mut density = 0;
    for z in -1..2 {
        for x in -1..2 {
            let (east, south) = ((column + x) << bits, (row + z) << bits);
            density = density.max(surface.density_at(east.clamp(0, last), south.clamp(0, last)));
        }
    }
    if density == 0 {
        return false;
    }
    let far = block_distance_squared(culling, planting, column >> 1, row >> 1);
    let mut tries = 0;
    for index in 0..planting.per_cell {
        // Ranks grow with numbers: beyond the first one not drawn at this distance, none is.
        if draw_distance_squared(planting, index * 256 / planting.per_cell) < far {
            break;
        }
        for cell in 0..4 {
            let (x, z) = (2 * column + (cell & 1), 2 * row + (cell >> 1));
            if let Some(clump) = clump_at(surface, planting, x, z, index) {
                let far = distance_squared(culling, clump.x, clump.y, clump.z);
                let extent = || extent_of(culling, planting, &clump, slope_at(surface, clump.x, clump.z));
                if is_within_draw_distance(planting, &clump, far) && may_be_in_view(culling, &extent()) {
                    return true;
                }
            }
        }
        tries += 4;
        if tries >= MAX_TRIES {
            return true;
        }
    }
    return false;
}

/// Whether a clump of a block may be in sight: the terrain hides neither the block nor, of grass,
/// all quarters with a clump.
#[must_use]
pub fn block_is_seen<S: Slots>(
    surface: &Surface<'_, S>,
    culling: &Culling,
    planting: &Planting,
    column: i32,
    row: i32,
    block: &BlockExtent,
) -> bool {
    if is_occluded(surface, culling.eye, &block.extent.occludee, culling.start) {
        return false;
    }
    if planting.kind != KIND_GRASS {
        return true;
    }
    let bits = planting.cell_bits + BLOCK_CELL_BITS - 1;
    for quarter in 0..4 {
        let (x, z) = (2 * column + (quarter & 1), 2 * row + (quarter >> 1));
        let Some(part) = block_extent(surface, culling, planting, bits, x, z) else { continue };
        if !may_be_in_view(culling, &part.extent) || !has_clump(surface, culling, planting, x, z) {
            continue;
        }
        let occludee = sloped_occludee(surface, planting, bits, x, z, &part);
        if !is_occluded(surface, culling.eye, &occludee, culling.start) {
            return true;
        }
    }
    return false;
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

/// Whether a block of the grid may hold visible clumps.
#[must_use]
pub fn block_is_visible<S: Slots>(
    surface: &Surface<'_, S>,
    culling: &Culling,
    planting: &Planting,
    column: i32,
    row: i32,
) -> bool {
    if block_distance_squared(culling, planting, column, row) > draw_distance_squared(planting, 0) {
        return false;
    }
    let bits = planting.cell_bits + BLOCK_CELL_BITS;
    let Some(block) = block_extent(surface, culling, planting, bits, column, row) else { return false };
    if !is_in_view(culling, &block.extent) {
        return false;
    }
    return culling.path != CULL_HIERARCHICAL
        || culling.occlusion_enabled == 0
        || block_is_seen(surface, culling, planting, column, row, &block);
}

#[cfg(test)]
mod tests;
