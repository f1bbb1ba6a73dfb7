//! Twin of `wgsl/shared/tree_impostor.wesl`: the quad of a tree, and where rays through it meet its
//! solids.

use super::clump::{Vec3, add, dot, scaled};
use super::crown::{Caster, Crown, crown_of, trunk_radius_m};

/// No hit.
pub const NO_WAY: f32 = 1e30;

const BOUGHS_FILL: f32 = 0.84;

/// The solid that stands for the crown of a tree.
#[must_use]
pub fn impostor_crown(tree: &Caster) -> Crown {
    let mut crown = crown_of(tree);
    crown.radius_m *= if crown.is_cone { BOUGHS_FILL } else { 1.0 };
    return crown;
}

fn cross(a: Vec3, b: Vec3) -> Vec3 {
    return [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
}

fn length(v: Vec3) -> f32 {
    return dot(v, v).sqrt();
}

/// A corner of the quad, from the eye, metres; `index` 0 to 5.
#[must_use]
pub fn impostor_corner(tree: &Caster, index: u32) -> Vec3 {
    let middle_m = add(tree.root_m, [0.0, 0.5 * tree.height_m, 0.0]);
    let away_m = length(middle_m).max(1e-3);
    let gaze = scaled(middle_m, 1.0 / away_m);
    let level = gaze[0].hypot(gaze[2]);
    let aside = if level > 1e-4 { scaled([-gaze[2], gaze[0]], 1.0 / level.max(1e-6)) } else { [1.0, 0.0] };
    let right = [aside[0], 0.0, aside[1]];
    let up = cross(right, gaze);
    let radius_m = 0.5 * tree.width_m.hypot(tree.height_m);
    let nearer = away_m / (away_m - radius_m).max(0.25 * away_m);
    let half_m = scaled([tree.width_m, tree.height_m * level + tree.width_m * gaze[1].abs()], 0.5 * nearer);
    let is_right = index == 1 || index == 4 || index == 5;
    let is_above = index == 2 || index == 3 || index == 5;
    let across = scaled(right, if is_right { half_m[0] } else { -half_m[0] });
    let along = scaled(up, if is_above { half_m[1] } else { -half_m[1] });
    return add(middle_m, add(across, along));
}

/// Where a ray begins that is intersected with a tree, metres along `toward` (unit).
#[must_use]
pub fn ray_begin_m(tree: &Caster, toward: Vec3) -> f32 {
    return dot(add(tree.root_m, [0.0, 0.5 * tree.height_m, 0.0]), toward);
}

/// Smaller solution of |begin + t step| = radius, or [`NO_WAY`].
#[must_use]
pub fn sphere_way(begin: Vec3, step: Vec3, radius: f32) -> f32 {
    let a = dot(step, step).max(1e-12);
    let b = dot(begin, step);
    let inside = b * b - a * (dot(begin, begin) - radius * radius);
    if inside <= 0.0 {
        return NO_WAY;
    }
    return (-inside.sqrt() - b) / a;
}

/// Where a ray enters the crown's solid: metres from `begin_m`, a place from the root.
#[must_use]
pub fn crown_way(crown: &Crown, begin_m: Vec3, toward: Vec3) -> f32 {
    if !crown.is_cone {
        let axes = [crown.radius_m, crown.rise_m, crown.radius_m];
        let from_middle = add(begin_m, [0.0, -crown.wide_m, 0.0]);
        let begin: Vec3 = std::array::from_fn(|axis| from_middle[axis] / axes[axis]);
        let step: Vec3 = std::array::from_fn(|axis| toward[axis] / axes[axis]);
        return sphere_way(begin, step, 1.0);
    }
    let level = |v: Vec3| [v[0], v[2]];
    let k = crown.radius_m / crown.rise_m;
    let y = begin_m[1] - (crown.wide_m + crown.rise_m);
    let mut a = dot(level(toward), level(toward)) - k * k * toward[1] * toward[1];
    a = if a.abs() < 1e-5 { 1e-5 } else { a };
    let b = dot(level(begin_m), level(toward)) - k * k * y * toward[1];
    let inside = b * b - a * (dot(level(begin_m), level(begin_m)) - k * k * y * y);
    let mut way = NO_WAY;
    if inside > 0.0 {
        let root = inside.sqrt();
        for side in 0..2 {
            let t = (if side == 0 { -root } else { root } - b) / a;
            let down = -(y + t * toward[1]);
            if down >= 0.0 && down <= crown.rise_m {
                way = way.min(t);
            }
        }
    }
    if toward[1] > 1e-5 {
        let t = (-crown.rise_m - y) / toward[1];
        let at_m = add(level(begin_m), scaled(level(toward), t));
        if dot(at_m, at_m) <= crown.radius_m * crown.radius_m {
            way = way.min(t);
        }
    }
    return way;
}

/// Where a ray enters a lobe; `lobe` is its centre and radius.
#[must_use]
pub fn lobe_way(crown: &Crown, lobe: [f32; 4], flat: f32, begin_m: Vec3, toward: Vec3) -> f32 {
    let axes = [crown.radius_m, crown.rise_m, crown.radius_m];
    let squash = [1.0, 1.0 / flat, 1.0];
    let from_middle = add(begin_m, [0.0, -crown.wide_m, 0.0]);
    let begin: Vec3 =
        std::array::from_fn(|axis| (from_middle[axis] / axes[axis] - lobe[axis]) * squash[axis]);
    let step: Vec3 = std::array::from_fn(|axis| toward[axis] / axes[axis] * squash[axis]);
    return sphere_way(begin, step, lobe[3]);
}

/// Where a ray meets the trunk, an upright cylinder up to 0.7 of the height.
#[must_use]
pub fn trunk_way(tree: &Caster, begin_m: Vec3, toward: Vec3) -> f32 {
    let level = |v: Vec3| [v[0], v[2]];
    let radius_m = trunk_radius_m(tree);
    let a = dot(level(toward), level(toward)).max(1e-6);
    let b = dot(level(begin_m), level(toward));
    let inside = b * b - a * (dot(level(begin_m), level(begin_m)) - radius_m * radius_m);
    if inside <= 0.0 {
        return NO_WAY;
    }
    let t = (-inside.sqrt() - b) / a;
    let up_m = begin_m[1] + t * toward[1];
    return if up_m >= -0.05 * tree.width_m && up_m <= 0.7 * tree.height_m { t } else { NO_WAY };
}

#[cfg(test)]
mod tests {
    use super::super::clump::tests::unit;
    use super::super::tree_shape::{LOBES, lobe_of, vertex_of_tree};
    use super::*;
    use crate::layout::TREE_VERTICES;

    /// A tree somewhere around the eye, 20 m to 8 km away, at elevations of up to 90 degrees.
    fn any_tree(seed: u32) -> (Caster, f32) {
        let away_m = 20.0 * 400.0f32.powf(unit(seed, 0));
        let (turn, rise) =
            (std::f32::consts::TAU * unit(seed, 1), std::f32::consts::PI * (unit(seed, 2) - 0.5));
        let level_m = away_m * rise.cos();
        let tree = Caster {
            root_m: [level_m * turn.cos(), away_m * rise.sin(), level_m * turn.sin()],
            width_m: 3.2 + 3.2 * unit(seed, 3),
            height_m: 6.0 + 8.0 * unit(seed, 4),
            species: seed % 3,
        };
        (tree, unit(seed, 5))
    }

    /// Right, up and distance of a point in the axes of the quad, over its half sides.
    fn on_quad(tree: &Caster, point_m: Vec3) -> [f32; 2] {
        let corner = |index| impostor_corner(tree, index);
        let middle = scaled(add(corner(0), corner(5)), 0.5);
        let right = scaled(add(corner(1), scaled(corner(0), -1.0)), 0.5);
        let up = scaled(add(corner(2), scaled(corner(0), -1.0)), 0.5);
        let gaze = scaled(middle, 1.0 / length(middle));
        let in_plane = scaled(point_m, dot(middle, gaze) / dot(point_m, gaze));
        let from_middle = add(in_plane, scaled(middle, -1.0));
        [dot(from_middle, right) / dot(right, right), dot(from_middle, up) / dot(up, up)]
    }

    #[test]
    fn the_quad_covers_every_vertex_of_the_crown() {
        let (mut widest, mut outside) = (0.0f32, 0);
        for seed in 0..3_000 {
            let (tree, phase) = any_tree(seed);
            let size_m = [tree.width_m, tree.height_m];
            for index in 0..TREE_VERTICES[1] {
                let at_m = vertex_of_tree(tree.species, 1, index, size_m, phase, [0.0; 2]);
                // Roots of trunks are below the ground.
                if at_m[1] >= 0.0 {
                    let [x, y] = on_quad(&tree, add(tree.root_m, at_m));
                    let out = x.abs().max(y.abs());
                    widest = widest.max(out);
                    assert!(out <= 1.001, "{seed}: {x} {y}");
                    outside += u32::from(out > 0.75);
                }
            }
        }
        assert!(widest > 0.95 && outside > 1_000, "the control, three quarters of it, does not: {widest}");
    }

    #[test]
    fn hits_lie_on_the_solid_and_inside_the_bounds_by_which_trees_are_culled() {
        let (mut hits, mut missed) = (0, 0);
        for seed in 0..20_000 {
            let (tree, _) = any_tree(seed);
            let crown = impostor_crown(&tree);
            let place = [unit(seed, 6), unit(seed, 7)].map(|share| 2.0 * share - 1.0);
            let corner = |index| impostor_corner(&tree, index);
            let middle = scaled(add(corner(0), corner(5)), 0.5);
            let right = scaled(add(corner(1), scaled(corner(0), -1.0)), 0.5 * place[0]);
            let up = scaled(add(corner(2), scaled(corner(0), -1.0)), 0.5 * place[1]);
            let aim = add(middle, add(right, up));
            let toward = scaled(aim, 1.0 / length(aim));
            let begin_m = add(scaled(toward, ray_begin_m(&tree, toward)), scaled(tree.root_m, -1.0));
            let way = crown_way(&crown, begin_m, toward);
            if way >= NO_WAY {
                missed += 1;
                continue;
            }
            hits += 1;
            let at = add(begin_m, scaled(toward, way));
            let out_m = at[0].hypot(at[2]);
            assert!(out_m <= 0.5 * tree.width_m && (0.0..=tree.height_m).contains(&at[1]), "{seed}: {at:?}");
            // On the solid: a step along the ray lies inside, a step back outside.
            let is_inside = |t: f32| {
                let at = add(begin_m, scaled(toward, way + t));
                let (out_m, y) = (at[0].hypot(at[2]), (at[1] - crown.wide_m) / crown.rise_m);
                if crown.is_cone {
                    (0.0..=1.0).contains(&y) && out_m <= crown.radius_m * (1.0 - y)
                } else {
                    (out_m / crown.radius_m).hypot(y) <= 1.0
                }
            };
            assert!(!is_inside(-0.02), "{seed}: the ray has entered before");
        }
        assert!(hits > 5_000 && missed > 1_000, "{hits} {missed}");
    }

    #[test]
    fn lobes_lie_inside_the_cut_cone_of_the_occlusion_test() {
        let (mut tightest, mut outside) = (f32::MAX, 0);
        for (species, step) in (1..3).flat_map(|species| (0..64).map(move |step| (species, step))) {
            let (width_m, height_m) = (2.0, 1.0);
            let crown = crown_of(&Caster { root_m: [0.0; 3], width_m, height_m, species });
            for lobe in (0..LOBES).map(|lobe| lobe_of(species, step as f32 / 63.0, lobe)) {
                let away = lobe.centre[0].hypot(lobe.centre[2]);
                for part in 0..=200 {
                    let rise = part as f32 / 100.0 - 1.0;
                    let up =
                        crown.wide_m + crown.rise_m * (lobe.centre[1] + lobe.radius * lobe.aspect * rise);
                    let out = crown.radius_m * (away + lobe.radius * (1.0 - rise * rise).max(0.0).sqrt());
                    let share = ((1.0 - up) * 256.0 / 84.0).clamp(0.0, 1.0);
                    let bound = |core: f32| (core + (277.0 - core) * share) / 256.0;
                    tightest = tightest.min(bound(84.0) - out);
                    outside += u32::from(out > bound(49.0));
                    assert!(up <= 1.0 && out <= bound(84.0), "{species} {step}: {out} at {up}");
                }
            }
        }
        assert!(tightest < 0.05 && outside > 0, "a narrower cone is too narrow: {tightest} {outside}");
    }

    #[test]
    fn hits_are_as_exact_far_away_as_near_by() {
        let tree =
            |away_m: f32| Caster { root_m: [0.0, 0.0, -away_m], width_m: 4.0, height_m: 10.0, species: 2 };
        let depth = |away_m: f32| {
            let tree = tree(away_m);
            let aim = [0.5, 6.0, -away_m];
            let toward = scaled(aim, 1.0 / length(aim));
            let begin_m = add(scaled(toward, ray_begin_m(&tree, toward)), scaled(tree.root_m, -1.0));
            add(begin_m, scaled(toward, crown_way(&crown_of(&tree), begin_m, toward)))[2]
        };
        assert!((depth(8_000.0) - depth(2_000.0)).abs() < 0.01);
        // The control: a ray from the eye itself is metres off.
        let far = tree(8_000.0);
        let aim: Vec3 = [0.5, 6.0, -8_000.0];
        let toward = scaled(aim, 1.0 / length(aim));
        let begin_m = scaled(far.root_m, -1.0);
        let way = crown_way(&crown_of(&far), begin_m, toward);
        let naive = add(begin_m, scaled(toward, way))[2];
        assert!((naive - depth(2_000.0)).abs() > 0.05, "{naive}");
    }
}
