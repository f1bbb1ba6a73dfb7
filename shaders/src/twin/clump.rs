//! Twin of `wgsl/shared/clump.wesl`: how a clump is packed, and the pose of its stem.

use crate::layout::{FINE_PER_METRE, Field, GRASS_TILT};

/// East, up, south.
pub type Vec3 = [f32; 3];
/// East and south.
pub type Vec2 = [f32; 2];

/// A visible clump, unpacked.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Clump {
    /// East of the low corner of the grid, above sea level, south of the corner; fine units.
    pub place: [i32; 3],
    /// Of the ground, unit.
    pub normal: Vec3,
    /// 0 to 1, as all of the next three.
    pub width: f32,
    /// See [`Self::width`].
    pub height: f32,
    /// See [`Self::width`].
    pub hue: f32,
    /// See [`Self::width`].
    pub phase: f32,
    /// 0 to 255; the smaller, the farther away the clump is drawn.
    pub rank: u32,
}

/// The sum of two vectors.
#[must_use]
pub fn add<const N: usize>(a: [f32; N], b: [f32; N]) -> [f32; N] {
    return std::array::from_fn(|axis| a[axis] + b[axis]);
}

/// A vector multiplied by a number.
#[must_use]
pub fn scaled<const N: usize>(v: [f32; N], times: f32) -> [f32; N] {
    return v.map(|part| part * times);
}

/// The scalar product.
#[must_use]
pub fn dot<const N: usize>(a: [f32; N], b: [f32; N]) -> f32 {
    return a.iter().zip(b).map(|(a, b)| a * b).sum();
}

/// The vector product.
#[must_use]
pub fn cross(a: Vec3, b: Vec3) -> Vec3 {
    return [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
}

fn clump_number(word: u32, shift: u32) -> f32 {
    return ((word >> shift) & 63) as f32 / 63.0;
}

/// The clump in four words.
#[must_use]
pub fn unpacked_clump(words: [u32; 4]) -> Clump {
    let level = [words[0], words[1]].map(|word| (((word as i32) >> 24) as f32 / 127.0).clamp(-1.0, 1.0));
    let upright = (1.0 - dot(level, level)).max(0.05).sqrt();
    let normal = [level[0], upright, level[1]];
    return Clump {
        place: [(words[0] & 0xff_ffff) as i32, words[2] as i32, (words[1] & 0xff_ffff) as i32],
        normal: scaled(normal, 1.0 / dot(normal, normal).sqrt()),
        width: clump_number(words[3], 0),
        height: clump_number(words[3], 6),
        hue: clump_number(words[3], 12),
        phase: clump_number(words[3], 18),
        rank: words[3] >> 24,
    };
}

/// Metres from the eye to the root.
#[must_use]
pub fn root_offset_m(field: &Field, clump: &Clump, eye_fraction_m: Vec3) -> Vec3 {
    let eye = [field.eye_x, field.eye_y, field.eye_z];
    let metres_per_fine = 1.0 / FINE_PER_METRE as f32;
    return std::array::from_fn(|axis| {
        let whole = clump.place[axis].wrapping_sub(eye[axis]);
        let fraction = eye_fraction_m[axis] / metres_per_fine;
        (whole as f32 - (fraction - (fraction + 0.5).floor())) * metres_per_fine
    });
}

/// Longest horizontal part of the direction of a stem.
pub const MAX_TILT: f32 = GRASS_TILT;
const MAX_FOOT_TILT: f32 = std::f32::consts::FRAC_1_SQRT_2;
const STEM_TILT: f32 = 0.45;

/// Pose of a stem.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct StemPose {
    /// Normal of its foot, unit.
    pub foot: Vec3,
    /// Horizontal part of the stem's direction at the root.
    pub root: Vec2,
    /// At the tip.
    pub tip: Vec2,
}

/// A horizontal part cut to a length.
#[must_use]
pub fn within_tilt(level: Vec2, most: f32) -> Vec2 {
    return scaled(level, f32::min(1.0, most / dot(level, level).max(1e-12).sqrt()));
}

/// The unit vector with a horizontal part.
#[must_use]
pub fn upright_direction(level: Vec2) -> Vec3 {
    return [level[0], (1.0 - dot(level, level)).max(0.0).sqrt(), level[1]];
}

