//! Twin of `wgsl/bound/terrain_occlusion.wesl`: whether the drawn land hides something from the eye.
//!
//! Along a ground track the drawn surface is linear between crossings of grid lines and diagonals,
//! and so is the ray; it is blocked if and only if it is below the surface at one of those
//! crossings. The tops of blocks prove that a ray is clear of them, and let most crossings be
//! skipped; bottoms prove that it is blocked; in between the drawn triangles decide.
//!
//! A target is as wide as its radius. Rays to all of it cross a column of the main axis within a
//! stretch of the other axis, at no more than a height that follows from the nearest or farthest of
//! it; where the surface is above that height all along the stretch, all of it is hidden. The
//! surface along the stretch is lowest at an end, a grid line or a diagonal, and those are whole
//! numbers.
//!
//! What is narrower at its top than at its foot, as a tree is, has a skirt: beyond the radius its
//! highest point falls evenly. So does what the surface has to reach beside the ray.
//!
//! Everything errs on one side. A sample is a place *near* a crossing, taken on the surface as
//! drawn, and heights are rounded so that the surface is never too high and the rays never too low:
//! what is called hidden is hidden. What is missed is a target that is hidden by less than a few
//! fine units.

use super::ring::mul_hi;
use super::surface::{FINE_BITS, GRID_BITS, NOWHERE, STEP_BITS, Slots, Surface, TILE_BITS};

/// Columns and blocks that one ray may visit; a ray that needs more is not blocked.
pub const MAX_VISITS: u32 = 512;
/// Rays steeper than this (rise over run) are not tested.
pub const STEEPEST: i32 = 16;
/// Grid lines and diagonals that the stretch beside a ray may cross; beyond that nothing is hidden.
pub const MAX_STRETCH: i32 = 160;

/// What a ray looks for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Occludee {
    /// Place in the square, fine units.
    pub x: i32,
    /// The highest point, fine units above the sea.
    pub top: i32,
    /// Place in the square, fine units.
    pub z: i32,
    /// Within this distance of the vertical through the place it may be as high as that, fine
    /// units; below 2^17.
    pub radius: i32,
    /// Of the radius, what lies in a plane that has the slope of the top; the rest leans out of it
    /// and gets no higher by that. At most the radius.
    pub slope_radius: i32,
    /// It reaches so much farther, ever lower; fine units below 2^14, 0 where all of it is within
    /// the radius.
    pub taper: i32,
    /// So much lower its highest point is at the end of the skirt, fine units below 2^16.
    pub taper_drop: i32,
    /// Growth of the highest point of it per fine unit east, Q14, within ±1: what stands on a slope
    /// is higher uphill.
    pub slope_east: i32,
    /// The same, south.
    pub slope_south: i32,
}

/// A line of sight from the eye, by its progress along the axis that it crosses faster: the main
/// one.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Ray {
    along_x: bool,
    /// Whether it goes west, or north: the main axis is mirrored, so that progress always grows.
    mirrored: bool,
    /// Place of the eye on the main axis, mirrored if need be.
    main: i32,
    /// Place of the eye on the other axis.
    other: i32,
    /// Height of the eye.
    up: i32,
    /// Progress up to the nearest of the target: what lies beyond may stand behind a part of it.
    length: i32,
    /// Growth of the other coordinate per progress, Q24.
    drift: i32,
    /// Growth of the height of the highest ray per progress, Q24, rounded up.
    rise: i32,
    /// Growth of half the stretch that rays to all of the target cross, per progress, Q13.
    widening: i32,
    /// The same of what is within the radius.
    core: i32,
    /// Growth of what rays to the end of the skirt are lower by, per progress, Q24, rounded down.
    taper_drop: i32,
    /// What the ray may be too low by, fine units: the eye is rounded.
    slack: i32,
    /// Growth of the height of the highest ray with the other coordinate, Q14.
    tilt: i32,
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

