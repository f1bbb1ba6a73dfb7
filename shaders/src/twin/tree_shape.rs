//! Twin of `wgsl/shared/tree_shape.wesl`: the shape of a tree. Places of vertices only; what they
//! are lit by is compared as pictures.

use super::clump::{TURN, Vec2, Vec3, add, dot, scaled};
use super::crown::{Caster, PINE, SPRUCE, crown_of, trunk_radius_m};

const SPRAYS: [u32; 2] = [168, 40];
const WHORL: [u32; 2] = [8, 5];
const TRUNK_SIDES: [u32; 2] = [5, 3];
pub(super) const LOBES: u32 = 8;
const TREE_SWAY: f32 = 0.03;

fn fract(x: f32) -> f32 {
    return x - x.floor();
}

fn part_random(phase: f32, part: u32) -> f32 {
    return fract(phase * 11.0 + part as f32 * 0.618_034);
}

/// Where the stem of a tree is at a share `along` of its height, metres from the root.
#[must_use]
pub fn tree_stem(along: f32, height_m: f32, sway_m: Vec2) -> Vec3 {
    let aside = scaled(sway_m, along * along);
    let tilt = scaled(sway_m, 2.0 / height_m.max(1e-3));
    let height_loss = dot(tilt, tilt) * along * along * along / 6.0;
    return [aside[0], height_m * (along - height_loss), aside[1]];
}

fn beside_stem(up: f32, aside_m: Vec2, height_m: f32, sway_m: Vec2) -> Vec3 {
    return add(tree_stem(up, height_m, sway_m), [aside_m[0], 0.0, aside_m[1]]);
}

/// Place of a vertex of a tree in the first two levels of detail, `size_m` wide and high, from its
/// root, metres.
#[must_use]
pub fn vertex_of_tree(species: u32, level: u32, index: u32, size_m: Vec2, phase: f32, push: Vec2) -> Vec3 {
    let tree = Caster { root_m: [0.0; 3], width_m: size_m[0], height_m: size_m[1], species };
    let sway_m = scaled(push, TREE_SWAY * size_m[0].min(0.5 * size_m[1]));
    let spray = index / 6;
    let corner = index % 6;
    let sprays = SPRAYS[level as usize];
    if spray >= sprays {
        return trunk_vertex(&tree, level as usize, spray - sprays, corner, phase, sway_m);
    }
    if species == SPRUCE {
        return bough_vertex(&tree, level as usize, spray, corner, phase, sway_m);
    }
    return spray_vertex(&tree, level as usize, spray, corner, phase, sway_m);
}

fn trunk_vertex(tree: &Caster, level: usize, part: u32, corner: u32, phase: f32, sway_m: Vec2) -> Vec3 {
    let right = u32::from(corner == 2 || corner == 3 || corner == 5);
    let top = corner == 1 || corner == 4 || corner == 5;
    let sides = TRUNK_SIDES[level];
    if part >= sides {
        return limb_vertex(tree, part - sides, right, top, phase, sway_m);
    }
    let angle = TURN * (phase + (part + right) as f32 / sides as f32);
    let outward = [angle.cos(), angle.sin()];
    let [low, high] = if tree.species == SPRUCE { [0.9, 0.2] } else { [1.35, 0.45] };
    let trunk_half_width_m = trunk_radius_m(tree) * if top { high } else { low };
    let up = if top { 0.7 } else { 0.0 };
    let mut offset_m = beside_stem(up, scaled(outward, trunk_half_width_m), tree.height_m, sway_m);
    offset_m[1] -= if top { 0.0 } else { 0.1 * tree.width_m };
    return offset_m;
}

fn limb_vertex(tree: &Caster, limb: u32, right: u32, top: bool, phase: f32, sway_m: Vec2) -> Vec3 {
    let crown = crown_of(tree);
    let lobe = lobe_of(tree.species, phase, 1 + (2 * limb) % (LOBES - 1));
    let limb_end = scaled(lobe.centre, 0.9);
    let end_up = (crown.wide_m + crown.rise_m * limb_end[1]) / tree.height_m;
    let lowest = if tree.species == PINE { 0.55 } else { 0.26 };
    let begin_up = (lowest + 0.05 * limb as f32).min((end_up - 0.06).max(0.1));
    let length = limb_end[0].hypot(limb_end[2]).max(1e-3);
    let across = scaled([-limb_end[2], limb_end[0]], 1.0 / length);
    let half_m = trunk_radius_m(tree) * if top { 0.12 } else { 0.42 } * (right as f32 * 2.0 - 1.0);
    let has_limb = if tree.species == SPRUCE { 0.0 } else { 1.0 };
    let tip_m = if top { scaled([limb_end[0], limb_end[2]], crown.radius_m * has_limb) } else { [0.0; 2] };
    let aside_m = add(scaled(across, half_m * has_limb), tip_m);
    let up = if top { begin_up + (end_up - begin_up) * has_limb } else { begin_up };
    return beside_stem(up, aside_m, tree.height_m, sway_m);
}

