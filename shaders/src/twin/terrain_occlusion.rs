//! Twin of `wgsl/bound/terrain_occlusion.wesl`: whether the drawn terrain occludes something.
//!
//! The test is conservative: what it calls occluded is occluded. It misses occludees that the
//! terrain covers by less than a few fine units. `docs/vegetation-occlusion.md` explains the
//! traversal with a figure and derives the three inequalities that it relies on; comments here
//! refer to them as (1), (2) and (3).

use super::ring::mul_hi;
use super::surface::{FINE_BITS, GRID_BITS, NOWHERE, Node, Slots, Surface, TILE_BITS};

/// Columns that one traversal may visit; a ray that needs more is not occluded.
pub const MAX_VISITS: u32 = 512;
/// log2 of the steepest height over distance that is tested.
pub const STEEPEST_BITS: u32 = 4;
/// Twice the grid lines that a stretch may cross; a longer stretch occludes nothing.
pub const MAX_STRETCH: i32 = 160;
/// Candidates in a cell of the track: a grid line, two diagonals, the end.
const CROSSINGS: u32 = 4;
/// Cells of a column: a block is eight cells wide, a tile of one chunk no more.
const MAX_CELLS: u32 = 9;

/// The object of an occlusion test: bounds of a clump or a block.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Occludee {
    /// Place in the grid, fine units.
    pub x: i32,
    /// The highest point, fine units above the sea.
    pub top: i32,
    /// Place in the grid, fine units.
    pub z: i32,
    /// Within this horizontal distance of the place it may be as high as `top`, fine units below
    /// 2^17.
    pub radius: i32,
    /// The part of the radius over which `top` follows the slope; beyond, it rises no further. At
    /// most the radius.
    pub slope_radius: i32,
    /// Width of the rim beyond the radius over which the height tapers, fine units below 2^14; 0
    /// for no rim.
    pub taper: i32,
    /// By how much the height is lower at the end of the rim, fine units below 2^16.
    pub taper_drop: i32,
    /// Slope of `top` to the east, Q14, within ±2: what grows on a slope is higher uphill.
    pub slope_east: i32,
    /// Slope of `top` to the south, Q14, within ±2.
    pub slope_south: i32,
}

/// The lines of sight to an occludee, as functions of the progress along the major axis: the axis
/// of the ground along which the occludee is farther away.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Ray {
    major_is_x: bool,
    /// Whether the major axis is mirrored, so that progress grows: to the west or north.
    is_mirrored: bool,
    /// Major coordinate of the eye, mirrored if need be.
    eye_major: i32,
    /// Minor coordinate of the eye.
    eye_minor: i32,
    eye_height: i32,
    /// Progress up to the nearest point of the occludee.
    length: i32,
    /// Growth of the minor coordinate per progress, Q24.
    minor_slope: i32,
    /// Growth of the height of the highest line of sight per progress, Q24, rounded up.
    height_slope: i32,
    /// Growth of half the width of all lines of sight per progress, Q13, rounded up.
    outer_slope: i32,
    /// The same of those within the radius.
    core_slope: i32,
    /// Growth of the drop at the end of the rim per progress, Q24, rounded down.
    drop_slope: i32,
    /// Error bound of the height, fine units: the eye is rounded.
    margin: i32,
    /// Growth of the height with the minor coordinate, Q14.
    cross_slope: i32,
}

/// The rim of an occludee where its lines of sight cross a column.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Taper {
    /// The height falls from this distance to the middle on.
    core: i32,
    /// The height falls over this distance.
    width: i32,
    /// The height falls by this much.
    drop: i32,
}

/// An occludee that is a point of the grid, fine units.
#[must_use]
pub fn point_occludee(x: i32, top: i32, z: i32) -> Occludee {
    return Occludee {
        x,
        top,
        z,
        radius: 0,
        slope_radius: 0,
        taper: 0,
        taper_drop: 0,
        slope_east: 0,
        slope_south: 0,
    };
}

/// `part / whole`, Q24, rounded down. `whole` below 2^24, the quotient below 16.
#[must_use]
pub fn quotient_q24(part: u32, whole: u32) -> u32 {
    let mut bits = part / whole;
    let mut rest = part % whole;
    for _ in 0..3 {
        bits = (bits << 8) | ((rest << 8) / whole);
        rest = (rest << 8) % whole;
    }
    return bits;
}

