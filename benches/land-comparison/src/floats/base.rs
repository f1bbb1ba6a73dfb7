//! The base field of docs/heightfield.md, sections 6 and 7, in floats: metres and shares of one.

use super::hash::Hash;
use super::lanes::{F8, I8};
use super::noise::Turned;
use terrain::constants::{BASE_CELL_BITS, BASE_STREAM, EXPOSURE_STREAM, UNITS_PER_METRE, WARP_STREAM};
use terrain::island::Lobe;

/// Depth of the sea floor.
const FLOOR_M: f32 = 64.0;

/// The noises of one world.
#[derive(Clone, Copy)]
pub struct Base {
    octaves: [Turned; 4],
    warp: [Turned; 4],
    exposure: Turned,
}

/// The field at some points.
#[derive(Clone, Copy)]
pub struct Node {
    /// Height, m.
    pub height: F8,
    /// Share of the fine octaves.
    pub roughness: F8,
    /// Beach (0) or cliff (1).
    pub exposure: F8,
}

/// A lobe of an island.
#[derive(Clone, Copy)]
pub struct FloatLobe {
    /// Units.
    centre: (i32, i32),
    /// 1/m.
    long: (f32, f32),
    short: (f32, f32),
    /// Factors of the falloff and of its square.
    mass: (f32, f32),
    height: f32,
    plateau: f32,
    crater: bool,
}

impl FloatLobe {
    /// The same lobe in floats.
    pub fn new(lobe: &Lobe) -> Self {
        // Q38 of 1/m.
        let axis = |(x, z): (i32, i32)| (x as f32 / 2f32.powi(38), z as f32 / 2f32.powi(38));
        Self {
            centre: lobe.centre,
            long: axis(lobe.long),
            short: axis(lobe.short),
            mass: (lobe.mass.0 as f32 / 8.0, lobe.mass.1 as f32 / 8.0),
            height: lobe.height as f32 / 256.0,
            plateau: (1 << lobe.plateau) as f32,
            crater: lobe.crater,
        }
    }
}

impl Base {
    /// The noises of a world seed.
    pub fn new(world_seed: u64) -> Self {
        const { assert!((BASE_STREAM | WARP_STREAM) & 1 == 0 && BASE_CELL_BITS == 21) };
        let four = |first: u32| [0, 1, 2, 3].map(|n| Turned::new(world_seed, first + n));
        Self {
            octaves: four(BASE_STREAM),
            warp: four(WARP_STREAM),
            exposure: Turned::new(world_seed, EXPOSURE_STREAM),
        }
    }

    /// The field at points, in units.
    #[inline(always)]
    pub fn at<H: Hash>(&self, lobes: &[FloatLobe], x: I8, z: I8) -> Node {
        let (zero, one) = (F8::splat(0.0), F8::splat(1.0));
        let (mass, height) = self.mass::<H>(lobes, x, z);
        let exposure = self.exposure.value::<H, 21, false>(x, z);
        let exposure = exposure.mul_add(F8::splat(3.0), F8::splat(-1.0 / 32.0)).clamp(0.0, 1.0);
        let ruggedness = exposure.mul_add(F8::splat(0.5), F8::splat(0.75));
        let rim = (mass * F8::splat(8.0)).min(one);
        let (middle, outer) = ((mass - F8::splat(0.625)).max(zero), one - rim);
        let mut shore = (middle * middle).mul_add(F8::splat(384.0), outer * outer * F8::splat(-80.0));

        let mut octaves = Damped { slope: (zero, zero), flatness: one, relief: zero };
        let value = octaves.add::<0>(self.octaves[0].sample::<H, 21, false>(x, z));
        shore = value.mul_add(F8::splat(64.0), shore);
        let value = octaves.add::<1>(self.octaves[1].sample::<H, 20, true>(x, z));
        shore = value.mul_add(F8::splat(64.0), shore);
        let value = octaves.add::<2>(self.octaves[2].sample::<H, 19, false>(x, z));
        shore = (value * ruggedness).mul_add(F8::splat(80.0), shore);
        let wide = shore;
        let value = octaves.add::<3>(self.octaves[3].sample::<H, 18, true>(x, z));
        let near = window((shore * F8::splat(1.0 / 128.0)).clamp(-1.0, 1.0));
        shore = (value * near * ruggedness).mul_add(F8::splat(128.0), shore);

        let inland = smoothstep((wide - F8::splat(8.0)) * F8::splat(1.0 / 128.0));
        let relief = octaves.relief.mul_add(F8::splat(1.375), F8::splat(13.0 / 32.0)).max(zero);
        let mountain = height * inland * (relief + F8::splat(5.0 / 32.0));
        // Half of the shore on both sides of the water line, less a square on land.
        let plain = shore.min(F8::splat(32.0));
        let bend = plain.max(zero) * F8::splat(1.0 / 32.0);
        let low = shore.mul_add(F8::splat(1.0 / 32.0), plain * F8::splat(0.5));
        let low = (bend * bend).neg_mul_add(F8::splat(8.0), low);
        let sum = mountain.mul_add(F8::splat(704.0), low + F8::splat(FLOOR_M)).max(zero);
        let raised = sum.mul_add(smoothstep(rim), F8::splat(-FLOOR_M));

        let near = window((shore * F8::splat(1.0 / 32.0)).clamp(-1.0, 1.0));
        let coast = near * exposure.mul_add(F8::splat(0.375), F8::splat(1.125));
        let foot = inland.neg_mul_add(inland, inland);
        let rocky = height * inland.mul_add(octaves.flatness, foot * F8::splat(2.5));
        let sum = coast.mul_add(F8::splat(0.5), rocky + F8::splat(1.0 / 64.0)).min(one);
        Node { height: raised, roughness: sum * rim, exposure: zero.select_below(mass, exposure, zero) }
    }

