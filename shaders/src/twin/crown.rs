//! Twin of `wgsl/shared/crown.wesl`: what a tree takes of the sun.

use super::clump::{Vec3, add, dot, scaled};
use crate::layout::SUN_RADIUS;

/// Species: cone of boughs.
pub const SPRUCE: u32 = 0;
/// Species: flat crown on a long trunk.
pub const PINE: u32 = 1;
/// Species: ellipsoid of leaves.
pub const BROADLEAF: u32 = 2;

/// A tree that casts a shadow.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Caster {
    /// Metres from the eye.
    pub root_m: Vec3,
    /// Metres.
    pub width_m: f32,
    /// Metres.
    pub height_m: f32,
    /// [`SPRUCE`], [`PINE`] or [`BROADLEAF`].
    pub species: u32,
}

/// The solid of a crown. Heights are metres above the root.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Crown {
    /// Of the widest place: the foot of a cone, the middle of an ellipsoid.
    pub wide_m: f32,
    /// From there to the top.
    pub rise_m: f32,
    /// Of the widest place.
    pub radius_m: f32,
    /// A cone, else an ellipsoid.
    pub is_cone: bool,
    /// Light that a metre inside takes, as a share of what is left.
    pub density: f32,
}

/// The crown of a tree.
#[must_use]
pub fn crown_of(caster: &Caster) -> Crown {
    let high = caster.height_m;
    let half = 0.5 * caster.width_m;
    let crown =
        |wide_m, rise_m, radius_m, is_cone, density| Crown { wide_m, rise_m, radius_m, is_cone, density };
    if caster.species == SPRUCE {
        return crown(0.10 * high, 0.90 * high, 0.86 * half, true, 1.5);
    }
    if caster.species == PINE {
        return crown(0.66 * high, 0.33 * high, 0.90 * half, false, 1.0);
    }
    return crown(0.56 * high, 0.43 * high, 0.92 * half, false, 1.0);
}

/// Horizontal part.
fn level(v: Vec3) -> [f32; 2] {
    [v[0], v[2]]
}

/// Metres that a ray is inside a crown. `at_m` is its beginning from the root, `toward` its
/// direction, unit, not downwards.
#[must_use]
pub fn crown_chord(crown: &Crown, at_m: Vec3, toward: Vec3) -> f32 {
    if !crown.is_cone {
        let axes = [crown.radius_m, crown.rise_m, crown.radius_m];
        let from_middle = add(at_m, [0.0, -crown.wide_m, 0.0]);
        let begin: Vec3 = std::array::from_fn(|axis| from_middle[axis] / axes[axis]);
        let step: Vec3 = std::array::from_fn(|axis| toward[axis] / axes[axis]);
        let a = dot(step, step);
        let b = dot(begin, step);
        let inside = b * b - a * (dot(begin, begin) - 1.0);
        if inside <= 0.0 {
            return 0.0;
        }
        let root = inside.sqrt();
        return f32::max(0.0, (root - b) - f32::max(-root - b, 0.0)) / a;
    }
    let k = crown.radius_m / crown.rise_m;
    let y = at_m[1] - (crown.wide_m + crown.rise_m);
    let up = toward[1].max(1e-4);
    let mut near = f32::max(0.0, (-crown.rise_m - y) / up);
    let mut far = -y / up;
    let mut a = dot(level(toward), level(toward)) - k * k * up * up;
    a = if a.abs() < 1e-5 { 1e-5 } else { a };
    let b = dot(level(at_m), level(toward)) - k * k * y * up;
    let c = dot(level(at_m), level(at_m)) - k * k * y * y;
    let inside = b * b - a * c;
    if inside <= 0.0 {
        return 0.0;
    }
    let root = inside.sqrt();
    if a > 0.0 {
        near = near.max((-b - root) / a);
        far = far.min((root - b) / a);
    } else {
        far = far.min((root - b) / a);
    }
    return f32::max(0.0, far - near);
}

/// Share of the sun that a trunk takes, 0 to 1. `blur_m` is added to the penumbra.
#[must_use]
pub fn trunk_shade(caster: &Caster, at_m: Vec3, toward: Vec3, blur_m: f32) -> f32 {
    let flat = dot(level(toward), level(toward)).sqrt().max(1e-4);
    let along = scaled(level(toward), 1.0 / flat);
    let way_m = -dot(level(at_m), along);
    let beside_m = (at_m[0] * along[1] - at_m[2] * along[0]).abs();
    let half_m = trunk_radius_m(caster);
    let up_m = at_m[1] + way_m * toward[1] / flat;
    if way_m < 0.0 || up_m < -0.2 || up_m > 0.8 * caster.height_m {
        return 0.0;
    }
    let soft_m = SUN_RADIUS as f32 * way_m / flat + blur_m + 1e-3;
    return (0.5 + (half_m - beside_m) / (2.0 * soft_m)).clamp(0.0, f32::min(1.0, half_m / soft_m));
}

