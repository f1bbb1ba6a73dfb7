//! Where the viewer draws woods: `woods_at` and `growth_at` of `wgsl/shared/splat.wesl` in f64.
//!
//! The rule is the shaders' alone; this repeats it for the places of [`super::features`], from
//! slopes of the 16 m grid. Beaches, which end below the woods, and tracks, a few metres wide, are
//! left out.

use shaders::layout::PATTERN_PERIOD_M;

/// Share of woods at a place (metres from the origin), by height and gradient.
pub fn share([x, z]: [f64; 2], height_m: f64, gradient: [f64; 2]) -> f64 {
    // The normal's parts up and south.
    let up = 1.0 / (1.0 + gradient[0].powi(2) + gradient[1].powi(2)).sqrt();
    let (steep, southward) = (1.0 - up, -gradient[1] * up);
    let (lowest, highest, steepest) = (5.0, 475.0, 0.31);
    if height_m <= lowest || height_m >= highest || steep >= steepest {
        return 0.0;
    }
    let turned = [2.0 * x + z, 2.0 * z - x];
    let (broad, medium) = (pattern_fbm([x, z], 512.0, 1), pattern_fbm([x, z], 64.0, 2));
    let fine = pattern(turned, 4.0, 3) - 0.5;
    let clumps = pattern_fbm(turned, 32.0, 15) - 0.5;
    let slope = steep + (medium - 0.5) * 0.07 + fine * 0.02;
    let plain = (1.0 - smoothstep(0.0015, 0.01, steep)) * (1.0 - smoothstep(20.0, 45.0, height_m));
    let shelter =
        (broad - 0.5) * 0.25 - southward * 0.25 - plain * 0.09 - smoothstep(120.0, 340.0, height_m) * 0.16;
    let noise = pattern_fbm([x, z], 256.0, 4) + (medium - 0.5) * 0.25 + fine * 0.03 + clumps * 0.12 + shelter;
    let belt =
        smoothstep(5.0, 12.0, height_m) * (1.0 - smoothstep(340.0, 430.0, height_m + (broad - 0.5) * 90.0));
    let summit = smoothstep(520.0, 700.0, height_m + (medium - 0.5) * 70.0);
    let rock = smoothstep(0.165, 0.255, slope);
    let high = 0.07 * smoothstep(90.0, 300.0, height_m);
    let ragged = slope + high + (broad - 0.5) * 0.06 + fine * 0.04 + clumps * 0.05;
    let stones = smoothstep(0.125, 0.185, ragged).max(0.8 * summit);
    smoothstep(0.47, 0.54, noise)
        * belt
        * (1.0 - smoothstep(0.16, 0.26, slope))
        * (1.0 - rock)
        * (1.0 - stones)
}

fn smoothstep(low: f64, high: f64, value: f64) -> f64 {
    let t = ((value - low) / (high - low)).clamp(0.0, 1.0);
    t * t * (3.0 - 2.0 * t)
}

/// Twin of `pattern_fbm` of `wgsl/shared/pattern.wesl`.
fn pattern_fbm(mut at: [f64; 2], cell_m: f64, salt: u32) -> f64 {
    let (mut sum, mut weight) = (0.0, 0.5333);
    for octave in 0..4 {
        sum += weight * pattern(at, cell_m, salt + octave);
        at = [2.0 * at[0] + at[1], 2.0 * at[1] - at[0]];
        weight *= 0.5;
    }
    sum
}

/// Twin of `pattern`: value noise in [0, 1].
fn pattern(at: [f64; 2], cell_m: f64, salt: u32) -> f64 {
    let mask = (f64::from(PATTERN_PERIOD_M) / cell_m) as i64 - 1;
    let low = at.map(|metres| (metres / cell_m).floor());
    let [u, v] = [0, 1].map(|axis| {
        let f = at[axis] / cell_m - low[axis];
        f * f * f * (f * (f * 6.0 - 15.0) + 10.0)
    });
    let corner = |east: i64, south: i64| {
        let [x, z] = [low[0] as i64 + east, low[1] as i64 + south].map(|cell| (cell & mask) as u32);
        f64::from(pattern_hash(x.wrapping_add(salt.wrapping_mul(2_654_435_769)), z) >> 8) / 16_777_216.0
    };
    let mix = |from: f64, to: f64, share: f64| from + (to - from) * share;
    mix(mix(corner(0, 0), corner(1, 0), u), mix(corner(0, 1), corner(1, 1), u), v)
}

/// Twin of `pattern_hash`.
fn pattern_hash(x: u32, y: u32) -> u32 {
    let mixed =
        x.wrapping_mul(1_664_525).wrapping_add(y.wrapping_mul(22_695_477)).wrapping_add(1_013_904_223);
    let state = mixed.wrapping_mul(747_796_405).wrapping_add(2_891_336_453);
    let word = ((state >> ((state >> 28) + 4)) ^ state).wrapping_mul(277_803_737);
    (word >> 22) ^ word
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn woods_grow_in_patches_on_gentle_middle_ground_alone() {
        let woods = |height_m: f64, slope: f64| {
            let places = (0..10_000).map(|n| [f64::from(n % 100) * 40.0, f64::from(n / 100) * 40.0]);
            places.map(|place| share(place, height_m, [slope, 0.0])).sum::<f64>() / 10_000.0
        };
        let middle = woods(60.0, 0.1);
        assert!((0.1..0.9).contains(&middle), "{middle}");
        assert_eq!([woods(3.0, 0.1), woods(480.0, 0.0), woods(60.0, 1.2)], [0.0; 3]);
    }

    #[test]
    fn woods_prefer_shaded_sides_to_sunny_ones_slopes_to_plains_and_low_ground_to_high() {
        let woods = |height_m: f64, gradient: [f64; 2]| {
            let places = (0..10_000).map(|n| [f64::from(n % 100) * 40.0, f64::from(n / 100) * 40.0]);
            places.map(|place| share(place, height_m, gradient)).sum::<f64>() / 10_000.0
        };
        // Land that rises southward faces north.
        let (shaded, sunny) = (woods(60.0, [0.0, 0.3]), woods(60.0, [0.0, -0.3]));
        assert!(shaded > 1.5 * sunny && sunny > 0.0, "{shaded} {sunny}");
        let (plain, slope) = (woods(13.0, [0.0, 0.0]), woods(13.0, [0.2, 0.0]));
        assert!(slope > 1.3 * plain && plain > 0.05, "{slope} {plain}");
        let (low, high) = (woods(60.0, [0.2, 0.0]), woods(330.0, [0.2, 0.0]));
        assert!(low > 2.0 * high && high > 0.0, "{low} {high}");
    }

    #[test]
    fn patterns_repeat_after_their_period_and_are_smooth() {
        let period = f64::from(PATTERN_PERIOD_M);
        for n in 0..50 {
            let at = [f64::from(n) * 37.7 - 500.0, f64::from(n) * 11.3];
            let (here, there) =
                (pattern_fbm(at, 256.0, 4), pattern_fbm([at[0] + period, at[1] - period], 256.0, 4));
            assert!((here - there).abs() < 1e-9 && (0.0..=1.0).contains(&here));
            assert!((pattern_fbm([at[0] + 0.01, at[1]], 256.0, 4) - here).abs() < 1e-3);
        }
    }
}
