//! Fixed-point gradient noise and its fractal sum.
//!
//! Perlin's gradient noise (2002 form: quintic fade) on a square lattice, in 32-bit integers. A lattice cell of
//! octave `o` is `2^(18 - o)` units wide; cell and fraction are `p >> s` and `p & mask`, exact for both signs.
//! The value of one octave is Q28 (about ±0.7), scaled to 2^-14 m before it is added: the only loss per octave
//! is one floor at 2^-14 m.

use crate::constants::{FIRST_AMPLITUDE_M, FIRST_CELL_BITS, FRACTION_BITS, GRADIENTS, OCTAVE_SHIFT, OCTAVES};
use crate::hash::{hash2, stream_seed};
use crate::ring::mul_hi;

/// The seeds of all octaves of one world.
#[derive(Clone, Copy, Debug)]
pub struct Fbm {
    seeds: [u32; OCTAVES],
}

/// What the fractal sum yields at a point, in units of 2^-14 m.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Relief {
    /// Sum of all octaves.
    pub hills: i32,
    /// Sum of octaves 1 and 2 alone (512 m and 256 m cells); ridges run where it changes sign.
    pub folds: i32,
}

impl Fbm {
    /// The fractal sum of a world.
    #[must_use]
    pub fn new(world_seed: u64) -> Self {
        Self { seeds: std::array::from_fn(|octave| stream_seed(world_seed, octave as u32)) }
    }

    /// The sum at one point. The slow, obvious form; [`Fbm::row`] must agree with it bit for bit.
    #[must_use]
    pub fn at(&self, x: i32, z: i32) -> Relief {
        let mut relief = Relief::default();
        for (octave, (shift_x, shift_z)) in OCTAVE_SHIFT.into_iter().enumerate() {
            let (x, cell_x) = lattice(octave, x, shift_x);
            let (z, cell_z) = lattice(octave, z, shift_z);
            let corners = Corners::of_cell(self.seeds[octave], cell_x, cell_z);
            relief.add(octave, corners.value(x, fade(x), z, fade(z)));
        }
        relief
    }

    /// The sum at the points `(x0 + i * spacing, z)` for every `i` of `out`.
    ///
    /// Hashes each lattice cell once instead of once per point.
    pub fn row(&self, x0: i32, z: i32, spacing: i32, out: &mut [Relief]) {
        out.fill(Relief::default());
        for (octave, (shift_x, shift_z)) in OCTAVE_SHIFT.into_iter().enumerate() {
            let (fraction_z, cell_z) = lattice(octave, z, shift_z);
            let fade_z = fade(fraction_z);
            let mut cell = None;
            let mut x = x0;
            for relief in &mut *out {
                let (fraction_x, cell_x) = lattice(octave, x, shift_x);
                let corners = match cell {
                    Some((cached, corners)) if cached == cell_x => corners,
                    _ => Corners::of_cell(self.seeds[octave], cell_x, cell_z),
                };
                cell = Some((cell_x, corners));
                relief.add(octave, corners.value(fraction_x, fade(fraction_x), fraction_z, fade_z));
                // The step after the last point may leave the world; its value is never used.
                x = x.wrapping_add(spacing);
            }
        }
    }
}

impl Relief {
    #[inline]
    fn add(&mut self, octave: usize, value_q28: i32) {
        let scaled = mul_hi(value_q28, (FIRST_AMPLITUDE_M >> octave) << 18);
        self.hills += scaled;
        if octave == 1 || octave == 2 {
            self.folds += scaled;
        }
    }
}

/// Fraction (Q18) and cell of a coordinate on an octave's lattice.
#[inline]
fn lattice(octave: usize, coordinate: i32, shift: i32) -> (i32, i32) {
    let cell_bits = FIRST_CELL_BITS - octave as u32;
    let shifted = coordinate + shift;
    let fraction = shifted & ((1 << cell_bits) - 1);
    (fraction << (FRACTION_BITS - cell_bits), shifted >> cell_bits)
}

/// The quintic fade 6t^5 - 15t^4 + 10t^3 of a Q18 fraction, in Q31. Every step rounds down, so the result stays
/// below 2^31 (tested over all 2^18 fractions).
#[inline]
#[must_use]
pub fn fade(fraction: i32) -> i32 {
    let t = fraction << 13;
    let t2 = mul_hi(t, t) << 1;
    let t3 = mul_hi(t2, t) << 1;
    let inner_q27 = (10 << 27) - 15 * (t >> 4) + 6 * (t2 >> 4);
    mul_hi(t3, inner_q27) << 5
}

/// Linear interpolation of Q28 values by a Q31 weight.
#[inline]
fn lerp(a: i32, b: i32, weight_q31: i32) -> i32 {
    a + mul_hi((b - a) << 1, weight_q31)
}

/// The gradients at the four corners of a lattice cell.
#[derive(Clone, Copy)]
struct Corners([(i32, i32); 4]);

