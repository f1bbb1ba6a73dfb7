//! Twin of `wgsl/bound/visibility.wesl`: bounds of clumps and blocks, and the tests that decide
//! which of them are drawn: distance, frustum, occlusion by terrain.
//!
//! Integers only: every client draws the same clumps.

use super::placement::{
    BLOCK_CELL_BITS, COARSE_BITS, Clump, FARTHEST, distance_bound, distance_squared, draw_distance_squared,
    height_scale_at, is_within_draw_distance, presence_at, widening_at,
};
use super::raymarch_occlusion::{Ground, raymarch_occlusion, raymarch_occlusion_by_vertices};
use super::surface::{FINE_BITS, GRID_BITS, NOWHERE, STEP_BITS, Slots, Surface, TILE_BITS};
use super::terrain_occlusion::{Occludee, is_occluded, point_occludee};
use crate::layout::{
    CULL_DISTANCE, CULL_EXACT, CULL_HIERARCHICAL, CULL_MARCH, CULL_NOISE, Culling, GRID_TILES, KIND_GRASS,
    Planting,
};

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
            top = top.max(height);
            // Land under one corner alone.
            bottom = bottom.min(height.max(node.bottom << FINE_BITS));
        }
    }
    // Heights are rounded down.
    return Some((top + 2, bottom));
}

