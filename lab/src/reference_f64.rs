//! The height formula in f64: the reference of the integers.
//!
//! The choices (gradients, islands) are the land's own integers, through its public hash; every
//! number that follows from them is real arithmetic. An f64 keeps 52 bits of values below 512 m, so
//! its own error is below a nanometre. Positions are integers (units), and cell and fraction are
//! cut from them as integers, so the reference is as good at the border of the world as at the
//! origin.
//!
//! The formula, for octaves `o` of cell `c = 1024 m / 2^o` and amplitude `a = 128 m / 2^o`, with
//! `t` the fraction in a cell and `s = 6t⁵ - 15t⁴ + 10t³` its fade:
//!
//! ```text
//! line = [t (1 - s), (t - 1) s]      step = [s - 1, -s]  (negated, as the integers keep them)
//! noise = sum over corners (i, j) of  gx line_i(x) step_j(z) + gz step_i(x) line_j(z)
//! hills = sum of a noise;  folds = octaves 1 and 2 of it
//! w = max(0, 1 - d²/r²)²;  ease(w) = 1 - (1 - w)²
//! raw = dome w + hills ease(w) + 64 m max(0, 1 - |folds| / 64 m)² w² - 64 m
//! height = raw, or within 8 m of the sea (r = raw / 8 m):  8 m (0.2 r + 1.6 r³ - 0.8 r⁵)
//! ```

use terrain::Octaves;
use terrain::constants::{
    BEACH_M, FIRST_AMPLITUDE_BITS, FIRST_CELL_BITS, GRADIENT_BITS, GRADIENTS, OCTAVE_SHIFT, OCTAVES, RIDGE_M,
    SEA_FLOOR_M, UNITS_PER_METRE,
};
use terrain::hash::{hash2, stream_seed};
use terrain::island::{Archipelago, Island};

/// The land of a seed in f64.
#[derive(Clone, Copy, Debug)]
pub struct ReferenceF64 {
    seeds: [u32; OCTAVES],
    archipelago: Archipelago,
    /// Rounds every weight to so many fraction bits: a control that must miss the bars. None for
    /// the reference.
    weight_bits: Option<u32>,
}

/// The fractal sum at a point, metres.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct FractalSum {
    /// Sum of the octaves kept.
    pub hills_m: f64,
    /// Octaves 1 and 2 of it.
    pub folds_m: f64,
}

/// The weights of the two sides of a cell, low side first.
struct Weights {
    line: [f64; 2],
    step: [f64; 2],
}

impl ReferenceF64 {
    /// The reference about a world.
    pub fn new(world_seed: u64) -> Self {
        Self {
            seeds: std::array::from_fn(|octave| stream_seed(world_seed, octave as u32)),
            archipelago: Archipelago::new(world_seed),
            weight_bits: None,
        }
    }

    /// The same formula with every weight rounded to `bits` fraction bits: a control.
    pub fn with_coarse_weights(self, bits: u32) -> Self {
        Self { weight_bits: Some(bits), ..self }
    }

    /// The height of a point (units), metres.
    pub fn height_m(&self, x: i32, z: i32, octaves: Octaves) -> f64 {
        let Some(island) = self.archipelago.island_at(x, z) else { return -f64::from(SEA_FLOOR_M) };
        let weight = falloff(&island, x, z);
        if weight == 0.0 {
            return -f64::from(SEA_FLOOR_M);
        }
        let FractalSum { hills_m, folds_m } = self.fractal_sum(x, z, octaves);
        let dome_m = f64::from(island.dome_m) * weight;
        let crest = (1.0 - folds_m.abs() / f64::from(RIDGE_M)).max(0.0);
        let ridge_m = f64::from(RIDGE_M) * crest * crest * weight * weight;
        beach_m(dome_m + hills_m * ease_out(weight) + ridge_m - f64::from(SEA_FLOOR_M))
    }

    /// The fractal sum at a point (units).
    pub fn fractal_sum(&self, x: i32, z: i32, octaves: Octaves) -> FractalSum {
        let mut relief = FractalSum::default();
        for octave in 0..octaves.count() {
            let value_m = amplitude_m(octave) * self.noise(octave, x, z);
            relief.hills_m += value_m;
            if octave == 1 || octave == 2 {
                relief.folds_m += value_m;
            }
        }
        relief
    }

    /// One octave of amplitude 1.
    fn noise(&self, octave: usize, x: i32, z: i32) -> f64 {
        let (shift_x, shift_z) = OCTAVE_SHIFT[octave];
        let ((cell_x, tx), (cell_z, tz)) = (lattice(octave, x, shift_x), lattice(octave, z, shift_z));
        let (east, south) = (self.weights(tx), self.weights(tz));
        let mut sum = 0.0;
        for j in 0..2 {
            for i in 0..2 {
                let (gx, gz) = gradient(self.seeds[octave], cell_x + i as i32, cell_z + j as i32);
                sum += gx * east.line[i] * south.step[j] + gz * east.step[i] * south.line[j];
            }
        }
        sum
    }