    /// Mass and height of all lobes at warped points.
    #[inline(always)]
    fn mass<H: Hash>(&self, lobes: &[FloatLobe], x: I8, z: I8) -> (F8, F8) {
        let (zero, one) = (F8::splat(0.0), F8::splat(1.0));
        let [wide_x, wide_z, narrow_x, narrow_z] = &self.warp;
        let (wide, narrow) = (F8::splat(1800.0), F8::splat(600.0));
        let warp_x = narrow_x.value::<H, 20, false>(x, z) * narrow;
        let warp_x = wide_x.value::<H, 22, false>(x, z).mul_add(wide, warp_x);
        let warp_z = narrow_z.value::<H, 20, true>(x, z) * narrow;
        let warp_z = wide_z.value::<H, 22, true>(x, z).mul_add(wide, warp_z);
        let (mut mass_left, mut height_left) = (one, one);
        let metres = F8::splat(1.0 / UNITS_PER_METRE as f32);
        for lobe in lobes {
            let dx = (x - I8::splat(lobe.centre.0)).to_floats().mul_add(metres, warp_x);
            let dz = (z - I8::splat(lobe.centre.1)).to_floats().mul_add(metres, warp_z);
            let along = dx.mul_add(F8::splat(lobe.long.0), dz * F8::splat(lobe.long.1));
            let across = dx.mul_add(F8::splat(lobe.short.0), dz * F8::splat(lobe.short.1));
            let outside = along.mul_add(along, across * across);
            if !outside.any_below(1.0) {
                continue;
            }
            let u = (one - outside).max(zero);
            let s = u * u;
            let mass = s * s.mul_add(F8::splat(lobe.mass.1), F8::splat(lobe.mass.0));
            mass_left = mass.clamp(0.0, 1.0).neg_mul_add(mass_left, mass_left);
            let mut top = (s * F8::splat(lobe.plateau)).min(one);
            if lobe.crater {
                let w = u.mul_add(F8::splat(16.0), F8::splat(-15.0)).max(zero);
                top = (w * w).neg_mul_add(F8::splat(7.0 / 16.0), top);
            }
            height_left = (top * F8::splat(lobe.height)).neg_mul_add(height_left, height_left);
        }
        (one - mass_left, one - height_left)
    }
}

/// Octaves that damp those after them.
struct Damped {
    slope: (F8, F8),
    flatness: F8,
    relief: F8,
}

impl Damped {
    /// Adds an octave; returns its value.
    #[inline(always)]
    fn add<const OCTAVE: usize>(&mut self, (value, slope_x, slope_z): (F8, F8, F8)) -> F8 {
        let more = F8::splat(if OCTAVE == 0 { 1.0 } else { 1.5 });
        let (x, z) = (slope_x.mul_add(more, self.slope.0), slope_z.mul_add(more, self.slope.1));
        self.slope = (x, z);
        let steepness = x.mul_add(x, z * z);
        self.flatness = steepness.neg_mul_add(F8::splat(1.0 / 204.8), F8::splat(1.0)).max(F8::splat(0.0));
        let damping = (self.flatness * self.flatness).mul_add(F8::splat(0.875), F8::splat(0.125));
        let folded =
            if OCTAVE == 0 { value } else { value.abs().neg_mul_add(F8::splat(1.5), F8::splat(0.375)) };
        let amplitude = F8::splat(1.0 / (1 << OCTAVE) as f32);
        self.relief = (folded * amplitude).mul_add(damping, self.relief);
        value
    }
}

/// `3 x^2 - 2 x^3`, with `x` limited to 0 and 1.
#[inline(always)]
pub fn smoothstep(x: F8) -> F8 {
    let x = x.clamp(0.0, 1.0);
    x * x * x.neg_mul_add(F8::splat(2.0), F8::splat(3.0))
}

/// `(1 - x^2)^2`.
#[inline(always)]
fn window(x: F8) -> F8 {
    let rest = x.neg_mul_add(x, F8::splat(1.0));
    rest * rest
}
