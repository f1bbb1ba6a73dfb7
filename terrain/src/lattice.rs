//! Gradient noise on a turned lattice, with its gradient: the octaves of the base field.
//!
//! The lattice is turned by a Pythagorean angle, so that its axes are not those of the world and
//! the turned coordinates are exact integers: `(4x - 3z, 3x + 4z)` or `(3x - 4z, 4x + 3z)`, five
//! times as long. They wrap modulo 2^32, and so do cells, so the noise is continuous everywhere.
//!
//! Unlike the octaves of [`crate::noise`] it is not separable into strips; it is evaluated at few
//! points and in 32 bits. A result is off the noise in real arithmetic by less than 2^-23.

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
    /// Five times the gradient along the axes of the world, from the gradient along the turned
    /// ones.
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::hash::mix;

    /// Proves `noise <= bound` for all gradients: the largest value of the middle of a part and the
    /// distance to its corners, times a bound of the slope, must not exceed it; else it is divided.
    /// False if a part of 2^-13 of a cell is not proved.
    ///
    /// Slope: a mean of unit gradients, and along each axis at most 15/8 times the sum of the
    /// largest products of two sides, `sqrt(2)` each.
    fn is_at_most(bound: f64, x: f64, z: f64, half: f64) -> bool {
        const SLOPE: f64 = 9.0;
        let fade = |t: f64| t * t * t * (t * (t * 6.0 - 15.0) + 10.0);
        let side = |t: f64| [(1.0 - fade(t), t), (fade(t), t - 1.0)];
        let mut largest = 0.0;
        for (weight_x, dx) in side(x) {
            for (weight_z, dz) in side(z) {
                let products = GRADIENTS.map(|(gx, gz)| (f64::from(gx) * dx + f64::from(gz) * dz) / 32_768.0);
                largest += weight_x * weight_z * products.into_iter().fold(f64::NEG_INFINITY, f64::max);
            }
        }
        if largest + SLOPE * half * 2f64.sqrt() <= bound {
            return true;
        }
        let half = half / 2.0;
        let signs = [(-1.0, -1.0), (1.0, -1.0), (-1.0, 1.0), (1.0, 1.0)];
        half > 2f64.powi(-15)
            && signs.iter().all(|(i, k)| is_at_most(bound, x + i * half, z + k * half, half))
    }

    #[test]
    fn noise_is_below_the_bound_that_the_range_of_heights_rests_on() {
        assert!(is_at_most(0.7056, 0.5, 0.5, 0.5));
        // The value in the middle of a cell: the control.
        assert!(!is_at_most(0.7036, 0.5, 0.5, 0.5));
    }

    /// The noise and five times its gradient along the axes of the world in f64, without the turned
    /// coordinates: the point is turned by the angle itself.
    fn sample_f64(lattice: &Lattice, x: i32, z: i32) -> (f64, f64, f64) {
        let (turned_x, turned_z) = lattice.turned(x, z);
        let size = 2f64.powi(lattice.bits as i32);
        let cells = u32::MAX >> lattice.bits;
        let part = |v: u32| ((v >> lattice.bits), f64::from(v & ((1 << lattice.bits) - 1)) / size);
        let ((cx, fx), (cz, fz)) = (part(turned_x), part(turned_z));
        let fade = |t: f64| t * t * t * (t * (t * 6.0 - 15.0) + 10.0);
        let slope = |t: f64| 30.0 * t * t * (t - 1.0) * (t - 1.0);
        let (mut value, mut gx, mut gz) = (0.0, 0.0, 0.0);
        for (i, k) in [(0u32, 0u32), (1, 0), (0, 1), (1, 1)] {
            let hash = hash2(lattice.seed, ((cx + i) & cells) as i32, ((cz + k) & cells) as i32);
            let (x, z) = GRADIENTS[(hash >> 27) as usize];
            let (x, z) = (f64::from(x) / 32_768.0, f64::from(z) / 32_768.0);
            let plane = x * (fx - f64::from(i)) + z * (fz - f64::from(k));
            let side = |t: f64, high: u32| {
                if high == 1 { (fade(t), slope(t)) } else { (1.0 - fade(t), -slope(t)) }
            };
            let ((wx, dx), (wz, dz)) = (side(fx, i), side(fz, k));
            value += plane * wx * wz;
            gx += x * wx * wz + plane * dx * wz;
            gz += z * wx * wz + plane * wx * dz;
        }
        match lattice.turn {
            Turn::Low => (value, 4.0 * gx + 3.0 * gz, 4.0 * gz - 3.0 * gx),
            Turn::High => (value, 3.0 * gx + 4.0 * gz, 3.0 * gz - 4.0 * gx),
        }
    }

    #[test]
    fn value_and_gradient_are_those_of_real_arithmetic() {
        for (stream, bits) in [(16, 21), (17, 20), (19, 18), (20, 22)] {
            let lattice = Lattice::new(42, stream, bits);
            for n in 0..50_000u32 {
                let (x, z) = (mix(2 * n) as i32 >> 1, mix(2 * n + 1) as i32 >> 1);
                let got = lattice.at(x, z);
                let (gx, gz) = lattice.turn.back(got.gradient);
                let exact = sample_f64(&lattice, x, z);
                let near = |got: i32, bits: i32, exact: f64, steps: i32| {
                    (f64::from(got) / 2f64.powi(bits) - exact).abs() < 2f64.powi(-steps)
                };
                assert!(near(got.value, 29, exact.0, 23), "value at ({x}, {z})");
                assert!(near(gx, 26, exact.1, 19) && near(gz, 26, exact.2, 19), "gradient at ({x}, {z})");
                assert!(got.value.abs() < 379_700_000, "0.7072 in Q29");
            }
        }
    }

    /// The gradient is the derivative of the value: along the axes of the world, by differences.
    #[test]
    fn the_gradient_is_the_derivative_along_the_axes_of_the_world() {
        for stream in [16, 17] {
            let lattice = Lattice::new(5, stream, 18);
            for n in 0..2_000u32 {
                let (x, z) = (mix(n) as i32 >> 4, mix(!n) as i32 >> 4);
                let value = |x: i32, z: i32| f64::from(lattice.at(x, z).value) / 2f64.powi(29);
                let (gx, gz) = lattice.turn.back(lattice.at(x, z).gradient);
                // Ten units are 50 of 2^18 turned units.
                let slope = |far: f64, near: f64| (far - near) / 20.0 * 2f64.powi(18);
                let (dx, dz) =
                    (slope(value(x + 10, z), value(x - 10, z)), slope(value(x, z + 10), value(x, z - 10)));
                for (got, expected) in [(gx, dx), (gz, dz)] {
                    assert!((f64::from(got) / 2f64.powi(26) - expected).abs() < 0.01, "at ({x}, {z})");
                }
            }
        }
    }

    #[test]
    fn noise_is_continuous_where_turned_coordinates_wrap() {
        let lattice = Lattice::new(9, 16, 21);
        let mut wraps = 0;
        for n in 0..200_000u32 {
            let z = mix(n) as i32 >> 1;
            // The x at which 4x - 3z + shift passes a multiple of 2^32.
            let x = (3u32.wrapping_mul(z as u32).wrapping_sub(lattice.shift) >> 2) as i32;
            for x in [x, x.wrapping_sub(1 << 30)] {
                let ((before, _), (after, _)) = (lattice.turned(x - 1, z), lattice.turned(x + 1, z));
                wraps += i32::from(before > after);
                let step = lattice.at(x + 1, z).value - lattice.at(x - 1, z).value;
                // Two units are 10 of 2^21, with at most 2.1 a cell.
                assert!(step.abs() < 6_000, "{step} at ({x}, {z})");
            }
        }
        assert!(wraps > 1_000, "{wraps}");
    }
}
