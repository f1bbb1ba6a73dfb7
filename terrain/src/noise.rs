//! The fine octaves: fixed-point gradient noise and its fractal sum.
//!
//! Perlin's gradient noise (2002 form: quintic fade) on a square lattice, in products of 16 by 16
//! bits. A lattice cell of octave `o` is `2^(15 - o)` units wide; cell and fraction are `p >> s`
//! and `p & mask`, exact for both signs.
//!
//! [`weights`](crate::weights) states the sum. It is evaluated in two steps, so that a whole row
//! of points can share the first: along z into one edge per lattice column, then along x. The sum
//! stays within 1 mm of real arithmetic (tested).

use crate::constants::{
    FINE_BITS, FINE_OCTAVES, FIRST_AMPLITUDE_BITS, FIRST_CELL_BITS, FRACTION_BITS, GRADIENTS,
};
use crate::hash::{hash2, stream_seed};
use crate::octaves::Octaves;
use crate::weights::{Weights, weights};

/// The seeds of the fine octaves of one world.
#[derive(Clone, Copy, Debug)]
pub struct Fbm {
    pub(crate) seeds: [u32; FINE_OCTAVES],
}

impl Fbm {
    /// The fractal sum of a world.
    #[must_use]
    pub fn new(world_seed: u64) -> Self {
        Self { seeds: std::array::from_fn(|octave| stream_seed(world_seed, octave as u32)) }
    }

    /// The sum at one point, 2^-16 m: the definition. Total over all of i32, wrapping at its ends,
    /// so that implementations can be compared there too; heights exist inside the world only.
    /// Whole grids ([`crate::simd`]) and GPUs must agree with it bit for bit.
    #[must_use]
    pub fn at(&self, x: i32, z: i32, octaves: Octaves) -> i32 {
        let mut sum = 0;
        for (octave, (shift_x, shift_z)) in octaves.shifts() {
            let (cell_x, fraction_x) = lattice(octave, x.wrapping_add(shift_x));
            let (cell_z, fraction_z) = lattice(octave, z.wrapping_add(shift_z));
            let seed = self.seeds[octave];
            let down = weights(fraction_z);
            let edge = |cell_x: i32| {
                Edge::new(gradient(seed, cell_x, cell_z), gradient(seed, cell_x, cell_z + 1), down)
            };
            sum += value(edge(cell_x), edge(cell_x + 1), weights(fraction_x)) >> fine_shift(octave);
        }
        sum
    }
}

/// Right shift that turns an octave's value (Q31 of its amplitude) into 2^-16 m.
pub(crate) const fn fine_shift(octave: usize) -> u32 {
    31 - FINE_BITS - FIRST_AMPLITUDE_BITS + octave as u32
}

/// Cell and fraction (Q15) of a shifted coordinate on an octave's lattice.
#[inline]
fn lattice(octave: usize, shifted: i32) -> (i32, i32) {
    let cell_bits = FIRST_CELL_BITS - octave as u32;
    let inside = shifted & ((1 << cell_bits) - 1);
    (shifted >> cell_bits, inside << (FRACTION_BITS - cell_bits))
}

/// The gradient of a lattice point, Q15.
#[inline]
fn gradient(seed: u32, cell_x: i32, cell_z: i32) -> (i32, i32) {
    let (x, z) = GRADIENTS[(hash2(seed, cell_x, cell_z) >> 27) as usize];
    (i32::from(x), i32::from(z))
}

/// One lattice column on one row of points: the noise on it as a linear function of the way east.
#[derive(Clone, Copy)]
struct Edge {
    /// Rise per cell eastward, negated, Q15.
    slope: i32,
    /// Value on the column itself, at most one half, Q16.
    value: i32,
}

impl Edge {
    /// Joins the gradients of a column above and below the row.
    #[inline]
    fn new(above: (i32, i32), below: (i32, i32), down: Weights) -> Self {
        let slope = above.0 * down.step[0] + below.0 * down.step[1];
        let value = above.1 * down.line[0] + below.1 * down.line[1];
        Self { slope: (slope + HALF_Q15) >> 15, value: (value + HALF_Q15) >> 15 }
    }
}

