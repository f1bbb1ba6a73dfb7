//! Vectors of x86-64: SSE4.1, AVX2 and AVX-512.
//!
//! One line per operation. Each type may only be used where its features were detected
//! ([`super::Kernel`]).

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

impl Lanes for Sse41 {
    const COUNT: usize = 4;
    type Half = i32;

    #[inline(always)]
    unsafe fn load(from: *const i32) -> Self {
        // SAFETY: the caller vouches for the CPU's features and the pointer.
        unsafe { Self(_mm_loadu_si128(from.cast())) }
    }
    #[inline(always)]
    unsafe fn store(self, to: *mut i32) {
        // SAFETY: the caller vouches for the CPU's features and the pointer.
        unsafe { _mm_storeu_si128(to.cast(), self.0) }
    }
    #[inline(always)]
    unsafe fn splat(value: i32) -> Self {
        // SAFETY: the caller vouches for the CPU's features and the pointer.
        unsafe { Self(_mm_set1_epi32(value)) }
    }
    #[inline(always)]
    unsafe fn ramp() -> Self {
        // SAFETY: the caller vouches for the CPU's features and the pointer.
        unsafe { Self(_mm_setr_epi32(0, 1, 2, 3)) }
    }
    #[inline(always)]
    unsafe fn add(self, other: Self) -> Self {
        // SAFETY: the caller vouches for the CPU's features and the pointer.
        unsafe { Self(_mm_add_epi32(self.0, other.0)) }
    }
    #[inline(always)]
    unsafe fn sub(self, other: Self) -> Self {
        // SAFETY: the caller vouches for the CPU's features and the pointer.
        unsafe { Self(_mm_sub_epi32(self.0, other.0)) }
    }
    #[inline(always)]
    unsafe fn mul(self, other: Self) -> Self {
        // SAFETY: the caller vouches for the CPU's features and the pointer.
        unsafe { Self(_mm_mullo_epi32(self.0, other.0)) }
    }
    #[inline(always)]
    unsafe fn mul_hi(self, other: Self) -> Self {
        // SAFETY: the caller vouches for the CPU's features and the pointer.
        unsafe {
            let even = _mm_mul_epi32(self.0, other.0);
            let odd = _mm_mul_epi32(_mm_srli_epi64(self.0, 32), _mm_srli_epi64(other.0, 32));
            Self(_mm_blend_epi16(_mm_srli_epi64(even, 32), odd, 0b1100_1100))
        }
    }
    #[inline(always)]
    unsafe fn mul_hi_u(self, other: Self) -> Self {
        // SAFETY: the caller vouches for the CPU's features and the pointer.
        unsafe {
            let even = _mm_mul_epu32(self.0, other.0);
            let odd = _mm_mul_epu32(_mm_srli_epi64(self.0, 32), _mm_srli_epi64(other.0, 32));
            Self(_mm_blend_epi16(_mm_srli_epi64(even, 32), odd, 0b1100_1100))
        }
    }
    #[inline(always)]
    unsafe fn dot(self, other: Self) -> Self {
        // SAFETY: the caller vouches for the CPU's features and the pointer.
        unsafe { Self(_mm_madd_epi16(self.0, other.0)) }
    }
    #[inline(always)]
    unsafe fn and(self, other: Self) -> Self {
        // SAFETY: the caller vouches for the CPU's features and the pointer.
        unsafe { Self(_mm_and_si128(self.0, other.0)) }
    }
    #[inline(always)]
    unsafe fn xor(self, other: Self) -> Self {
        // SAFETY: the caller vouches for the CPU's features and the pointer.
        unsafe { Self(_mm_xor_si128(self.0, other.0)) }
    }
    #[inline(always)]
    unsafe fn min(self, other: Self) -> Self {
        // SAFETY: the caller vouches for the CPU's features and the pointer.
        unsafe { Self(_mm_min_epi32(self.0, other.0)) }
    }
    #[inline(always)]
    unsafe fn max(self, other: Self) -> Self {
        // SAFETY: the caller vouches for the CPU's features and the pointer.
        unsafe { Self(_mm_max_epi32(self.0, other.0)) }
    }
    #[inline(always)]
    unsafe fn abs(self) -> Self {
        // SAFETY: the caller vouches for the CPU's features and the pointer.
        unsafe { Self(_mm_abs_epi32(self.0)) }
    }
    #[inline(always)]
    unsafe fn shl(self, bits: u32) -> Self {
        // SAFETY: the caller vouches for the CPU's features and the pointer.
        unsafe { Self(_mm_sll_epi32(self.0, _mm_cvtsi32_si128(bits as i32))) }
    }
    #[inline(always)]
    unsafe fn shr(self, bits: u32) -> Self {
        // SAFETY: the caller vouches for the CPU's features and the pointer.
        unsafe { Self(_mm_srl_epi32(self.0, _mm_cvtsi32_si128(bits as i32))) }
    }
    #[inline(always)]
    unsafe fn sar(self, bits: u32) -> Self {
        // SAFETY: the caller vouches for the CPU's features and the pointer.
        unsafe { Self(_mm_sra_epi32(self.0, _mm_cvtsi32_si128(bits as i32))) }
    }
    #[inline(always)]
    unsafe fn pack(self, high: Self) -> Self {
        // SAFETY: the caller vouches for the CPU's features and the pointer.
        unsafe { Self(_mm_blend_epi16(self.0, _mm_slli_epi32(high.0, 16), 0b1010_1010)) }
    }
    #[inline(always)]
    unsafe fn select_below(self, limit: Self, then: Self, otherwise: Self) -> Self {
        // SAFETY: the caller vouches for the CPU's features and the pointer.
        unsafe { Self(_mm_blendv_epi8(otherwise.0, then.0, _mm_cmplt_epi32(self.0, limit.0))) }
    }
    #[inline(always)]
    unsafe fn any(self) -> bool {
        // SAFETY: the caller vouches for the CPU's features and the pointer.
        unsafe { _mm_testz_si128(self.0, self.0) == 0 }
    }
    #[inline(always)]
    unsafe fn picker(offsets: Self) -> Self {
        // SAFETY: the caller vouches for the CPU's features and the pointer.
        unsafe {
            // Byte shuffles name bytes: four per lane.
            let bytes = _mm_mullo_epi32(offsets.0, _mm_set1_epi32(0x0404_0404));
            Self(_mm_add_epi32(bytes, _mm_set1_epi32(0x0302_0100)))
        }
    }
    #[inline(always)]
    unsafe fn window(from: *const i32, picker: Self) -> Self {
        // SAFETY: the caller vouches for the CPU's features and the pointer.
        unsafe { Self(_mm_shuffle_epi8(_mm_loadu_si128(from.cast()), picker.0)) }
    }
    #[inline(always)]
    unsafe fn lookup(table: &[i32; 32], index: Self) -> Self {
        // SAFETY: the caller vouches for the CPU's features and the pointer.
        unsafe {
            let mut at = [0; 4];
            index.store(at.as_mut_ptr());
            Self::load(at.map(|index: i32| table[index as usize & 31]).as_ptr())
        }
    }
    #[inline(always)]
    unsafe fn max_of_pairs(self, next: Self) -> Self {
        // SAFETY: the caller vouches for the CPU's features and the pointer.
        unsafe {
            let (a, b) = (_mm_castsi128_ps(self.0), _mm_castsi128_ps(next.0));
            let even = _mm_castps_si128(_mm_shuffle_ps(a, b, 0b10_00_10_00));
            let odd = _mm_castps_si128(_mm_shuffle_ps(a, b, 0b11_01_11_01));
            Self(_mm_max_epi32(even, odd))
        }
    }
    #[inline(always)]
    unsafe fn min_of_pairs(self, next: Self) -> Self {
        // SAFETY: the caller vouches for the CPU's features and the pointer.
        unsafe {
            let (a, b) = (_mm_castsi128_ps(self.0), _mm_castsi128_ps(next.0));
            let even = _mm_castps_si128(_mm_shuffle_ps(a, b, 0b10_00_10_00));
            let odd = _mm_castps_si128(_mm_shuffle_ps(a, b, 0b11_01_11_01));
            Self(_mm_min_epi32(even, odd))
        }
    }
}

