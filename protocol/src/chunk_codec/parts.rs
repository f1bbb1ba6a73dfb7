//! Residuals as parts: whole byte planes, and the bits above them packed.
//!
//! The width of the widest residual says everything about the layout. Its whole bytes but the last become planes of one byte a
//! residual; the 1 to 8 bits above them are packed into fields of 1, 2, 4 or 8 bits, because a Huffman code cannot spend less than
//! a bit on a symbol, and the upper bits of most residuals are worth less.
//!
//! A part travels behind its length (u16). A part as long as its content is the content itself, a shorter one is a frame of
//! [`super::entropy`].

use super::entropy::{self, Effort};
use super::kernel::{self, Kernel};
use crate::error::ChunkError;
use crate::limits::MAX_RESIDUAL_BITS;
use terrain::constants::VERTEX_COUNT;

/// Most byte planes of a chunk, the packed one included.
const MAX_PLANES: usize = MAX_RESIDUAL_BITS.div_ceil(8) as usize;

/// How residuals of a width lie.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Layout {
    /// Planes of a byte a residual.
    whole: usize,
    /// Bits of a field of the packed plane; 0 where all residuals are 0 and there is none.
    field: u32,
}

impl Layout {
    /// The layout of residuals below `2^width`; none if no valid chunk has such.
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

    /// Bytes of the packed plane of so many residuals.
    const fn packed(self, count: usize) -> usize {
        (count * self.field as usize).div_ceil(8)
    }
}

/// Bits of the widest residual.
pub(super) const fn width(any: u32) -> u32 {
    u32::BITS - any.leading_zeros()
}

/// Appends the parts of residuals below `2^width`.
pub(super) fn push(kernel: Kernel, residuals: &[u32], width: u32, effort: Effort, out: &mut Vec<u8>) {
    let Some(layout) = Layout::of_width(width).filter(|layout| layout.field > 0) else { return };
    let mut plane = [0; VERTEX_COUNT];
    let plane = &mut plane[..residuals.len()];
    for index in 0..layout.whole {
        kernel::split(kernel, residuals, index, plane);
        push_part(plane, effort, false, out);
    }
    kernel::split(kernel, residuals, layout.whole, plane);
    let mut packed = [0; VERTEX_COUNT];
    let packed = &mut packed[..layout.packed(residuals.len())];
    for (field, values) in plane.chunks(packed.len()).enumerate() {
        let shift = field as u32 * layout.field;
        packed.iter_mut().zip(values).for_each(|(byte, value)| *byte |= value << shift);
    }
    push_part(packed, effort, true, out);
}

/// Appends one part behind its length.
pub(super) fn push_part(content: &[u8], effort: Effort, try_literals: bool, out: &mut Vec<u8>) {
    let at = out.len();
    out.extend_from_slice(&[0; 2]);
    entropy::compress(content, effort, try_literals, out);
    // At most the content's length, which is below 2^13.
    let length = (out.len() - at - 2) as u16;
    out[at..at + 2].copy_from_slice(&length.to_le_bytes());
}

/// Room for the decoded parts of one chunk.
pub(super) struct Room {
    planes: [[u8; VERTEX_COUNT]; MAX_PLANES],
    packed: [u8; VERTEX_COUNT],
}

impl Room {
    pub(super) const fn new() -> Self {
        Self { planes: [[0; VERTEX_COUNT]; MAX_PLANES], packed: [0; VERTEX_COUNT] }
    }

    /// Takes the parts of `count` residuals below `2^width` off a payload: their byte planes, lowest first; none where all
    /// residuals are 0.
    ///
    /// # Errors
    /// [`ChunkError::Content`] for an impossible width, else as [`take_part`].
    pub(super) fn take<'a, 'p: 'a>(
        &'a mut self,
        kernel: Kernel,
        width: u32,
        count: usize,
        payload: &mut &'p [u8],
    ) -> Result<Planes<'a>, ChunkError> {
        let layout =
            Layout::of_width(width).ok_or(ChunkError::Content("no residual of a chunk is so wide"))?;
        let mut planes = Planes { planes: [&[]; MAX_PLANES], count: 0 };
        if layout.field == 0 {
            return Ok(planes);
        }
        planes.count = layout.whole + 1;
        let (whole, top) = self.planes.split_at_mut(layout.whole);
        for (plane, room) in planes.planes.iter_mut().zip(whole) {
            *plane = take_part(payload, &mut room[..count])?;
        }
        let packed = take_part(payload, &mut self.packed[..layout.packed(count)])?;
        planes.planes[layout.whole] = if layout.field == 8 {
            packed
        } else {
            let room = &mut top[0][..count];
            kernel::unpack(kernel, packed, layout.field, room);
            room
        };
        Ok(planes)
    }
}

/// The byte planes of residuals, in the payload or in a [`Room`].
pub(super) struct Planes<'a> {
    planes: [&'a [u8]; MAX_PLANES],
    count: usize,
}

impl<'a> Planes<'a> {
    /// The planes, lowest first; none where all residuals are 0.
    pub(super) fn get(&self) -> &[&'a [u8]] {
        &self.planes[..self.count]
    }
}

/// Takes one part off a payload: its content, from the payload itself where it is stored, else from `room`, whose length is
/// that of the content.
///
/// # Errors
/// [`ChunkError::Part`] for a length that no such part has or that the payload does not hold, [`ChunkError::Compression`].
pub(super) fn take_part<'a, 'p: 'a>(
    payload: &mut &'p [u8],
    room: &'a mut [u8],
) -> Result<&'a [u8], ChunkError> {
    let (length, rest) = payload.split_first_chunk().ok_or(ChunkError::Part)?;
    let length = usize::from(u16::from_le_bytes(*length));
    if length > room.len() {
        return Err(ChunkError::Part);
    }
    let (coded, rest) = rest.split_at_checked(length).ok_or(ChunkError::Part)?;
    *payload = rest;
    if length == room.len() {
        return Ok(coded);
    }
    entropy::decompress(coded, room)?;
    Ok(room)
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
        assert_eq!(Layout::of_width(MAX_RESIDUAL_BITS + 1), None);
        assert_eq!(Layout::of_width(u32::MAX), None);
    }

    proptest! {
        #[test]
        fn residuals_of_every_width_and_count_come_back(seed: u32, width in 0..=MAX_RESIDUAL_BITS, count in 1..=VERTEX_COUNT) {
            let mask = ((1u64 << width) - 1) as u32;
            let residuals: Vec<u32> = (0..count).map(|index| mix(seed ^ index as u32) & mask).collect();
            for kernel in Kernel::available() {
                for effort in [Effort::Fast, Effort::Compact] {
                    let mut payload = Vec::new();
                    push(kernel, &residuals, width, effort, &mut payload);
                    let (mut rest, mut out) = (&payload[..], vec![1; count]);
                    let mut room = Room::new();
                    let planes = room.take(kernel, width, count, &mut rest).unwrap();
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