const HALF_Q15: i32 = 1 << 14;

/// The value of one octave between two lattice columns, Q31 of its amplitude. No sum overflows:
/// slopes and values are below 0.996 and 0.498, and all the weights of a row of products add up to
/// less than that leaves.
#[inline]
fn value(low: Edge, high: Edge, east: Weights) -> i32 {
    low.slope * east.line[0]
        + low.value * east.step[0]
        + high.slope * east.line[1]
        + high.value * east.step[1]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::hash::mix;

    /// The same formula in f64, where nothing is rounded.
    fn fbm_f64(fbm: &Fbm, x: i32, z: i32) -> f64 {
        let fade = |t: f64| t * t * t * (t * (t * 6.0 - 15.0) + 10.0);
        let mut sum = 0.0;
        for (octave, shift) in Octaves::ALL.shifts() {
            let size = f64::from(1i32 << (FIRST_CELL_BITS - octave as u32));
            let split = |v: i32, shift: i32| {
                let cells = f64::from(v + shift) / size;
                (cells - cells.floor(), cells.floor() as i32)
            };
            let (fx, cx) = split(x, shift.0);
            let (fz, cz) = split(z, shift.1);
            let corner = |dx: i32, dz: i32| {
                let (gx, gz) = gradient(fbm.seeds[octave], cx + dx, cz + dz);
                -(f64::from(gx) * (fx - f64::from(dx)) + f64::from(gz) * (fz - f64::from(dz))) / 32768.0
            };
            let near = corner(0, 0) + (corner(1, 0) - corner(0, 0)) * fade(fx);
            let far = corner(0, 1) + (corner(1, 1) - corner(0, 1)) * fade(fx);
            sum += (near + (far - near) * fade(fz)) * f64::from(1 << FIRST_AMPLITUDE_BITS)
                / f64::from(1 << octave);
        }
        sum
    }

    #[test]
    fn the_integer_sum_is_within_a_millimetre_of_the_f64_formula() {
        let fbm = Fbm::new(42);
        let worst = (0..100_000u32)
            .map(|n| {
                let (x, z) = (mix(2 * n) as i32 >> 1, mix(2 * n + 1) as i32 >> 1);
                let got = f64::from(fbm.at(x, z, Octaves::ALL)) / f64::from(1 << FINE_BITS);
                (got - fbm_f64(&fbm, x, z)).abs()
            })
            .fold(0.0, f64::max);
        assert!(worst < 0.001, "worst difference {worst} m");
        assert!(worst > 0.0001, "a difference of {worst} m would mean that the integers were not looked at");
    }

    /// The extreme of the products: all four gradients along the worst direction, at every pair of
    /// fractions.
    #[test]
    fn no_sum_of_products_can_overflow() {
        let extreme = [(32_610, 3_212), (20_788, 25_330), (3_212, 32_610)];
        for t in (0..1 << FRACTION_BITS).step_by(101).chain([(1 << FRACTION_BITS) - 1]) {
            let w = weights(t);
            for (x, z) in extreme {
                for sign in 0..16 {
                    let pick = |bit: i32| if sign >> bit & 1 == 0 { (x, z) } else { (-x, -z) };
                    // Overflow checks are on in tests: a wrap would panic.
                    let (low, high) = (Edge::new(pick(0), pick(1), w), Edge::new(pick(2), pick(3), w));
                    assert!(i16::try_from(low.slope).is_ok() && i16::try_from(low.value).is_ok());
                    for east in [w, weights((1 << FRACTION_BITS) - 1 - t), weights(1 << (FRACTION_BITS - 1))]
                    {
                        let got = f64::from(value(low, high, east)) / 2f64.powi(31);
                        assert!(got.abs() < 0.7072, "{got}");
                    }
                }
            }
        }
    }
}
