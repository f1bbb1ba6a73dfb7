//! Brick material in running bond, six bricks wide and twelve courses high. Its steep edges test
//! the ray march.

use crate::features::materials::{CustomMaterial, MATERIAL_SIZE, MATERIAL_TEXELS};
use glam::{Vec2, Vec3};
use shaders::layout::BakeTexel;

/// Bricks along u and courses along v of a tile; an even number of courses, so that it repeats.
const BRICKS: Vec2 = Vec2::new(6.0, 12.0);
/// Width of the edge slope, as a share of the brick's cell along u and v, from the middle of the
/// joint.
const EDGE: Vec2 = Vec2::new(0.06, 0.10);

/// The brick at a position, and the position in its cell, 0 to 1.
fn cell(uv: Vec2) -> (Vec2, Vec2) {
    let scaled = uv * BRICKS;
    let course = scaled.y.floor();
    let along = scaled.x + 0.5 * course.rem_euclid(2.0);
    (Vec2::new(along.floor().rem_euclid(BRICKS.x), course), Vec2::new(along, scaled.y).fract())
}

fn smoothstep(low: f32, high: f32, x: f32) -> f32 {
    let part = ((x - low) / (high - low)).clamp(0.0, 1.0);
    part * part * (3.0 - 2.0 * part)
}

/// Height at a place of the tile: 1 on bricks, 0 in the middle of the joints.
#[must_use]
pub fn height(uv: Vec2) -> f32 {
    let (_, within) = cell(uv);
    let edge = |place: f32, width: f32| smoothstep(0.0, width, place) * smoothstep(0.0, width, 1.0 - place);
    edge(within.x, EDGE.x) * edge(within.y, EDGE.y)
}

/// Height range in tiles that the normals are computed for: that of the cobbles, whose set the
/// bricks replace.
const RELIEF: f32 = 0.025;

/// The brick material.
#[must_use]
pub fn material() -> CustomMaterial {
    let side = MATERIAL_SIZE as usize;
    let centre = |index: usize| (Vec2::new((index % side) as f32, (index / side) as f32) + 0.5) / side as f32;
    let texels = (0..MATERIAL_TEXELS).map(|index| texel(index, centre(index)));
    CustomMaterial { texels: texels.collect(), normals_given: true, occlusion_given: true }
}

fn texel(index: usize, uv: Vec2) -> BakeTexel {
    let (brick, _) = cell(uv);
    let here = height(uv);
    // Color differs by brick, grain by texel.
    let burnt = share((brick.x + BRICKS.x * brick.y) as u32 + 17);
    let hue = share((brick.x + BRICKS.x * brick.y) as u32 + 4711);
    let grain = share(index as u32 ^ 0x9e37_79b9);
    let clay = Vec3::new(0.44, 0.125, 0.060).lerp(Vec3::new(0.30, 0.105, 0.070), hue) * (0.62 + 0.6 * burnt);
    let mortar = Vec3::new(0.36, 0.345, 0.32);
    let albedo = mortar.lerp(clay, smoothstep(0.25, 0.6, here)) * (0.90 + 0.20 * grain);
    let step = 0.5 / MATERIAL_SIZE as f32;
    let rise = |ahead: Vec2| (height(uv + ahead) - height(uv - ahead)) * RELIEF / (2.0 * step);
    let slope = Vec2::new(rise(Vec2::X * step), rise(Vec2::Y * step));
    BakeTexel {
        albedo: albedo.into(),
        height: here,
        normal: (-slope / (1.0 + slope.length_squared()).sqrt()).into(),
        roughness: 0.9 - 0.12 * here,
        occlusion: 0.55 + 0.45 * here,
    }
}

/// 0 to 1 by an integer hash (lowbias32, Wellons, "Hash Prospecting", 2018).
fn share(seed: u32) -> f32 {
    let mut hash = seed;
    hash = (hash ^ (hash >> 16)).wrapping_mul(0x7feb_352d);
    hash = (hash ^ (hash >> 15)).wrapping_mul(0x846c_a68b);
    (hash ^ (hash >> 16)) as f32 / u32::MAX as f32
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bricks_are_high_joints_are_low_and_every_other_course_is_shifted_by_half_a_brick() {
        let at = |column: f32, course: f32| height(Vec2::new(column, course) / BRICKS);
        for course in 0..12 {
            let shift = 0.5 * (course % 2) as f32;
            let middle = course as f32 + 0.5;
            assert_eq!((at(2.5 + shift, middle), at(2.0 + shift, middle)), (1.0, 0.0), "course {course}");
            assert_eq!(at(2.3, course as f32), 0.0);
        }
    }

    #[test]
    fn the_tile_repeats_and_its_set_is_complete() {
        let set = material();
        assert_eq!(set.texels.len(), MATERIAL_TEXELS);
        let share =
            set.texels.iter().filter(|texel| texel.height > 0.5).count() as f32 / MATERIAL_TEXELS as f32;
        assert!((0.7..0.95).contains(&share), "{share}");
        for part in [0.1, 0.37, 0.8] {
            assert!((height(Vec2::new(part, 1e-6)) - height(Vec2::new(part, 1.0 - 1e-6))).abs() < 1e-3);
            assert!((height(Vec2::new(1e-6, part)) - height(Vec2::new(1.0 - 1e-6, part))).abs() < 1e-3);
        }
        // Normals lean away from the bricks, towards the joint.
        let row = MATERIAL_SIZE as usize * 20;
        let left = set.texels[row..row + MATERIAL_SIZE as usize]
            .iter()
            .find(|texel| texel.height > 0.3 && texel.height < 0.7);
        assert!(left.is_some_and(|texel| texel.normal[0].abs() > 0.3), "{left:?}");
    }
}
