//! The statements of [`crate::curves`] and [`crate::lattice`] on vectors.

use super::lanes::Lanes;
use crate::constants::GRADIENTS;
use crate::curves::ALMOST_ONE_Q30;
use crate::lattice::{Lattice, Turn};

/// Gradients as pairs of 16 bits: x low, z high.
pub(super) const PACKED_GRADIENTS: [i32; 32] = {
    let mut packed = [0; 32];
    let mut index = 0;
    while index < 32 {
        packed[index] = (GRADIENTS[index].0 as i32 & 0xffff) | ((GRADIENTS[index].1 as i32) << 16);
        index += 1;
    }
    packed
};

// Functions, not closures: only these can be made to inherit the caller's instruction set.

/// [`crate::hash::mix`] of every lane.
#[inline(always)]
pub(super) unsafe fn mix<L: Lanes>(h: L) -> L {
    // SAFETY: the caller guarantees the CPU features, here and below.
    unsafe {
        let h = h.xor(h.shr(16)).mul(L::splat(0x21f0_aaad));
        let h = h.xor(h.shr(15)).mul(L::splat(0xd35a_2d97_u32 as i32));
        h.xor(h.shr(15))
    }
}

/// [`crate::curves::fade`].
#[inline(always)]
pub(super) unsafe fn fade<L: Lanes>(t: L) -> L {
    // SAFETY: see `mix`.
    unsafe {
        let t2 = t.mul_hi(t).shl(1);
        let t3 = t2.mul_hi(t).shl(1);
        let inner = L::splat(10 << 27).sub(t.sar(4).mul(L::splat(15))).add(t2.sar(4).mul(L::splat(6)));
        t3.mul_hi(inner).shl(5)
    }
}

/// [`crate::curves::fade_slope`].
#[inline(always)]
pub(super) unsafe fn fade_slope<L: Lanes>(t: L) -> L {
    // SAFETY: see `mix`.
    unsafe {
        let four = t.mul_hi(L::splat(i32::MAX).sub(t)).shl(3);
        four.mul_hi(four).sar(4).mul(L::splat(15))
    }
}

/// [`crate::curves::lerp`].
#[inline(always)]
pub(super) unsafe fn lerp<L: Lanes>(a: L, b: L, t: L) -> L {
    // SAFETY: see `mix`.
    unsafe { a.add(b.sub(a).mul_hi(t).shl(1)) }
}

/// [`crate::curves::square`].
#[inline(always)]
pub(super) unsafe fn square<L: Lanes>(x: L) -> L {
    // SAFETY: see `mix`.
    unsafe {
        let twice = x.shl(1);
        twice.mul_hi(twice)
    }
}

/// [`crate::curves::smoothstep`].
#[inline(always)]
pub(super) unsafe fn smoothstep<L: Lanes>(x: L) -> L {
    // SAFETY: see `mix`.
    unsafe { square(x).shl(1).mul_hi(L::splat(3 << 29).sub(x)).shl(2) }
}

/// [`crate::curves::window`].
#[inline(always)]
pub(super) unsafe fn window<L: Lanes>(x: L) -> L {
    // SAFETY: see `mix`.
    unsafe { square(L::splat(ALMOST_ONE_Q30).sub(square(x))) }
}

/// `value` limited to `[low, high]`.
#[inline(always)]
pub(super) unsafe fn clamp<L: Lanes>(value: L, low: i32, high: i32) -> L {
    // SAFETY: see `mix`.
    unsafe { value.max(L::splat(low)).min(L::splat(high)) }
}

/// One corner of a cell: the noise's linear part there, and its gradient (Q29).
#[derive(Clone, Copy)]
struct Corner<L> {
    plane: L,
    x: L,
    z: L,
}

#[inline(always)]
unsafe fn corner<L: Lanes>(column: L, cell_z: L, x: L, z: L) -> Corner<L> {
    // SAFETY: see `mix`; an index of 5 bits is below 32.
    unsafe {
        let hash = mix(column.add(cell_z.mul(L::splat(0x85eb_ca6b_u32 as i32))));
        let packed = L::lookup(&PACKED_GRADIENTS, hash.shr(27));
        // Q30 as a factor, Q29 as a gradient.
        let (gx, gz) = (packed.shl(16).sar(1), packed.sar(16).shl(15));
        Corner { plane: gx.mul_hi(x).add(gz.mul_hi(z)), x: gx.sar(1), z: gz.sar(1) }
    }
}

/// Value of [`Lattice::at`], and five times its gradient along the axes of the world (Q26) where
/// `GRADIENT` asks for it, else zeros.
#[inline(always)]
pub(super) unsafe fn lattice<L: Lanes, const GRADIENT: bool>(lattice: &Lattice, x: L, z: L) -> (L, L, L) {
    // SAFETY: see `mix`.
    unsafe {
        let (x3, z3, x4, z4) = (x.add(x.shl(1)), z.add(z.shl(1)), x.shl(2), z.shl(2));
        let (x, z) = match lattice.turn {
            Turn::Low => (x4.sub(z3), x3.add(z4)),
            Turn::High => (x3.sub(z4), x4.add(z3)),
        };
        let shift = L::splat(lattice.shift as i32);
        let (x, z) = (x.add(shift), z.add(shift));
        let bits = lattice.bits;
        let (mask, cells) = (L::splat((1 << bits) - 1), L::splat((u32::MAX >> bits) as i32));
        let one = L::splat(1);
        let (cell_x, cell_z) = (x.shr(bits), z.shr(bits));
        let (next_x, next_z) = (cell_x.add(one).and(cells), cell_z.add(one).and(cells));
        let (low_x, low_z) = (x.and(mask).shl(31 - bits), z.and(mask).shl(31 - bits));
        let sign = L::splat(i32::MIN);
        let (high_x, high_z) = (low_x.xor(sign), low_z.xor(sign));
        let (fade_x, fade_z) = (fade(low_x), fade(low_z));
        let (seed, factor) = (L::splat(lattice.seed as i32), L::splat(0x9e37_79b9_u32 as i32));
        let (west, east) = (mix(seed.xor(cell_x.mul(factor))), mix(seed.xor(next_x.mul(factor))));
        let c00 = corner(west, cell_z, low_x, low_z);
        let c10 = corner(east, cell_z, high_x, low_z);
        let c01 = corner(west, next_z, low_x, high_z);
        let c11 = corner(east, next_z, high_x, high_z);
        let (west, east) = (lerp(c00.plane, c01.plane, fade_z), lerp(c10.plane, c11.plane, fade_z));
        let value = lerp(west, east, fade_x);
        if !GRADIENT {
            return (value, L::splat(0), L::splat(0));
        }
        let (north, south) = (lerp(c00.plane, c10.plane, fade_x), lerp(c01.plane, c11.plane, fade_x));
        let mean_x = lerp(lerp(c00.x, c10.x, fade_x), lerp(c01.x, c11.x, fade_x), fade_z);
        let mean_z = lerp(lerp(c00.z, c10.z, fade_x), lerp(c01.z, c11.z, fade_x), fade_z);
        let gx = mean_x.sar(3).add(east.sub(west).mul_hi(fade_slope(low_x)));
        let gz = mean_z.sar(3).add(south.sub(north).mul_hi(fade_slope(low_z)));
        let (gx3, gz3, gx4, gz4) = (gx.add(gx.shl(1)), gz.add(gz.shl(1)), gx.shl(2), gz.shl(2));
        match lattice.turn {
            Turn::Low => (value, gx4.add(gz3), gz4.sub(gx3)),
            Turn::High => (value, gx3.add(gz4), gz3.sub(gx4)),
        }
    }
}