/// Growth per progress of half the width of the lines of sight to a radius, Q13: inequality (2).
fn half_width_slope(radius: i32, drift: i32, length: i32) -> i32 {
    // sqrt(1 + drift²) is at most 1 + drift / 2.
    let half = radius + (mul_hi(radius << 8, drift << 1) >> 2) + 2;
    return (((half as u32) << 13) / length as u32) as i32 + 1;
}

/// Heights over the eye at both ends of `slope_radius` along the ray, nearest and farthest, rounded
/// up; `centre` in the middle, `slope` along the ray, Q14.
fn end_heights(centre: i32, slope: i32, slope_radius: i32) -> [i32; 2] {
    let raise = mul_hi(slope_radius << 12, slope.abs() << 6) + 2;
    return if slope < 0 {
        [centre + raise, centre - raise + 2]
    } else {
        [centre - raise + 2, centre + raise]
    };
}

/// Height over distance, Q24, rounded up; the distance is known to `lean`.
fn height_slope_to(height: i32, distance: i32, lean: i32) -> i32 {
    if height < 0 {
        return -(quotient_q24(height.unsigned_abs(), (distance + lean + 1) as u32) as i32);
    }
    return quotient_q24(height as u32, (distance - lean - 1) as u32) as i32 + 1;
}

/// The lines of sight from `eye` (east, up, south) to an occludee; none if they are too short or
/// too steep.
fn ray_to(eye: [i32; 3], occludee: &Occludee, start: i32) -> Option<Ray> {
    let (east, south) = (occludee.x - eye[0], occludee.z - eye[2]);
    let major_is_x = east.abs() >= south.abs();
    let (forward, sideways) = if major_is_x { (east, south) } else { (south, east) };
    let distance = forward.abs();
    let outer_radius = occludee.radius + occludee.taper;
    let length = distance - outer_radius - 1;
    if length <= start {
        return None;
    }
    let (eye_major, eye_minor) = if major_is_x { (eye[0], eye[2]) } else { (eye[2], eye[0]) };
    let is_mirrored = forward < 0;
    let drift = quotient_q24(sideways.unsigned_abs(), distance as u32) as i32;
    let minor_slope = if sideways < 0 { -drift } else { drift };
    let (slope_major, cross_slope) = if major_is_x {
        (occludee.slope_east, occludee.slope_south)
    } else {
        (occludee.slope_south, occludee.slope_east)
    };
    let slope = if is_mirrored { -slope_major } else { slope_major } + mul_hi(cross_slope << 8, minor_slope);
    let lean = occludee.radius - occludee.slope_radius;
    let centre = occludee.top - eye[1];
    let bounds = end_heights(centre, slope, outer_radius);
    let steepest = bounds[0].abs().max(bounds[1].abs());
    if steepest >> STEEPEST_BITS >= length || length <= lean + start {
        return None;
    }
    // The part of the rim's drop that leaning and the slope take. A rim whose drop is all taken
    // counts as a part of the slope.
    let farthest = distance + outer_radius + 1;
    let most = quotient_q24(steepest as u32, length as u32) as i32 + 1;
    let by_slope = mul_hi((occludee.taper + lean) << 12, slope.abs() << 6);
    let lost = by_slope + mul_hi(occludee.taper << 9, most) + 3;
    let has_rim = occludee.taper > 0 && farthest >> 1 <= length;
    let drop = if has_rim { occludee.taper_drop - lost } else { 0 };
    let slope_radius = if occludee.taper == 0 || drop > 0 { occludee.slope_radius } else { outer_radius };
    // Height over distance is a ratio of linear functions of the place: greatest at an end.
    let heights = end_heights(centre, slope, slope_radius);
    let height_slope = height_slope_to(heights[0], distance - slope_radius, lean).max(height_slope_to(
        heights[1],
        distance + slope_radius,
        lean,
    ));
    return Some(Ray {
        major_is_x,
        is_mirrored,
        eye_major: if is_mirrored { (1 << GRID_BITS) - eye_major } else { eye_major },
        eye_minor,
        eye_height: eye[1],
        length,
        minor_slope,
        height_slope,
        outer_slope: half_width_slope(outer_radius, drift, length),
        core_slope: half_width_slope(occludee.radius, drift, length),
        drop_slope: quotient_q24(drop.max(0) as u32, farthest as u32) as i32,
        margin: (height_slope.abs() >> 24) + 4,
        cross_slope,
    });
}

/// Height of the highest line of sight at a progress, fine units, never too low: inequality (1).
fn ray_height(ray: &Ray, progress: i32) -> i32 {
    return ray.eye_height + mul_hi(ray.height_slope << 2, progress << 6) + 1;
}

