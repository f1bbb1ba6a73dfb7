//! A plain loop without a library: f32 gradient noise with a quintic fade, summed point by point.

use super::{FIRST_CELL, GAIN, LACUNARITY, fill_points};
use crate::rounds::Contender;

/// A contender that fills a grid; [`super::OCTAVES`] for an equal one.
pub fn contender<'a>(name: &str, octaves: usize, columns: usize, rows: usize) -> Contender<'a> {
    Contender::new(name, columns * rows, move |corner, out: &mut [f32]| {
        fill_points(corner, columns, out, |x, z| fbm(octaves, x, z));
    })
}

fn fbm(octaves: usize, x: f32, z: f32) -> f32 {
    let (mut frequency, mut amplitude, mut sum) = (1.0 / FIRST_CELL as f32, 1.0, 0.0);
    for octave in 0..octaves {
        sum += gradient_noise(octave as u32, x * frequency, z * frequency) * amplitude;
        frequency *= LACUNARITY;
        amplitude *= GAIN;
    }
    sum
}

fn gradient_noise(seed: u32, x: f32, z: f32) -> f32 {
    let (cell_x, cell_z) = (x.floor(), z.floor());
    let (x, z) = (x - cell_x, z - cell_z);
    let (cell_x, cell_z) = (cell_x as i32, cell_z as i32);
    let fade = |t: f32| t * t * t * (t * (t * 6.0 - 15.0) + 10.0);
    let mix = |a: f32, b: f32, t: f32| a + (b - a) * t;
    let corner =
        |east: i32, south: i32| slope(seed, cell_x + east, cell_z + south, x - east as f32, z - south as f32);
    let east = fade(x);
    mix(mix(corner(0, 0), corner(1, 0), east), mix(corner(0, 1), corner(1, 1), east), fade(z))
}

/// The linear function of one lattice point, along one of eight directions.
fn slope(seed: u32, cell_x: i32, cell_z: i32, x: f32, z: f32) -> f32 {
    const DIAGONAL: f32 = std::f32::consts::FRAC_1_SQRT_2;
    // The other four are opposite to these.
    const DIRECTIONS: [(f32, f32); 4] = [(1.0, 0.0), (DIAGONAL, DIAGONAL), (0.0, 1.0), (-DIAGONAL, DIAGONAL)];
    let mut hash = (cell_x as u32).wrapping_mul(0x9e37_79b1) ^ (cell_z as u32).wrapping_mul(0x85eb_ca77);
    hash = (hash ^ seed.wrapping_mul(0xc2b2_ae3d)).wrapping_mul(0x27d4_eb2f);
    let (along_x, along_z) = DIRECTIONS[((hash >> 29) & 3) as usize];
    let along = along_x * x + along_z * z;
    if hash >> 31 == 0 { along } else { -along }
}
