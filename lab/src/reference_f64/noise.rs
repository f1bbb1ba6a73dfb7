//! Gradient noise on the two kinds of lattice, in any kind of number.

use super::real::Real;
use terrain::constants::{
    BASE_CELL_BITS, BASE_OCTAVES, BASE_STREAM, EXPOSURE_CELL_BITS, EXPOSURE_STREAM, FIRST_AMPLITUDE_BITS,
    FIRST_CELL_BITS, GRADIENT_BITS, GRADIENTS, UNITS_PER_METRE, WARP_CELL_BITS, WARP_STREAM,
};
use terrain::hash::{hash2, stream_seed};

/// A coordinate on a lattice.
#[derive(Clone, Copy, Debug)]
pub struct Cut<R> {
    /// The cell.
    pub cell: i32,
    /// The way through it, in `[0, 1)`.
    pub fraction: R,
}

/// One fine octave of amplitude 1.
#[derive(Clone, Copy, Debug)]
pub struct FineOctave {
    /// Its index, 0 for the widest.
    pub index: usize,
    /// Seed of its gradients.
    pub seed: u32,
    /// Rounds every weight to so many fraction bits: a control.
    pub weight_bits: Option<u32>,
}

/// One noise on a turned lattice.
#[derive(Clone, Copy, Debug)]
pub struct Turned {
    /// Seed of its gradients.
    pub seed: u32,
    /// log2 of the cell in turned coordinates, which are five times as long as the world's.
    pub bits: u32,
    /// Whether it is turned by 53.13 degrees instead of 36.87.
    pub is_high: bool,
    /// Added to both turned coordinates, units.
    pub shift: u32,
}

/// Noise on a turned lattice at a point.
#[derive(Clone, Copy, Debug)]
pub struct Sample<R> {
    /// The value.
    pub value: R,
    /// Five times its gradient along the axes of the world, values per cell.
    pub gradient: [R; 2],
}

/// The noises of the base field of one world.
#[derive(Clone, Copy, Debug)]
pub struct TurnedNoises {
    /// Octaves, widest first.
    pub octaves: [Turned; BASE_OCTAVES],
    /// Warp along x (even) and z (odd), widest first.
    pub warp: [Turned; 4],
    /// Beaches and cliffs.
    pub exposure: Turned,
}

impl TurnedNoises {
    /// Those of a world.
    pub fn new(world_seed: u64) -> Self {
        let noise = |stream: u32, bits: u32| Turned::new(world_seed, stream, bits);
        Self {
            octaves: std::array::from_fn(|o| noise(BASE_STREAM + o as u32, BASE_CELL_BITS - o as u32)),
            warp: std::array::from_fn(|n| noise(WARP_STREAM + n as u32, WARP_CELL_BITS[n / 2])),
            exposure: noise(EXPOSURE_STREAM, EXPOSURE_CELL_BITS),
        }
    }

    /// All of them.
    pub fn iter(&self) -> impl Iterator<Item = &Turned> {
        self.octaves.iter().chain(&self.warp).chain([&self.exposure])
    }
}

impl Turned {
    fn new(world_seed: u64, stream: u32, bits: u32) -> Self {
        Self {
            seed: stream_seed(world_seed, stream),
            bits,
            is_high: stream & 1 == 1,
            shift: stream.wrapping_mul(0x9e37_79b1),
        }
    }

    /// Width of a cell, metres.
    pub fn cell_m(&self) -> f64 {
        f64::from(1u32 << self.bits) / f64::from(5 * UNITS_PER_METRE)
    }

    /// A vector along the turned axes from one along the world's, five times as long.
    pub fn turn<R: Real>(&self, [x, z]: [R; 2]) -> [R; 2] {
        let (three, four) = (R::of(3.0), R::of(4.0));
        if self.is_high {
            [three * x - four * z, four * x + three * z]
        } else {
            [four * x - three * z, three * x + four * z]
        }
    }

    /// The opposite turn, again five times as long.
    pub fn turn_back<R: Real>(&self, [x, z]: [R; 2]) -> [R; 2] {
        let (three, four) = (R::of(3.0), R::of(4.0));
        if self.is_high {
            [three * x + four * z, three * z - four * x]
        } else {
            [four * x + three * z, four * z - three * x]
        }
    }

