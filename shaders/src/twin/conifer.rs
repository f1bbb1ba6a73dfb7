//! Twin of `wgsl/shared/conifer.wesl`: the shape of a conifer. Places of vertices only; what they
//! are lit by is compared as pictures.

use super::clump::{TURN, Vec2, Vec3, add, dot, scaled};

const CONIFER_TIERS: u32 = 9;
const CONIFER_BOUGHS: u32 = 6;
const CONIFER_TRUNK_SIDES: u32 = 3;
const CONIFER_FAR_TIERS: u32 = 4;
const CONIFER_FAR_BOUGHS: u32 = 3;
const CONIFER_SWAY: f32 = 0.03;

fn conifer_number(phase: f32, part: u32) -> f32 {
    let number = phase * 11.0 + part as f32 * 0.618_034;
    return number - number.floor();
}

/// Where the stem of a tree is at a share `along` of its height, metres from the root.
#[must_use]
pub fn conifer_stem(along: f32, height_m: f32, sway_m: Vec2) -> Vec3 {
    let aside = scaled(sway_m, along * along);
    let tilt = scaled(sway_m, 2.0 / height_m.max(1e-3));
    let sinks = dot(tilt, tilt) * along * along * along / 6.0;
    return [aside[0], height_m * (along - sinks), aside[1]];
}

/// Place of a vertex of a tree, `size_m` wide and high, from its root, metres.
#[must_use]
pub fn conifer_vertex(level: u32, index: u32, size_m: Vec2, phase: f32, push: Vec2) -> Vec3 {
    let is_near = level == 0;
    let tiers = if is_near { CONIFER_TIERS } else { CONIFER_FAR_TIERS };
    let boughs = if is_near { CONIFER_BOUGHS } else { CONIFER_FAR_BOUGHS };
    let radius_m = 0.5 * size_m[0];
    let sway_m = scaled(push, CONIFER_SWAY * size_m[0].min(0.5 * size_m[1]));
    let triangle = index / 3;
    let corner = index % 3;
    let part = triangle >> 1;
    let second = triangle & 1;
    let outward = |angle: f32, length: f32| [length * angle.cos(), 0.0, length * angle.sin()];

    if part >= tiers * boughs {
        let side = part - tiers * boughs;
        let right = [[0, 0, 1], [1, 0, 1]][second as usize][corner as usize];
        let top = [[0, 1, 0], [0, 1, 1]][second as usize][corner as usize] == 1;
        let angle = TURN * (phase + (side + right) as f32 / CONIFER_TRUNK_SIDES as f32);
        let thick_m = (0.022 * size_m[1]).min(0.2 * radius_m) * if top { 0.55 } else { 1.0 };
        let along = if top { 0.5 } else { 0.0 };
        let mut offset_m = add(conifer_stem(along, size_m[1], sway_m), outward(angle, thick_m));
        offset_m[1] -= if top { 0.0 } else { 0.2 * radius_m };
        return offset_m;
    }

    let tier = part / boughs;
    let bough = part % boughs;
    let up = tier as f32 / tiers as f32;
    let rim = if is_near { 0.13 } else { 0.06 } + 0.86 * up * (1.0 - 0.06 * up);
    let meet_at = (rim + if is_near { 0.21 } else { 0.40 }).min(1.0);
    let crown = (1.0 - 0.92 * up).powf(0.85);
    let steps = 2 * bough + second;
    let is_apex = corner == 0;
    let step = if corner == 1 { steps + 1 } else { steps };
    let is_gap = step & 1 == 0;
    let number = conifer_number(phase, tier * boughs + bough);
    let first = phase + 0.381_966 * tier as f32;
    let angle = TURN * (first + step as f32 / (2 * boughs) as f32);
    if is_apex {
        let is_top = tier + 1 == tiers;
        return conifer_stem(if is_top { 1.0 } else { meet_at }, size_m[1], sway_m);
    }
    let gap = if is_near { 0.46 } else { 0.55 };
    let reach = if is_gap { gap } else { 0.94 - 0.24 * number } * crown;
    let stem = conifer_stem(rim + if is_gap { 0.03 } else { 0.0 }, size_m[1], sway_m);
    let mut offset_m = add(stem, outward(angle, radius_m * reach));
    offset_m[1] -= if is_gap { 0.0 } else { 0.03 * size_m[1] * (0.4 + number) };
    return offset_m;
}

#[cfg(test)]
mod tests {
    use super::super::clump::tests::{any_level, unit};
    use super::*;
    use crate::layout::TREE_VERTICES;

    #[test]
    fn every_vertex_of_a_tree_lies_inside_its_cylinder() {
        let (mut widest, mut highest) = (0.0f32, 0.0f32);
        for seed in 0..5_000 {
            let size_m = [20.0 * unit(seed, 0), 40.0 * unit(seed, 1)];
            let (phase, push) = (unit(seed, 2), any_level(seed, 3, 0.55));
            for (level, count) in (0..).zip(TREE_VERTICES) {
                for index in 0..count {
                    let [x, y, z] = conifer_vertex(level, index, size_m, phase, push);
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
    fn the_first_tree_vertex_is_an_apex_and_the_last_is_trunk() {
        let at = |index| conifer_vertex(0, index, [4.0, 10.0], 0.3, [0.0, 0.0]);
        assert!(at(0)[1] > at(1)[1] && at(0)[1] > at(2)[1]);
        let [x, _, z] = at(TREE_VERTICES[0] - 1);
        assert!(x.hypot(z) < 0.3);
        let boughs = CONIFER_FAR_TIERS * CONIFER_FAR_BOUGHS;
        assert_eq!(TREE_VERTICES[1], 6 * boughs, "far trees have no trunk");
    }

    #[test]
    fn swaying_keeps_the_length_of_a_stem() {
        // The strongest sway of a tree as wide as it is high.
        let sway_m = [0.55 * 0.03 * 5.0, 0.0];
        let points: Vec<Vec3> =
            (0..=1000).map(|step| conifer_stem(step as f32 / 1000.0, 10.0, sway_m)).collect();
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
