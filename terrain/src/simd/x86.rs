//! Vectors of x86-64: SSE4.1, AVX2 and AVX-512.
//!
//! Each type may only be used where its features were detected ([`super::Kernel`]).

use super::lanes::Lanes;
use core::arch::x86_64::*;

/// 4 lanes; needs SSSE3 and SSE4.1.
#[derive(Clone, Copy)]
pub(super) struct Sse41(__m128i);

/// 8 lanes; needs AVX2.
#[derive(Clone, Copy)]
pub(super) struct Avx2(__m256i);

/// 16 lanes; needs AVX-512 F and BW.
#[derive(Clone, Copy)]
pub(super) struct Avx512(__m512i);

/// Implements [`Lanes`] from the intrinsics of one instruction set. A part in the form
/// `(operands) => expression` has no single intrinsic; its operands are registers, or what the
/// method takes.
macro_rules! lanes {
    (
        $type:ident, $count:literal lanes, half $half:ty;
        load $load:ident, store $store:ident, splat $splat:ident, ramp $ramp:expr;
        binary { $($binary:ident: $binary_op:ident),* $(,)? }
        shift { $($shift:ident: $shift_op:ident),* $(,)? }
        abs $abs:ident;
        // Products of the even lanes, 64 bits wide; the shift that moves odd lanes to even ones;
        // the high halves of the even products (shifted) and of the odd ones, joined.
        products { mul_hi: $product:ident, mul_hi_u: $product_u:ident }
        high $high_half:ident, ($even:ident, $odd:ident) => $join:expr;
        pack ($low:ident, $high:ident) => $pack:expr;
        select_below ($value:ident, $limit:ident, $then:ident, $otherwise:ident) => $select:expr;
        any ($tested:ident) => $any:expr;
        picker ($offsets:ident) => $picker:expr;
        window ($window:ident, $picked:ident) => $permuted:expr;
        lookup ($table:ident, $index:ident) => $lookup:expr;
        // The elements at even and at odd places of two registers; the extremes in order.
        pairs { max_of_pairs: $max:ident, min_of_pairs: $min:ident }
        ($first:ident, $second:ident) => $pairs:expr, ordered ($extremes:ident) => $ordered:expr;
    ) => {
        // SAFETY of every block: the caller of a method guarantees the CPU's features and the
        // pointers (see `Lanes`).
        impl Lanes for $type {
            const COUNT: usize = $count;
            type Half = $half;

            #[inline(always)]
            unsafe fn load(from: *const i32) -> Self {
                unsafe { Self($load(from.cast())) }
            }
            #[inline(always)]
            unsafe fn store(self, to: *mut i32) {
                unsafe { $store(to.cast(), self.0) }
            }
            #[inline(always)]
            unsafe fn splat(value: i32) -> Self {
                unsafe { Self($splat(value)) }
            }
            #[inline(always)]
            unsafe fn ramp() -> Self {
                unsafe { Self($ramp) }
            }
            $(
                #[inline(always)]
                unsafe fn $binary(self, other: Self) -> Self {
                    unsafe { Self($binary_op(self.0, other.0)) }
                }
            )*
            $(
                #[inline(always)]
                unsafe fn $shift(self, bits: u32) -> Self {
                    unsafe { Self($shift_op(self.0, _mm_cvtsi32_si128(bits as i32))) }
                }
            )*
            #[inline(always)]
            unsafe fn abs(self) -> Self {
                unsafe { Self($abs(self.0)) }
            }
            #[inline(always)]
            unsafe fn mul_hi(self, other: Self) -> Self {
                unsafe {
                    let $odd = $product($high_half(self.0, 32), $high_half(other.0, 32));
                    let $even = $high_half($product(self.0, other.0), 32);
                    Self($join)
                }
            }
            #[inline(always)]
            unsafe fn mul_hi_u(self, other: Self) -> Self {
                unsafe {
                    let $odd = $product_u($high_half(self.0, 32), $high_half(other.0, 32));
                    let $even = $high_half($product_u(self.0, other.0), 32);
                    Self($join)
                }
            }
            #[inline(always)]
            unsafe fn pack(self, high: Self) -> Self {
                let ($low, $high) = (self.0, high.0);
                unsafe { Self($pack) }
            }
            #[inline(always)]
            unsafe fn select_below(self, limit: Self, then: Self, otherwise: Self) -> Self {
                let ($value, $limit, $then, $otherwise) = (self.0, limit.0, then.0, otherwise.0);
                unsafe { Self($select) }
            }
            #[inline(always)]
            unsafe fn any(self) -> bool {
                let $tested = self.0;
                unsafe { $any }
            }
            #[inline(always)]
            unsafe fn picker(offsets: Self) -> Self {
                let $offsets = offsets.0;
                Self($picker)
            }
            #[inline(always)]
            unsafe fn window(from: *const i32, picker: Self) -> Self {
                let $picked = picker.0;
                unsafe {
                    let $window = $load(from.cast());
                    Self($permuted)
                }
            }
            #[inline(always)]
            unsafe fn lookup(table: &[i32; 32], index: Self) -> Self {
                let ($table, $index) = (table, index.0);
                unsafe { Self($lookup) }
            }
            #[inline(always)]
            unsafe fn max_of_pairs(self, next: Self) -> Self {
                let ($first, $second) = (self.0, next.0);
                unsafe {
                    let (even, odd) = $pairs;
                    let $extremes = $max(even, odd);
                    Self($ordered)
                }
            }
            #[inline(always)]
            unsafe fn min_of_pairs(self, next: Self) -> Self {
                let ($first, $second) = (self.0, next.0);
                unsafe {
                    let (even, odd) = $pairs;
                    let $extremes = $min(even, odd);
                    Self($ordered)
                }
            }
        }
    };
}

