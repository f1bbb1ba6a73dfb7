//! Twin of `wgsl/bound/raymarch_occlusion.wesl`: two simple tests that lose visible plants, as
//! reference methods. Ray marching in even steps over the noise finds peaks between vertices that
//! are never drawn; over the drawn vertices, bilinear, it misses the triangles; both test one point
//! of a clump.

use super::ring::mul_hi;
use super::surface::{FINE_BITS, GRID_BITS, Slots, Surface};
use super::terrain_occlusion::{Occludee, point_occludee, quotient_q24};
use crate::layout::Culling;

/// Steps of a march at most.
pub const MAX_STEPS: i32 = 2048;

/// A height field to march over: the height at a place of the grid, fine units.
pub trait Ground {
    /// That height.
    fn height(&self, x: i32, z: i32) -> i32;
}

impl<F: Fn(i32, i32) -> i32> Ground for F {
    fn height(&self, x: i32, z: i32) -> i32 {
        self(x, z)
    }
}

/// Whether ray marching from the eye to a point finds terrain above the line of sight; the last
/// `skipped_end` of the way is not tested.
#[must_use]
pub fn raymarch_occlusion(
    ground: &impl Ground,
    culling: &Culling,
    occludee: &Occludee,
    skipped_end: i32,
) -> bool {
    let east = occludee.x - culling.eye[0];
    let up = occludee.top - culling.eye[1];
    let south = occludee.z - culling.eye[2];
    let length = east.abs().max(south.abs());
    if length == 0 || up.abs() >> 4 >= length {
        return false;
    }
    let whole = length as u32;
    let by_x = quotient_q24(east.unsigned_abs(), whole) as i32;
    let by_z = quotient_q24(south.unsigned_abs(), whole) as i32;
    let by_y = quotient_q24(up.unsigned_abs(), whole) as i32;
    let last = (1 << GRID_BITS) - 1;
    let sign = |value: i32| if value < 0 { -1 } else { 1 };
    for n in 1..=MAX_STEPS {
        let progress = n * culling.step;
        if progress >= length - skipped_end {
            break;
        }
        let x = culling.eye[0] + sign(east) * mul_hi(by_x << 2, progress << 6);
        let z = culling.eye[2] + sign(south) * mul_hi(by_z << 2, progress << 6);
        let y = culling.eye[1] + sign(up) * mul_hi(by_y << 2, progress << 6);
        if ground.height(x.clamp(0, last), z.clamp(0, last)) > y {
            return true;
        }
    }
    return false;
}

/// The test of a chunk of side `2^bits` by five points: four corners and the middle, at its
/// highest point; its own ground hides nothing of the middle. True if all five are hidden.
#[must_use]
pub fn raymarch_occlusion_of_corners<S: Slots>(
    surface: &Surface<'_, S>,
    culling: &Culling,
    bits: u32,
    column: i32,
    row: i32,
) -> bool {
    let side = 1 << bits;
    let last = (1 << GRID_BITS) - 1;
    let bilinear = |x: i32, z: i32| surface.bilinear_at(x, z);
    return (0..5).all(|corner| {
        let toward = [(corner & 1) * 2 - 1, (corner >> 1) * 2 - 1];
        let reach = if corner == 4 { 0 } else { side / 2 };
        let at = |middle: i32, toward: i32| (middle + toward * reach).clamp(0, last);
        let x = at((column << bits) + side / 2, toward[0]);
        let z = at((row << bits) + side / 2, toward[1]);
        let top = surface.node(bits, column, row).top << FINE_BITS;
        let occludee = point_occludee(x, top, z);
        raymarch_occlusion(&bilinear, culling, &occludee, if corner == 4 { side / 2 } else { 0 })
    });
}

/// Whether ray marching over the drawn vertices finds an occludee occluded.
#[must_use]
pub fn raymarch_occlusion_by_vertices<S: Slots>(
    surface: &Surface<'_, S>,
    culling: &Culling,
    occludee: &Occludee,
) -> bool {
    let bilinear = |x: i32, z: i32| surface.bilinear_at(x, z);
    return raymarch_occlusion(&bilinear, culling, occludee, 0);
}
