//! Where woods grow: the broad part of `woods_at` in `shaders/wgsl/shared/splat.wesl`, to choose a
//! place by. Nothing that is drawn depends on it.

use glam::DVec2;
use shaders::layout::PATTERN_PERIOD_M;

/// Share of woods at a place, 0 to 1. `normal` is that of the land, `(x, y, z)`.
pub fn wood_share(at: DVec2, height_m: f64, normal: [f64; 3]) -> f64 {
    let broad = pattern_fbm(at, 512, 1);
    let medium = pattern_fbm(at, 64, 2);
    let level = 1.0 - normal[1];
    let plain = (1.0 - smoothstep(0.0015, 0.01, level)) * (1.0 - smoothstep(20.0, 45.0, height_m));
    let shelter =
        (broad - 0.5) * 0.25 - normal[2] * 0.25 - plain * 0.09 - smoothstep(120.0, 340.0, height_m) * 0.16;
    let noise = pattern_fbm(at, 256, 4) + (medium - 0.5) * 0.25 + shelter;
    let belt =
        smoothstep(5.0, 12.0, height_m) * (1.0 - smoothstep(340.0, 430.0, height_m + (broad - 0.5) * 90.0));
    smoothstep(0.47, 0.54, noise) * belt * (1.0 - smoothstep(0.16, 0.26, level + (medium - 0.5) * 0.07))
}

fn smoothstep(low: f64, high: f64, value: f64) -> f64 {
    let t = ((value - low) / (high - low)).clamp(0.0, 1.0);
    t * t * (3.0 - 2.0 * t)
}

/// `pattern_fbm` of `shaders/wgsl/shared/pattern.wesl`.
fn pattern_fbm(at: DVec2, cell_m: i32, salt: u32) -> f64 {
    let (mut p, mut sum, mut weight) = (at, 0.0, 0.5333);
    for octave in 0..4 {
        sum += weight * pattern(p, cell_m, salt + octave);
        p = DVec2::new(2.0 * p.x + p.y, 2.0 * p.y - p.x);
        weight *= 0.5;
    }
    sum
}

fn pattern(at: DVec2, cell_m: i32, salt: u32) -> f64 {
    let p = at / f64::from(cell_m);
    let low = p.floor();
    let f = p - low;
    let mask = PATTERN_PERIOD_M / cell_m - 1;
    let value = |east: i32, south: i32| {
        let wrapped = [low.x as i32 + east, low.y as i32 + south].map(|cell| (cell & mask) as u32);
        let hash = pattern_hash(wrapped[0].wrapping_add(salt.wrapping_mul(2_654_435_769)), wrapped[1]);
        f64::from(hash >> 8) / 16_777_216.0
    };
    let fade = |t: f64| t * t * t * (t * (t * 6.0 - 15.0) + 10.0);
    let (u, v) = (fade(f.x), fade(f.y));
    let along = |south: i32| value(0, south) + (value(1, south) - value(0, south)) * u;
    along(0) + (along(1) - along(0)) * v
}

fn pattern_hash(x: u32, y: u32) -> u32 {
    let state = x
        .wrapping_mul(1_664_525)
        .wrapping_add(y.wrapping_mul(22_695_477))
        .wrapping_add(1_013_904_223)
        .wrapping_mul(747_796_405)
        .wrapping_add(2_891_336_453);
    let word = ((state >> ((state >> 28) + 4)) ^ state).wrapping_mul(277_803_737);
    (word >> 22) ^ word
}
