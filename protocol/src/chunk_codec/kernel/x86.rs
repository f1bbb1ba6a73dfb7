//! Heights from byte planes on SSE4.1 and AVX2.
//!
//! A sum along a row is a prefix sum: within a vector by shifts (Hillis and Steele, "Data parallel
//! algorithms", 1986), from vector to vector by a carry that holds the last lane everywhere. Every
//! row begins with a vertex of its own, so that the 64 others fill whole vectors.

use super::{Heights, restore_on, unzigzag};
use core::arch::x86_64::*;
use terrain::constants::{CELLS, VERTEX_COUNT, VERTICES};

/// Planes that the vectors are made for; wider residuals are rare enough for the plain loop.
const PLANES: usize = 2;

/// The first vertex of a row and the other 64 of every plane, in groups of `N`; nothing for a plane
/// that is not there.
type Row<'a, const N: usize> = (i32, [&'a [[u8; N]]; PLANES]);

/// A row of the planes. All of them hold all vertices.
#[inline(always)]
fn row<'a, const N: usize>(planes: [&'a [u8]; PLANES], index: usize) -> Row<'a, N> {
    let bytes = planes.map(|plane| plane.get(index * VERTICES..(index + 1) * VERTICES).unwrap_or_default());
    let byte = |plane: usize| bytes[plane].first().copied().map_or(0, u32::from);
    let first = unzigzag(byte(0) | byte(1) << 8);
    (first, bytes.map(|row| row.get(1..).unwrap_or_default().as_chunks().0))
}

/// Both planes, if these are one or two whole ones.
#[inline(always)]
fn narrow<'a>(planes: &[&'a [u8]]) -> Option<[&'a [u8]; PLANES]> {
    let narrow = match *planes {
        [low] => [low, &[][..]],
        [low, high] => [low, high],
        _ => return None,
    };
    planes.iter().all(|plane| plane.len() == VERTEX_COUNT).then_some(narrow)
}

/// As [`super::restore`], 4 lanes.
#[target_feature(enable = "sse4.1")]
pub(super) fn restore_sse41(planes: &[&[u8]], first: i32, heights: &mut Heights) -> (i32, i32) {
    let Some(planes) = narrow(planes) else { return restore_on(planes, first, heights) };
    let bytes = |bytes: &[u8; 4]| _mm_cvtepu8_epi32(_mm_cvtsi32_si128(i32::from_le_bytes(*bytes)));
    let (mut edge, mut above) = (first, [_mm_set1_epi32(first); CELLS / 4]);
    let (mut low, mut high) = (_mm_set1_epi32(i32::MAX), _mm_set1_epi32(i32::MIN));
    let (mut edge_low, mut edge_high) = (i32::MAX, i32::MIN);
    for (index, out) in heights.as_chunks_mut::<VERTICES>().0.iter_mut().enumerate() {
        let (rise, [lower, upper]) = row::<4>(planes, index);
        edge = edge.wrapping_add(rise);
        out[0] = edge;
        (edge_low, edge_high) = (edge_low.min(edge), edge_high.max(edge));
        let mut carry = _mm_set1_epi32(rise);
        let mut upper = upper.iter();
        let groups = lower.iter().zip(&mut above).zip(out[1..].as_chunks_mut::<4>().0);
        for ((lower, above), out) in groups {
            let mut word = bytes(lower);
            if let Some(upper) = upper.next() {
                word = _mm_or_si128(word, _mm_slli_epi32(bytes(upper), 8));
            }
            let sign = _mm_sub_epi32(_mm_setzero_si128(), _mm_and_si128(word, _mm_set1_epi32(1)));
            let mut sum = _mm_xor_si128(_mm_srli_epi32(word, 1), sign);
            sum = _mm_add_epi32(sum, _mm_slli_si128(sum, 4));
            sum = _mm_add_epi32(sum, _mm_slli_si128(sum, 8));
            sum = _mm_add_epi32(sum, carry);
            carry = _mm_shuffle_epi32(sum, 0xff);
            *above = _mm_add_epi32(*above, sum);
            low = _mm_min_epi32(low, *above);
            high = _mm_max_epi32(high, *above);
            // SAFETY: `out` holds 4 lanes.
            unsafe { _mm_storeu_si128(out.as_mut_ptr().cast(), *above) };
        }
    }
    let (mut lows, mut highs) = ([0; 4], [0; 4]);
    // SAFETY: both hold 4 lanes.
    unsafe {
        _mm_storeu_si128(lows.as_mut_ptr().cast(), low);
        _mm_storeu_si128(highs.as_mut_ptr().cast(), high);
    }
    (lows.into_iter().fold(edge_low, i32::min), highs.into_iter().fold(edge_high, i32::max))
}