impl Corners {
    fn of_cell(seed: u32, cell_x: i32, cell_z: i32) -> Self {
        let gradient = |x, z| GRADIENTS[(hash2(seed, x, z) >> 27) as usize];
        Self([
            gradient(cell_x, cell_z),
            gradient(cell_x + 1, cell_z),
            gradient(cell_x, cell_z + 1),
            gradient(cell_x + 1, cell_z + 1),
        ])
    }

    /// The noise at a fraction (Q18) with its fades (Q31), Q28.
    #[inline]
    fn value(&self, x: i32, fade_x: i32, z: i32, fade_z: i32) -> i32 {
        const ONE: i32 = 1 << FRACTION_BITS;
        let dot = |(gradient_x, gradient_z): (i32, i32), x: i32, z: i32| gradient_x * x + gradient_z * z;
        let [g00, g10, g01, g11] = self.0;
        let near = lerp(dot(g00, x, z), dot(g10, x - ONE, z), fade_x);
        let far = lerp(dot(g01, x, z - ONE), dot(g11, x - ONE, z - ONE), fade_x);
        lerp(near, far, fade_z)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::constants::{FINE_BITS, WORLD_HALF};
    use crate::hash::mix;
    use proptest::prelude::*;

    #[test]
    fn fade_is_the_quintic_over_every_fraction_and_never_reaches_one() {
        let mut previous = -1;
        for fraction in 0..1 << FRACTION_BITS {
            let t = f64::from(fraction) / f64::from(1 << FRACTION_BITS);
            let exact = t * t * t * (t * (t * 6.0 - 15.0) + 10.0);
            let got = fade(fraction);
            assert!(got >= 0, "fade({fraction}) wrapped");
            assert!((f64::from(got) / 2f64.powi(31) - exact).abs() < 2f64.powi(-24), "fade({fraction})");
            assert!(got >= previous - 128, "fade({fraction}) falls by more than its rounding");
            previous = got;
        }
        assert_eq!(fade(0), 0);
    }

    /// The same formula in f64, where nothing is rounded.
    fn fbm_f64(fbm: &Fbm, x: i32, z: i32) -> f64 {
        let fade = |t: f64| t * t * t * (t * (t * 6.0 - 15.0) + 10.0);
        let mut sum = 0.0;
        for octave in 0..OCTAVES {
            let size = f64::from(1i32 << (FIRST_CELL_BITS - octave as u32));
            let split = |v: i32, shift: i32| {
                let cells = f64::from(v + shift) / size;
                (cells - cells.floor(), cells.floor() as i32)
            };
            let (fx, cx) = split(x, OCTAVE_SHIFT[octave].0);
            let (fz, cz) = split(z, OCTAVE_SHIFT[octave].1);
            let corner = |dx: i32, dz: i32| {
                let (gx, gz) = GRADIENTS[(hash2(fbm.seeds[octave], cx + dx, cz + dz) >> 27) as usize];
                (f64::from(gx) * (fx - f64::from(dx)) + f64::from(gz) * (fz - f64::from(dz))) / 1024.0
            };
            let near = corner(0, 0) + (corner(1, 0) - corner(0, 0)) * fade(fx);
            let far = corner(0, 1) + (corner(1, 1) - corner(0, 1)) * fade(fx);
            sum += (near + (far - near) * fade(fz)) * f64::from(FIRST_AMPLITUDE_M >> octave);
        }
        sum
    }

    #[test]
    fn the_integer_sum_is_within_a_millimetre_of_the_f64_formula() {
        let fbm = Fbm::new(42);
        let worst = (0..20_000u32)
            .map(|n| {
                let (x, z) = (mix(2 * n) as i32 >> 1, mix(2 * n + 1) as i32 >> 1);
                let got = f64::from(fbm.at(x, z).hills) / f64::from(1 << FINE_BITS);
                (got - fbm_f64(&fbm, x, z)).abs()
            })
            .fold(0.0, f64::max);
        assert!(worst < 0.001, "worst difference {worst} m");
    }

    #[test]
    fn no_plane_of_octave_extremes_can_overflow() {
        // Each octave is bounded by its amplitude (|n| < 1 in Q28), so the sum stays below 256 m.
        let fbm = Fbm::new(u64::MAX);
        for n in 0..50_000u32 {
            let relief = fbm.at(mix(n) as i32 >> 1, mix(!n) as i32 >> 1);
            assert!(relief.hills.abs() < 256 << FINE_BITS && relief.folds.abs() < 96 << FINE_BITS);
        }
    }

    proptest! {
        #[test]
        fn rows_equal_points(seed: u64, x in -WORLD_HALF..WORLD_HALF - (64 << 13), z in -WORLD_HALF..=WORLD_HALF,
                             level in 0u32..5) {
            let fbm = Fbm::new(seed);
            let mut row = [Relief::default(); 65];
            let spacing = 512 << level;
            fbm.row(x, z, spacing, &mut row);
            for (i, relief) in row.iter().enumerate() {
                prop_assert_eq!(*relief, fbm.at(x + i as i32 * spacing, z));
            }
        }
    }
}
