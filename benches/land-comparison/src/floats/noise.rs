//! Gradient noise in floats (Perlin, "Improving Noise", 2002): the fine octaves on axes that are
//! shared, and the octaves on turned lattices with their gradients. Cells are integers and
//! fractions exact, as in the land.

use super::hash::Hash;
use super::lanes::{F8, I8};

/// Cosines of the eight directions of the first quadrant, `(i + 1/2) 11.25` degrees.
const COSINES: [f32; 8] = [
    0.995_184_7,
    0.956_940_35,
    0.881_921_3,
    0.773_010_43,
    0.634_393_3,
    0.471_396_74,
    0.290_284_66,
    0.098_017_14,
];

/// Where points lie on one axis of a lattice.
#[derive(Clone, Copy)]
pub struct Axis {
    /// The hashes of the cell and of the one after it.
    hash: [I8; 2],
    /// The fraction of the cell.
    t: F8,
    fade: F8,
}

impl Axis {
    /// Of an octave that is left out.
    #[inline(always)]
    pub fn none() -> Self {
        Self { hash: [I8::splat(0); 2], t: F8::splat(0.0), fade: F8::splat(0.0) }
    }

    /// The east axis of a lattice of cells of `2^BITS` units.
    #[inline(always)]
    pub fn east<H: Hash, const BITS: i32>(seed: u32, x: I8) -> Self {
        let (cell, t) = split::<BITS>(x);
        let seed = I8::splat(seed as i32);
        Self::new([H::column(seed, cell), H::column(seed, cell + I8::splat(1))], t)
    }

    /// The south axis.
    #[inline(always)]
    pub fn south<H: Hash, const BITS: i32>(z: I8) -> Self {
        let (cell, t) = split::<BITS>(z);
        Self::new([H::row(cell), H::row(cell + I8::splat(1))], t)
    }

    #[inline(always)]
    fn new(hash: [I8; 2], t: F8) -> Self {
        Self { hash, t, fade: fade(t) }
    }
}

/// The noise at points of two axes.
#[inline(always)]
pub fn value<H: Hash>(x: &Axis, z: &Axis) -> F8 {
    let one = F8::splat(1.0);
    let (far_x, far_z) = (x.t - one, z.t - one);
    let ([west, east], [above, below]) = (x.hash, z.hash);
    let a = corner(H::point(west, above), x.t, z.t).plane;
    let b = corner(H::point(east, above), far_x, z.t).plane;
    let c = corner(H::point(west, below), x.t, far_z).plane;
    let d = corner(H::point(east, below), far_x, far_z).plane;
    lerp(lerp(a, b, x.fade), lerp(c, d, x.fade), z.fade)
}

/// A turned lattice of one world.
#[derive(Clone, Copy, Default)]
pub struct Turned {
    seed: u32,
    shift: u32,
}

impl Turned {
    /// Of a stream of a world seed.
    pub fn new(world_seed: u64, stream: u32) -> Self {
        let seed = terrain::hash::stream_seed(world_seed, stream);
        Self { seed, shift: stream.wrapping_mul(0x9e37_79b1) }
    }

    /// The noise on the lattice of `2^BITS` turned units, of an even stream or an odd one.
    #[inline(always)]
    pub fn value<H: Hash, const BITS: i32, const ODD: bool>(&self, x: I8, z: I8) -> F8 {
        let (x, z) = self.axes::<H, BITS, ODD>(x, z);
        value::<H>(&x, &z)
    }