    fn weights(&self, t: f64) -> Weights {
        let s = fade(t);
        let weights = Weights { line: [t * (1.0 - s), (t - 1.0) * s], step: [s - 1.0, -s] };
        let Some(bits) = self.weight_bits else { return weights };
        let scale = f64::from(1u32 << bits);
        let coarse = |value: f64| (value * scale).round() / scale;
        Weights { line: weights.line.map(coarse), step: weights.step.map(coarse) }
    }
}

/// Amplitude of an octave, metres.
pub fn amplitude_m(octave: usize) -> f64 {
    f64::from((1u32 << FIRST_AMPLITUDE_BITS) >> octave)
}

/// Lattice cell of an octave, metres.
pub fn cell_m(octave: usize) -> f64 {
    f64::from(1i32 << (FIRST_CELL_BITS - octave as u32)) / f64::from(UNITS_PER_METRE)
}

/// The quintic fade (Perlin, "Improving Noise", 2002).
pub fn fade(t: f64) -> f64 {
    t * t * t * (t * (t * 6.0 - 15.0) + 10.0)
}

/// The gradient of a lattice point: a unit vector but for the rounding of the table.
pub fn gradient(seed: u32, cell_x: i32, cell_z: i32) -> (f64, f64) {
    let (x, z) = GRADIENTS[(hash2(seed, cell_x, cell_z) >> 27) as usize];
    let scale = f64::from(1i32 << GRADIENT_BITS);
    (f64::from(x) / scale, f64::from(z) / scale)
}

/// Cell and fraction of a coordinate (units) on an octave's lattice. Both exact.
fn lattice(octave: usize, coordinate: i32, shift: i32) -> (i32, f64) {
    let bits = FIRST_CELL_BITS - octave as u32;
    let shifted = i64::from(coordinate) + i64::from(shift);
    let inside = shifted & ((1 << bits) - 1);
    ((shifted >> bits) as i32, inside as f64 / f64::from(1i32 << bits))
}

/// `(1 - d²/r²)²` inside an island, 0 from the rim on.
pub fn falloff(island: &Island, x: i32, z: i32) -> f64 {
    let metres = |v: i32, centre: i32| (f64::from(v) - f64::from(centre)) / f64::from(UNITS_PER_METRE);
    let (dx, dz) = (metres(x, island.centre.0), metres(z, island.centre.1));
    let inside = (1.0 - (dx * dx + dz * dz) / f64::from(island.radius_m).powi(2)).max(0.0);
    inside * inside
}

/// `1 - (1 - w)²`.
pub fn ease_out(weight: f64) -> f64 {
    1.0 - (1.0 - weight) * (1.0 - weight)
}

/// The beach polynomial, metres in and out.
pub fn beach_m(raw_m: f64) -> f64 {
    let r = raw_m / f64::from(BEACH_M);
    if r.abs() >= 1.0 {
        return raw_m;
    }
    f64::from(BEACH_M) * r * (0.2 + r * r * (1.6 - 0.8 * r * r))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sample;
    use terrain::constants::FINE_BITS;
    use terrain::noise::Fbm;
    use terrain::{Land, Position};

    /// Fine units (2^-16 m) to metres.
    fn fine_m(fine: i32) -> f64 {
        f64::from(fine) / f64::from(1i32 << FINE_BITS)
    }

    #[test]
    fn integers_on_vertices_are_within_1_128_m_of_the_reference() {
        let (land, reference) = (Land::new(42), ReferenceF64::new(42));
        let mut worst: f64 = 0.0;
        for (x, z) in sample::land_vertices(42, 20_000, 7) {
            let integer = f64::from(land.height_at(Position::new(x, z).unwrap())) / 256.0;
            worst = worst.max((integer - reference.height_m(x, z, Octaves::ALL)).abs());
        }
        assert!(worst < 1.0 / 128.0, "{worst} m");
        assert!(
            worst > 0.4 / 256.0,
            "{worst} m: less than the last rounding means that nothing was compared"
        );
    }

    #[test]
    fn the_fractal_sum_agrees_for_every_octave_count() {
        let (fbm, reference) = (Fbm::new(3), ReferenceF64::new(3));
        for octaves in (0..=OCTAVES).map(|count| Octaves::new(count).unwrap()) {
            for (x, z) in sample::world_points(2_000, octaves.count() as u32) {
                let (got, exact) = (fbm.at(x, z, octaves), reference.fractal_sum(x, z, octaves));
                assert!((fine_m(got.hills) - exact.hills_m).abs() < 0.003, "({x}, {z})");
                assert!((fine_m(got.folds) - exact.folds_m).abs() < 0.003, "({x}, {z})");
            }
        }
    }

    #[test]
    fn coarse_weights_and_another_seed_are_far_from_the_reference() {
        let reference = ReferenceF64::new(42);
        let apart = |other: ReferenceF64| {
            sample::land_vertices(42, 2_000, 9)
                .map(|(x, z)| {
                    (reference.height_m(x, z, Octaves::ALL) - other.height_m(x, z, Octaves::ALL)).abs()
                })
                .fold(0.0, f64::max)
        };
        assert!(apart(reference.with_coarse_weights(10)) > 1.0 / 128.0);
        assert!(apart(ReferenceF64::new(43)) > 10.0);
        assert!(apart(reference) == 0.0);
    }
}
