//! Crate `fastnoise-lite`: Perlin FBM, f32, one point at a time.

use super::{FIRST_CELL, GAIN, LACUNARITY, OCTAVES, fill_points};
use crate::rounds::Contender;
use fastnoise_lite::{FastNoiseLite, FractalType, NoiseType};

/// A contender that fills a grid.
pub fn contender<'a>(name: &str, columns: usize, rows: usize) -> Contender<'a> {
    let mut fbm = FastNoiseLite::with_seed(1);
    fbm.set_noise_type(Some(NoiseType::Perlin));
    fbm.set_fractal_type(Some(FractalType::FBm));
    fbm.set_fractal_octaves(Some(OCTAVES as i32));
    fbm.set_fractal_lacunarity(Some(LACUNARITY));
    fbm.set_fractal_gain(Some(GAIN));
    fbm.set_frequency(Some(1.0 / FIRST_CELL as f32));
    Contender::new(name, columns * rows, move |corner, out: &mut [f32]| {
        fill_points(corner, columns, out, |x, z| fbm.get_noise_2d(x, z));
    })
}