    /// The noise, and five times its gradient along the axes of the world, per cell.
    #[inline(always)]
    pub fn sample<H: Hash, const BITS: i32, const ODD: bool>(&self, x: I8, z: I8) -> (F8, F8, F8) {
        let (x, z) = self.axes::<H, BITS, ODD>(x, z);
        let one = F8::splat(1.0);
        let (far_x, far_z) = (x.t - one, z.t - one);
        let ([west, east], [above, below]) = (x.hash, z.hash);
        let a = corner(H::point(west, above), x.t, z.t);
        let b = corner(H::point(east, above), far_x, z.t);
        let c = corner(H::point(west, below), x.t, far_z);
        let d = corner(H::point(east, below), far_x, far_z);
        let (west, east) = (lerp(a.plane, c.plane, z.fade), lerp(b.plane, d.plane, z.fade));
        let (north, south) = (lerp(a.plane, b.plane, x.fade), lerp(c.plane, d.plane, x.fade));
        let value = lerp(west, east, x.fade);
        let mean_x = lerp(lerp(a.x, b.x, x.fade), lerp(c.x, d.x, x.fade), z.fade);
        let mean_z = lerp(lerp(a.z, b.z, x.fade), lerp(c.z, d.z, x.fade), z.fade);
        let along_x = (east - west).mul_add(fade_slope(x.t), mean_x);
        let along_z = (south - north).mul_add(fade_slope(z.t), mean_z);
        let (three, four) = (F8::splat(3.0), F8::splat(4.0));
        if ODD {
            (value, along_x.mul_add(three, along_z * four), along_x.neg_mul_add(four, along_z * three))
        } else {
            (value, along_x.mul_add(four, along_z * three), along_x.neg_mul_add(three, along_z * four))
        }
    }

    #[inline(always)]
    fn axes<H: Hash, const BITS: i32, const ODD: bool>(&self, x: I8, z: I8) -> (Axis, Axis) {
        let (x3, z3) = (x + x + x, z + z + z);
        let (x4, z4) = (x.shl::<2>(), z.shl::<2>());
        let (x, z) = if ODD { (x3 - z4, x4 + z3) } else { (x4 - z3, x3 + z4) };
        let shift = I8::splat(self.shift as i32);
        let (x, z) = (x + shift, z + shift);
        // Cells wrap: the one after the last is the first.
        let last = I8::splat((u32::MAX >> BITS) as i32);
        let (west, north) = (x.shr::<BITS>(), z.shr::<BITS>());
        let (east, south) = ((west + I8::splat(1)) & last, (north + I8::splat(1)) & last);
        let seed = I8::splat(self.seed as i32);
        (
            Axis::new([H::column(seed, west), H::column(seed, east)], fraction::<BITS>(x)),
            Axis::new([H::row(north), H::row(south)], fraction::<BITS>(z)),
        )
    }
}

/// The cell of a coordinate and the fraction of it.
#[inline(always)]
fn split<const BITS: i32>(v: I8) -> (I8, F8) {
    (v.sar::<BITS>(), fraction::<BITS>(v))
}

#[inline(always)]
fn fraction<const BITS: i32>(v: I8) -> F8 {
    (v & I8::splat((1 << BITS) - 1)).to_floats() * F8::splat(1.0 / (1 << BITS) as f32)
}

/// The linear function of one lattice point, and its gradient.
struct Corner {
    plane: F8,
    x: F8,
    z: F8,
}

// Functions, not closures: only these can be made to inherit the caller's instruction set.

#[inline(always)]
fn corner(hash: I8, dx: F8, dz: F8) -> Corner {
    let (x, z) = gradient(hash);
    Corner { plane: x.mul_add(dx, z * dz), x, z }
}

/// One of 32 directions by the high bits of a hash: three choose it in the first quadrant, two the
/// quadrant.
#[inline(always)]
fn gradient(hash: I8) -> (F8, F8) {
    let table = F8::load(&COSINES);
    // In the second and the fourth quadrant cosine and sine change places.
    let odd = hash.shl::<1>().sar::<31>();
    let index = hash.shr::<27>() ^ odd;
    let sign = I8::splat(i32::MIN);
    let x = table.pick(index).with_sign((hash ^ hash.shl::<1>()) & sign);
    let z = table.pick(!index).with_sign(hash & sign);
    (x, z)
}

#[inline(always)]
fn lerp(a: F8, b: F8, t: F8) -> F8 {
    (b - a).mul_add(t, a)
}

/// `6 t^5 - 15 t^4 + 10 t^3`.
#[inline(always)]
fn fade(t: F8) -> F8 {
    let inner = t.mul_add(F8::splat(6.0), F8::splat(-15.0)).mul_add(t, F8::splat(10.0));
    t * t * t * inner
}

/// `30 t^2 (1 - t)^2`.
#[inline(always)]
fn fade_slope(t: F8) -> F8 {
    let product = t.neg_mul_add(t, t);
    product * product * F8::splat(30.0)
}
