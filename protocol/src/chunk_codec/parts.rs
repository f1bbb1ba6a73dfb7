//! Residuals as parts: plain low bits, whole byte planes above them, and packed bits above those.
//!
//! The low bits of noise are noise: coding does not shorten them and takes time to decode. So the
//! lowest 0, 1, 2, 4 or 8 bits of every residual are stored plain. The width of the widest residual
//! determines the layout of the rest. All bytes of the rest except the highest become planes of one
//! byte a residual. The 1 to 8 bits of the highest byte are packed into fields of 1, 2, 4 or 8
//! bits, because a Huffman code takes at least one bit per symbol, and the upper bits of most
//! residuals carry less information.
//!
//! A part follows its length (u16). A part as long as its content is the content itself, a shorter
//! one is a frame of [`super::entropy`].

use super::entropy::{self, Effort};
use super::kernel::{self, Kernel};
use crate::error::ChunkError;
use crate::limits::MAX_RESIDUAL_BITS;
use terrain::constants::VERTEX_COUNT;

/// Most byte planes of a chunk, the packed one included.
const MAX_PLANES: usize = MAX_RESIDUAL_BITS.div_ceil(8) as usize;

/// The layout of residuals of a width.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Layout {
    /// Planes of a byte a residual.
    whole: usize,
    /// Bits of a field of the packed plane; 0 where all residuals are 0 and there is none.
    field: u32,
}

impl Layout {
    /// The layout of residuals below `2^width`; none if no valid chunk has this width.
    pub(super) fn of_width(width: u32) -> Option<Self> {
        match width {
            0 => Some(Self { whole: 0, field: 0 }),
            1..=MAX_RESIDUAL_BITS => {
                let whole = (width - 1) / 8;
                Some(Self { whole: whole as usize, field: (width - 8 * whole).next_power_of_two() })
            }
            _ => None,
        }
    }

    /// Bytes of the packed plane of `count` residuals.
    const fn packed(self, count: usize) -> usize {
        packed_bytes(count, self.field)
    }
}

/// Bits of the widest of some residuals, from the bitwise OR of all of them.
pub(super) const fn width(or_of_all: u32) -> u32 {
    u32::BITS - or_of_all.leading_zeros()
}

/// Appends the parts of residuals below `2^width`.
pub(super) fn push(kernel: Kernel, residuals: &[u32], width: u32, effort: Effort, out: &mut Vec<u8>) {
    if width == 0 {
        return;
    }
    let plain = plain_bits(residuals, width, effort);
    let Some(layout) = Layout::of_width(width - plain) else { return };
    let (mut plane, mut packed) = ([0; VERTEX_COUNT], [0; VERTEX_COUNT]);
    let plane = &mut plane[..residuals.len()];
    out.push(plain as u8);
    if plain > 0 {
        kernel::split(kernel, residuals, 0, (0xff_u16 >> (8 - plain)) as u8, plane);
        let packed = &mut packed[..packed_bytes(residuals.len(), plain)];
        kernel::pack(kernel, plane, plain, packed);
        out.extend_from_slice(packed);
    }
    for index in 0..layout.whole as u32 {
        kernel::split(kernel, residuals, plain + 8 * index, 0xff, plane);
        push_part(plane, effort, out);
    }
    kernel::split(kernel, residuals, plain + 8 * layout.whole as u32, 0xff, plane);
    if layout.field == 8 {
        push_part(plane, effort, out);
        return;
    }
    let packed = &mut packed[..layout.packed(residuals.len())];
    kernel::pack(kernel, plane, layout.field, packed);
    push_part(packed, effort, out);
}

/// One residual in this number is sampled to choose the number of plain bits. The sample is cheap,
/// and a poor choice costs a few bytes.
const SAMPLED: usize = 7;