    /// The noise at a place on the lattice.
    pub fn at<R: Real>(&self, [x, z]: [Cut<R>; 2]) -> Sample<R> {
        // Cells wrap with the turned coordinates, modulo 2^32 units.
        let cells = u32::MAX >> self.bits;
        let corner = |i: u32, j: u32| {
            let wrapped = |cell: i32, step: u32| ((cell as u32).wrapping_add(step) & cells) as i32;
            let [gx, gz] = gradient(self.seed, wrapped(x.cell, i), wrapped(z.cell, j)).map(R::of);
            let far = |step: u32| R::of(f64::from(step));
            [gx * (x.fraction - far(i)) + gz * (z.fraction - far(j)), gx, gz]
        };
        let (fade_x, fade_z) = (fade(x.fraction), fade(z.fraction));
        let [c00, c10, c01, c11] = [corner(0, 0), corner(1, 0), corner(0, 1), corner(1, 1)];
        let (west, east) = (mix(c00[0], c01[0], fade_z), mix(c10[0], c11[0], fade_z));
        let (north, south) = (mix(c00[0], c10[0], fade_x), mix(c01[0], c11[0], fade_x));
        let mean = |n: usize| mix(mix(c00[n], c10[n], fade_x), mix(c01[n], c11[n], fade_x), fade_z);
        let along_x = mean(1) + (east - west) * fade_slope(x.fraction);
        let along_z = mean(2) + (south - north) * fade_slope(z.fraction);
        Sample { value: mix(west, east, fade_x), gradient: self.turn_back([along_x, along_z]) }
    }
}

impl FineOctave {
    /// The noise at a place on the lattice, negated as the integers keep it.
    pub fn at<R: Real>(&self, [x, z]: [Cut<R>; 2]) -> R {
        let ((line_x, step_x), (line_z, step_z)) = (self.weights(x.fraction), self.weights(z.fraction));
        let mut sum = R::of(0.0);
        for j in 0..2 {
            for i in 0..2 {
                let [gx, gz] = gradient(self.seed, x.cell + i as i32, z.cell + j as i32).map(R::of);
                sum = sum + gx * line_x[i] * step_z[j] + gz * step_x[i] * line_z[j];
            }
        }
        sum
    }

    /// Lines and steps of the two sides of a cell, low side first ([`terrain::weights`]).
    fn weights<R: Real>(&self, t: R) -> ([R; 2], [R; 2]) {
        let (s, one) = (fade(t), R::of(1.0));
        let (line, step) = ([t * (one - s), (t - one) * s], [s - one, -s]);
        let Some(bits) = self.weight_bits else { return (line, step) };
        (line.map(|weight| weight.rounded(bits)), step.map(|weight| weight.rounded(bits)))
    }
}

/// Amplitude of a fine octave, metres.
pub fn amplitude_m(octave: usize) -> f64 {
    f64::from((1u32 << FIRST_AMPLITUDE_BITS) >> octave)
}

/// Lattice cell of a fine octave, metres.
pub fn cell_m(octave: usize) -> f64 {
    f64::from(1i32 << (FIRST_CELL_BITS - octave as u32)) / f64::from(UNITS_PER_METRE)
}

/// The quintic fade (Perlin, "Improving Noise", 2002).
pub fn fade<R: Real>(t: R) -> R {
    t * t * t * (t * (t * R::of(6.0) - R::of(15.0)) + R::of(10.0))
}

/// Its derivative.
pub fn fade_slope<R: Real>(t: R) -> R {
    (t * (R::of(1.0) - t)).square() * R::of(30.0)
}

/// The gradient of a lattice point: a unit vector but for the rounding of the table.
fn gradient(seed: u32, cell_x: i32, cell_z: i32) -> [f64; 2] {
    let (x, z) = GRADIENTS[(hash2(seed, cell_x, cell_z) >> 27) as usize];
    [x, z].map(|part| f64::from(part) / f64::from(1i32 << GRADIENT_BITS))
}

fn mix<R: Real>(a: R, b: R, t: R) -> R {
    a + (b - a) * t
}