/// The line from `eye` (east, up, south) to a target; none if it is too short or too steep to be
/// tested.
///
/// A point of the target that lies `a` beside its middle and `b` behind it is seen along a track
/// that at the same progress `u` runs `u (a - drift b) / (length + b)` beside the middle's;
/// `a² + b²` is at most the square of the radius.
///
/// The highest ray: a point whose foot lies `c` behind the middle in the plane of the top, and that
/// leans by `l` from there, is seen at a rise of at most `(h + g c) / (D + c + l)`, `h` the height
/// of the top over the eye, `g` the slope along the ray, `D` the way to the middle. That is a ratio
/// of linear functions of `c`, so it is greatest at an end of `c`, and with `l` at the end that the
/// sign of the height asks for.
///
/// The skirt: what is a share `t` of the way down to its end may lie farther out in that plane by
/// `t` times what the end does, the rest of the radius and the skirt, and nearer by `t` of the
/// skirt, which raises it by `g` times the one and by the rise of the ray, twice at most where the
/// farthest point is no more than twice as far as the nearest, times the other. What is left of the
/// fall is the fall of the requirement; if nothing is, all of it counts as following the plane.
fn ray(eye: [i32; 3], occludee: &Occludee, start: i32) -> Option<Ray> {
    let (east, south) = (occludee.x - eye[0], occludee.z - eye[2]);
    let along_x = east.abs() >= south.abs();
    let (forward, sideways) = if along_x { (east, south) } else { (south, east) };
    let to_middle = forward.abs();
    let outer_radius = occludee.radius + occludee.taper;
    let length = to_middle - outer_radius - 1;
    if length <= start {
        return None;
    }
    let (at, other) = if along_x { (eye[0], eye[2]) } else { (eye[2], eye[0]) };
    let mirrored = forward < 0;
    let drift = quotient_q24(sideways.unsigned_abs(), to_middle as u32) as i32;
    // Of the slope of the target's top the part across the ray stays one at every progress; the
    // part along it raises the whole.
    let (ahead, tilt) = if along_x {
        (occludee.slope_east, occludee.slope_south)
    } else {
        (occludee.slope_south, occludee.slope_east)
    };
    let ahead = if mirrored { -ahead } else { ahead };
    let turned = mul_hi(tilt << 8, if sideways < 0 { -drift } else { drift });
    let along = ahead + turned;
    let lean = occludee.radius - occludee.slope_radius;
    // Heights over the eye of what follows the plane so far, nearest and farthest, rounded up.
    let ends = |slope_radius: i32| {
        let raise = mul_hi(slope_radius << 12, along.abs() << 6) + 2;
        let middle = occludee.top - eye[1];
        if along < 0 { [middle + raise, middle - raise + 2] } else { [middle - raise + 2, middle + raise] }
    };
    let rise_of = |[near, far]: [i32; 2], slope_radius: i32| {
        let of = |up: i32, to: i32| {
            if up < 0 {
                return -(quotient_q24(up.unsigned_abs(), (to + lean + 1) as u32) as i32);
            }
            return quotient_q24(up as u32, (to - lean - 1) as u32) as i32 + 1;
        };
        return of(near, to_middle - slope_radius).max(of(far, to_middle + slope_radius));
    };
    let highest = ends(outer_radius);
    let steepest = highest[0].abs().max(highest[1].abs());
    if steepest >> 4 >= length || length <= lean + start {
        return None;
    }
    let farthest = to_middle + outer_radius + 1;
    let most = quotient_q24(steepest as u32, length as u32) as i32 + 1;
    let lost =
        mul_hi((occludee.taper + lean) << 12, along.abs() << 6) + mul_hi(occludee.taper << 9, most) + 3;
    let taper_drop =
        if occludee.taper > 0 && farthest >> 1 <= length { occludee.taper_drop - lost } else { 0 };
    let slope_radius =
        if occludee.taper == 0 || taper_drop > 0 { occludee.slope_radius } else { outer_radius };
    let rise = rise_of(ends(slope_radius), slope_radius);
    // sqrt(1 + drift²) is at most 1 + drift / 2.
    let widening = |radius: i32| {
        let half = radius + (mul_hi(radius << 8, drift << 1) >> 2) + 2;
        (((half as u32) << 13) / length as u32) as i32 + 1
    };
    return Some(Ray {
        along_x,
        mirrored,
        main: if mirrored { (1 << GRID_BITS) - at } else { at },
        other,
        up: eye[1],
        length,
        drift: if sideways < 0 { -drift } else { drift },
        rise,
        widening: widening(outer_radius),
        core: widening(occludee.radius),
        taper_drop: quotient_q24(taper_drop.max(0) as u32, farthest as u32) as i32,
        slack: (rise.abs() >> 24) + 4,
        tilt,
    });
}

impl Ray {
    /// Height at a progress, fine units, never too low.
    fn height(&self, progress: i32) -> i32 {
        return self.up + mul_hi(self.rise << 2, progress << 6) + 1;
    }

