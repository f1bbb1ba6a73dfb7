//! Float noise: the rivals that the integers are compared with.
//!
//! Two kinds. [`FloatLand`] is our own formula said in f32, as a shader or an engine would say it:
//! absolute f32 metres, `floor`, fractions. [`Rival`] is a named field in metres with its own slope
//! bound: ours in fixed point, ours in f32, and the `noise` crate (0.9) fed with f64 coordinates
//! and with coordinates that went through f32, as those of a vertex buffer have.

use crate::stability::bounds::NOISE_SLOPE;
use crate::truth::{amplitude_m, cell_m};
use noise::{Fbm, MultiFractal, NoiseFn, Perlin};
use terrain::Octaves;
use terrain::constants::{
    BEACH_M, FINE_BITS, GRADIENT_BITS, GRADIENTS, OCTAVE_SHIFT, OCTAVES, RIDGE_M, SEA_FLOOR_M,
    UNITS_PER_METRE,
};
use terrain::hash::{hash2, stream_seed};
use terrain::island::Archipelago;

/// Periods of the `noise` crate: its lattice hash keeps eight bits of a cell, so every field
/// repeats after 256 cells, here of 1,024 m.
pub const RIVAL_PERIOD_M: i32 = 256 * 1024;

/// Sum of all amplitudes, metres: what the `noise` crate divides its sum by.
const TOTAL_M: f64 = 255.0;

/// Our formula in f32 at absolute positions.
#[derive(Clone, Copy, Debug)]
pub struct FloatLand {
    seeds: [u32; OCTAVES],
    archipelago: Archipelago,
}

impl FloatLand {
    /// The float land of a seed.
    #[must_use]
    pub fn new(world_seed: u64) -> Self {
        Self {
            seeds: std::array::from_fn(|octave| stream_seed(world_seed, octave as u32)),
            archipelago: Archipelago::new(world_seed),
        }
    }

    /// Hills and folds at a place, metres.
    #[must_use]
    pub fn relief(&self, x_m: f32, z_m: f32) -> (f32, f32) {
        let (mut hills, mut folds) = (0.0, 0.0);
        for octave in 0..OCTAVES {
            let value = amplitude_m(octave) as f32 * self.noise(octave, x_m, z_m);
            hills += value;
            if octave == 1 || octave == 2 {
                folds += value;
            }
        }
        (hills, folds)
    }

    /// The height at a place, metres. The island's integers are granted; only the arithmetic is
    /// float.
    #[must_use]
    pub fn height_m(&self, x_m: f32, z_m: f32) -> f32 {
        let units = |metres: f32| (metres * UNITS_PER_METRE as f32) as i32;
        let Some(island) = self.archipelago.island_at(units(x_m), units(z_m)) else {
            return -SEA_FLOOR_M as f32;
        };
        let metres = |units: i32| units as f32 / UNITS_PER_METRE as f32;
        let (dx, dz) = (x_m - metres(island.centre.0), z_m - metres(island.centre.1));
        let inside = (1.0 - (dx * dx + dz * dz) / (island.radius_m as f32).powi(2)).max(0.0);
        let weight = inside * inside;
        if weight == 0.0 {
            return -SEA_FLOOR_M as f32;
        }
        let (hills, folds) = self.relief(x_m, z_m);
        let crest = (1.0 - folds.abs() / RIDGE_M as f32).max(0.0);
        let ridge = RIDGE_M as f32 * crest * crest * weight * weight;
        let ease = 1.0 - (1.0 - weight) * (1.0 - weight);
        let raw = island.dome_m as f32 * weight + hills * ease + ridge - SEA_FLOOR_M as f32;
        let r = raw / BEACH_M as f32;
        if r.abs() >= 1.0 { raw } else { BEACH_M as f32 * r * (0.2 + r * r * (1.6 - 0.8 * r * r)) }
    }

    fn noise(&self, octave: usize, x_m: f32, z_m: f32) -> f32 {
        let cell = cell_m(octave) as f32;
        let shift = |units: i32| units as f32 / UNITS_PER_METRE as f32;
        let (shift_x, shift_z) = OCTAVE_SHIFT[octave];
        let (x, z) = ((x_m + shift(shift_x)) / cell, (z_m + shift(shift_z)) / cell);
        let (low_x, low_z) = (x.floor(), z.floor());
        let (tx, tz) = (x - low_x, z - low_z);
        let corner = |i: i32, j: i32| {
            let hash = hash2(self.seeds[octave], low_x as i32 + i, low_z as i32 + j);
            let (gx, gz) = GRADIENTS[(hash >> 27) as usize];
            let scale = -1.0 / (1u32 << GRADIENT_BITS) as f32;
            scale * (f32::from(gx) * (tx - i as f32) + f32::from(gz) * (tz - j as f32))
        };
        let fade = |t: f32| t * t * t * (t * (t * 6.0 - 15.0) + 10.0);
        let mix = |a: f32, b: f32, s: f32| a + (b - a) * s;
        let (sx, sz) = (fade(tx), fade(tz));
        mix(mix(corner(0, 0), corner(1, 0), sx), mix(corner(0, 1), corner(1, 1), sx), sz)
    }
}