/// Minor coordinate of the track at a progress, within the grid; off by at most 2.
fn ray_minor(ray: &Ray, progress: i32) -> i32 {
    let at = ray.eye_minor + mul_hi(ray.minor_slope << 2, progress << 6);
    return at.clamp(0, (1 << GRID_BITS) - 1);
}

/// Major coordinate of the track at a progress, within the grid.
fn ray_major(ray: &Ray, progress: i32) -> i32 {
    let at = ray.eye_major + progress;
    return (if ray.is_mirrored { (1 << GRID_BITS) - at } else { at }).clamp(0, (1 << GRID_BITS) - 1);
}

/// Progress at the end of the column of width `2^bits` that holds a progress, or of the ray.
fn column_end(ray: &Ray, progress: i32, bits: u32) -> i32 {
    let edge = (((ray.eye_major + progress) >> bits) + 1) << bits;
    return (edge - ray.eye_major).min(ray.length);
}

/// Index of the column of width `2^bits` that holds a progress, as the grid counts columns.
fn column_of(ray: &Ray, progress: i32, bits: u32) -> i32 {
    let column = (ray.eye_major + progress) >> bits;
    let last = (1 << (GRID_BITS - bits)) - 1;
    return (if ray.is_mirrored { last - column } else { column }).clamp(0, last);
}

/// Lower bound of the drawn surface at a place on the ray's axes: inequality (3).
fn lowest_on_ray_axes<S: Slots>(surface: &Surface<'_, S>, ray: &Ray, major: i32, minor: i32) -> i32 {
    if ray.major_is_x {
        return surface.lowest_at(major, minor);
    }
    return surface.lowest_at(minor, major);
}

/// The surface at a place of a column that is centred at `centre`, lowered by how much higher the
/// lines of sight are there than in the centre.
fn height_above_ray<S: Slots>(
    surface: &Surface<'_, S>,
    ray: &Ray,
    major: i32,
    centre: i32,
    taper: Taper,
    minor: i32,
) -> i32 {
    let beyond = ((minor - centre).abs() - taper.core).clamp(0, taper.width.max(0)) as u32;
    let fallen = (taper.drop as u32 * beyond / taper.width.max(1) as u32) as i32;
    let lowest = lowest_on_ray_axes(surface, ray, major, minor);
    return lowest + fallen - mul_hi((minor - centre) << 12, ray.cross_slope << 6) - 1;
}

/// log2 of the cells of the chunk at a place on the ray's axes.
fn cell_bits_on_ray_axes<S: Slots>(surface: &Surface<'_, S>, ray: &Ray, major: i32, minor: i32) -> u32 {
    if ray.major_is_x {
        return surface.cell_bits(major, minor);
    }
    return surface.cell_bits(minor, major);
}

/// Whether the surface is above all lines of sight on a stretch of a column: `half` to either side
/// of `centre`, where the highest line of sight has the height `height`.
///
/// Surface and lines of sight are linear between grid lines, diagonals and the begin of the rim, so
/// those places and both ends decide. Where vertices have been moved, the surface is bounded by one
/// height for each block, so both ends of the block decide.
fn stretch_is_above<S: Slots>(
    surface: &Surface<'_, S>,
    ray: &Ray,
    major: i32,
    centre: i32,
    half: i32,
    height: i32,
    taper: Taper,
) -> bool {
    let last = (1 << GRID_BITS) - 1;
    let (low, high) = ((centre - half).clamp(0, last), (centre + half).clamp(0, last));
    let is_below = |minor: i32| height_above_ray(surface, ray, major, centre, taper, minor) < height;
    if is_below(low) || is_below(high) {
        return false;
    }
    if taper.drop > 0 {
        let (left, right) = (centre - taper.core, centre + taper.core);
        if left > low && left < high && is_below(left) {
            return false;
        }
        if right > low && right < high && is_below(right) {
            return false;
        }
    }
    let bits =
        cell_bits_on_ray_axes(surface, ray, major, low).min(cell_bits_on_ray_axes(surface, ray, major, high));
    // A diagonal crosses the column where the distance from the corner equals that of the column.
    let inside = major & ((1 << bits) - 1);
    let first = low >> bits;
    let lines = (high >> bits) - first;
    if 2 * lines > MAX_STRETCH {
        return false;
    }
    for line in 0..=lines {
        let corner = (first + line) << bits;
        if corner > low && is_below(corner) {
            return false;
        }
        // The end of a block of 2 x 2 cells: the bound of moved vertices holds for all of it.
        if (first + line) & 1 == 0 && corner - 1 > low && is_below(corner - 1) {
            return false;
        }
        let diagonal = corner + inside;
        if diagonal > low && diagonal < high && is_below(diagonal) {
            return false;
        }
    }
    return true;
}