    /// The other coordinate at a progress, within the square; off by at most 2.
    fn across(&self, progress: i32) -> i32 {
        return (self.other + mul_hi(self.drift << 2, progress << 6)).clamp(0, (1 << GRID_BITS) - 1);
    }

    /// The main coordinate at a progress, within the square.
    fn along(&self, progress: i32) -> i32 {
        let at = self.main + progress;
        return (if self.mirrored { (1 << GRID_BITS) - at } else { at }).clamp(0, (1 << GRID_BITS) - 1);
    }

    /// Where the column of width `2^bits` ends that holds a progress, or the ray does.
    fn column_end(&self, progress: i32, bits: u32) -> i32 {
        let edge = (((self.main + progress) >> bits) + 1) << bits;
        return (edge - self.main).min(self.length);
    }
}

/// Whether the surface is above a height all along a stretch of the other axis that is centred at
/// `across`, `half` each way; beyond `core` from the middle of the target the height falls, by
/// `taper_drop` over `taper`. Places along the main axis are whole numbers, so those of grid lines and
/// diagonals are too.
fn stretch_is_above<S: Slots>(
    surface: &Surface<'_, S>,
    ray: &Ray,
    along: i32,
    across: i32,
    half: i32,
    height: i32,
    taper: Taper,
) -> bool {
    let last = (1 << GRID_BITS) - 1;
    let (low, high) = ((across - half).clamp(0, last), (across + half).clamp(0, last));
    // How far the surface is above the highest ray that passes there.
    let lowest = |other: i32| {
        let (x, z) = if ray.along_x { (along, other) } else { (other, along) };
        let beyond = ((other - across).abs() - taper.core).clamp(0, taper.width.max(0)) as u32;
        let fallen = (taper.taper_drop as u32 * beyond / taper.width.max(1) as u32) as i32;
        surface.lowest_at(x, z) + fallen - mul_hi((other - across) << 12, ray.tilt << 6) - 1
    };
    if lowest(low) < height || lowest(high) < height {
        return false;
    }
    // Where the height begins to fall it bends upwards.
    if taper.taper_drop > 0 {
        let (left, right) = (across - taper.core, across + taper.core);
        if (left > low && left < high && lowest(left) < height)
            || (right > low && right < high && lowest(right) < height)
        {
            return false;
        }
    }
    let cells = |other: i32| {
        let (x, z) = if ray.along_x { (along, other) } else { (other, along) };
        surface.cell_bits(x, z)
    };
    let bits = cells(low).min(cells(high));
    // Grid lines, and between them diagonals: the places whose distance from the main coordinate is
    // a multiple of the cell.
    let inside = along & ((1 << bits) - 1);
    let first = low >> bits;
    let lines = (high >> bits) - first;
    if 2 * lines > MAX_STRETCH {
        return false;
    }
    for line in 0..=lines {
        let corner = (first + line) << bits;
        if corner > low && lowest(corner) < height {
            return false;
        }
        let diagonal = corner + inside;
        if diagonal > low && diagonal < high && lowest(diagonal) < height {
            return false;
        }
    }
    return true;
}

/// The skirt of a target where rays to it cross a column of the main axis.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Taper {
    /// Within this distance of the middle the height does not fall.
    core: i32,
    /// It falls evenly over so much more.
    width: i32,
    /// By so much.
    taper_drop: i32,
}

/// Whether the surface as drawn hides the target at a progress.
fn occludes_at<S: Slots>(surface: &Surface<'_, S>, ray: &Ray, progress: i32) -> bool {
    let (along, across) = (ray.along(progress), ray.across(progress));
    let (x, z) = if ray.along_x { (along, across) } else { (across, along) };
    let height = ray.height(progress) + ray.slack;
    if surface.lowest_at(x, z) < height {
        return false;
    }
    // Three more for the eye and the track, which are rounded.
    let half = ((ray.widening * progress) >> 13) + 4;
    let core = ((ray.core * progress) >> 13) + 4;
    let taper_drop = if half > core { mul_hi(ray.taper_drop << 2, progress << 6) } else { 0 };
    let taper = Taper { core, width: half - core, taper_drop };
    return stretch_is_above(surface, ray, along, across, half, height, taper);
}

/// `span * part / whole` for numbers below 2^(bits + 1), cut to 14 bits.
fn share(part: i32, whole: i32, span: i32, bits: u32) -> i32 {
    let cut = bits.max(14) - 14;
    let divisor = ((whole >> cut) as u32).max(1);
    return (((part >> cut) as u32 * (span >> cut) as u32 / divisor) as i32) << cut;
}

