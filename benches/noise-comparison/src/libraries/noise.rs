//! Crate `noise`: `Fbm<Perlin>`, f64, one point at a time.

use super::{FIRST_CELL, GAIN, LACUNARITY, OCTAVES, fill_points};
use crate::rounds::Contender;
use noise::{Fbm, MultiFractal, NoiseFn, Perlin};

/// A contender that fills a grid.
pub fn contender<'a>(name: &str, columns: usize, rows: usize) -> Contender<'a> {
    let fbm = Fbm::<Perlin>::new(1)
        .set_octaves(OCTAVES)
        .set_frequency(1.0 / FIRST_CELL as f64)
        // The crate's default is 2π/3, not 2.
        .set_lacunarity(f64::from(LACUNARITY))
        .set_persistence(f64::from(GAIN));
    Contender::new(name, columns * rows, move |corner, out: &mut [f32]| {
        fill_points(corner, columns, out, |x, z| fbm.get([f64::from(x), f64::from(z)]) as f32);
    })
}