/// Whether the surface on the track itself is above the lines of sight at a progress: cheap, and
/// necessary for [`occludes_at`].
fn centre_is_above<S: Slots>(surface: &Surface<'_, S>, ray: &Ray, progress: i32) -> bool {
    let lowest = lowest_on_ray_axes(surface, ray, ray_major(ray, progress), ray_minor(ray, progress));
    return lowest >= ray_height(ray, progress) + ray.margin;
}

/// Whether the surface in the column at a progress is above all lines of sight.
fn occludes_at<S: Slots>(surface: &Surface<'_, S>, ray: &Ray, progress: i32) -> bool {
    let height = ray_height(ray, progress) + ray.margin;
    // Three more for the eye and the track, which are rounded.
    let half = ((ray.outer_slope * progress) >> 13) + 4;
    let core = ((ray.core_slope * progress) >> 13) + 4;
    let drop = if half > core { mul_hi(ray.drop_slope << 2, progress << 6) } else { 0 };
    let taper = Taper { core, width: half - core, drop };
    return stretch_is_above(
        surface,
        ray,
        ray_major(ray, progress),
        ray_minor(ray, progress),
        half,
        height,
        taper,
    );
}

/// `span * part / whole` for numbers below 2^(bits + 1), cut to 14 bits.
fn share_along(part: i32, whole: i32, span: i32, bits: u32) -> i32 {
    let cut = bits.max(14) - 14;
    let divisor = ((whole >> cut) as u32).max(1);
    return (((part >> cut) as u32 * (span >> cut) as u32 / divisor) as i32) << cut;
}

/// A place in a cell of the track at which the triangles are tested.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Crossing {
    exists: bool,
    progress: i32,
}

/// Candidate `which` between two progresses in one column of cells of `2^bits`: the grid line
/// across, two diagonals, the end.
fn crossing_of(ray: &Ray, progress: i32, next: i32, bits: u32, which: u32) -> Crossing {
    if which == 3 {
        return Crossing { exists: true, progress: next };
    }
    let (near, far) = (ray_minor(ray, progress), ray_minor(ray, next));
    let span = next - progress;
    if which == 0 {
        let line = (near >> bits).max(far >> bits) << bits;
        let share = share_along((line - near).abs(), (far - near).abs(), span, bits);
        return Crossing { exists: near >> bits != far >> bits, progress: progress + share };
    }
    // Index of a diagonal: east minus south.
    let way = if ray.major_is_x { 1 } else { -1 };
    let first = way * (ray_major(ray, progress) - near);
    let last = way * (ray_major(ray, next) - far);
    let (low, high) = (first.min(last) >> bits, first.max(last) >> bits);
    let index = low + which as i32;
    let line = index << bits;
    let share = share_along((line - first).abs(), (last - first).abs(), span, bits);
    return Crossing { exists: index <= high, progress: progress + share };
}

/// Bounds of a node at a place on the ray's axes.
fn node_on_ray_axes<S: Slots>(
    surface: &Surface<'_, S>,
    ray: &Ray,
    bits: u32,
    major: i32,
    minor: i32,
) -> Node {
    if ray.major_is_x {
        return surface.node(bits, major, minor);
    }
    return surface.node(bits, minor, major);
}

/// Bounds of the one or two nodes that the track crosses between two progresses of one column.
fn column_bounds<S: Slots>(surface: &Surface<'_, S>, ray: &Ray, bits: u32, progress: i32, end: i32) -> Node {
    let column = column_of(ray, progress, bits);
    let (near, far) = (ray_minor(ray, progress) >> bits, ray_minor(ray, end) >> bits);
    let first = node_on_ray_axes(surface, ray, bits, column, near);
    if far == near {
        return first;
    }
    let second = node_on_ray_axes(surface, ray, bits, column, far);
    return Node {
        top: first.top.max(second.top),
        bottom: first.bottom.min(second.bottom),
        finest: first.finest.min(second.finest),
    };
}

