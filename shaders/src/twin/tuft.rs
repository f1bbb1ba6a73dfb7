//! Twin of `wgsl/shared/tuft.wesl`: the shape of a clump of grass.

use super::blade::{
    BLADES, FEW_BLADES, blade_curve, blade_direction, blade_point, blade_presence, blade_share,
};
use super::clump::{
    MAX_TILT, StemPose, TURN, Vec2, Vec3, add, aligned, cross, dot, fract, scaled, smoothstep, stem_point,
    within_tilt,
};

const QUADS: u32 = 3;
const QUAD_BLADES: u32 = 2;
const QUAD_HALF_WIDTH: f32 = 0.32;
const HALF_WIDTH: f32 = 0.01157;
const FEW_HALF_WIDTH: f32 = 0.0600;
const SINK_M: f32 = 0.03;

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
    /// The vector that tilts the normal of the ground here.
    pub round: Vec3,
}

fn tuft_number(phase: f32, blade: u32) -> f32 {
    return fract(phase * 7.0 + blade as f32 * 0.618_034);
}

fn blade_numbers(phase: f32, blade: u32) -> [f32; 4] {
    let (turns, steps) = ([7.0, 11.0, 13.0, 17.0], [0.618_034, 0.754_877_7, 0.569_840_3, 0.414_213_57]);
    return std::array::from_fn(|n| fract(phase * turns[n] + blade as f32 * steps[n]));
}

/// Vertex `index` of a clump of grass, `size_m` wide and high, at a level of detail, 0 (near) to 2
/// (far), `distance_m` from the eye. `phase`, 0 to 1, turns the clump and varies its blades.
#[must_use]
pub fn tuft_vertex(
    level: u32,
    index: u32,
    size_m: Vec2,
    phase: f32,
    pose: &StemPose,
    distance_m: f32,
) -> TuftVertex {
    if level == 2 {
        return quad_vertex(index, size_m, phase, pose);
    }
    let segments = if level == 0 { 3 } else { 1 };
    let corners = 2 * segments + 1;
    let stride = if level == 0 { corners + 2 } else { corners };
    let blade = index / stride;
    let corner = if level == 0 { (index % stride).clamp(1, corners) - 1 } else { index % stride };
    let row = corner >> 1;
    let across = if row == segments { 0.0 } else { (corner & 1) as f32 * 2.0 - 1.0 };
    let along = row as f32 / segments as f32;
    let numbers = blade_numbers(phase, blade);

    let way = TURN * numbers[2];
    let out = [way.cos(), way.sin()];
    let root_m = scaled(out, numbers[1].sqrt() * (0.25 * size_m[0] + 0.10));
    let turn = TURN * numbers[3];
    let side = aligned([turn.cos(), 0.0, turn.sin()], pose.foot);
    let facing = [-turn.sin(), turn.cos()];
    let outward = if dot(facing, out) >= 0.0 { 1.0 } else { -1.0 };
    let most = f32::min(0.7, (0.4 * size_m[0] + 0.24) / size_m[1].max(1e-3));
    let fall = scaled(facing, outward * most * (0.25 + 0.75 * tuft_number(phase, blade + 4)));
    let curve = blade_curve(pose.root, within_tilt(add(pose.tip, fall), MAX_TILT));
    let length = 1.0 - 0.3 * numbers[0];

    let share = blade_share(distance_m);
    let few = (share * BLADES as f32 / FEW_BLADES as f32).min(1.0);
    let presence = if level == 0 {
        blade_presence(share, blade, BLADES) / share
    } else {
        blade_presence(few, blade, FEW_BLADES) / few
    };
    let profile =
        if level == 0 { HALF_WIDTH * (1.0 - along * along) } else { FEW_HALF_WIDTH * (1.0 - along) };
    let half_width_m = size_m[0] * profile * presence;

    let mut offset_m = aligned([root_m[0], 0.0, root_m[1]], pose.foot);
    offset_m = add(offset_m, scaled(blade_point(&curve, along), size_m[1] * length));
    offset_m = add(offset_m, scaled(side, across * half_width_m));
    offset_m[1] -= SINK_M;
    let upper = cross(blade_direction(&curve, along), side);
    let upper = scaled(upper, 1.0 / dot(upper, upper).sqrt());
    let near = 1.0 - smoothstep(8.0, 30.0, distance_m);
    let round = scaled(add(scaled(upper, upper[1]), scaled(side, 0.45 * across)), near);
    return TuftVertex { offset_m, along, across, blade: numbers[0], round };
}

