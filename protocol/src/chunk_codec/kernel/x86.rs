//! Heights from byte planes on SSE4.1 and AVX2.
//!
//! A sum along a row is a prefix sum: within a vector by shifts (Hillis and Steele, "Data parallel
//! algorithms", 1986), from vector to vector by a carry that holds the last lane everywhere. Every
//! row begins with a vertex of its own, so that the 64 others fill whole vectors. AVX2 sums the
//! rows in 16 bits that fit, which are nearly all.

use super::{Heights, restore_on, unzigzag};
use core::arch::x86_64::*;
use terrain::constants::{CELLS, VERTEX_COUNT, VERTICES};

/// Planes that the vectors are made for; wider residuals are rare enough for the plain loop.
const PLANES: usize = 2;

/// A row of both planes: the first vertex's residual, and the bytes of the 64 others.
type Row<'a> = (i32, [&'a [u8; CELLS]; PLANES]);

/// A row of the planes. All of them hold all vertices; one that is not there counts as 0.
#[inline(always)]
fn row<'a>(planes: [&'a [u8]; PLANES], index: usize) -> Row<'a> {
    let bytes = planes.map(|plane| {
        let row = plane.get(index * VERTICES..(index + 1) * VERTICES).unwrap_or(&[0; VERTICES]);
        let (first, others) = row.split_first().unwrap_or((&0, &[]));
        (u32::from(*first), others.first_chunk().unwrap_or(&[0; CELLS]))
    });
    (unzigzag(bytes[0].0 | bytes[1].0 << 8), bytes.map(|(_, others)| others))
}