/// The number of plain low bits of residuals below `2^width`; less than `width`.
fn plain_bits(residuals: &[u32], width: u32, effort: Effort) -> u32 {
    // Magnitudes are about exponentially distributed. With a mean of `m` times the range of the
    // plain bits, leaving these uncoded costs 0.06 / m^2 bits a residual: at most a thirtieth of a
    // bit with the compact effort.
    let sampled = residuals.iter().step_by(SAMPLED).map(|residual| u64::from(*residual));
    let mean = sampled.clone().sum::<u64>() / sampled.count().max(1) as u64;
    let enough = match effort {
        Effort::Compact => [(8, 384), (4, 24), (2, 6), (1, 3)],
        // More bytes for less time: the fast coder would hardly shorten these bits.
        Effort::Fast => [(8, 12), (4, 6), (2, 3), (1, 2)],
    };
    let fits = |(bits, least): &&(u32, u64)| *bits < width && mean >= *least;
    enough.iter().find(fits).map_or(0, |(bits, _)| *bits)
}

/// Bytes of `count` fields of `bits` bits.
const fn packed_bytes(count: usize, bits: u32) -> usize {
    (count * bits as usize).div_ceil(8)
}

/// Whether the fields behind those of `count` residuals, at most seven, are 0: the encoding is
/// canonical, so bits that nothing reads have one value.
fn has_empty_end(packed: &[u8], bits: u32, count: usize) -> bool {
    let fields = packed.len() * 8 / bits.max(1) as usize;
    (count..fields).all(|field| {
        let byte = packed[field % packed.len()];
        byte >> (bits * (field / packed.len()) as u32) & (0xff_u16 >> (8 - bits)) as u8 == 0
    })
}

/// Appends one part behind its length.
pub(super) fn push_part(content: &[u8], effort: Effort, out: &mut Vec<u8>) {
    let at = out.len();
    out.extend_from_slice(&[0; 2]);
    entropy::compress(content, effort, out);
    // At most the content's length, which is below 2^13.
    let length = (out.len() - at - 2) as u16;
    out[at..at + 2].copy_from_slice(&length.to_le_bytes());
}

/// Scratch memory for the decoded parts of one chunk.
pub(super) struct Scratch {
    planes: [[u8; VERTEX_COUNT]; MAX_PLANES],
    packed: [u8; VERTEX_COUNT],
    merged: [[u8; VERTEX_COUNT]; MAX_PLANES],
}

impl Scratch {
    pub(super) const fn new() -> Self {
        let planes = [[0; VERTEX_COUNT]; MAX_PLANES];
        Self { planes, packed: [0; VERTEX_COUNT], merged: planes }
    }

    /// Takes the parts of `count` residuals below `2^width` off a payload: their byte planes,
    /// lowest first; none where all residuals are 0.
    ///
    /// # Errors
    /// [`ChunkError::Content`] for an impossible width or number of plain bits and for unused
    /// fields that are not 0, else as [`take_part`].
    pub(super) fn take<'a, 'p: 'a>(
        &'a mut self,
        kernel: Kernel,
        width: u32,
        count: usize,
        payload: &mut &'p [u8],
    ) -> Result<Planes<'a>, ChunkError> {
        let too_wide = ChunkError::Content("no residual of a chunk is so wide");
        let mut planes = Planes { planes: [&[]; MAX_PLANES], count: 0 };
        if width == 0 {
            return Ok(planes);
        }
        let (plain, rest) = payload.split_first().ok_or(ChunkError::Part)?;
        let plain = u32::from(*plain);
        let rest_bits =
            width.checked_sub(plain).filter(|rest| *rest > 0 && matches!(plain, 0 | 1 | 2 | 4 | 8));
        let rest_bits = rest_bits.ok_or(ChunkError::Content("no residual has so many plain bits"))?;
        let layout = Layout::of_width(rest_bits).filter(|_| width <= MAX_RESIDUAL_BITS).ok_or(too_wide)?;
        let (low, rest) = rest.split_at_checked(packed_bytes(count, plain)).ok_or(ChunkError::Part)?;
        *payload = rest;

        let Self { planes: rooms, packed, merged } = self;
        let (whole, top) = rooms.split_at_mut(layout.whole);
        let mut above: [&[u8]; MAX_PLANES] = [&[]; MAX_PLANES];
        for (plane, scratch) in above.iter_mut().zip(whole) {
            *plane = take_part(payload, &mut scratch[..count])?;
        }
        let packed = take_part(payload, &mut packed[..layout.packed(count)])?;
        if !has_empty_end(low, plain, count) || !has_empty_end(packed, layout.field, count) {
            return Err(ChunkError::Content("an unused field is not 0"));
        }
        above[layout.whole] = if layout.field == 8 {
            packed
        } else {
            let scratch = &mut top[0][..count];
            kernel::unpack(kernel, packed, layout.field, scratch);
            scratch
        };
        let above = &above[..=layout.whole];
        let or_of_all = above[layout.whole].iter().fold(0, |or, byte| or | byte);
        if rest_bits != 8 * layout.whole as u32 + u8::BITS - or_of_all.leading_zeros() {
            return Err(ChunkError::Content("the width is not that of the widest residual"));
        }
        match plain {
            0 => planes.set(above.iter().copied()),
            8 => planes.set([low].into_iter().chain(above.iter().copied())),
            bits => {
                let needed = width.div_ceil(8) as usize;
                for (index, scratch) in merged[..needed].iter_mut().enumerate() {
                    kernel::merge(kernel, low, bits, above, index, &mut scratch[..count]);
                }
                planes.set(merged[..needed].iter().map(|plane| &plane[..count]));
            }
        }
        Ok(planes)
    }
}