/// log2 of the width of the column after one that ends: wider where a wider one begins.
fn next_column_bits(ray: &Ray, progress: i32, bits: u32) -> u32 {
    let odd = ((ray.eye_major + progress) >> bits) & 1;
    return (bits + odd as u32).min(GRID_BITS - 1);
}

/// State of a traversal.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Traversal {
    /// Nothing before this progress occludes.
    progress: i32,
    /// log2 of the width of the column at the progress.
    bits: u32,
    visits: u32,
}

/// A column whose bounds do not prove it clear.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Column {
    end: i32,
    /// Progress of the lower end of the ray where the bottom of the column is above that end.
    lower_end: Option<i32>,
    /// Whether narrower columns have bounds of their own.
    can_descend: bool,
    /// log2 of the smallest cells in it.
    cell_bits: u32,
}

/// State `SKIP_COLUMNS`: passes over columns whose bounds are below the ray; none at the end of the
/// ray.
fn skip_columns<S: Slots>(surface: &Surface<'_, S>, ray: &Ray, traversal: &mut Traversal) -> Option<Column> {
    loop {
        let Traversal { progress, bits, visits } = *traversal;
        if progress >= ray.length || visits >= MAX_VISITS {
            return None;
        }
        traversal.visits += 1;
        let end = column_end(ray, progress, bits);
        let node = column_bounds(surface, ray, bits, progress, end);
        let (at_begin, at_end) = (ray_height(ray, progress), ray_height(ray, end));
        let lower = at_begin.min(at_end);
        if lower >= node.top << FINE_BITS {
            advance(ray, traversal, end);
            continue;
        }
        let can_descend = bits > node.finest.min(TILE_BITS);
        let is_above = node.bottom > NOWHERE && lower + ray.margin <= node.bottom << FINE_BITS;
        if !is_above && can_descend {
            traversal.bits -= 1;
            continue;
        }
        let lower_end = is_above.then_some(if at_begin < at_end { progress } else { end });
        // Nodes above tiles have no smallest cell and can always be descended.
        return Some(Column { end, lower_end, can_descend, cell_bits: node.finest.wrapping_sub(3) });
    }
}

/// State `TEST_LOWER_END`: all of the column is above the lower end of the ray, so that end decides
/// most often.
fn test_lower_end<S: Slots>(surface: &Surface<'_, S>, ray: &Ray, lower_end: i32) -> bool {
    return centre_is_above(surface, ray, lower_end) && occludes_at(surface, ray, lower_end);
}

/// State `TEST_CROSSINGS`: tests the triangles of a column at their edges.
fn test_crossings<S: Slots>(
    surface: &Surface<'_, S>,
    ray: &Ray,
    progress: i32,
    end: i32,
    cell_bits: u32,
) -> bool {
    let mut at = progress;
    for _ in 0..MAX_CELLS {
        if at >= end {
            break;
        }
        let next = column_end(ray, at, cell_bits).min(end);
        for which in 0..CROSSINGS {
            let crossing = crossing_of(ray, at, next, cell_bits, which);
            if crossing.exists
                && centre_is_above(surface, ray, crossing.progress)
                && occludes_at(surface, ray, crossing.progress)
            {
                return true;
            }
        }
        at = next;
    }
    return false;
}

/// Leaves a column that occludes nothing.
fn advance(ray: &Ray, traversal: &mut Traversal, end: i32) {
    traversal.bits = next_column_bits(ray, traversal.progress, traversal.bits);
    traversal.progress = end;
}

/// Whether the drawn terrain certainly occludes all of an occludee from the eye (east, up, south;
/// fine units). Terrain nearer than `start` occludes nothing: the near plane cuts it.
#[must_use]
pub fn is_occluded<S: Slots>(
    surface: &Surface<'_, S>,
    eye: [i32; 3],
    occludee: &Occludee,
    start: i32,
) -> bool {
    let Some(ray) = ray_to(eye, occludee, start) else { return false };
    let mut traversal = Traversal { progress: start, bits: TILE_BITS - 3, visits: 0 };
    while let Some(column) = skip_columns(surface, &ray, &mut traversal) {
        if column.lower_end.is_some_and(|lower_end| test_lower_end(surface, &ray, lower_end)) {
            return true;
        }
        if column.can_descend {
            traversal.bits -= 1;
            continue;
        }
        if test_crossings(surface, &ray, traversal.progress, column.end, column.cell_bits) {
            return true;
        }
        advance(&ray, &mut traversal, column.end);
    }
    return false;
}

#[cfg(test)]
mod tests;