impl Lanes for Avx2 {
    const COUNT: usize = 8;
    type Half = Sse41;

    #[inline(always)]
    unsafe fn load(from: *const i32) -> Self {
        // SAFETY: the caller vouches for the CPU's features and the pointer.
        unsafe { Self(_mm256_loadu_si256(from.cast())) }
    }
    #[inline(always)]
    unsafe fn store(self, to: *mut i32) {
        // SAFETY: the caller vouches for the CPU's features and the pointer.
        unsafe { _mm256_storeu_si256(to.cast(), self.0) }
    }
    #[inline(always)]
    unsafe fn splat(value: i32) -> Self {
        // SAFETY: the caller vouches for the CPU's features and the pointer.
        unsafe { Self(_mm256_set1_epi32(value)) }
    }
    #[inline(always)]
    unsafe fn ramp() -> Self {
        // SAFETY: the caller vouches for the CPU's features and the pointer.
        unsafe { Self(_mm256_setr_epi32(0, 1, 2, 3, 4, 5, 6, 7)) }
    }
    #[inline(always)]
    unsafe fn add(self, other: Self) -> Self {
        // SAFETY: the caller vouches for the CPU's features and the pointer.
        unsafe { Self(_mm256_add_epi32(self.0, other.0)) }
    }
    #[inline(always)]
    unsafe fn sub(self, other: Self) -> Self {
        // SAFETY: the caller vouches for the CPU's features and the pointer.
        unsafe { Self(_mm256_sub_epi32(self.0, other.0)) }
    }
    #[inline(always)]
    unsafe fn mul(self, other: Self) -> Self {
        // SAFETY: the caller vouches for the CPU's features and the pointer.
        unsafe { Self(_mm256_mullo_epi32(self.0, other.0)) }
    }
    #[inline(always)]
    unsafe fn mul_hi(self, other: Self) -> Self {
        // SAFETY: the caller vouches for the CPU's features and the pointer.
        unsafe {
            let even = _mm256_mul_epi32(self.0, other.0);
            let odd = _mm256_mul_epi32(_mm256_srli_epi64(self.0, 32), _mm256_srli_epi64(other.0, 32));
            Self(_mm256_blend_epi32(_mm256_srli_epi64(even, 32), odd, 0b1010_1010))
        }
    }
    #[inline(always)]
    unsafe fn mul_hi_u(self, other: Self) -> Self {
        // SAFETY: the caller vouches for the CPU's features and the pointer.
        unsafe {
            let even = _mm256_mul_epu32(self.0, other.0);
            let odd = _mm256_mul_epu32(_mm256_srli_epi64(self.0, 32), _mm256_srli_epi64(other.0, 32));
            Self(_mm256_blend_epi32(_mm256_srli_epi64(even, 32), odd, 0b1010_1010))
        }
    }
    #[inline(always)]
    unsafe fn dot(self, other: Self) -> Self {
        // SAFETY: the caller vouches for the CPU's features and the pointer.
        unsafe { Self(_mm256_madd_epi16(self.0, other.0)) }
    }
    #[inline(always)]
    unsafe fn and(self, other: Self) -> Self {
        // SAFETY: the caller vouches for the CPU's features and the pointer.
        unsafe { Self(_mm256_and_si256(self.0, other.0)) }
    }
    #[inline(always)]
    unsafe fn xor(self, other: Self) -> Self {
        // SAFETY: the caller vouches for the CPU's features and the pointer.
        unsafe { Self(_mm256_xor_si256(self.0, other.0)) }
    }
    #[inline(always)]
    unsafe fn min(self, other: Self) -> Self {
        // SAFETY: the caller vouches for the CPU's features and the pointer.
        unsafe { Self(_mm256_min_epi32(self.0, other.0)) }
    }
    #[inline(always)]
    unsafe fn max(self, other: Self) -> Self {
        // SAFETY: the caller vouches for the CPU's features and the pointer.
        unsafe { Self(_mm256_max_epi32(self.0, other.0)) }
    }
    #[inline(always)]
    unsafe fn abs(self) -> Self {
        // SAFETY: the caller vouches for the CPU's features and the pointer.
        unsafe { Self(_mm256_abs_epi32(self.0)) }
    }
    #[inline(always)]
    unsafe fn shl(self, bits: u32) -> Self {
        // SAFETY: the caller vouches for the CPU's features and the pointer.
        unsafe { Self(_mm256_sll_epi32(self.0, _mm_cvtsi32_si128(bits as i32))) }
    }
    #[inline(always)]
    unsafe fn shr(self, bits: u32) -> Self {
        // SAFETY: the caller vouches for the CPU's features and the pointer.
        unsafe { Self(_mm256_srl_epi32(self.0, _mm_cvtsi32_si128(bits as i32))) }
    }
    #[inline(always)]
    unsafe fn sar(self, bits: u32) -> Self {
        // SAFETY: the caller vouches for the CPU's features and the pointer.
        unsafe { Self(_mm256_sra_epi32(self.0, _mm_cvtsi32_si128(bits as i32))) }
    }
    #[inline(always)]
    unsafe fn pack(self, high: Self) -> Self {
        // SAFETY: the caller vouches for the CPU's features and the pointer.
        unsafe { Self(_mm256_blend_epi16(self.0, _mm256_slli_epi32(high.0, 16), 0b1010_1010)) }
    }
    #[inline(always)]
    unsafe fn select_below(self, limit: Self, then: Self, otherwise: Self) -> Self {
        // SAFETY: the caller vouches for the CPU's features and the pointer.
        unsafe { Self(_mm256_blendv_epi8(otherwise.0, then.0, _mm256_cmpgt_epi32(limit.0, self.0))) }
    }
    #[inline(always)]
    unsafe fn any(self) -> bool {
        // SAFETY: the caller vouches for the CPU's features and the pointer.
        unsafe { _mm256_testz_si256(self.0, self.0) == 0 }
    }
    #[inline(always)]
    unsafe fn picker(offsets: Self) -> Self {
        offsets
    }
    #[inline(always)]
    unsafe fn window(from: *const i32, picker: Self) -> Self {
        // SAFETY: the caller vouches for the CPU's features and the pointer.
        unsafe { Self(_mm256_permutevar8x32_epi32(_mm256_loadu_si256(from.cast()), picker.0)) }
    }
    #[inline(always)]
    unsafe fn lookup(table: &[i32; 32], index: Self) -> Self {
        // SAFETY: the caller vouches for the CPU's features and the pointer.
        unsafe {
            // Masked, so that the gather cannot leave the table.
            let index = _mm256_and_si256(index.0, _mm256_set1_epi32(31));
            Self(_mm256_i32gather_epi32(table.as_ptr(), index, 4))
        }
    }
    #[inline(always)]
    unsafe fn max_of_pairs(self, next: Self) -> Self {
        // SAFETY: the caller vouches for the CPU's features and the pointer.
        unsafe {
            let (a, b) = (_mm256_castsi256_ps(self.0), _mm256_castsi256_ps(next.0));
            let even = _mm256_castps_si256(_mm256_shuffle_ps(a, b, 0b10_00_10_00));
            let odd = _mm256_castps_si256(_mm256_shuffle_ps(a, b, 0b11_01_11_01));
            // The shuffles work in halves of 128 bits; put the four quarters in order.
            Self(_mm256_permute4x64_epi64(_mm256_max_epi32(even, odd), 0b11_01_10_00))
        }
    }
    #[inline(always)]
    unsafe fn min_of_pairs(self, next: Self) -> Self {
        // SAFETY: the caller vouches for the CPU's features and the pointer.
        unsafe {
            let (a, b) = (_mm256_castsi256_ps(self.0), _mm256_castsi256_ps(next.0));
            let even = _mm256_castps_si256(_mm256_shuffle_ps(a, b, 0b10_00_10_00));
            let odd = _mm256_castps_si256(_mm256_shuffle_ps(a, b, 0b11_01_11_01));
            // The shuffles work in halves of 128 bits; put the four quarters in order.
            Self(_mm256_permute4x64_epi64(_mm256_min_epi32(even, odd), 0b11_01_10_00))
        }
    }
}