/// The byte planes of residuals, in the payload or in a [`Scratch`].
pub(super) struct Planes<'a> {
    planes: [&'a [u8]; MAX_PLANES],
    count: usize,
}

impl<'a> Planes<'a> {
    fn set(&mut self, planes: impl Iterator<Item = &'a [u8]>) {
        for (own, plane) in self.planes.iter_mut().zip(planes) {
            *own = plane;
            self.count += 1;
        }
    }

    /// The planes, lowest first; none where all residuals are 0.
    pub(super) fn get(&self) -> &[&'a [u8]] {
        &self.planes[..self.count]
    }
}

/// Takes one part off a payload: its content, from the payload itself where it is stored, else from
/// `scratch`, whose length is that of the content.
///
/// # Errors
/// [`ChunkError::Part`] for a length that no such part has or that the payload does not hold,
/// [`ChunkError::Compression`].
pub(super) fn take_part<'a, 'p: 'a>(
    payload: &mut &'p [u8],
    scratch: &'a mut [u8],
) -> Result<&'a [u8], ChunkError> {
    let (length, rest) = payload.split_first_chunk().ok_or(ChunkError::Part)?;
    let length = usize::from(u16::from_le_bytes(*length));
    if length > scratch.len() {
        return Err(ChunkError::Part);
    }
    let (coded, rest) = rest.split_at_checked(length).ok_or(ChunkError::Part)?;
    *payload = rest;
    if length == scratch.len() {
        return Ok(coded);
    }
    entropy::decompress(coded, scratch)?;
    Ok(scratch)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use terrain::hash::mix;

    #[test]
    fn layouts_hold_their_width_and_no_more_than_they_must() {
        for width in 1..=MAX_RESIDUAL_BITS {
            let layout = Layout::of_width(width).unwrap();
            let bits = 8 * layout.whole as u32 + layout.field;
            assert!(bits >= width && layout.field <= 8 && layout.whole < MAX_PLANES, "{width}: {layout:?}");
            assert!(width - 8 * layout.whole as u32 > layout.field / 2, "{width}: {layout:?}");
        }
        assert_eq!(Layout::of_width(0), Some(Layout { whole: 0, field: 0 }));
        assert_eq!(Layout::of_width(MAX_RESIDUAL_BITS + 1), None);
        assert_eq!(Layout::of_width(u32::MAX), None);
    }

    #[test]
    fn plain_bits_grow_with_the_mean_and_are_fewer_than_the_width() {
        for effort in [Effort::Fast, Effort::Compact] {
            let bits = |residual: u32, count, width| plain_bits(&vec![residual; count], width, effort);
            let growing: Vec<_> = (0..20).map(|n| bits((1 << n) - 1, 70, MAX_RESIDUAL_BITS)).collect();
            assert!(growing.is_sorted() && growing[0] == 0 && growing[19] == 8, "{growing:?}");
            for residual in [1, 4, 10, 30, 400] {
                let of = |count| bits(residual, count, MAX_RESIDUAL_BITS);
                assert_eq!(of(1), of(700), "the mean of equal residuals of {residual}");
            }
            assert!((1..=MAX_RESIDUAL_BITS).all(|width| bits(1 << 20, 70, width) < width));
        }
    }

    #[test]
    fn a_width_without_a_bit_above_the_plain_ones_is_rejected() {
        let (count, mut scratch) = (8, Scratch::new());
        let fault = Err(ChunkError::Content("no residual has so many plain bits"));
        for (plain, width) in [(1_u8, 1), (2, 2), (4, 4), (8, 8), (8, 7), (3, 5), (255, 27)] {
            // The plain bits, and an empty part above them.
            let low = vec![0; packed_bytes(count, u32::from(plain))];
            let payload = [vec![plain], low, vec![0; 2]].concat();
            let taken = scratch.take(Kernel::PORTABLE, width, count, &mut &payload[..]).map(|_| ());
            assert_eq!(taken, fault, "{plain} of {width} bits");
        }
    }

    #[test]
    fn only_unused_fields_must_be_0() {
        // So few residuals that every part is stored as it is.
        let (kernel, mut scratch) = (Kernel::PORTABLE, Scratch::new());
        let unused_field = Err(ChunkError::Content("an unused field is not 0"));
        let mut rejected = 0;
        for count in 1..=20 {
            for (plain, bits) in
                [0, 1, 2, 4, 8].into_iter().flat_map(|plain| [(plain, 1), (plain, 2), (plain, 4)])
            {
                let (low, top) = (packed_bytes(count, plain), packed_bytes(count, bits));
                // All bits of all fields in use are 1.
                let ones = vec![0xff; count];
                let packed = |bits: u32, length: usize| {
                    let (mut values, mut packed) = (ones.clone(), vec![0; length]);
                    values.iter_mut().for_each(|value| *value >>= 8 - bits);
                    kernel::pack(kernel, &values, bits, &mut packed);
                    packed
                };
                let low = if plain == 0 { Vec::new() } else { packed(plain, low) };
                let length = (top as u16).to_le_bytes();
                let valid = [&[plain as u8][..], &low, &length, &packed(bits, top)].concat();
                let mut take =
                    |payload: &[u8]| scratch.take(kernel, plain + bits, count, &mut &payload[..]).map(|_| ());
                assert_eq!(take(&valid), Ok(()), "{count} of {plain} and {bits} bits");
                for bit in (8..8 + 8 * low.len()).chain(8 * (valid.len() - top)..8 * valid.len()) {
                    let mut other = valid.clone();
                    other[bit / 8] ^= 1 << (bit % 8);
                    let is_used = valid[bit / 8] >> (bit % 8) & 1 == 1;
                    assert_eq!(take(&other) != unused_field, is_used, "{count} of {plain} and {bits}: {bit}");
                    rejected += u32::from(!is_used);
                }
            }
        }
        assert!(rejected > 500, "{rejected} bits are unused");
    }

    proptest! {
        #[test]
        fn residuals_of_every_width_and_count_round_trip(
            seed: u32, width in 0..=MAX_RESIDUAL_BITS, count in 1..=VERTEX_COUNT,
        ) {
            let mask = ((1u64 << width) - 1) as u32;
            let residuals: Vec<u32> = (0..count).map(|index| mix(seed ^ index as u32) & mask).collect();
            // The widest of a few may be narrower than the requested width.
            let width = super::width(residuals.iter().fold(0, |or, residual| or | residual));
            for kernel in Kernel::available() {
                for effort in [Effort::Fast, Effort::Compact] {
                    let mut payload = Vec::new();
                    push(kernel, &residuals, width, effort, &mut payload);
                    let (mut rest, mut out) = (&payload[..], vec![1; count]);
                    let mut scratch = Scratch::new();
                    let planes = scratch.take(kernel, width, count, &mut rest).unwrap();
                    kernel::join(kernel, planes.get(), &mut out);
                    prop_assert!(rest.is_empty());
                    for (out, residual) in out.iter().zip(&residuals) {
                        prop_assert_eq!(kernel::zigzag(*out), *residual);
                    }
                }
            }
        }
    }
}
