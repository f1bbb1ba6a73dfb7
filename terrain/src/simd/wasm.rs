//! Vectors of WebAssembly's 128-bit SIMD. A module uses them or not as a whole, so nothing is
//! detected at run time.

use super::lanes::Lanes;
use core::arch::wasm32::*;

/// 4 lanes.
#[derive(Clone, Copy)]
pub(super) struct Simd128(v128);

impl Lanes for Simd128 {
    const COUNT: usize = 4;
    type Half = i32;

    #[inline(always)]
    unsafe fn load(from: *const i32) -> Self {
        // SAFETY: the caller guarantees the pointer, here and below.
        Self(unsafe { v128_load(from.cast()) })
    }
    #[inline(always)]
    unsafe fn store(self, to: *mut i32) {
        // SAFETY: see `load`.
        unsafe { v128_store(to.cast(), self.0) }
    }
    #[inline(always)]
    unsafe fn splat(value: i32) -> Self {
        Self(i32x4_splat(value))
    }
    #[inline(always)]
    unsafe fn ramp() -> Self {
        Self(i32x4(0, 1, 2, 3))
    }

    #[inline(always)]
    unsafe fn add(self, other: Self) -> Self {
        Self(i32x4_add(self.0, other.0))
    }
    #[inline(always)]
    unsafe fn sub(self, other: Self) -> Self {
        Self(i32x4_sub(self.0, other.0))
    }
    #[inline(always)]
    unsafe fn mul(self, other: Self) -> Self {
        Self(i32x4_mul(self.0, other.0))
    }
    #[inline(always)]
    unsafe fn mul_hi(self, other: Self) -> Self {
        let low = i64x2_extmul_low_i32x4(self.0, other.0);
        let high = i64x2_extmul_high_i32x4(self.0, other.0);
        Self(i32x4_shuffle::<1, 3, 5, 7>(low, high))
    }
    #[inline(always)]
    unsafe fn mul_hi_u(self, other: Self) -> Self {
        let low = u64x2_extmul_low_u32x4(self.0, other.0);
        let high = u64x2_extmul_high_u32x4(self.0, other.0);
        Self(i32x4_shuffle::<1, 3, 5, 7>(low, high))
    }
    #[inline(always)]
    unsafe fn dot(self, other: Self) -> Self {
        Self(i32x4_dot_i16x8(self.0, other.0))
    }
    #[inline(always)]
    unsafe fn and(self, other: Self) -> Self {
        Self(v128_and(self.0, other.0))
    }
    #[inline(always)]
    unsafe fn xor(self, other: Self) -> Self {
        Self(v128_xor(self.0, other.0))
    }
    #[inline(always)]
    unsafe fn min(self, other: Self) -> Self {
        Self(i32x4_min(self.0, other.0))
    }
    #[inline(always)]
    unsafe fn max(self, other: Self) -> Self {
        Self(i32x4_max(self.0, other.0))
    }
    #[inline(always)]
    unsafe fn abs(self) -> Self {
        Self(i32x4_abs(self.0))
    }

    #[inline(always)]
    unsafe fn shl(self, bits: u32) -> Self {
        Self(i32x4_shl(self.0, bits))
    }
    #[inline(always)]
    unsafe fn shr(self, bits: u32) -> Self {
        Self(u32x4_shr(self.0, bits))
    }
    #[inline(always)]
    unsafe fn sar(self, bits: u32) -> Self {
        Self(i32x4_shr(self.0, bits))
    }

    #[inline(always)]
    unsafe fn pack(self, high: Self) -> Self {
        Self(i16x8_shuffle::<0, 8, 2, 10, 4, 12, 6, 14>(self.0, high.0))
    }
    #[inline(always)]
    unsafe fn select_below(self, limit: Self, then: Self, otherwise: Self) -> Self {
        Self(v128_bitselect(then.0, otherwise.0, i32x4_lt(self.0, limit.0)))
    }
    #[inline(always)]
    unsafe fn any(self) -> bool {
        v128_any_true(self.0)
    }

    #[inline(always)]
    unsafe fn picker(offsets: Self) -> Self {
        // Byte shuffles name bytes: four per lane.
        Self(i32x4_add(i32x4_mul(offsets.0, i32x4_splat(0x0404_0404)), i32x4_splat(0x0302_0100)))
    }
    #[inline(always)]
    unsafe fn window(from: *const i32, picker: Self) -> Self {
        // SAFETY: see `load`.
        Self(i8x16_swizzle(unsafe { v128_load(from.cast()) }, picker.0))
    }
    #[inline(always)]
    unsafe fn lookup(table: &[i32; 32], index: Self) -> Self {
        let at = |lane: i32| table[lane as usize & 31];
        Self(i32x4(
            at(i32x4_extract_lane::<0>(index.0)),
            at(i32x4_extract_lane::<1>(index.0)),
            at(i32x4_extract_lane::<2>(index.0)),
            at(i32x4_extract_lane::<3>(index.0)),
        ))
    }

    #[inline(always)]
    unsafe fn max_of_pairs(self, next: Self) -> Self {
        let (even, odd) = pairs(self, next);
        Self(i32x4_max(even, odd))
    }
    #[inline(always)]
    unsafe fn min_of_pairs(self, next: Self) -> Self {
        let (even, odd) = pairs(self, next);
        Self(i32x4_min(even, odd))
    }
}

#[inline(always)]
fn pairs(first: Simd128, next: Simd128) -> (v128, v128) {
    (i32x4_shuffle::<0, 2, 4, 6>(first.0, next.0), i32x4_shuffle::<1, 3, 5, 7>(first.0, next.0))
}
