//! Twin of `wgsl/shared/tuft.wesl`: the shape of a clump of grass.

use super::clump::{MAX_TILT, StemPose, TURN, Vec2, Vec3, add, aligned, scaled, stem_point, within_tilt};

const QUADS: u32 = 3;

/// A vertex of a clump.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TuftVertex {
    /// From the root, metres.
    pub offset_m: Vec3,
    /// 0 at the foot to 1 at the tip.
    pub along: f32,
    /// -1 and 1 at the edges of a blade, 0 at its tip.
    pub across: f32,
    /// A number of its own for every blade, 0 to 1.
    pub blade: f32,
}

fn tuft_segments(level: u32) -> u32 {
    return if level == 0 { 3 } else { 1 };
}

fn tuft_blades(level: u32) -> u32 {
    return if level == 2 { 2 } else { 3 };
}

fn tuft_half_width(level: u32, row: u32) -> f32 {
    return match (level, row) {
        (0, 0) => 0.112,
        (0, 1) => 0.160,
        (0, 2) => 0.104,
        (1, 0) => 0.2133,
        (2, 0) => 0.32,
        _ => 0.0,
    };
}

fn tuft_number(phase: f32, blade: u32) -> f32 {
    let number = phase * 7.0 + blade as f32 * 0.618_034;
    return number - number.floor();
}

/// Vertex `index` of a clump of grass, `size_m` wide and high, at a level of detail, 0 (near) to 2
/// (far). `phase`, 0 to 1, turns the clump and varies its blades.
#[must_use]
pub fn tuft_vertex(level: u32, index: u32, size_m: Vec2, phase: f32, pose: &StemPose) -> TuftVertex {
    let segments = tuft_segments(level);
    let blades = tuft_blades(level);
    let corners = 2 * segments + 1;
    let stride = if level == 0 { corners + 2 } else { corners };
    let blade = index / stride;
    let corner = if level == 0 { (index % stride).clamp(1, corners) - 1 } else { index % stride };
    let row = corner >> 1;
    let across = if row == segments { 0.0 } else { (corner & 1) as f32 * 2.0 - 1.0 };
    let quad = blade / blades;
    let place = (blade % blades) as f32 - 0.5 * (blades - 1) as f32;
    let along = row as f32 / segments as f32;
    let number = tuft_number(phase, blade);

    let angle = TURN * (phase + quad as f32 / (2 * QUADS) as f32);
    let level_side = [angle.cos(), angle.sin()];
    let side = aligned([level_side[0], 0.0, level_side[1]], pose.foot);
    let fall = scaled([-level_side[1], level_side[0]], 0.5 * number - 0.25);
    let blade_pose = StemPose { tip: within_tilt(add(pose.tip, fall), MAX_TILT), ..*pose };

    let centre = place * (if blades == 2 { 0.36 } else { 0.25 } + 0.24 * along * along);
    let length = 1.0 - 0.3 * tuft_number(phase, blade + 4);
    let mut offset_m = scaled(stem_point(&blade_pose, row, segments), size_m[1] * length);
    offset_m = add(offset_m, scaled(side, size_m[0] * (centre + across * tuft_half_width(level, row))));
    offset_m[1] -= (0.04 * size_m[1] + 0.01 * size_m[0]).min(0.14 * size_m[0]);
    return TuftVertex { offset_m, along, across, blade: number };
}

#[cfg(test)]
mod tests {
    use super::super::clump::tests::{any_level, unit};
    use super::super::clump::{dot, stem_pose, upright_direction};
    use super::*;
    use crate::layout::{GRASS_VERTICES, grass_reach_m, grass_rise_m};

    /// A clump of any size on any ground, pushed anywhere.
    fn any_clump(seed: u32) -> (Vec2, f32, StemPose) {
        let size_m = [4.0 * unit(seed, 0), 2.0 * unit(seed, 1)];
        let normal = upright_direction(any_level(seed, 2, 1.0));
        (size_m, (unit(seed, 4) * 63.0).round() / 63.0, stem_pose(normal, any_level(seed, 5, 3.0)))
    }

    #[test]
    fn every_vertex_of_a_clump_lies_inside_its_cylinder() {
        let (mut widest, mut highest) = (0.0f32, 0.0f32);
        for seed in 0..20_000 {
            let (size_m, phase, pose) = any_clump(seed);
            let [width_m, height_m] = size_m;
            let (reach_m, rise_m) = (grass_reach_m(width_m, height_m), grass_rise_m(width_m, height_m));
            for (level, count) in (0..).zip(GRASS_VERTICES) {
                for index in 0..count {
                    let [x, y, z] = tuft_vertex(level, index, size_m, phase, &pose).offset_m;
                    let out_m = x.hypot(z);
                    assert!(out_m <= reach_m * (1.0 + 1e-5) + 1e-6, "{out_m} of {reach_m}: {seed}");
                    assert!(y <= rise_m + 1e-6, "{y} of {rise_m}: {seed}");
                    assert!(y >= -0.5 * width_m - 1e-6, "{y}: {seed}");
                    widest = widest.max(out_m / reach_m);
                    highest = highest.max(y / rise_m);
                }
            }
        }
        // A bound that nothing comes near to would be a wasteful one.
        assert!(widest > 0.8 && highest > 0.8, "{widest} {highest}");
    }

    #[test]
    fn all_levels_of_detail_have_the_same_area_of_leaves() {
        let areas = [0, 1, 2].map(|level: u32| {
            (0..2000)
                .map(|seed| {
                    let (_, phase, _) = any_clump(seed);
                    let pose = stem_pose([0.0, 1.0, 0.0], [0.0, 0.0]);
                    let count = GRASS_VERTICES[level as usize];
                    let points: Vec<Vec3> = (0..count)
                        .map(|index| tuft_vertex(level, index, [0.01, 1.0], phase, &pose).offset_m)
                        .collect();
                    let step = if level == 0 { 1 } else { 3 };
                    points.windows(3).step_by(step).map(area).sum::<f32>()
                })
                .sum::<f32>()
                / 2000.0
        });
        for area in areas {
            assert!((area / areas[0] - 1.0).abs() < 0.03, "{areas:?}");
        }
    }

    fn area(corners: &[Vec3]) -> f32 {
        let [a, b] = [1, 2].map(|corner| add(corners[corner], scaled(corners[0], -1.0)));
        // Lagrange's identity.
        0.5 * (dot(a, a) * dot(b, b) - dot(a, b) * dot(a, b)).max(0.0).sqrt()
    }

    #[test]
    fn the_quads_stand_60_degrees_apart() {
        let pose = stem_pose([0.0, 1.0, 0.0], [0.0, 0.0]);
        let per_quad = GRASS_VERTICES[1] / QUADS;
        let side = |quad: u32| {
            let foot = |index| tuft_vertex(1, quad * per_quad + index, [1.0, 1.0], 0.0, &pose).offset_m;
            let across = add(foot(1), scaled(foot(0), -1.0));
            scaled(across, 1.0 / dot(across, across).sqrt())
        };
        for (a, b, cosine) in [(0, 1, 0.5), (1, 2, 0.5), (0, 2, -0.5)] {
            assert!((dot(side(a), side(b)) - cosine).abs() < 1e-5);
        }
    }
}