/// Both planes, if these are at most two whole ones.
#[inline(always)]
fn narrow<'a>(planes: &[&'a [u8]]) -> Option<[&'a [u8]; PLANES]> {
    let narrow = match *planes {
        [] => [&[][..]; PLANES],
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
        let (rise, [lower, upper]) = row(planes, index);
        edge = edge.wrapping_add(rise);
        out[0] = edge;
        (edge_low, edge_high) = (edge_low.min(edge), edge_high.max(edge));
        let mut carry = _mm_set1_epi32(rise);
        let bytes_of = lower.as_chunks::<4>().0.iter().zip(upper.as_chunks::<4>().0);
        let groups = bytes_of.zip(&mut above).zip(out[1..].as_chunks_mut::<4>().0);
        for (((lower, upper), above), out) in groups {
            let word = _mm_or_si128(bytes(lower), _mm_slli_epi32(bytes(upper), 8));
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

/// Largest rise of a row's first vertex, and largest sum of the upper bytes of the other 64, with
/// which no sum of the row leaves 16 bits: a residual with upper byte `u` is at most `128 (u + 1)`,
/// so a sum is at most `8192 + 128 (127 + 64) < 2^15`.
const NARROW: (i32, i32) = (1 << 13, 127);

/// The sums of a row behind its first vertex, the heights of the row above, and the extremes.
struct Rows {
    above: [__m256i; CELLS / 8],
    low: __m256i,
    high: __m256i,
}

impl Rows {
    /// Adds 8 sums to the heights above them.
    #[inline]
    #[target_feature(enable = "avx2")]
    fn put(&mut self, group: usize, sums: __m256i, out: &mut [i32; 8]) {
        let heights = _mm256_add_epi32(self.above[group], sums);
        self.above[group] = heights;
        self.low = _mm256_min_epi32(self.low, heights);
        self.high = _mm256_max_epi32(self.high, heights);
        // SAFETY: `out` holds 8 lanes.
        unsafe { _mm256_storeu_si256(out.as_mut_ptr().cast(), heights) };
    }

    /// A row, 8 lanes of 32 bits.
    #[inline]
    #[target_feature(enable = "avx2")]
    fn wide(&mut self, (rise, [lower, upper]): Row<'_>, out: &mut [[i32; 8]]) {
        let bytes = |bytes: &[u8; 8]| _mm256_cvtepu8_epi32(_mm_cvtsi64_si128(i64::from_le_bytes(*bytes)));
        let last = _mm256_set1_epi32(7);
        let mut carry = _mm256_set1_epi32(rise);
        let groups = lower.as_chunks::<8>().0.iter().zip(upper.as_chunks::<8>().0).zip(out);
        for (group, ((lower, upper), out)) in groups.enumerate() {
            let word = _mm256_or_si256(bytes(lower), _mm256_slli_epi32(bytes(upper), 8));
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
            self.put(group, sum, out);
        }
    }

    /// A row whose sums fit 16 bits ([`NARROW`]), 16 lanes. The sums are widened before they are
    /// added to heights.
    #[inline]
    #[target_feature(enable = "avx2")]
    fn narrow(&mut self, (rise, [lower, upper]): Row<'_>, out: &mut [[i32; 8]]) {
        // SAFETY: an array holds 16 bytes.
        let bytes =
            |bytes: &[u8; 16]| unsafe { _mm256_cvtepu8_epi16(_mm_loadu_si128(bytes.as_ptr().cast())) };
        let last = _mm256_set1_epi16(0x0f0e);
        let mut carry = _mm256_set1_epi16(rise as i16);
        let pairs = lower.as_chunks::<16>().0.iter().zip(upper.as_chunks::<16>().0);
        let pairs = pairs.zip(out.as_chunks_mut::<2>().0);
        for (pair, ((lower, upper), [out_low, out_high])) in pairs.enumerate() {
            let word = _mm256_or_si256(bytes(lower), _mm256_slli_epi16(bytes(upper), 8));
            let sign = _mm256_sub_epi16(_mm256_setzero_si256(), _mm256_and_si256(word, _mm256_set1_epi16(1)));
            let mut sum = _mm256_xor_si256(_mm256_srli_epi16(word, 1), sign);
            sum = _mm256_add_epi16(sum, _mm256_slli_si256(sum, 2));
            sum = _mm256_add_epi16(sum, _mm256_slli_si256(sum, 4));
            sum = _mm256_add_epi16(sum, _mm256_slli_si256(sum, 8));
            // As above: these shifts stay within halves.
            let half = _mm256_permute2x128_si256(sum, sum, 0x08);
            sum = _mm256_add_epi16(sum, _mm256_shuffle_epi8(half, last));
            let total = _mm256_shuffle_epi8(_mm256_permute4x64_epi64(sum, 0xff), last);
            sum = _mm256_add_epi16(sum, carry);
            carry = _mm256_add_epi16(carry, total);
            let (first, second) = (_mm256_castsi256_si128(sum), _mm256_extracti128_si256(sum, 1));
            self.put(2 * pair, _mm256_cvtepi16_epi32(first), out_low);
            self.put(2 * pair + 1, _mm256_cvtepi16_epi32(second), out_high);
        }
    }
}

/// Whether the sums of a row fit 16 bits by [`NARROW`].
#[inline]
#[target_feature(enable = "avx2")]
fn is_narrow((rise, [_, upper]): Row<'_>) -> bool {
    let mut sums = _mm256_setzero_si256();
    for group in upper.as_chunks::<32>().0 {
        // SAFETY: a group holds 32 bytes.
        let bytes = unsafe { _mm256_loadu_si256(group.as_ptr().cast()) };
        sums = _mm256_add_epi64(sums, _mm256_sad_epu8(bytes, _mm256_setzero_si256()));
    }
    let sums = _mm_add_epi64(_mm256_castsi256_si128(sums), _mm256_extracti128_si256(sums, 1));
    // At most 64 * 255.
    let sum = _mm_cvtsi128_si32(_mm_add_epi64(sums, _mm_unpackhi_epi64(sums, sums)));
    rise.abs() <= NARROW.0 && sum <= NARROW.1
}

/// As [`super::restore`], 8 or 16 lanes.
#[target_feature(enable = "avx2")]
pub(super) fn restore_avx2(planes: &[&[u8]], first: i32, heights: &mut Heights) -> (i32, i32) {
    let Some(planes) = narrow(planes) else { return restore_on(planes, first, heights) };
    let above = [_mm256_set1_epi32(first); CELLS / 8];
    let mut rows = Rows { above, low: _mm256_set1_epi32(i32::MAX), high: _mm256_set1_epi32(i32::MIN) };
    let (mut edge, mut edge_low, mut edge_high) = (first, i32::MAX, i32::MIN);
    for (index, out) in heights.as_chunks_mut::<VERTICES>().0.iter_mut().enumerate() {
        let row = row(planes, index);
        edge = edge.wrapping_add(row.0);
        out[0] = edge;
        (edge_low, edge_high) = (edge_low.min(edge), edge_high.max(edge));
        let out = out[1..].as_chunks_mut::<8>().0;
        if is_narrow(row) {
            rows.narrow(row, out);
        } else {
            rows.wide(row, out);
        }
    }
    let (mut lows, mut highs) = ([0; 8], [0; 8]);
    // SAFETY: both hold 8 lanes.
    unsafe {
        _mm256_storeu_si256(lows.as_mut_ptr().cast(), rows.low);
        _mm256_storeu_si256(highs.as_mut_ptr().cast(), rows.high);
    }
    (lows.into_iter().fold(edge_low, i32::min), highs.into_iter().fold(edge_high, i32::max))
}