lanes! {
    Sse41, 4 lanes, half i32;
    load _mm_loadu_si128, store _mm_storeu_si128, splat _mm_set1_epi32, ramp _mm_setr_epi32(0, 1, 2, 3);
    binary {
        add: _mm_add_epi32, sub: _mm_sub_epi32, mul: _mm_mullo_epi32, dot: _mm_madd_epi16,
        and: _mm_and_si128, xor: _mm_xor_si128, min: _mm_min_epi32, max: _mm_max_epi32,
    }
    shift { shl: _mm_sll_epi32, shr: _mm_srl_epi32, sar: _mm_sra_epi32 }
    abs _mm_abs_epi32;
    products { mul_hi: _mm_mul_epi32, mul_hi_u: _mm_mul_epu32 }
    high _mm_srli_epi64, (even, odd) => _mm_blend_epi16(even, odd, 0b1100_1100);
    pack (low, high) => _mm_blend_epi16(low, _mm_slli_epi32(high, 16), 0b1010_1010);
    select_below (value, limit, then, otherwise) =>
        _mm_blendv_epi8(otherwise, then, _mm_cmplt_epi32(value, limit));
    any (value) => _mm_testz_si128(value, value) == 0;
    // A byte shuffle takes four byte numbers per lane.
    picker (offsets) => unsafe {
        let bytes = _mm_mullo_epi32(offsets, _mm_set1_epi32(0x0404_0404));
        _mm_add_epi32(bytes, _mm_set1_epi32(0x0302_0100))
    };
    window (window, picker) => _mm_shuffle_epi8(window, picker);
    lookup (table, index) => {
        let mut at = [0; 4];
        Self(index).store(at.as_mut_ptr());
        Self::load(at.map(|index: i32| table[index as usize & 31]).as_ptr()).0
    };
    pairs { max_of_pairs: _mm_max_epi32, min_of_pairs: _mm_min_epi32 }
    (first, second) => {
        let (a, b) = (_mm_castsi128_ps(first), _mm_castsi128_ps(second));
        (
            _mm_castps_si128(_mm_shuffle_ps(a, b, 0b10_00_10_00)),
            _mm_castps_si128(_mm_shuffle_ps(a, b, 0b11_01_11_01)),
        )
    }, ordered (extremes) => extremes;
}