/// As [`super::restore`], 8 lanes.
#[target_feature(enable = "avx2")]
pub(super) fn restore_avx2(planes: &[&[u8]], first: i32, heights: &mut Heights) -> (i32, i32) {
    let Some(planes) = narrow(planes) else { return restore_on(planes, first, heights) };
    let bytes = |bytes: &[u8; 8]| _mm256_cvtepu8_epi32(_mm_cvtsi64_si128(i64::from_le_bytes(*bytes)));
    let last = _mm256_set1_epi32(7);
    let (mut edge, mut above) = (first, [_mm256_set1_epi32(first); CELLS / 8]);
    let (mut low, mut high) = (_mm256_set1_epi32(i32::MAX), _mm256_set1_epi32(i32::MIN));
    let (mut edge_low, mut edge_high) = (i32::MAX, i32::MIN);
    for (index, out) in heights.as_chunks_mut::<VERTICES>().0.iter_mut().enumerate() {
        let (rise, [lower, upper]) = row::<8>(planes, index);
        edge = edge.wrapping_add(rise);
        out[0] = edge;
        (edge_low, edge_high) = (edge_low.min(edge), edge_high.max(edge));
        let mut carry = _mm256_set1_epi32(rise);
        let mut upper = upper.iter();
        let groups = lower.iter().zip(&mut above).zip(out[1..].as_chunks_mut::<8>().0);
        for ((lower, above), out) in groups {
            let mut word = bytes(lower);
            if let Some(upper) = upper.next() {
                word = _mm256_or_si256(word, _mm256_slli_epi32(bytes(upper), 8));
            }
            let sign = _mm256_sub_epi32(_mm256_setzero_si256(), _mm256_and_si256(word, _mm256_set1_epi32(1)));
            let mut sum = _mm256_xor_si256(_mm256_srli_epi32(word, 1), sign);
            sum = _mm256_add_epi32(sum, _mm256_slli_si256(sum, 4));
            sum = _mm256_add_epi32(sum, _mm256_slli_si256(sum, 8));
            // These shifts stay within halves: the low half's last lane goes to every lane of the
            // high half.
            let half = _mm256_permute2x128_si256(sum, sum, 0x08);
            sum = _mm256_add_epi32(sum, _mm256_shuffle_epi32(half, 0xff));
            sum = _mm256_add_epi32(sum, carry);
            carry = _mm256_permutevar8x32_epi32(sum, last);
            *above = _mm256_add_epi32(*above, sum);
            low = _mm256_min_epi32(low, *above);
            high = _mm256_max_epi32(high, *above);
            // SAFETY: `out` holds 8 lanes.
            unsafe { _mm256_storeu_si256(out.as_mut_ptr().cast(), *above) };
        }
    }
    let (mut lows, mut highs) = ([0; 8], [0; 8]);
    // SAFETY: both hold 8 lanes.
    unsafe {
        _mm256_storeu_si256(lows.as_mut_ptr().cast(), low);
        _mm256_storeu_si256(highs.as_mut_ptr().cast(), high);
    }
    (lows.into_iter().fold(edge_low, i32::min), highs.into_iter().fold(edge_high, i32::max))
}