fn bough_vertex(tree: &Caster, level: usize, spray: u32, corner: u32, phase: f32, sway_m: Vec2) -> Vec3 {
    let random01 = part_random(phase, spray);
    let whorl = spray / WHORL[level];
    let whorls = SPRAYS[level] / WHORL[level];
    let crown = crown_of(tree);
    let up = (whorl as f32 + 0.4 * random01) / whorls as f32;
    let bough_length = (1.0 - 0.93 * up).powf(0.9) * (1.0 - 0.22 * random01);
    let turn = (spray % WHORL[level]) as f32 / WHORL[level] as f32 + 0.381_966 * whorl as f32;
    let angle = TURN * (phase + turn + 0.05 * random01);
    let outward = [angle.cos(), angle.sin()];
    let across = [-outward[1], outward[0]];
    let is_end = corner == 1 || corner == 5;
    let is_side = corner == 2 || corner == 4;
    let sign = if corner == 4 { 1.0 } else { -1.0 };
    let half = [0.40, 0.56][level];
    let along: f32 = if is_side { 0.5 } else { f32::from(u8::from(is_end)) };
    let length_m = crown.radius_m * bough_length;
    let outwards = scaled(outward, length_m * if is_side { 0.56 } else { along });
    let aside_m = add(outwards, scaled(across, if is_side { sign * half * length_m } else { 0.0 }));
    let foot = (crown.wide_m + crown.rise_m * (0.04 + 0.93 * up)) / tree.height_m;
    let span = 1.0 / whorls as f32;
    let hang = if is_side {
        0.34
    } else if is_end {
        0.30
    } else {
        -0.05
    };
    let lower = if level > 0 && !is_end && is_side { 0.35 * span } else { 0.0 };
    let fall = hang * length_m / tree.height_m + lower;
    let high = if level > 0 && along == 0.0 { (foot + 0.8 * span).min(1.0) } else { foot };
    return beside_stem((high - fall).clamp(0.01, 0.995), aside_m, tree.height_m, sway_m);
}

/// A lobe of a crown, in radii of the crown's ellipsoid.
pub(super) struct Lobe {
    pub(super) centre: Vec3,
    pub(super) radius: f32,
    pub(super) aspect: f32,
}

pub(super) fn lobe_of(species: u32, phase: f32, lobe: u32) -> Lobe {
    let random01 = part_random(phase, lobe + 512);
    let y = 0.92 - 1.5 * lobe as f32 / (LOBES - 1) as f32;
    let angle = TURN * (0.381_966 * lobe as f32 + 3.0 * phase + 0.12 * random01);
    let sin_polar = (1.0 - y * y).sqrt();
    let outward = [sin_polar * angle.cos(), y, sin_polar * angle.sin()];
    let away = 0.42 + 0.20 * fract(5.0 * random01);
    let aspect = if species == PINE { 0.62 } else { 1.0 };
    return Lobe { centre: scaled(outward, away), radius: 0.985 - away, aspect };
}