/// Bounds of all clumps of a block.
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
    // Land may rise by kilometres within a block: squares of what is farther do not fit.
    let near = (far - apart - 5).clamp(0, 0xffff) as u32;
    let is_far = near * near > planting.detail[1];
    let chunk = (wide >> 9) + 2 + spread_of(planting.kind, is_far);
    let tall = planting.height_low + planting.height_span;
    let height = ((tall * height_scale_at(planting, far - apart - 5)) >> 8) + 1;
    let shape = shape_of(planting, chunk, height, is_far, None, push_of(planting, 63, 128));
    return Some(Extent {
        occludee: Occludee {
            x,
            top: top + shape.over,
            z,
            radius: diagonal + shape.radius,
            slope_radius: diagonal + shape.radius,
            taper: shape.taper,
            taper_drop: shape.taper_drop,
            slope_east: 0,
            slope_south: 0,
        },
        bottom: bottom - chunk,
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
    let Some(extent) = block_extent(surface, culling, planting, column, row) else { return false };
    if !is_in_view(culling, &extent) {
        return false;
    }
    return culling.path != CULL_HIERARCHICAL
        || culling.occlusion_enabled == 0
        || !is_occluded(surface, culling.eye, &extent.occludee, culling.start);
}

#[cfg(test)]
mod tests {
    use super::super::clump::tests::{any_level, unit};
    use super::super::clump::{
        add, grown_push, lean_push, root_offset_m, stem_pose, unpacked_clump, wind_push,
    };
    use super::super::field::{field_height_scale, field_keeps, field_size_m, field_widening};
    use super::super::tree::{tree_size_m, tree_species};
    use super::super::tree_shape::vertex_of_tree;
    use super::super::tuft::tuft_vertex;
    use super::*;
    use crate::layout::{Field, GRASS_VERTICES, KIND_TREES, TREE_VERTICES};
    use bytemuck::Zeroable;

    const FINE: f32 = 4096.0;
    const EYE: [i32; 3] = [1 << 23, 100 << 12, 1 << 23];
    /// Half a millimetre for floats, two fine units for what is rounded down.
    const ROUNDING_M: f32 = 0.001;

    /// The uniforms of a species, for culling and for drawing.
    fn kind(kind: u32, thin_from_m: f32, wind: f32, lean: f32) -> (Planting, Field) {
        let is_grass = kind == KIND_GRASS;
        let width_m = if is_grass { [0.16, 0.36] } else { [3.2, 6.4] };
        let height_m = if is_grass { [0.22, 0.62] } else { [6.0, 14.0] };
        let (widest, range_m) = if is_grass { (6.0, 260.0) } else { (1.0, 1500.0) };
        let lod_m: [f32; 2] = if is_grass { [10.0, 32.0] } else { [50.0, 220.0] };
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
            ..Field::zeroed()
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
        let words = [
            clump.x as u32 | byte(slope[0]),
            clump.z as u32 | byte(slope[1]),
            clump.y as u32,
            clump.attributes,
        ];
        let packed = unpacked_clump(words);
        let root_m = root_offset_m(field, &packed, [0.0; 3]);
        let far_m = root_m.iter().map(|axis| axis * axis).sum::<f32>().sqrt();
        if !field_keeps(field, packed.rank, far_m) {
            return Vec::new();
        }
        let [width, height] = field_size_m(field, packed.width, packed.height);
        let size_m =
            [width * field_widening(field, packed.rank, far_m), height * field_height_scale(field, far_m)];
        let wind =
            wind_push(field.wind, [unit(seed, 20), unit(seed, 21)], 100.0 * unit(seed, 22), packed.phase);
        let culling = Culling { eye: EYE, ..Culling::zeroed() };
        let far = distance_squared(&culling, clump.x, clump.y, clump.z);
        let level = u32::from(far > planting.detail[0]) + u32::from(far > planting.detail[1]);
        if planting.kind != KIND_GRASS {
            // Heights of all zones, so that all species are tried.
            let species = tree_species(&packed);
            let size_m = tree_size_m(species, size_m);
            // An impostor stands for the geometry of the level before.
            let level = level.min(1);
            let vertices = 0..TREE_VERTICES[level as usize];
            return vertices
                .map(|index| (vertex_of_tree(species, level, index, size_m, packed.phase, wind), 1.0))
                .collect();
        }
        let own = grown_push(packed.hue, packed.phase);
        let push = add(add(own, wind), lean_push(field.lean, root_m, far_m));
        let pose = stem_pose(packed.normal, push);
        (0..GRASS_VERTICES[level as usize])
            .map(|index| tuft_vertex(level, index, size_m, packed.phase, &pose, far_m))
            .map(|vertex| (vertex.offset_m, vertex.along))
            .collect()
    }

    fn any_clump(seed: u32, far_m: f32) -> (Clump, [i32; 2]) {
        let way = any_level(seed, 0, 1.0);
        let length = way[0].hypot(way[1]).max(1e-3);
        let at = |axis: usize| EYE[2 * axis] + (way[axis] / length * far_m * FINE) as i32;
        let up = (unit(seed, 2) - 0.7) * far_m * 0.8;
        let slope = any_level(seed, 3, 1.3).map(|rise| (rise * 16_384.0) as i32);
        let attributes = (unit(seed, 5) * 16_777_215.0) as u32;
        let rank = (256.0 * unit(seed, 6).powi(2)) as u32;
        (
            Clump { x: at(0), z: at(1), y: EYE[1] + (up * FINE) as i32, attributes: attributes | rank << 24 },
            slope,
        )
    }

    /// How far a vertex is outside what a target is said to take up, as it is seen along a
    /// horizontal direction, metres: beside it, and above it.
    fn outside(occludee: &Occludee, root_y: i32, (offset, along): ([f32; 3], f32), angle: f32) -> [f32; 2] {
        let metres = |fine: i32| fine as f32 / FINE;
        let (radius, taper, slope_radius) =
            (metres(occludee.radius), metres(occludee.taper), metres(occludee.slope_radius));
        let down = if occludee.taper > 0 { 1.0 - along } else { 0.0 };
        let beside = offset[0].hypot(offset[2]) - (radius + down * taper);
        // Behind and beside the root, as it is seen.
        let turned = |x: f32, z: f32| [x * angle.cos() + z * angle.sin(), z * angle.cos() - x * angle.sin()];
        let [behind, across] = turned(offset[0], offset[2]);
        let [ahead, tilt] =
            turned(occludee.slope_east as f32 / 16_384.0, occludee.slope_south as f32 / 16_384.0);
        let spread = slope_radius + down * (radius + taper - slope_radius);
        let lean = radius - slope_radius;
        let (least, most) = ((behind - lean).max(-spread), (behind + lean).min(spread));
        let planar = if ahead > 0.0 { most } else { least };
        let limit = metres(occludee.top - root_y) + tilt * across + ahead * planar
            - down * metres(occludee.taper_drop);
        [beside, offset[1] - limit]
    }

    #[test]
    fn every_drawn_vertex_lies_inside_its_occludee() {
        let culling = Culling { eye: EYE, ..Culling::zeroed() };
        let (mut tested, mut tapers, mut closest) = (0, 0, [f32::MIN; 2]);
        for seed in 0..30_000 {
            let [wind, lean] = [unit(seed, 10).round(), unit(seed, 11)];
            let thin_from_m = [14.0, 42.0, 80.0][(3.0 * unit(seed, 12)) as usize % 3];
            let (planting, field) = kind(KIND_GRASS, thin_from_m, wind, lean);
            let (clump, gradient) = any_clump(seed, 1.0 + 250.0 * unit(seed, 13).powi(2));
            let slope = Some(gradient).filter(|[east, south]| steepness(*east, *south) <= 1 << 14);
            let occludee = extent_of(&culling, &planting, &clump, slope).occludee;
            tapers += u32::from(occludee.taper > 0);
            for vertex in drawn(&planting, &field, &clump, gradient, seed) {
                for turn in 0..6 {
                    let out = outside(&occludee, clump.y, vertex, turn as f32);
                    assert!(
                        out[0].max(out[1]) <= ROUNDING_M,
                        "{out:?} m: {seed} {clump:?} {gradient:?} {occludee:?}"
                    );
                    closest = [closest[0].max(out[0]), closest[1].max(out[1])];
                }
                tested += 1;
            }
        }
        assert!(tested > 100_000 && tapers > 1000, "{tested} {tapers}");
        // A bound that nothing comes near to would be a wasteful one; one a little smaller, the
        // control, is left.
        assert!(closest.iter().all(|out| *out > -0.02), "{closest:?}");
    }

    #[test]
    fn every_vertex_of_a_tree_lies_inside_its_cone() {
        let culling = Culling { eye: EYE, ..Culling::zeroed() };
        let mut left = 0;
        for seed in 0..4000 {
            let (planting, field) = kind(KIND_TREES, 1500.0, 1.0, 0.0);
            let (clump, _) = any_clump(seed, 5.0 + 1000.0 * unit(seed, 13));
            let occludee = extent_of(&culling, &planting, &clump, Some([0, 0])).occludee;
            let top = (occludee.top - clump.y) as f32 / FINE;
            let reach = |y: f32, thinner: f32| {
                let share = ((top - y) / (occludee.taper_drop as f32 / FINE)).max(0.0);
                (occludee.radius as f32 + share * occludee.taper as f32) / FINE * thinner
            };
            for ([x, y, z], _) in drawn(&planting, &field, &clump, [0, 0], seed) {
                let out = x.hypot(z);
                assert!(y <= top && out <= reach(y, 1.0) + ROUNDING_M, "{out} at {y} of {top}: {seed}");
                // The lobes of impostors touch the cone more closely (`tree_impostor`).
                left += u32::from(out > reach(y, 0.75));
            }
        }
        assert!(left > 100, "the control: {left}");
    }

    #[test]
    fn no_blade_is_longer_than_the_table_says() {
        for phase in 0..64u32 {
            let pose = stem_pose([0.0, 1.0, 0.0], [0.0; 2]);
            let tips = (0..GRASS_VERTICES[2])
                .map(|index| tuft_vertex(2, index, [0.0, 1.0], phase as f32 / 63.0, &pose, 50.0))
                .filter(|vertex| vertex.along == 1.0);
            // A blade leans out of its own: its length is that of the stem.
            let longest = tips.map(|tip| {
                let [x, y, z] = tip.offset_m;
                x.hypot(y).hypot(z)
            });
            let longest = longest.fold(0.0, f32::max);
            let longest_by_table = LONGEST[(phase % 9) as usize] as f32 / 256.0;
            assert!(
                (longest..longest + 0.02).contains(&longest_by_table),
                "{phase}: {longest} of {longest_by_table}"
            );
        }
    }
}
