//! Float noise that the integers are compared with: our formula in f32, as a shader or an engine
//! computes it (absolute f32 metres, `floor`, fractions), and the `noise` crate (0.9).

use crate::reference_f64::cell_m;
use crate::reference_f64::formula::{Place, World};
use crate::reference_f64::noise::{Cut, FineOctave, Sample, Turned};
use noise::{Fbm, MultiFractal, Perlin};
use terrain::Octaves;
use terrain::constants::{FINE_OCTAVES, OCTAVE_SHIFT, UNITS_PER_METRE};
use terrain::spline::CELL_BITS;

/// Periods of the `noise` crate: its lattice hash keeps eight bits of a cell, so every field
/// repeats after 256 cells, here of 128 m.
pub const NOISE_CRATE_PERIOD_M: i32 = 256 * 128;

/// Sum of the amplitudes of the fine octaves, metres: the `noise` crate divides its sum by it.
pub const TOTAL_M: f64 = 31.0;

/// Our formula in f32 at absolute positions.
#[derive(Clone, Copy, Debug)]
pub struct FloatLand {
    world: World,
}

/// A position in f32 metres.
#[derive(Clone, Copy, Debug)]
struct Metres {
    x: f32,
    z: f32,
}

impl FloatLand {
    /// The float land of a seed.
    pub fn new(world_seed: u64) -> Self {
        Self { world: World::new(world_seed) }
    }

    /// Sum of the fine octaves at a place, metres.
    pub fn fractal_sum(&self, x_m: f32, z_m: f32) -> f32 {
        self.world.fine_sum(Metres { x: x_m, z: z_m }, Octaves::ALL)
    }

    /// The height at a place, metres. The islands' integers are granted; only the arithmetic is
    /// float.
    pub fn height_m(&self, x_m: f32, z_m: f32) -> f32 {
        let units = |metres: f32| (metres * UNITS_PER_METRE as f32) as i32;
        let lobes = self.world.lobes(units(x_m), units(z_m));
        self.world.height(Metres { x: x_m, z: z_m }, &lobes, Octaves::ALL)
    }
}

impl Metres {
    fn cut(metres: f32, cell_m: f32) -> Cut<f32> {
        let cells = metres / cell_m;
        // Fits: turned coordinates are below 2^26 m, their cells at least 819 m of them.
        Cut { cell: cells.floor() as i32, fraction: cells - cells.floor() }
    }
}

/// Width of a cell of the base lattice, metres.
const BASE_CELL_M: f32 = ((1 << CELL_BITS) / UNITS_PER_METRE) as f32;

impl Place for Metres {
    type Real = f32;

    fn fine(self, octave: &FineOctave) -> f32 {
        let (shift_x, shift_z) = OCTAVE_SHIFT[octave.index];
        let cut = |v: f32, shift: i32| Self::cut(v + metres_f32(shift), cell_m(octave.index) as f32);
        octave.at([cut(self.x, shift_x), cut(self.z, shift_z)])
    }

    fn turned(self, noise: &Turned) -> Sample<f32> {
        let shift = noise.shift as f32 / UNITS_PER_METRE as f32;
        let cell = (1u32 << noise.bits) as f32 / UNITS_PER_METRE as f32;
        noise.at(noise.turn([self.x, self.z]).map(|v| Self::cut(v + shift, cell)))
    }

    fn beyond(self, centre: (i32, i32)) -> [f32; 2] {
        [self.x - metres_f32(centre.0), self.z - metres_f32(centre.1)]
    }

    fn base(self) -> [Cut<f32>; 2] {
        [self.x, self.z].map(|v| Self::cut(v, BASE_CELL_M))
    }

    fn node(self, [x, z]: [i32; 2]) -> Self {
        let middle = |cell: i32| (cell as f32 + 0.5) * BASE_CELL_M;
        Self { x: middle(x), z: middle(z) }
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

/// The `noise` crate's sum with our fine octaves, in metres once multiplied by [`TOTAL_M`]. Its
/// single octave reaches `√2` in theory and is cut at 1.
pub fn noise_crate(seed: u32) -> Fbm<Perlin> {
    Fbm::<Perlin>::new(seed)
        .set_octaves(FINE_OCTAVES)
        .set_frequency(1.0 / cell_m(0))
        .set_persistence(0.5)
        .set_lacunarity(2.0)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::reference_f64::{Exact, ReferenceF64};
    use crate::sample;

    #[test]
    fn the_total_is_the_sum_of_the_amplitudes() {
        let amplitudes = (0..FINE_OCTAVES).map(crate::reference_f64::amplitude_m);
        assert_eq!(amplitudes.sum::<f64>(), TOTAL_M);
    }

    #[test]
    fn the_float_land_is_near_the_reference_only_near_the_origin() {
        let (float, reference) = (FloatLand::new(1), ReferenceF64::new(1));
        let apart = |x: i32, z: i32| {
            let float = f64::from(float.fractal_sum(metres_f32(x), metres_f32(z)));
            (float - reference.world().fine_sum(Exact { x, z }, Octaves::ALL)).abs()
        };
        let near = sample::world_points(2_000, 1).map(|(x, z)| apart(x >> 14, z >> 14)).fold(0.0, f64::max);
        let far = sample::world_points(2_000, 1).map(|(x, z)| apart(x, z)).fold(0.0, f64::max);
        assert!(near < 0.001 && far > 0.02, "{near} near, {far} far");
    }

    #[test]
    fn float_heights_are_those_of_the_formula_near_the_origin() {
        let (float, reference) = (FloatLand::new(1), ReferenceF64::new(1));
        let worst = sample::world_points(2_000, 2)
            .map(|(x, z)| (x >> 12, z >> 12))
            .map(|(x, z)| {
                let got = f64::from(float.height_m(metres_f32(x), metres_f32(z)));
                (got - reference.height_m(x, z, Octaves::ALL)).abs()
            })
            .fold(0.0, f64::max);
        assert!(worst > 0.0 && worst < 0.5, "{worst} m");
    }
}