fn quad_vertex(index: u32, size_m: Vec2, phase: f32, pose: &StemPose) -> TuftVertex {
    let blade = index / 3;
    let corner = index % 3;
    let along = if corner == 2 { 1.0 } else { 0.0 };
    let across = if corner == 2 { 0.0 } else { (corner & 1) as f32 * 2.0 - 1.0 };
    let quad = blade / QUAD_BLADES;
    let place = (blade % QUAD_BLADES) as f32 - 0.5;
    let number = tuft_number(phase, blade);

    let angle = TURN * (phase + quad as f32 / (2 * QUADS) as f32);
    let level_side = [angle.cos(), angle.sin()];
    let side = aligned([level_side[0], 0.0, level_side[1]], pose.foot);
    let fall = scaled([-level_side[1], level_side[0]], 0.5 * number - 0.25);
    let blade_pose = StemPose { tip: within_tilt(add(pose.tip, fall), MAX_TILT), ..*pose };

    let centre = place * (0.36 + 0.24 * along * along);
    let length = 1.0 - 0.3 * tuft_number(phase, blade + 4);
    let half_width = QUAD_HALF_WIDTH * (1.0 - along);
    let mut offset_m = scaled(stem_point(&blade_pose, along as u32, 1), size_m[1] * length);
    offset_m = add(offset_m, scaled(side, size_m[0] * (centre + across * half_width)));
    offset_m[1] -= (0.04 * size_m[1] + 0.01 * size_m[0]).min(0.14 * size_m[0]);
    return TuftVertex { offset_m, along, across, blade: number, round: [0.0; 3] };
}

#[cfg(test)]
mod tests {
    use super::super::clump::tests::{any_level, unit};
    use super::super::clump::{stem_pose, upright_direction};
    use super::*;
    use crate::layout::{GRASS_SPREAD_M, GRASS_VERTICES, grass_reach_m, grass_rise_m};

    /// A clump of any size on any ground, pushed anywhere.
    fn any_clump(seed: u32) -> (Vec2, f32, StemPose) {
        let size_m = [4.0 * unit(seed, 0), 2.0 * unit(seed, 1)];
        let normal = upright_direction(any_level(seed, 2, 1.0));
        (size_m, (unit(seed, 4) * 63.0).round() / 63.0, stem_pose(normal, any_level(seed, 5, 3.0)))
    }

    /// A distance at which a level of detail is drawn, metres.
    fn any_distance_m(level: u32, seed: u32) -> f32 {
        let [begin, end] = [[0.5, 10.2], [9.8, 32.2], [31.8, 260.0]][level as usize];
        begin + (end - begin) * unit(seed, 30)
    }

    #[test]
    fn every_vertex_of_a_clump_lies_inside_its_cylinder() {
        let mut closest = [[0.0f32; 2]; 3];
        let mut beyond = 0;
        for seed in 0..6000 {
            let (size_m, phase, pose) = any_clump(seed);
            let [width_m, height_m] = size_m;
            for (level, count) in (0..).zip(GRASS_VERTICES) {
                let spread_m = if level == 2 { 0.0 } else { GRASS_SPREAD_M };
                let (reach_m, rise_m) =
                    (grass_reach_m(width_m, height_m, spread_m), grass_rise_m(width_m, height_m, spread_m));
                let distance_m = any_distance_m(level, seed);
                for index in 0..count {
                    let [x, y, z] = tuft_vertex(level, index, size_m, phase, &pose, distance_m).offset_m;
                    let out_m = x.hypot(z);
                    assert!(out_m <= reach_m * (1.0 + 1e-5) + 1e-6, "{out_m} of {reach_m}: {seed}");
                    assert!(y <= rise_m + 1e-6, "{y} of {rise_m}: {seed}");
                    assert!(y >= -0.5 * width_m - spread_m - 1e-6, "{y}: {seed}");
                    let [widest, highest] = &mut closest[level as usize];
                    (*widest, *highest) = (widest.max(out_m / reach_m), highest.max(y / rise_m));
                    // The control: without the spread.
                    beyond += u32::from(out_m > grass_reach_m(width_m, height_m, 0.0));
                }
            }
        }
        // A bound that nothing comes near to would be a wasteful one. Blades of the first two
        // levels fall less where their roots are far out.
        let enough =
            closest.iter().zip([0.6, 0.6, 0.8]).all(|(near, reach)| near[0] > reach && near[1] > 0.8);
        assert!(enough, "{closest:?}");
        assert!(beyond > 100, "{beyond}");
    }

    /// Mean area of the leaves of a clump of height 1 and width 0.01 m, without its last vertices.
    fn area_of(level: u32, distance_m: f32, without: u32) -> f32 {
        let clumps = (0..64).map(|phase| {
            let pose = stem_pose([0.0, 1.0, 0.0], [0.0, 0.0]);
            let count = GRASS_VERTICES[level as usize] - without;
            let vertex = |index| {
                tuft_vertex(level, index, [0.01, 1.0], phase as f32 / 63.0, &pose, distance_m).offset_m
            };
            let points: Vec<Vec3> = (0..count).map(vertex).collect();
            let step = if level == 0 { 1 } else { 3 };
            points.windows(3).step_by(step).map(area).sum::<f32>()
        });
        clumps.sum::<f32>() / 64.0
    }