/// The pose of a clump whose tip is pushed aside by `push`.
#[must_use]
pub fn stem_pose(normal: Vec3, push: Vec2) -> StemPose {
    let foot = within_tilt([normal[0], normal[2]], MAX_FOOT_TILT);
    let root = scaled(foot, STEM_TILT);
    return StemPose { foot: upright_direction(foot), root, tip: within_tilt(add(root, push), MAX_TILT) };
}

/// A vector turned as up has to be turned to become the unit vector `up`.
#[must_use]
pub fn aligned(v: Vec3, up: Vec3) -> Vec3 {
    let k = [up[2], 0.0, -up[0]];
    return add(add(scaled(v, up[1]), cross(k, v)), scaled(k, dot(k, v) / (1.0 + up[1])));
}

/// A point of the stem, of height 1: after `row` of `segments` straight pieces.
#[must_use]
pub fn stem_point(pose: &StemPose, row: u32, segments: u32) -> Vec3 {
    let mut point = [0.0; 3];
    for piece in 0..row {
        let along = (piece as f32 + 0.5) / segments as f32;
        let level = add(scaled(pose.root, 1.0 - along), scaled(pose.tip, along));
        point = add(point, upright_direction(level));
    }
    return scaled(point, 1.0 / segments as f32);
}

const WIND: Vec2 = [0.8, 0.6];
const FRONT_WAVES: Vec2 = [160.0, 120.0];
const BEND_WAVES: Vec2 = [-36.0, 48.0];
const STRENGTH_WAVES: Vec2 = [32.0, 8.0];
const FLUTTER_WAVES: Vec2 = [1480.0, 480.0];
/// Mean of [`gust_at`] over places and times.
pub const GUST_MEAN: f32 = 0.33;
const FRONT_S: f32 = 4.6;
const BEND_S: f32 = 23.0;
const STRENGTH_S: f32 = 11.0;
const FLUTTER_S: f32 = 1.15;
/// A whole turn, radians.
pub const TURN: f32 = std::f32::consts::TAU;

pub(super) fn fract(x: f32) -> f32 {
    return x - x.floor();
}

pub(super) fn smoothstep(low: f32, high: f32, x: f32) -> f32 {
    let part = ((x - low) / (high - low)).clamp(0.0, 1.0);
    return part * part * (3.0 - 2.0 * part);
}

/// Strength of the gust at a place, 0 to 1.
#[must_use]
pub fn gust_at(turns: Vec2, time_s: f32) -> f32 {
    let bend = (TURN * fract(dot(BEND_WAVES, turns) - time_s / BEND_S)).sin();
    let since = fract(time_s / FRONT_S - dot(FRONT_WAVES, turns) + 0.15 * bend);
    let front = smoothstep(0.0, 0.12, since) * (1.0 - smoothstep(0.12, 0.95, since));
    let strength = 0.7 + 0.3 * (TURN * fract(dot(STRENGTH_WAVES, turns) - time_s / STRENGTH_S)).sin();
    return front * strength;
}

/// Sideways push of the wind, a horizontal part of direction, at most 0.55.
#[must_use]
pub fn wind_push(wind: f32, turns: Vec2, time_s: f32, phase: f32) -> Vec2 {
    let gust = gust_at(turns, time_s);
    let flutter = TURN * fract(dot(FLUTTER_WAVES, turns) - time_s / FLUTTER_S + 0.35 * phase);
    let along = 0.10 + 0.36 * gust + (0.02 + 0.06 * gust) * flutter.sin();
    let across = (0.04 + 0.06 * gust) * flutter.cos();
    return scaled(add(scaled(WIND, along), scaled([-WIND[1], WIND[0]], across)), wind);
}

/// How a clump has grown on its own, a horizontal part of direction, at most 0.24.
#[must_use]
pub fn grown_push(hue: f32, phase: f32) -> Vec2 {
    let angle = 9.0 * hue + 2.0 * phase;
    return scaled([angle.cos(), angle.sin()], 0.08 + 0.16 * hue);
}

