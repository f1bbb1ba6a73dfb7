//! Twin of `wgsl/shared/blade.wesl`: the curve of a blade of grass, and which blades of a clump are
//! drawn at a distance.

use super::clump::{Vec2, Vec3, add, scaled, upright_direction};

/// Blades of a clump at the first level of detail.
pub const BLADES: u32 = 128;
/// Blades of a clump at the second level of detail, the first ones of the first level.
pub const FEW_BLADES: u32 = 32;
const ALL_BLADES_M: f32 = 5.0;

/// A quadratic Bezier curve from the origin.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BladeCurve {
    /// The point that the curve leaves the origin for, and that it comes from at the tip.
    pub control: Vec3,
    /// Its end.
    pub tip: Vec3,
}

/// The curve of a stem of length 1, whose direction has a horizontal part that grows evenly from
/// `root` to `tip`; as long as the stem within 1 %.
#[must_use]
pub fn blade_curve(root: Vec2, tip: Vec2) -> BladeCurve {
    let middle = scaled(add(root, tip), 0.5);
    let low = upright_direction(root)[1];
    let high = upright_direction(tip)[1];
    let rise = (low + 4.0 * upright_direction(middle)[1] + high) / 6.0;
    return BladeCurve {
        control: [0.5 * root[0], 0.5 * rise + 0.25 * (low - high), 0.5 * root[1]],
        tip: [middle[0], rise, middle[1]],
    };
}

/// A point of the curve; `along` is 0 at the root to 1 at the tip.
#[must_use]
pub fn blade_point(curve: &BladeCurve, along: f32) -> Vec3 {
    return add(scaled(curve.control, 2.0 * along * (1.0 - along)), scaled(curve.tip, along * along));
}

/// Its direction there, not normalised.
#[must_use]
pub fn blade_direction(curve: &BladeCurve, along: f32) -> Vec3 {
    let end = add(curve.tip, scaled(curve.control, -1.0));
    return add(scaled(curve.control, 1.0 - along), scaled(end, along));
}

/// Share of the blades of the first level of detail that are drawn at a distance, metres.
#[must_use]
pub fn blade_share(distance_m: f32) -> f32 {
    let times = ALL_BLADES_M / distance_m.max(1e-3);
    return f32::min(1.0, times * times.max(0.5)).max(0.07);
}

/// Share of its width that a blade has at a distance where `share` of `blades` are drawn, 0 to 1,
/// before it is widened by 1 / `share`.
#[must_use]
pub fn blade_presence(share: f32, blade: u32, blades: u32) -> f32 {
    let band = (0.25 * share).max(1.0 / blades as f32).min(2.0 * (1.0 - share));
    let inside = share + 0.5 * band - (blade as f32 + 0.5) / blades as f32;
    return (inside / band.max(1e-6)).clamp(0.0, 1.0);
}

#[cfg(test)]
mod tests {
    use super::super::clump::tests::any_level;
    use super::super::clump::{dot, stem_point};
    use super::*;
    use crate::twin::clump::StemPose;

    /// Length of the curve as a chain of `pieces` straight pieces.
    fn length_of(point: impl Fn(f32) -> Vec3, pieces: u32) -> f32 {
        let points: Vec<Vec3> = (0..=pieces).map(|n| point(n as f32 / pieces as f32)).collect();
        let pieces = points.windows(2).map(|ends| add(ends[1], scaled(ends[0], -1.0)));
        pieces.map(|piece| dot(piece, piece).sqrt()).sum()
    }

    #[test]
    fn bending_keeps_the_length_of_a_blade() {
        let mut shortest = 1.0f32;
        for seed in 0..20_000 {
            let (root, tip) = (any_level(seed, 0, 0.32), any_level(seed, 2, 0.75));
            let curve = blade_curve(root, tip);
            let length = length_of(|along| blade_point(&curve, along), 64);
            assert!((0.99..=1.003).contains(&length), "{length}: {root:?} {tip:?}");
            // The tip is that of the stem.
            let pose = StemPose { foot: [0.0, 1.0, 0.0], root, tip };
            let apart = add(stem_point(&pose, 64, 64), scaled(curve.tip, -1.0));
            assert!(dot(apart, apart).sqrt() < 0.003, "{apart:?}");
            // The control: a curve whose rise follows from the slopes at both ends is shorter.
            let (low, high) = (upright_direction(root)[1], upright_direction(tip)[1]);
            let plain = BladeCurve {
                control: [0.5 * root[0], 0.5 * low, 0.5 * root[1]],
                tip: [curve.tip[0], 0.5 * (low + high), curve.tip[2]],
            };
            shortest = shortest.min(length_of(|along| blade_point(&plain, along), 64));
        }
        assert!(shortest < 0.97, "{shortest}");
    }

    #[test]
    fn the_direction_of_a_curve_is_that_of_its_points() {
        for seed in 0..1000 {
            let curve = blade_curve(any_level(seed, 0, 0.32), any_level(seed, 2, 0.75));
            for along in [0.1, 0.5, 0.9] {
                let [before, after] = [-0.01, 0.01].map(|step| blade_point(&curve, along + step));
                let step = scaled(add(after, scaled(before, -1.0)), 1.0 / 0.04);
                let apart = add(step, scaled(blade_direction(&curve, along), -1.0));
                assert!(dot(apart, apart) < 1e-6, "{apart:?}");
            }
        }
    }

    #[test]
    fn the_widths_of_all_drawn_blades_are_the_same_at_every_distance() {
        let width_at = |distance_m: f32, blades: u32| {
            let share = (blade_share(distance_m) * BLADES as f32 / blades as f32).min(1.0);
            let sum: f32 = (0..blades).map(|blade| blade_presence(share, blade, blades)).sum();
            sum / share / blades as f32
        };
        for step in 0..400 {
            let distance_m = 0.5 + 0.08 * step as f32;
            for blades in [BLADES, FEW_BLADES] {
                let width = width_at(distance_m, blades);
                assert!((width - 1.0).abs() < 0.01, "{width} of {blades} at {distance_m} m");
            }
        }
        // The control: a blade that is there or not.
        let hard = (0..32).filter(|blade| blade_presence(0.31, *blade, 32) > 0.5).count() as f32;
        assert!((hard / 32.0 / 0.31 - 1.0).abs() > 0.005);
    }

    #[test]
    fn where_the_level_changes_the_same_blades_are_drawn() {
        let share = blade_share(10.0);
        assert!((share * BLADES as f32 - FEW_BLADES as f32).abs() < 1e-3, "{share}");
        let drawn = (0..BLADES).filter(|blade| blade_presence(share, *blade, BLADES) > 0.5).count();
        assert_eq!(drawn, FEW_BLADES as usize);
    }
}
