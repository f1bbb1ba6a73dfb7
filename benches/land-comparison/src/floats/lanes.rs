//! Eight floats and eight integers of 32 bits, on AVX2 with FMA.
//!
//! Every function is inlined into one that has these features ([`super`]); outside of it a value of
//! these types must not be used.

use std::arch::x86_64::*;
use std::ops::{Add, BitAnd, BitXor, Mul, Not, Sub};

/// Lanes of a vector.
pub const COUNT: usize = 8;

/// Eight floats.
#[derive(Clone, Copy)]
pub struct F8(__m256);

/// Eight integers.
#[derive(Clone, Copy)]
pub struct I8(__m256i);

/// Implements an operator by one instruction.
macro_rules! operator {
    ($type:ident: $($trait:ident $name:ident $instruction:ident),*) => {
        $(
            impl $trait for $type {
                type Output = Self;

                #[inline(always)]
                fn $name(self, other: Self) -> Self {
                    // SAFETY: the CPU has AVX2, see the head of this file; so below.
                    Self(unsafe { $instruction(self.0, other.0) })
                }
            }
        )*
    };
}

operator!(F8: Add add _mm256_add_ps, Sub sub _mm256_sub_ps, Mul mul _mm256_mul_ps);
operator!(
    I8: Add add _mm256_add_epi32, Sub sub _mm256_sub_epi32, Mul mul _mm256_mullo_epi32,
    BitAnd bitand _mm256_and_si256, BitXor bitxor _mm256_xor_si256
);

impl Not for I8 {
    type Output = Self;

    #[inline(always)]
    fn not(self) -> Self {
        self ^ Self::splat(-1)
    }
}

impl F8 {
    #[inline(always)]
    pub fn splat(value: f32) -> Self {
        Self(unsafe { _mm256_set1_ps(value) })
    }

    #[inline(always)]
    pub fn load(from: &[f32; COUNT]) -> Self {
        Self(unsafe { _mm256_loadu_ps(from.as_ptr()) })
    }

    #[inline(always)]
    pub fn store(self, to: &mut [f32; COUNT]) {
        unsafe { _mm256_storeu_ps(to.as_mut_ptr(), self.0) }
    }

    /// `self * factor + addend`, rounded once.
    #[inline(always)]
    pub fn mul_add(self, factor: Self, addend: Self) -> Self {
        Self(unsafe { _mm256_fmadd_ps(self.0, factor.0, addend.0) })
    }

    /// `addend - self * factor`, rounded once.
    #[inline(always)]
    pub fn neg_mul_add(self, factor: Self, addend: Self) -> Self {
        Self(unsafe { _mm256_fnmadd_ps(self.0, factor.0, addend.0) })
    }

    #[inline(always)]
    pub fn min(self, other: Self) -> Self {
        Self(unsafe { _mm256_min_ps(self.0, other.0) })
    }

    #[inline(always)]
    pub fn max(self, other: Self) -> Self {
        Self(unsafe { _mm256_max_ps(self.0, other.0) })
    }

    #[inline(always)]
    pub fn clamp(self, low: f32, high: f32) -> Self {
        self.max(Self::splat(low)).min(Self::splat(high))
    }

    #[inline(always)]
    pub fn abs(self) -> Self {
        Self(unsafe { _mm256_andnot_ps(_mm256_set1_ps(-0.0), self.0) })
    }

    /// The sign is inverted where the highest bit of `sign` is set; its other bits must be zero.
    #[inline(always)]
    pub fn with_sign(self, sign: I8) -> Self {
        Self(unsafe { _mm256_xor_ps(self.0, _mm256_castsi256_ps(sign.0)) })
    }

    /// Per lane the element of `self` whose number stands in the low three bits of `index`.
    #[inline(always)]
    pub fn pick(self, index: I8) -> Self {
        Self(unsafe { _mm256_permutevar8x32_ps(self.0, index.0) })
    }

    /// Per lane `then` where `self < limit`, else `otherwise`.
    #[inline(always)]
    pub fn select_below(self, limit: Self, then: Self, otherwise: Self) -> Self {
        Self(unsafe { _mm256_blendv_ps(otherwise.0, then.0, _mm256_cmp_ps::<_CMP_LT_OQ>(self.0, limit.0)) })
    }

    /// Whether any lane is below a limit.
    #[inline(always)]
    pub fn any_below(self, limit: f32) -> bool {
        unsafe { _mm256_movemask_ps(_mm256_cmp_ps::<_CMP_LT_OQ>(self.0, _mm256_set1_ps(limit))) != 0 }
    }

    /// Rounded to nearest.
    #[inline(always)]
    pub fn to_integers(self) -> I8 {
        I8(unsafe { _mm256_cvtps_epi32(self.0) })
    }
}

impl I8 {
    #[inline(always)]
    pub fn splat(value: i32) -> Self {
        Self(unsafe { _mm256_set1_epi32(value) })
    }

    /// 0, 1, 2, ...
    #[inline(always)]
    pub fn ramp() -> Self {
        Self(unsafe { _mm256_setr_epi32(0, 1, 2, 3, 4, 5, 6, 7) })
    }

    #[inline(always)]
    pub fn load(from: &[i32; COUNT]) -> Self {
        Self(unsafe { _mm256_loadu_si256(from.as_ptr().cast()) })
    }

    #[inline(always)]
    pub fn store(self, to: &mut [i32; COUNT]) {
        unsafe { _mm256_storeu_si256(to.as_mut_ptr().cast(), self.0) }
    }

    #[inline(always)]
    pub fn shl<const BITS: i32>(self) -> Self {
        Self(unsafe { _mm256_slli_epi32::<BITS>(self.0) })
    }

    /// Right shift that fills with zeros.
    #[inline(always)]
    pub fn shr<const BITS: i32>(self) -> Self {
        Self(unsafe { _mm256_srli_epi32::<BITS>(self.0) })
    }

    /// Right shift that fills with the sign.
    #[inline(always)]
    pub fn sar<const BITS: i32>(self) -> Self {
        Self(unsafe { _mm256_srai_epi32::<BITS>(self.0) })
    }

    #[inline(always)]
    pub fn to_floats(self) -> F8 {
        F8(unsafe { _mm256_cvtepi32_ps(self.0) })
    }
}