/// Radius of a trunk at its foot, metres.
#[must_use]
pub fn trunk_radius_m(caster: &Caster) -> f32 {
    return f32::min(0.018 * caster.height_m, 0.1 * caster.width_m);
}

/// Share of the sun that a tree leaves a point, 0 to 1. `point_m` is metres from the eye.
#[must_use]
pub fn sun_past(caster: &Caster, point_m: Vec3, sun: Vec3, blur_m: f32) -> f32 {
    let at_m = add(point_m, scaled(caster.root_m, -1.0));
    let crown = crown_of(caster);
    let passed = (-crown.density * crown_chord(&crown, at_m, sun)).exp();
    return passed * (1.0 - trunk_shade(caster, at_m, sun, blur_m));
}

/// Share of the sky that a tree leaves the ground at a point, 0 to 1: least at the trunk.
#[must_use]
pub fn sky_past(caster: &Caster, point_m: Vec3) -> f32 {
    let at_m = [point_m[0] - caster.root_m[0], point_m[2] - caster.root_m[2]];
    let square = dot(at_m, at_m);
    let radius_m = crown_of(caster).radius_m.max(0.1);
    let trunk_m = 3.0 * trunk_radius_m(caster).max(0.01);
    return (1.0 - 0.42 * (-square / (1.7 * radius_m * radius_m)).exp())
        * (1.0 - 0.35 * (-square / (trunk_m * trunk_m)).exp());
}

#[cfg(test)]
mod tests {
    use super::super::clump::tests::unit;
    use super::*;

    fn tree(species: u32) -> Caster {
        Caster { root_m: [0.0; 3], width_m: 5.0, height_m: 11.0, species }
    }

    /// Whether a point, metres from the root, is inside a crown.
    fn is_inside(crown: &Crown, [x, y, z]: Vec3) -> bool {
        let up = (y - crown.wide_m) / crown.rise_m;
        let out = x.hypot(z) / crown.radius_m;
        if crown.is_cone { (0.0..=1.0).contains(&up) && out <= 1.0 - up } else { up * up + out * out <= 1.0 }
    }

    /// The way inside by steps of 5 mm.
    fn marched(crown: &Crown, at_m: Vec3, toward: Vec3) -> f32 {
        let steps = (0..12_000).map(|step| add(at_m, scaled(toward, 0.005 * (step as f32 + 0.5))));
        0.005 * steps.filter(|point| is_inside(crown, *point)).count() as f32
    }

    #[test]
    fn chords_agree_with_a_march_through_the_solid() {
        let (mut inside, mut control) = (0, 0);
        for seed in 0..600 {
            let crown = crown_of(&tree(seed % 3));
            let (turn, lift) = (std::f32::consts::TAU * unit(seed, 0), 0.1 + 1.3 * unit(seed, 1));
            let toward = [lift.cos() * turn.cos(), lift.sin(), lift.cos() * turn.sin()];
            // Rays that pass near the crown, begun outside and inside of it.
            let through = [0, 1, 2].map(|axis| 5.0 * (unit(seed, 2 + axis) - 0.5));
            let through = add(through, [0.0, 6.0, 0.0]);
            let at_m = add(through, scaled(toward, -14.0 * unit(seed, 6)));
            let (found, expected) = (crown_chord(&crown, at_m, toward), marched(&crown, at_m, toward));
            assert!((found - expected).abs() < 0.03, "{seed}: {found} {expected}");
            inside += u32::from(expected > 0.5);
            let other = Crown { radius_m: 0.9 * crown.radius_m, ..crown };
            control += u32::from((crown_chord(&other, at_m, toward) - expected).abs() > 0.03);
        }
        assert!(inside > 150 && control > 150, "{inside} {control}");
    }

    #[test]
    fn a_tree_shades_behind_itself_and_not_before() {
        let sun = [0.8, 0.6, 0.0];
        for species in [SPRUCE, PINE, BROADLEAF] {
            let at = |x: f32| sun_past(&tree(species), [x, 0.0, 0.3], sun, 0.01);
            let behind = (0..80).map(|step| at(-0.2 * step as f32)).fold(1.0, f32::min);
            assert!(behind < 0.1, "{species}: {behind}");
            assert!(at(6.0) > 0.999, "{species}");
            assert!(
                sky_past(&tree(species), [0.0; 3]) < 0.5 && sky_past(&tree(species), [9.0, 0.0, 0.0]) > 0.95
            );
        }
    }
}