impl Lanes for Avx512 {
    const COUNT: usize = 16;
    type Half = Avx2;

    #[inline(always)]
    unsafe fn load(from: *const i32) -> Self {
        // SAFETY: the caller vouches for the CPU's features and the pointer.
        unsafe { Self(_mm512_loadu_si512(from.cast())) }
    }
    #[inline(always)]
    unsafe fn store(self, to: *mut i32) {
        // SAFETY: the caller vouches for the CPU's features and the pointer.
        unsafe { _mm512_storeu_si512(to.cast(), self.0) }
    }
    #[inline(always)]
    unsafe fn splat(value: i32) -> Self {
        // SAFETY: the caller vouches for the CPU's features and the pointer.
        unsafe { Self(_mm512_set1_epi32(value)) }
    }
    #[inline(always)]
    unsafe fn ramp() -> Self {
        // SAFETY: the caller vouches for the CPU's features and the pointer.
        unsafe { Self(_mm512_setr_epi32(0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15)) }
    }
    #[inline(always)]
    unsafe fn add(self, other: Self) -> Self {
        // SAFETY: the caller vouches for the CPU's features and the pointer.
        unsafe { Self(_mm512_add_epi32(self.0, other.0)) }
    }
    #[inline(always)]
    unsafe fn sub(self, other: Self) -> Self {
        // SAFETY: the caller vouches for the CPU's features and the pointer.
        unsafe { Self(_mm512_sub_epi32(self.0, other.0)) }
    }
    #[inline(always)]
    unsafe fn mul(self, other: Self) -> Self {
        // SAFETY: the caller vouches for the CPU's features and the pointer.
        unsafe { Self(_mm512_mullo_epi32(self.0, other.0)) }
    }
    #[inline(always)]
    unsafe fn mul_hi(self, other: Self) -> Self {
        // SAFETY: the caller vouches for the CPU's features and the pointer.
        unsafe {
            let even = _mm512_mul_epi32(self.0, other.0);
            let odd = _mm512_mul_epi32(_mm512_srli_epi64(self.0, 32), _mm512_srli_epi64(other.0, 32));
            Self(_mm512_mask_blend_epi32(0xaaaa, _mm512_srli_epi64(even, 32), odd))
        }
    }
    #[inline(always)]
    unsafe fn mul_hi_u(self, other: Self) -> Self {
        // SAFETY: the caller vouches for the CPU's features and the pointer.
        unsafe {
            let even = _mm512_mul_epu32(self.0, other.0);
            let odd = _mm512_mul_epu32(_mm512_srli_epi64(self.0, 32), _mm512_srli_epi64(other.0, 32));
            Self(_mm512_mask_blend_epi32(0xaaaa, _mm512_srli_epi64(even, 32), odd))
        }
    }
    #[inline(always)]
    unsafe fn dot(self, other: Self) -> Self {
        // SAFETY: the caller vouches for the CPU's features and the pointer.
        unsafe { Self(_mm512_madd_epi16(self.0, other.0)) }
    }
    #[inline(always)]
    unsafe fn and(self, other: Self) -> Self {
        // SAFETY: the caller vouches for the CPU's features and the pointer.
        unsafe { Self(_mm512_and_si512(self.0, other.0)) }
    }
    #[inline(always)]
    unsafe fn xor(self, other: Self) -> Self {
        // SAFETY: the caller vouches for the CPU's features and the pointer.
        unsafe { Self(_mm512_xor_si512(self.0, other.0)) }
    }
    #[inline(always)]
    unsafe fn min(self, other: Self) -> Self {
        // SAFETY: the caller vouches for the CPU's features and the pointer.
        unsafe { Self(_mm512_min_epi32(self.0, other.0)) }
    }
    #[inline(always)]
    unsafe fn max(self, other: Self) -> Self {
        // SAFETY: the caller vouches for the CPU's features and the pointer.
        unsafe { Self(_mm512_max_epi32(self.0, other.0)) }
    }
    #[inline(always)]
    unsafe fn abs(self) -> Self {
        // SAFETY: the caller vouches for the CPU's features and the pointer.
        unsafe { Self(_mm512_abs_epi32(self.0)) }
    }
    #[inline(always)]
    unsafe fn shl(self, bits: u32) -> Self {
        // SAFETY: the caller vouches for the CPU's features and the pointer.
        unsafe { Self(_mm512_sll_epi32(self.0, _mm_cvtsi32_si128(bits as i32))) }
    }
    #[inline(always)]
    unsafe fn shr(self, bits: u32) -> Self {
        // SAFETY: the caller vouches for the CPU's features and the pointer.
        unsafe { Self(_mm512_srl_epi32(self.0, _mm_cvtsi32_si128(bits as i32))) }
    }
    #[inline(always)]
    unsafe fn sar(self, bits: u32) -> Self {
        // SAFETY: the caller vouches for the CPU's features and the pointer.
        unsafe { Self(_mm512_sra_epi32(self.0, _mm_cvtsi32_si128(bits as i32))) }
    }
    #[inline(always)]
    unsafe fn pack(self, high: Self) -> Self {
        // SAFETY: the caller vouches for the CPU's features and the pointer.
        unsafe { Self(_mm512_mask_blend_epi16(0xaaaa_aaaa, self.0, _mm512_slli_epi32(high.0, 16))) }
    }
    #[inline(always)]
    unsafe fn select_below(self, limit: Self, then: Self, otherwise: Self) -> Self {
        // SAFETY: the caller vouches for the CPU's features and the pointer.
        unsafe {
            Self(_mm512_mask_blend_epi32(_mm512_cmplt_epi32_mask(self.0, limit.0), otherwise.0, then.0))
        }
    }
    #[inline(always)]
    unsafe fn any(self) -> bool {
        // SAFETY: the caller vouches for the CPU's features and the pointer.
        unsafe { _mm512_test_epi32_mask(self.0, self.0) != 0 }
    }
    #[inline(always)]
    unsafe fn picker(offsets: Self) -> Self {
        offsets
    }
    #[inline(always)]
    unsafe fn window(from: *const i32, picker: Self) -> Self {
        // SAFETY: the caller vouches for the CPU's features and the pointer.
        unsafe { Self(_mm512_permutexvar_epi32(picker.0, _mm512_loadu_si512(from.cast()))) }
    }
    #[inline(always)]
    unsafe fn lookup(table: &[i32; 32], index: Self) -> Self {
        // SAFETY: the caller vouches for the CPU's features and the pointer.
        unsafe {
            let (low, high) = (
                _mm512_loadu_si512(table.as_ptr().cast()),
                _mm512_loadu_si512(table.as_ptr().add(16).cast()),
            );
            Self(_mm512_permutex2var_epi32(low, index.0, high))
        }
    }
    #[inline(always)]
    unsafe fn max_of_pairs(self, next: Self) -> Self {
        // SAFETY: the caller vouches for the CPU's features and the pointer.
        unsafe {
            let even = _mm512_setr_epi32(0, 2, 4, 6, 8, 10, 12, 14, 16, 18, 20, 22, 24, 26, 28, 30);
            let odd = _mm512_or_si512(even, _mm512_set1_epi32(1));
            let (even, odd) = (
                _mm512_permutex2var_epi32(self.0, even, next.0),
                _mm512_permutex2var_epi32(self.0, odd, next.0),
            );
            Self(_mm512_max_epi32(even, odd))
        }
    }
    #[inline(always)]
    unsafe fn min_of_pairs(self, next: Self) -> Self {
        // SAFETY: the caller vouches for the CPU's features and the pointer.
        unsafe {
            let even = _mm512_setr_epi32(0, 2, 4, 6, 8, 10, 12, 14, 16, 18, 20, 22, 24, 26, 28, 30);
            let odd = _mm512_or_si512(even, _mm512_set1_epi32(1));
            let (even, odd) = (
                _mm512_permutex2var_epi32(self.0, even, next.0),
                _mm512_permutex2var_epi32(self.0, odd, next.0),
            );
            Self(_mm512_min_epi32(even, odd))
        }
    }
}