/// Whether the triangles hide the target at one of their edges between two progresses. Cells are
/// `2^bits` wide or wider.
fn occludes_between<S: Slots>(surface: &Surface<'_, S>, ray: &Ray, from: i32, to: i32, bits: u32) -> bool {
    let mut progress = from;
    // A block is eight cells wide, a tile of one chunk no more.
    for _ in 0..9 {
        if progress >= to {
            break;
        }
        let end = ray.column_end(progress, bits).min(to);
        let (near, far) = (ray.across(progress), ray.across(end));
        let span = end - progress;
        if near >> bits != far >> bits {
            let line = (near >> bits).max(far >> bits) << bits;
            let there = progress + share((line - near).abs(), (far - near).abs(), span, bits);
            if occludes_at(surface, ray, there) {
                return true;
            }
        }
        // Which diagonal a place lies on: east minus south.
        let sign = if ray.along_x { 1 } else { -1 };
        let first = sign * (ray.along(progress) - near);
        let last = sign * (ray.along(end) - far);
        let (low, high) = (first.min(last) >> bits, first.max(last) >> bits);
        for step in 1..=2 {
            if low + step <= high {
                let line = (low + step) << bits;
                let there = progress + share((line - first).abs(), (last - first).abs(), span, bits);
                if occludes_at(surface, ray, there) {
                    return true;
                }
            }
        }
        if occludes_at(surface, ray, end) {
            return true;
        }
        progress = end;
    }
    return false;
}

/// Whether the drawn land certainly hides all of a target from the eye (east, up, south; fine
/// units). What is nearer than `start` hides nothing: it is cut by the near plane.
#[must_use]
pub fn is_occluded<S: Slots>(
    surface: &Surface<'_, S>,
    eye: [i32; 3],
    occludee: &Occludee,
    start: i32,
) -> bool {
    let Some(ray) = ray(eye, occludee, start) else { return false };
    let mut progress = start;
    let mut bits = TILE_BITS - 3;
    for _ in 0..MAX_VISITS {
        if progress >= ray.length {
            break;
        }
        let end = ray.column_end(progress, bits);
        let column = ray.along_column(progress, bits);
        let (near, far) = (ray.across(progress) >> bits, ray.across(end) >> bits);
        let first = node(surface, &ray, bits, column, near);
        let mut top = first.top;
        let mut bottom = first.bottom;
        let mut finest = first.finest;
        if far != near {
            let second = node(surface, &ray, bits, column, far);
            top = top.max(second.top);
            bottom = bottom.min(second.bottom);
            finest = finest.min(second.finest);
        }
        let (from, to) = (ray.height(progress), ray.height(end));
        let mut is_clear = from.min(to) >= top << FINE_BITS;
        if !is_clear {
            // All of the block is higher than the lower end of the ray.
            let at = if from < to { progress } else { end };
            if bottom > NOWHERE
                && from.min(to) + ray.slack <= bottom << FINE_BITS
                && occludes_at(surface, &ray, at)
            {
                return true;
            }
            if bits > finest.min(TILE_BITS) {
                bits -= 1;
                continue;
            }
            if occludes_between(surface, &ray, progress, end, finest - 3) {
                return true;
            }
            is_clear = true;
        }
        if is_clear {
            // Past it; a wider column next, if one begins here.
            let odd = ((ray.main + progress) >> bits) & 1;
            bits = (bits + odd as u32).min(GRID_BITS - 1);
            progress = end;
        }
    }
    return false;
}

impl Ray {
    /// Which column of width `2^bits` a progress lies in, counted as the square is.
    fn along_column(&self, progress: i32, bits: u32) -> i32 {
        let column = (self.main + progress) >> bits;
        let last = (1 << (GRID_BITS - bits)) - 1;
        return (if self.mirrored { last - column } else { column }).clamp(0, last);
    }
}

/// Bounds over a column and a row of the ray's axes.
fn node<S: Slots>(
    surface: &Surface<'_, S>,
    ray: &Ray,
    bits: u32,
    along: i32,
    across: i32,
) -> super::surface::Node {
    if ray.along_x {
        return surface.node(bits, along, across);
    }
    return surface.node(bits, across, along);
}

/// Cells of level 0 across a tile, for those who march in steps of their own.
pub const TILE_STEPS: u32 = TILE_BITS - STEP_BITS;