    #[test]
    fn all_levels_of_detail_have_the_same_area_of_leaves() {
        let far = area_of(2, 100.0, 0);
        for (level, distances_m) in [(0, [1.0, 4.0, 6.0, 8.0, 10.0]), (1, [10.0, 14.0, 20.0, 26.0, 32.0])] {
            for distance_m in distances_m {
                let share = area_of(level, distance_m, 0) / far;
                assert!((share - 1.0).abs() < 0.01, "{share} in level {level} at {distance_m} m");
            }
        }
        // The control: a clump that lacks one blade of 32.
        assert!(area_of(1, 10.0, 3) / far < 0.99);
    }

    #[test]
    fn roots_are_spread_over_the_disc_and_blades_are_4_to_9_mm_wide() {
        let pose = stem_pose([0.0, 1.0, 0.0], [0.0, 0.0]);
        for (width_m, millimetres) in [(0.16, 3.0..5.0), (0.36, 7.5..9.0)] {
            let mut quarters = [0; 4];
            for blade in 0..BLADES {
                let edge = |side| tuft_vertex(0, 9 * blade + side, [width_m, 0.4], 0.3, &pose, 2.0).offset_m;
                // The first vertex of a blade stands twice.
                let (left, right) = (edge(1), edge(2));
                let across = add(right, scaled(left, -1.0));
                assert!(millimetres.contains(&(1000.0 * dot(across, across).sqrt())), "{across:?}");
                let root = scaled(add(left, right), 0.5);
                assert!(root[1] < 0.0 && root[0].hypot(root[2]) <= 0.25 * width_m + 0.10 + 1e-5);
                quarters[usize::from(root[0] > 0.0) + 2 * usize::from(root[2] > 0.0)] += 1;
            }
            assert!(quarters.iter().all(|count| (26..=38).contains(count)), "{quarters:?}");
        }
    }

    #[test]
    fn a_change_of_level_leaves_roots_and_tips_in_place() {
        let mut moved = 0.0f32;
        for seed in 0..500 {
            let (_, phase, pose) = any_clump(seed);
            let size_m = [0.26, 0.42];
            for blade in 0..FEW_BLADES {
                let near = tuft_vertex(0, 9 * blade + 7, size_m, phase, &pose, 10.0).offset_m;
                let far = tuft_vertex(1, 3 * blade + 2, size_m, phase, &pose, 10.0).offset_m;
                assert_eq!(near, far, "{seed} {blade}");
                // The control: the tip of another blade.
                let other = tuft_vertex(1, 3 * ((blade + 1) % 32) + 2, size_m, phase, &pose, 10.0).offset_m;
                moved = moved.max((other[0] - near[0]).abs());
            }
        }
        assert!(moved > 0.1, "{moved}");
    }

    #[test]
    fn normals_are_rounded_across_a_blade_and_stay_above_the_ground() {
        let pose = stem_pose([0.0, 1.0, 0.0], [0.3, 0.2]);
        for blade in 0..BLADES {
            let round = |side| tuft_vertex(0, 9 * blade + side, [0.26, 0.42], 0.3, &pose, 3.0).round;
            // The first edges of the middle row.
            let (left, right) = (round(3), round(4));
            let across = add(right, scaled(left, -1.0));
            assert!(dot(across, across).sqrt() > 0.5, "{across:?}");
            assert!(left[1].min(right[1]) > -1e-6);
        }
        assert_eq!(tuft_vertex(1, 0, [0.26, 0.42], 0.3, &pose, 30.0).round, [0.0; 3]);
    }

    fn area(corners: &[Vec3]) -> f32 {
        let [a, b] = [1, 2].map(|corner| add(corners[corner], scaled(corners[0], -1.0)));
        // Lagrange's identity.
        0.5 * (dot(a, a) * dot(b, b) - dot(a, b) * dot(a, b)).max(0.0).sqrt()
    }

    #[test]
    fn the_quads_stand_60_degrees_apart() {
        let pose = stem_pose([0.0, 1.0, 0.0], [0.0, 0.0]);
        let per_quad = GRASS_VERTICES[2] / QUADS;
        let side = |quad: u32| {
            let foot = |index| tuft_vertex(2, quad * per_quad + index, [1.0, 1.0], 0.0, &pose, 50.0).offset_m;
            let across = add(foot(1), scaled(foot(0), -1.0));
            scaled(across, 1.0 / dot(across, across).sqrt())
        };
        for (a, b, cosine) in [(0, 1, 0.5), (1, 2, 0.5), (0, 2, -0.5)] {
            assert!((dot(side(a), side(b)) - cosine).abs() < 1e-5);
        }
    }
}