/// Push away from an eye above, a horizontal part of direction, at most 0.45.
#[must_use]
pub fn lean_push(lean: f32, root_offset_m: Vec3, distance_m: f32) -> Vec2 {
    let from_eye = scaled(root_offset_m, 1.0 / distance_m.max(1e-3));
    let above = (-from_eye[1]).clamp(0.0, 1.0);
    let share = ((distance_m - 2.0) / 6.0).clamp(0.0, 1.0);
    let near = share * share * (3.0 - 2.0 * share);
    return scaled([from_eye[0], from_eye[2]], 0.9 * lean * above * near);
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;
    use terrain::hash::mix;

    /// The `index`th of a stream of numbers from 0 to 1.
    pub fn unit(seed: u32, index: u32) -> f32 {
        (mix(mix(seed).wrapping_add(index)) >> 8) as f32 / 16_777_216.0
    }

    /// A direction with any horizontal part.
    pub fn any_level(seed: u32, index: u32, longest: f32) -> Vec2 {
        let (angle, length) = (TURN * unit(seed, index), longest * unit(seed, index + 1));
        [length * angle.cos(), length * angle.sin()]
    }

    #[test]
    fn a_clump_is_unpacked_with_the_signs_of_its_normal() {
        let words =
            [0x81_000001, 0x40_ffffff, (-5_i32) as u32, 9 | (63 << 6) | (1 << 12) | (32 << 18) | (200 << 24)];
        let clump = unpacked_clump(words);
        assert_eq!((clump.place, clump.rank), ([1, -5, 0xff_ffff], 200));
        assert_eq!(
            [clump.width, clump.height, clump.hue, clump.phase],
            [9.0 / 63.0, 1.0, 1.0 / 63.0, 32.0 / 63.0]
        );
        assert!(clump.normal[0] < 0.0 && clump.normal[1] > 0.0 && clump.normal[2] > 0.0);
        assert!((dot(clump.normal, clump.normal) - 1.0).abs() < 1e-6);
    }

    #[test]
    fn roots_are_exact_although_the_eye_is_rounded() {
        let clump = unpacked_clump([9_000_000, 5_000_000, 123_456, 0]);
        for n in 0..1000 {
            // The true eye: whole units of 16 fine ones, and a part of a unit.
            let fraction_m = [0, 1, 2].map(|axis| unit(n, axis) / 256.0);
            let units = [560_000, 7000, 312_000];
            let eye = [0, 1, 2].map(|axis| units[axis] * 16 + (fraction_m[axis] * 4096.0).round() as i32);
            let field = Field { eye_x: eye[0], eye_y: eye[1], eye_z: eye[2], ..bytemuck::Zeroable::zeroed() };
            for (axis, found) in root_offset_m(&field, &clump, fraction_m).into_iter().enumerate() {
                let exact = f64::from(clump.place[axis]) / 4096.0
                    - f64::from(units[axis]) / 256.0
                    - f64::from(fraction_m[axis]);
                // Half of a fine unit would be 1.2e-4.
                assert!((f64::from(found) - exact).abs() < 1e-5, "{found} instead of {exact}");
            }
        }
    }

    #[test]
    fn alignment_is_a_rotation_that_takes_up_to_the_normal() {
        for n in 0..20_000 {
            let up = upright_direction(any_level(n, 0, 1.0));
            let moved = aligned([0.0, 1.0, 0.0], up);
            assert!((0..3).all(|axis| (moved[axis] - up[axis]).abs() < 1e-6), "{up:?}: {moved:?}");
            let [a, b] = [2, 5].map(|first| [0, 1, 2].map(|axis| 2.0 * unit(n, first + axis) - 1.0));
            let (turned_a, turned_b) = (aligned(a, up), aligned(b, up));
            // Lengths and angles stay, and so does the hand.
            assert!((dot(turned_a, turned_b) - dot(a, b)).abs() < 2e-6, "{up:?} {a:?} {b:?}");
            assert!((dot(turned_a, turned_a) - dot(a, a)).abs() < 2e-6);
            let hand = aligned(cross(a, b), up);
            let crossed = cross(turned_a, turned_b);
            assert!((0..3).all(|axis| (hand[axis] - crossed[axis]).abs() < 3e-6));
        }
        // A plain shear, the control, is none.
        let up = upright_direction([0.5, 0.0]);
        assert!((dot(add([1.0, 0.0, 0.0], up), add([1.0, 0.0, 0.0], up)) - 1.0).abs() > 0.1);
    }

    #[test]
    fn bending_keeps_the_length_of_a_stem() {
        for n in 0..20_000 {
            let normal = upright_direction(any_level(n, 0, 1.0));
            let pose = stem_pose(normal, any_level(n, 2, 2.0));
            for segments in 1..=3 {
                let points = (0..=segments).map(|row| stem_point(&pose, row, segments));
                let points: Vec<Vec3> = points.collect();
                let length: f32 = points
                    .windows(2)
                    .map(|ends| add(ends[1], scaled(ends[0], -1.0)))
                    .map(|piece| dot(piece, piece).sqrt())
                    .sum();
                assert!((length - 1.0).abs() < 1e-6, "{length} for {pose:?}");
            }
        }
        // The control: a tip that is pushed sideways by half the height is 11.8 % too far away.
        let sheared = add([0.0, 1.0, 0.0], [0.5, 0.0, 0.0]);
        assert!((dot(sheared, sheared).sqrt() - 1.118).abs() < 1e-3);
    }

    #[test]
    fn gusts_pass_as_fronts_41_metres_apart() {
        let period_m = crate::layout::PATTERN_PERIOD_M as f32;
        let turns = |metres: f32| scaled(WIND, metres / period_m);
        // Along the wind, the steps of 0.25 m at which a gust sets in.
        let fronts_at = |time_s: f32| -> Vec<f32> {
            let strong = |step: i32| gust_at(turns(0.25 * step as f32), time_s) > 0.15;
            (0..4000)
                .filter(|step| strong(*step) && !strong(step + 1))
                .map(|step| 0.25 * step as f32)
                .collect()
        };
        let fronts = fronts_at(0.0);
        for pair in fronts.windows(2) {
            assert!((30.0..60.0).contains(&(pair[1] - pair[0])), "{pair:?}");
        }
        // A quarter of a period later each is about a quarter of the way farther downwind.
        let later = fronts_at(0.25 * FRONT_S);
        let near = |metres: f32| later.iter().any(|front| (front - metres).abs() < 3.0);
        assert!(fronts[..fronts.len() - 1].iter().all(|front| near(front + 10.24)), "{fronts:?} {later:?}");
        // The control: upwind there is none.
        assert!(!fronts[1..].iter().any(|front| near(front - 10.24)));
    }

    #[test]
    fn gusts_are_a_third_in_the_mean_and_never_jump() {
        let (mut sum, mut fastest) = (0.0, 0.0f32);
        for n in 0..50_000 {
            let (turns, time_s) = ([unit(n, 0), unit(n, 1)], 100.0 * unit(n, 2));
            let gust = gust_at(turns, time_s);
            assert!((0.0..=1.0).contains(&gust));
            sum += gust;
            fastest = fastest.max((gust_at(turns, time_s + 0.01) - gust).abs());
        }
        assert!((sum / 50_000.0 - GUST_MEAN).abs() < 0.01, "{}", sum / 50_000.0);
        // It sets in over half a second: at most 1.5 of it in 0.55 s, and not at once.
        assert!((0.01..0.04).contains(&fastest), "{fastest}");
    }

    #[test]
    fn pushes_keep_within_their_bounds_and_wind_has_no_seam() {
        let (mut strongest, mut most) = (0.0f32, 0.0f32);
        for n in 0..50_000 {
            let turns = [unit(n, 0), unit(n, 1)];
            let push = wind_push(1.0, turns, 100.0 * unit(n, 2), unit(n, 3));
            strongest = strongest.max(dot(push, push).sqrt());
            let offset = [0, 1, 2].map(|axis| 100.0 * (unit(n, 4 + axis) - 0.5));
            let lean = lean_push(1.0, offset, dot(offset, offset).sqrt());
            most = most.max(dot(lean, lean).sqrt());
        }
        assert!((0.45..=0.55).contains(&strongest) && (0.40..0.4501).contains(&most), "{strongest} {most}");
        assert_eq!(wind_push(0.0, [0.3, 0.4], 5.0, 0.5), [0.0, 0.0]);
        for (low, high) in [([0.0, 0.25], [1.0, 0.25]), ([0.125, 0.0], [0.125, 1.0])] {
            let (here, there) = (wind_push(1.0, low, 0.0, 0.0), wind_push(1.0, high, 0.0, 0.0));
            assert!((0..2).all(|axis| (here[axis] - there[axis]).abs() < 1e-5), "{here:?} {there:?}");
        }
    }
}
