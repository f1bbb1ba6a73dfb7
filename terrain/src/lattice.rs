//! Gradient noise on a turned lattice, with its gradient: the octaves of the base field.
//!
//! The lattice is turned by a Pythagorean angle, so that its axes are not those of the world and the
//! turned coordinates are exact integers: `(4x - 3z, 3x + 4z)` or `(3x - 4z, 4x + 3z)`, five times
//! as long. They wrap modulo 2^32, and so do cells, so the noise is continuous everywhere.
//!
//! Unlike the octaves of [`crate::noise`] it is not separable into strips; it is evaluated at few
//! points and in 32 bits. A result is off the noise in real arithmetic by less than 2^-24.

use crate::constants::GRADIENTS;
use crate::curves::{fade, fade_slope, lerp};
use crate::hash::{hash2, stream_seed};
use crate::ring::mul_hi;

/// The two angles by which a lattice is turned.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Turn {
    /// 36.87 degrees: `(4x - 3z, 3x + 4z)`.
    Low,
    /// 53.13 degrees: `(3x - 4z, 4x + 3z)`.
    High,
}

impl Turn {
    /// Five times the gradient along the axes of the world, from the gradient along the turned ones.
    #[must_use]
    #[inline]
    pub const fn back(self, (x, z): (i32, i32)) -> (i32, i32) {
        match self {
            Self::Low => (4 * x + 3 * z, 4 * z - 3 * x),
            Self::High => (3 * x + 4 * z, 3 * z - 4 * x),
        }
    }
}

/// One octave of noise on a turned lattice.
#[derive(Clone, Copy, Debug)]
pub struct Lattice {
    /// Seed of the gradients.
    pub(crate) seed: u32,
    /// log2 of the cell in turned coordinates; a cell is `2^bits / 5` units wide.
    pub(crate) bits: u32,
    /// Angle of the lattice.
    pub(crate) turn: Turn,
    /// Added to both turned coordinates, so that no two octaves vanish at the same points.
    pub(crate) shift: u32,
}

/// The noise at a point.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Sample {
    /// Value, Q29, magnitude below 0.7072.
    pub value: i32,
    /// Gradient along the turned axes in values per cell, Q26, each below 2.1.
    pub gradient: (i32, i32),
}

impl Lattice {
    /// The octave of one stream of a world: cells of `2^bits / 5` units.
    #[must_use]
    pub const fn new(world_seed: u64, stream: u32, bits: u32) -> Self {
        let turn = if stream & 1 == 0 { Turn::Low } else { Turn::High };
        Self { seed: stream_seed(world_seed, stream), bits, turn, shift: stream.wrapping_mul(0x9e37_79b1) }
    }

    /// The turned and shifted coordinates of a point, modulo 2^32.
    #[must_use]
    #[inline]
    pub(crate) const fn turned(&self, x: i32, z: i32) -> (u32, u32) {
        let (x, z) = (x as u32, z as u32);
        let (x3, z3) = (x.wrapping_mul(3), z.wrapping_mul(3));
        let (x4, z4) = (x.wrapping_mul(4), z.wrapping_mul(4));
        let (x, z) = match self.turn {
            Turn::Low => (x4.wrapping_sub(z3), x3.wrapping_add(z4)),
            Turn::High => (x3.wrapping_sub(z4), x4.wrapping_add(z3)),
        };
        (x.wrapping_add(self.shift), z.wrapping_add(self.shift))
    }

    /// The noise at a point, units. Total over all of i32.
    #[must_use]
    pub fn at(&self, x: i32, z: i32) -> Sample {
        let (x, z) = self.turned(x, z);
        let (mask, cells) = ((1 << self.bits) - 1, u32::MAX >> self.bits);
        let (cell_x, cell_z) = (x >> self.bits, z >> self.bits);
        let (next_x, next_z) = ((cell_x + 1) & cells, (cell_z + 1) & cells);
        let (low_x, low_z) =
            (((x & mask) << (31 - self.bits)) as i32, ((z & mask) << (31 - self.bits)) as i32);
        // One less: the distance to the high side, in [-1, 0).
        let (high_x, high_z) = (low_x ^ i32::MIN, low_z ^ i32::MIN);
        let (fade_x, fade_z) = (fade(low_x), fade(low_z));
        let corner = |cell_x: u32, cell_z: u32, x: i32, z: i32| {
            let (gx, gz) = GRADIENTS[(hash2(self.seed, cell_x as i32, cell_z as i32) >> 27) as usize];
            let (gx, gz) = (i32::from(gx) << 14, i32::from(gz) << 14);
            // Q30 times Q31 is Q29 in the high half.
            (mul_hi(gx << 1, x) + mul_hi(gz << 1, z), gx, gz)
        };
        let c00 = corner(cell_x, cell_z, low_x, low_z);
        let c10 = corner(next_x, cell_z, high_x, low_z);
        let c01 = corner(cell_x, next_z, low_x, high_z);
        let c11 = corner(next_x, next_z, high_x, high_z);
        let (west, east) = (lerp(c00.0, c01.0, fade_z), lerp(c10.0, c11.0, fade_z));
        let (north, south) = (lerp(c00.0, c10.0, fade_x), lerp(c01.0, c11.0, fade_x));
        let mean = |a: i32, b: i32, c: i32, d: i32| lerp(lerp(a, b, fade_x), lerp(c, d, fade_x), fade_z);
        let gradient_x = (mean(c00.1, c10.1, c01.1, c11.1) >> 3) + mul_hi(east - west, fade_slope(low_x));
        let gradient_z = (mean(c00.2, c10.2, c01.2, c11.2) >> 3) + mul_hi(south - north, fade_slope(low_z));
        Sample { value: lerp(west, east, fade_x), gradient: (gradient_x, gradient_z) }
    }
}
