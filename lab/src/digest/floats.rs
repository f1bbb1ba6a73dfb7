//! The control without a GPU: splines, fine octaves and coasts in f32, over the nodes, cells and
//! gradients of the integers. What `probe_heights_float` does on a GPU.

use crate::digest::cpu::coarse_octaves;
use crate::digest::probes::Probe;
use rayon::prelude::*;
use terrain::constants::{
    BEACH_M, CLIFF_FOOT_M, CLIFF_M, FINE_BITS, FINE_OCTAVES, FIRST_AMPLITUDE_BITS, FIRST_CELL_BITS,
    GRADIENTS, OCTAVE_SHIFT, UNITS_PER_METRE,
};
use terrain::hash::hash2;
use terrain::ring::{mod_floor, mod_trunc};
use terrain::spline::{self, CELL_BITS};
use terrain::{Land, Octaves, Position};

/// What a backend with float arithmetic returns. Remainders stay exact.
pub fn words(land: &Land, probes: &[Probe]) -> Vec<i32> {
    let seeds = land.parameters().fine_seeds;
    probes
        .par_iter()
        .flat_map_iter(|[x, z]| {
            let (x, z) = (*x, *z);
            let fine = fractal_sum(&seeds, x, z, FINE_OCTAVES);
            let [height, coarse] = [Octaves::ALL, coarse_octaves()].map(|octaves| {
                let height_m = Position::new(x, z).map_or(0.0, |_| height_m(land, &seeds, x, z, octaves));
                (height_m * UNITS_PER_METRE as f32).round() as i32
            });
            let fine = (fine * (1i32 << FINE_BITS) as f32).round() as i32;
            [mod_trunc(x, z), mod_floor(x, z), fine, height, coarse]
        })
        .collect()
}

/// The sum of the first fine octaves, metres.
fn fractal_sum(seeds: &[u32; FINE_OCTAVES], x: i32, z: i32, octaves: usize) -> f32 {
    let fade = |t: f32| t * t * t * (t * (t * 6.0 - 15.0) + 10.0);
    let mut sum = 0.0;
    for (octave, ((shift_x, shift_z), seed)) in OCTAVE_SHIFT.iter().zip(seeds).enumerate().take(octaves) {
        let bits = FIRST_CELL_BITS - octave as u32;
        let place = |shifted: i32| {
            let fraction = (shifted & ((1 << bits) - 1)) as f32 / (1i32 << bits) as f32;
            (shifted >> bits, fraction)
        };
        let ((cell_x, t_x), (cell_z, t_z)) =
            (place(x.wrapping_add(*shift_x)), place(z.wrapping_add(*shift_z)));
        let corner = |east: i32, south: i32| {
            let hash = hash2(*seed, cell_x.wrapping_add(east), cell_z.wrapping_add(south));
            let (along, across) = GRADIENTS[(hash >> 27) as usize];
            (f32::from(along) * (t_x - east as f32) + f32::from(across) * (t_z - south as f32)) / 32768.0
        };
        let north = corner(0, 0) + (corner(1, 0) - corner(0, 0)) * fade(t_x);
        let south = corner(0, 1) + (corner(1, 1) - corner(0, 1)) * fade(t_x);
        // The land's noise is the negative of Perlin's.
        sum -= (north + (south - north) * fade(t_z)) * (1i32 << FIRST_AMPLITUDE_BITS) as f32
            / (1i32 << octave) as f32;
    }
    sum
}

/// The height of a point inside the world, metres.
fn height_m(land: &Land, seeds: &[u32; FINE_OCTAVES], x: i32, z: i32, octaves: Octaves) -> f32 {
    let [base, roughness, exposure] = node(land, x, z, octaves);
    let raw = base + roughness * fractal_sum(seeds, x, z, octaves.fine());
    let beach_m = BEACH_M as f32;
    let r = raw / beach_m;
    let beach = if r.abs() < 1.0 { raw * (0.2 + r * r * (1.6 - 0.8 * r * r)) } else { raw };
    let rise = ((raw + CLIFF_FOOT_M as f32) / beach_m).clamp(0.0, 1.0);
    let cliff = CLIFF_M as f32 * rise * rise * (3.0 - 2.0 * rise);
    beach + (raw + cliff - beach) * exposure
}

/// Height (metres), roughness and exposure of the base field.
fn node(land: &Land, x: i32, z: i32, octaves: Octaves) -> [f32; 3] {
    // All nodes of a spline lie within two cells.
    const NEAR: i32 = 2 << CELL_BITS;
    let lobes = land.archipelago().lobes_near(x - NEAR, z - NEAR, 2 * NEAR as u32);
    let at = |place: (i32, i32)| {
        let node = land.base().at(&lobes, place, octaves.base());
        let share = |q15: i32| q15 as f32 / 32768.0;
        [node.height as f32 / (1i32 << FINE_BITS) as f32, share(node.roughness), share(node.exposure)]
    };
    if !octaves.splined() {
        return at((x, z));
    }
    let weights = |fraction: i32| {
        let t = fraction as f32 / (1i32 << CELL_BITS) as f32;
        [0.5 * (1.0 - t) * (1.0 - t), 0.5 + t * (1.0 - t), 0.5 * t * t]
    };
    let ((cell_x, t_x), (cell_z, t_z)) = (spline::cell(x), spline::cell(z));
    let mut sum = [0.0; 3];
    for (south, weight_z) in (-1..).zip(weights(t_z)) {
        for (east, weight_x) in (-1..).zip(weights(t_x)) {
            let parts = at((spline::node(cell_x + east), spline::node(cell_z + south)));
            sum.iter_mut().zip(parts).for_each(|(sum, part)| *sum += weight_x * weight_z * part);
        }
    }
    sum
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::digest::cpu::scalar;

    #[test]
    fn floats_are_near_the_definition_at_the_origin_but_not_equal() {
        let land = Land::new(3);
        let probes: Vec<Probe> = (0..400).map(|n| [n * 3701 + 11, n * 5303 + 5]).collect();
        let (exact, floats) = (scalar(&land, &probes), words(&land, &probes));
        assert_eq!(exact.len(), floats.len());
        assert_ne!(exact, floats);
        let apart = exact.iter().zip(&floats).map(|(a, b)| a.abs_diff(*b)).max();
        // 2^-16 m: a thousandth of the land.
        assert!(apart < Some(200), "{apart:?}");
    }
}
