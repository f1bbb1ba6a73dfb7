//! Float noise that the integers are compared with: our formula in f32, as a shader or an engine
//! computes it (absolute f32 metres, `floor`, fractions), and the `noise` crate (0.9).

use crate::reference_f64::{amplitude_m, cell_m};
use noise::{Fbm, MultiFractal, Perlin};
use terrain::constants::{
    BEACH_M, GRADIENT_BITS, GRADIENTS, OCTAVE_SHIFT, OCTAVES, RIDGE_M, SEA_FLOOR_M, UNITS_PER_METRE,
};
use terrain::hash::{hash2, stream_seed};
use terrain::island::Archipelago;

/// Periods of the `noise` crate: its lattice hash keeps eight bits of a cell, so every field
/// repeats after 256 cells, here of 1,024 m.
pub const NOISE_CRATE_PERIOD_M: i32 = 256 * 1024;

/// Sum of all amplitudes, metres: the `noise` crate divides its sum by it.
pub const TOTAL_M: f64 = 255.0;

/// Our formula in f32 at absolute positions.
#[derive(Clone, Copy, Debug)]
pub struct FloatLand {
    seeds: [u32; OCTAVES],
    archipelago: Archipelago,
}

impl FloatLand {
    /// The float land of a seed.
    pub fn new(world_seed: u64) -> Self {
        Self {
            seeds: std::array::from_fn(|octave| stream_seed(world_seed, octave as u32)),
            archipelago: Archipelago::new(world_seed),
        }
    }

    /// Hills and folds at a place, metres.
    pub fn fractal_sum(&self, x_m: f32, z_m: f32) -> (f32, f32) {
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
        let (hills, folds) = self.fractal_sum(x_m, z_m);
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

/// Position in units to metres in f64, exact.
pub fn metres(units: i32) -> f64 {
    f64::from(units) / f64::from(UNITS_PER_METRE)
}

/// The same rounded to f32: at 2^20 m to multiples of 1/8 m, at 4 million metres of 1/4 m.
pub fn metres_f32(units: i32) -> f32 {
    metres(units) as f32
}

/// The `noise` crate's sum with our octaves, in metres. Its single octave reaches `√2` in theory
/// and is cut at 1.
pub fn noise_crate(seed: u32) -> Fbm<Perlin> {
    Fbm::<Perlin>::new(seed)
        .set_octaves(OCTAVES)
        .set_frequency(1.0 / cell_m(0))
        .set_persistence(0.5)
        .set_lacunarity(2.0)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::reference_f64::ReferenceF64;
    use crate::sample;
    use terrain::Octaves;

    #[test]
    fn the_float_land_is_near_the_reference_only_near_the_origin() {
        let (float, reference) = (FloatLand::new(1), ReferenceF64::new(1));
        let apart = |x: i32, z: i32| {
            (f64::from(float.fractal_sum(metres_f32(x), metres_f32(z)).0)
                - reference.fractal_sum(x, z, Octaves::ALL).hills_m)
                .abs()
        };
        let near = sample::world_points(2_000, 1).map(|(x, z)| apart(x >> 14, z >> 14)).fold(0.0, f64::max);
        let far = sample::world_points(2_000, 1).map(|(x, z)| apart(x, z)).fold(0.0, f64::max);
        assert!(near < 0.001 && far > 0.05, "{near} near, {far} far");
    }
}