fn spray_vertex(tree: &Caster, level: usize, spray: u32, corner: u32, phase: f32, sway_m: Vec2) -> Vec3 {
    let random01 = part_random(phase, spray);
    let crown = crown_of(tree);
    let lobe = lobe_of(tree.species, phase, spray % LOBES);
    let place = (spray / LOBES) as f32;
    let y = 1.0 - (2.0 * place + 1.0) * LOBES as f32 / SPRAYS[level] as f32;
    let angle = TURN * (0.381_966 * place + 5.0 * phase + 0.03 * random01);
    let sin_polar = (1.0 - y * y).max(0.0).sqrt();
    let outward = [sin_polar * angle.cos(), y, sin_polar * angle.sin()];
    let half = lobe.radius * [0.55, 0.95][level];
    let shell = lobe.radius * [0.55 + 0.40 * fract(7.0 * random01), 0.60][level];
    let east = [outward[2] + 1e-4, 0.0, -outward[0]];
    let east = scaled(east, 1.0 / dot(east, east).sqrt());
    let north = [
        outward[1] * east[2] - outward[2] * east[1],
        outward[2] * east[0] - outward[0] * east[2],
        outward[0] * east[1] - outward[1] * east[0],
    ];
    let spin = TURN * fract(13.0 * random01);
    let first = add(scaled(east, spin.cos()), scaled(north, spin.sin()));
    let tilt = 1.8 * fract(29.0 * random01) - 0.9;
    let second = add(add(scaled(north, spin.cos()), scaled(east, -spin.sin())), scaled(outward, tilt));
    let second = scaled(second, 1.0 / dot(second, second).sqrt());
    let right = if corner == 1 || corner == 3 || corner == 4 { 1.0 } else { -1.0 };
    let above = if corner == 2 || corner == 4 || corner == 5 { 1.0 } else { -1.0 };
    let aside = add(scaled(first, right), scaled(second, above));
    let in_lobe = add(scaled(outward, shell), scaled(aside, half));
    let unclamped = add(lobe.centre, [in_lobe[0], in_lobe[1] * lobe.aspect, in_lobe[2]]);
    let at = scaled(unclamped, f32::min(1.0, 0.985 / dot(unclamped, unclamped).sqrt().max(1e-3)));
    let up = (crown.wide_m + crown.rise_m * at[1]) / tree.height_m;
    return beside_stem(up, scaled([at[0], at[2]], crown.radius_m), tree.height_m, sway_m);
}

#[cfg(test)]
mod tests {
    use super::super::clump::tests::{any_level, unit};
    use super::*;
    use crate::layout::TREE_VERTICES;

    #[test]
    fn every_vertex_of_a_tree_lies_inside_its_cylinder() {
        let (mut widest, mut highest) = (0.0f32, 0.0f32);
        for seed in 0..3_000 {
            let size_m = [20.0 * unit(seed, 0), 40.0 * unit(seed, 1)];
            let (phase, push) = (unit(seed, 2), any_level(seed, 3, 0.55));
            let species = seed % 3;
            for (level, count) in (0..2).zip(TREE_VERTICES) {
                for index in 0..count {
                    let [x, y, z] = vertex_of_tree(species, level, index, size_m, phase, push);
                    assert!(x.hypot(z) <= 0.5 * size_m[0] + 1e-5, "{seed}: {index}");
                    assert!(y <= size_m[1] + 1e-5 && y >= -0.5 * size_m[0] - 1e-5, "{seed}: {index}");
                    widest = widest.max(x.hypot(z) / (0.5 * size_m[0]));
                    highest = highest.max(y / size_m[1]);
                }
            }
        }
        assert!(widest > 0.9 && highest > 0.99, "{widest} {highest}");
    }

    #[test]
    fn the_last_vertices_of_a_tree_are_those_of_its_trunk() {
        for species in 0..3 {
            let at = |level, index| vertex_of_tree(species, level, index, [4.0, 10.0], 0.3, [0.0, 0.0]);
            for level in 0..2 {
                let count = TREE_VERTICES[level as usize];
                let out = |index| at(level, index)[0].hypot(at(level, index)[2]);
                let first = 6 * SPRAYS[level as usize];
                let limbs = first + 6 * TRUNK_SIDES[level as usize];
                assert!(limbs < count, "{species} {level}: some limbs");
                assert!((first..limbs).all(|index| out(index) < 0.4), "{species} {level}");
                assert!((0..first).any(|index| out(index) > 1.0), "{species} {level}");
                // Limbs lead from the stem into the crown; a spruce has none.
                let ends = (limbs..count).map(out).fold(0.0, f32::max);
                assert!(if species == SPRUCE { ends < 0.1 } else { (0.4..1.4).contains(&ends) }, "{ends}");
            }
        }
    }

    #[test]
    fn swaying_keeps_the_length_of_a_stem() {
        // The strongest sway of a tree as wide as it is high.
        let sway_m = [0.55 * 0.03 * 5.0, 0.0];
        let points: Vec<Vec3> =
            (0..=1000).map(|step| tree_stem(step as f32 / 1000.0, 10.0, sway_m)).collect();
        let pieces = points.windows(2).map(|ends| {
            let piece = add(ends[1], scaled(ends[0], -1.0)).map(f64::from);
            piece.iter().map(|part| part * part).sum::<f64>().sqrt()
        });
        let length_m: f64 = pieces.sum();
        assert!((length_m / 10.0 - 1.0).abs() < 1e-5, "{length_m}");
        let sheared = 10.0f64.hypot(f64::from(sway_m[0]));
        assert!(sheared / 10.0 - 1.0 > 3e-5, "the control is longer: {sheared}");
    }
}
