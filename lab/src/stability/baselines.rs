//! Fields that the stability sweep compares: our fine octaves in fixed point and in f32, and the
//! `noise` crate (0.9) with f64 coordinates and with coordinates rounded to f32, as in a vertex
//! buffer.

use super::bounds::{NOISE_SLOPE, fine_slope};
use crate::floats::{FloatLand, TOTAL_M, metres, metres_f32, noise_crate};
use crate::reference_f64::cell_m;
use noise::{NoiseFn, Perlin};
use terrain::Octaves;
use terrain::constants::{FINE_BITS, FINE_OCTAVES};

/// A field of relief over the whole world, metres.
pub struct Baseline {
    pub name: &'static str,
    /// Upper bound of its slope along an axis in real arithmetic, metres per metre.
    pub slope: f64,
    /// Relief (metres) at a position (units).
    pub relief_m: Box<dyn Fn(i32, i32) -> f64 + Sync>,
}

/// All fields, ours first.
pub fn baselines(world_seed: u64) -> Vec<Baseline> {
    let fixed = terrain::noise::Fbm::new(world_seed);
    let float = FloatLand::new(world_seed);
    let (sum, sum_f32) = (noise_crate(world_seed as u32), noise_crate(world_seed as u32));
    let (perlin, perlin_f32) = (Perlin::new(world_seed as u32), Perlin::new(world_seed as u32));
    // Its gradients are (±1, ±1) and its octave is scaled by √2: twice a unit gradient's.
    let ours = fine_slope();
    let finest = 1.0 / cell_m(FINE_OCTAVES - 1);
    let octave = 2.0 * NOISE_SLOPE * finest;
    let unit_m = 1.0 / f64::from(1i32 << FINE_BITS);
    let rounded = |x, z| [x, z].map(|units| f64::from(metres_f32(units)));
    vec![
        baseline("ours, fixed point", ours, move |x, z| f64::from(fixed.at(x, z, Octaves::ALL)) * unit_m),
        baseline("our formula in f32", ours, move |x, z| {
            float.fractal_sum(metres_f32(x), metres_f32(z)).into()
        }),
        baseline("noise 0.9 Fbm<Perlin>, f32 coordinates", 2.0 * ours, move |x, z| {
            TOTAL_M * sum_f32.get(rounded(x, z))
        }),
        baseline("noise 0.9 Fbm<Perlin>, f64 coordinates", 2.0 * ours, move |x, z| {
            TOTAL_M * sum.get([metres(x), metres(z)])
        }),
        baseline("noise 0.9 Perlin (8 m), f32 coordinates", octave, move |x, z| {
            perlin_f32.get(rounded(x, z).map(|metres| metres * finest))
        }),
        baseline("noise 0.9 Perlin (8 m), f64 coordinates", octave, move |x, z| {
            perlin.get([metres(x) * finest, metres(z) * finest])
        }),
    ]
}

fn baseline(name: &'static str, slope: f64, relief_m: impl Fn(i32, i32) -> f64 + Sync + 'static) -> Baseline {
    Baseline { name, slope, relief_m: Box::new(relief_m) }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::floats::NOISE_CRATE_PERIOD_M;
    use crate::sample;
    use terrain::constants::UNITS_PER_METRE;

    #[test]
    fn the_noise_crate_repeats_every_256_cells_and_ours_does_not() {
        let shift = NOISE_CRATE_PERIOD_M * UNITS_PER_METRE;
        for baseline in baselines(3) {
            let repeats = sample::world_points(200, 8).all(|(x, z)| {
                let (x, z) = (x >> 6, z >> 6);
                ((baseline.relief_m)(x, z) - (baseline.relief_m)(x + shift, z)).abs() < 1e-6
            });
            let is_f64 = baseline.name.contains("f64");
            assert!(repeats == is_f64 || baseline.name.contains("f32"), "{}", baseline.name);
        }
    }
}