/// A field of relief over the whole world, metres.
pub struct Rival {
    /// What it is.
    pub name: &'static str,
    /// Upper bound of its slope along an axis in real arithmetic, metres per metre.
    pub slope: f64,
    /// Relief (metres) at a position (units).
    pub relief_m: Box<dyn Fn(i32, i32) -> f64 + Sync>,
}

/// Position in units to metres in f64, exact.
#[must_use]
pub fn metres(units: i32) -> f64 {
    f64::from(units) / f64::from(UNITS_PER_METRE)
}

/// The same rounded to f32: at 2^20 m to multiples of 1/8 m, at 4 million metres of 1/4 m.
#[must_use]
pub fn metres_f32(units: i32) -> f32 {
    metres(units) as f32
}

/// The `noise` crate's sum with our octaves, in metres. Its single octave reaches `√2` in theory
/// and is cut at 1.
#[must_use]
pub fn noise_crate(seed: u32) -> Fbm<Perlin> {
    Fbm::<Perlin>::new(seed)
        .set_octaves(OCTAVES)
        .set_frequency(1.0 / cell_m(0))
        .set_persistence(0.5)
        .set_lacunarity(2.0)
}

/// All rivals, ours first.
#[must_use]
pub fn rivals(world_seed: u64) -> Vec<Rival> {
    let fixed = terrain::noise::Fbm::new(world_seed);
    let float = FloatLand::new(world_seed);
    let (sum, sum_f32) = (noise_crate(world_seed as u32), noise_crate(world_seed as u32));
    let (perlin, perlin_f32) = (Perlin::new(world_seed as u32), Perlin::new(world_seed as u32));
    // Its gradients are (±1, ±1) and its octave is scaled by √2: twice a unit gradient's.
    let ours = NOISE_SLOPE * (0..OCTAVES).map(|octave| amplitude_m(octave) / cell_m(octave)).sum::<f64>();
    let finest = 1.0 / cell_m(OCTAVES - 1);
    vec![
        Rival {
            name: "ours, fixed point",
            slope: ours,
            relief_m: Box::new(move |x, z| {
                f64::from(fixed.at(x, z, Octaves::ALL).hills) / f64::from(1i32 << FINE_BITS)
            }),
        },
        Rival {
            name: "our formula in f32",
            slope: ours,
            relief_m: Box::new(move |x, z| f64::from(float.relief(metres_f32(x), metres_f32(z)).0)),
        },
        Rival {
            name: "noise 0.9 Fbm<Perlin>, f32 coordinates",
            slope: 2.0 * ours,
            relief_m: Box::new(move |x, z| {
                TOTAL_M * sum_f32.get([f64::from(metres_f32(x)), f64::from(metres_f32(z))])
            }),
        },
        Rival {
            name: "noise 0.9 Fbm<Perlin>, f64 coordinates",
            slope: 2.0 * ours,
            relief_m: Box::new(move |x, z| TOTAL_M * sum.get([metres(x), metres(z)])),
        },
        Rival {
            name: "noise 0.9 Perlin (8 m), f32 coordinates",
            slope: 2.0 * NOISE_SLOPE * finest,
            relief_m: Box::new(move |x, z| {
                perlin_f32.get([f64::from(metres_f32(x)) * finest, f64::from(metres_f32(z)) * finest])
            }),
        },
        Rival {
            name: "noise 0.9 Perlin (8 m), f64 coordinates",
            slope: 2.0 * NOISE_SLOPE * finest,
            relief_m: Box::new(move |x, z| perlin.get([metres(x) * finest, metres(z) * finest])),
        },
    ]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sample;
    use crate::truth::Truth;

    #[test]
    fn the_float_land_is_our_formula_near_the_origin_and_is_not_far_out() {
        let (float, truth) = (FloatLand::new(1), Truth::new(1));
        let apart = |x: i32, z: i32| {
            (f64::from(float.relief(metres_f32(x), metres_f32(z)).0)
                - truth.relief(x, z, Octaves::ALL).hills_m)
                .abs()
        };
        let near = sample::world_points(2_000, 1).map(|(x, z)| apart(x >> 14, z >> 14)).fold(0.0, f64::max);
        let far = sample::world_points(2_000, 1).map(|(x, z)| apart(x, z)).fold(0.0, f64::max);
        assert!(near < 0.001 && far > 0.05, "{near} near, {far} far");
    }

    #[test]
    fn the_noise_crate_repeats_every_256_cells_and_ours_does_not() {
        let shift = RIVAL_PERIOD_M * UNITS_PER_METRE;
        for rival in rivals(3) {
            let repeats = sample::world_points(200, 8).all(|(x, z)| {
                let (x, z) = (x >> 6, z >> 6);
                ((rival.relief_m)(x, z) - (rival.relief_m)(x + shift, z)).abs() < 1e-6
            });
            let is_f64 = rival.name.contains("f64");
            assert!(repeats == is_f64 || rival.name.contains("f32"), "{}", rival.name);
        }
    }
}