lanes! {
    Avx2, 8 lanes, half Sse41;
    load _mm256_loadu_si256, store _mm256_storeu_si256, splat _mm256_set1_epi32,
    ramp _mm256_setr_epi32(0, 1, 2, 3, 4, 5, 6, 7);
    binary {
        add: _mm256_add_epi32, sub: _mm256_sub_epi32, mul: _mm256_mullo_epi32, dot: _mm256_madd_epi16,
        and: _mm256_and_si256, xor: _mm256_xor_si256, min: _mm256_min_epi32, max: _mm256_max_epi32,
    }
    shift { shl: _mm256_sll_epi32, shr: _mm256_srl_epi32, sar: _mm256_sra_epi32 }
    abs _mm256_abs_epi32;
    products { mul_hi: _mm256_mul_epi32, mul_hi_u: _mm256_mul_epu32 }
    high _mm256_srli_epi64, (even, odd) => _mm256_blend_epi32(even, odd, 0b1010_1010);
    pack (low, high) => _mm256_blend_epi16(low, _mm256_slli_epi32(high, 16), 0b1010_1010);
    select_below (value, limit, then, otherwise) =>
        _mm256_blendv_epi8(otherwise, then, _mm256_cmpgt_epi32(limit, value));
    any (value) => _mm256_testz_si256(value, value) == 0;
    picker (offsets) => offsets;
    window (window, picker) => _mm256_permutevar8x32_epi32(window, picker);
    // Masked: the gather cannot leave the table.
    lookup (table, index) =>
        _mm256_i32gather_epi32(table.as_ptr(), _mm256_and_si256(index, _mm256_set1_epi32(31)), 4);
    pairs { max_of_pairs: _mm256_max_epi32, min_of_pairs: _mm256_min_epi32 }
    (first, second) => {
        let (a, b) = (_mm256_castsi256_ps(first), _mm256_castsi256_ps(second));
        (
            _mm256_castps_si256(_mm256_shuffle_ps(a, b, 0b10_00_10_00)),
            _mm256_castps_si256(_mm256_shuffle_ps(a, b, 0b11_01_11_01)),
        )
    // The shuffles work in halves of 128 bits; this puts the four quarters in order.
    }, ordered (extremes) => _mm256_permute4x64_epi64(extremes, 0b11_01_10_00);
}

lanes! {
    Avx512, 16 lanes, half Avx2;
    load _mm512_loadu_si512, store _mm512_storeu_si512, splat _mm512_set1_epi32,
    ramp _mm512_setr_epi32(0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15);
    binary {
        add: _mm512_add_epi32, sub: _mm512_sub_epi32, mul: _mm512_mullo_epi32, dot: _mm512_madd_epi16,
        and: _mm512_and_si512, xor: _mm512_xor_si512, min: _mm512_min_epi32, max: _mm512_max_epi32,
    }
    shift { shl: _mm512_sll_epi32, shr: _mm512_srl_epi32, sar: _mm512_sra_epi32 }
    abs _mm512_abs_epi32;
    products { mul_hi: _mm512_mul_epi32, mul_hi_u: _mm512_mul_epu32 }
    high _mm512_srli_epi64, (even, odd) => _mm512_mask_blend_epi32(0xaaaa, even, odd);
    pack (low, high) => _mm512_mask_blend_epi16(0xaaaa_aaaa, low, _mm512_slli_epi32(high, 16));
    select_below (value, limit, then, otherwise) =>
        _mm512_mask_blend_epi32(_mm512_cmplt_epi32_mask(value, limit), otherwise, then);
    any (value) => _mm512_test_epi32_mask(value, value) != 0;
    picker (offsets) => offsets;
    window (window, picker) => _mm512_permutexvar_epi32(picker, window);
    lookup (table, index) => {
        let low = _mm512_loadu_si512(table.as_ptr().cast());
        let high = _mm512_loadu_si512(table.as_ptr().add(16).cast());
        _mm512_permutex2var_epi32(low, index, high)
    };
    pairs { max_of_pairs: _mm512_max_epi32, min_of_pairs: _mm512_min_epi32 }
    (first, second) => {
        let even = _mm512_setr_epi32(0, 2, 4, 6, 8, 10, 12, 14, 16, 18, 20, 22, 24, 26, 28, 30);
        let odd = _mm512_or_si512(even, _mm512_set1_epi32(1));
        (_mm512_permutex2var_epi32(first, even, second), _mm512_permutex2var_epi32(first, odd, second))
    }, ordered (extremes) => extremes;
}
