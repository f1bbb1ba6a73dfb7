//! Compression of byte strings: the only file that names a compressor.
//!
//! A compressed string is one Zstandard frame (RFC 8878) of the simplest form: single segment, with
//! content size, without dictionary and checksum. Other frames are rejected before the decoder, so
//! that a frame can neither request a window nor expand beyond the reader's buffer.

use crate::error::ChunkError;
use std::cell::RefCell;

/// The trade-off between encoding time and bytes.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub enum Effort {
    /// Fast encoding: level -5, without entropy coding of literals. About 1.4 times the bytes;
    /// heights are decoded almost twice as fast (record `streaming`).
    Fast,
    /// Compact encoding, for frames that are sent more than once: coded literals, and the match
    /// search of level 1 where its result is shorter.
    #[default]
    Compact,
}

/// First bytes of a frame, RFC 8878 section 3.1.1.
const MAGIC: [u8; 4] = [0x28, 0xb5, 0x2f, 0xfd];

/// The content size of a frame of the simplest form; none for any other frame, and for bytes behind
/// it: decoders would take them for further frames, or skip them.
fn stated_size(frame: &[u8]) -> Option<u64> {
    let (size, blocks) = header(frame)?;
    ends_with_its_last_block(blocks).then_some(size)
}

/// The content size, and what follows the header.
fn header(frame: &[u8]) -> Option<(u64, &[u8])> {
    let (magic, rest) = frame.split_first_chunk()?;
    let (descriptor, rest) = rest.split_first()?;
    // Single segment; no reserved or unused bit, checksum or dictionary.
    if *magic != MAGIC || descriptor & 0x3f != 0x20 {
        return None;
    }
    match descriptor >> 6 {
        0 => rest.split_first().map(|(size, rest)| (u64::from(*size), rest)),
        1 => rest.split_first_chunk().map(|(size, rest)| (u64::from(u16::from_le_bytes(*size)) + 256, rest)),
        2 => rest.split_first_chunk().map(|(size, rest)| (u64::from(u32::from_le_bytes(*size)), rest)),
        _ => rest.split_first_chunk().map(|(size, rest)| (u64::from_le_bytes(*size), rest)),
    }
}

/// Whether the last block (RFC 8878, section 3.1.1.2) ends where the bytes do.
fn ends_with_its_last_block(mut blocks: &[u8]) -> bool {
    while let Some((&[low, middle, high], rest)) = blocks.split_first_chunk() {
        let word = u32::from_le_bytes([low, middle, high, 0]);
        // Of a repeated byte the size is that of the content.
        let length = if (word >> 1) & 3 == 1 { 1 } else { (word >> 3) as usize };
        let Some((_, rest)) = rest.split_at_checked(length) else { return false };
        if word & 1 == 1 {
            return rest.is_empty();
        }
        blocks = rest;
    }
    false
}

/// Decompresses one frame whose content must fill `out` exactly.
///
/// # Errors
/// [`ChunkError::Compression`]: another size, another form of frame, trailing bytes, or damage.
pub(super) fn decompress(frame: &[u8], out: &mut [u8]) -> Result<(), ChunkError> {
    if stated_size(frame) != Some(out.len() as u64) {
        return Err(ChunkError::Compression);
    }
    let filled = CODER.with_borrow_mut(|coder| coder.decompress(frame, out));
    if filled == Some(out.len()) { Ok(()) } else { Err(ChunkError::Compression) }
}

/// Appends a string to `out`, compressed if that is shorter, else uncompressed. Returns whether it
/// is compressed.
pub(super) fn compress(content: &[u8], effort: Effort, out: &mut Vec<u8>) -> bool {
    CODER.with_borrow_mut(|coder| coder.compress(content, effort, out))
}

thread_local! {
    /// Contexts are large and expensive to create; every thread keeps its own.
    static CODER: RefCell<Coder> = RefCell::default();
}

#[cfg(not(target_arch = "wasm32"))]
mod native {
    use super::Effort;
    use zstd::zstd_safe::{CCtx, CParameter, DCtx, ParamSwitch};

    /// Level whose match search skips the whole input: only the coding of literals is left.
    const LITERALS_ONLY: i32 = -100_000;

    /// Matches are searched if coded literals take less than this fraction of the content: close to
    /// one bit a literal, the minimum of a Huffman code.
    const REPEATS_BELOW: usize = 6;

    /// The contexts of one thread, each created at its first use.
    #[derive(Default)]
    pub(super) struct Coder {
        fast: Option<CCtx<'static>>,
        compact: Option<CCtx<'static>>,
        literals: Option<CCtx<'static>>,
        reader: Option<DCtx<'static>>,
        /// Output of the second attempt; copied if it is shorter.
        attempt: Vec<u8>,
    }

    /// A context of a level; none if the library fails, which means no compression.
    fn context(level: i32, literals: ParamSwitch) -> Option<CCtx<'static>> {
        let mut context = CCtx::try_create()?;
        context.set_parameter(CParameter::CompressionLevel(level)).ok()?;
        context.set_parameter(CParameter::LiteralCompressionMode(literals)).ok()?;
        Some(context)
    }

    fn context_in<'a>(
        slot: &'a mut Option<CCtx<'static>>,
        level: i32,
        literals: ParamSwitch,
    ) -> Option<&'a mut CCtx<'static>> {
        if slot.is_none() {
            *slot = context(level, literals);
        }
        slot.as_mut()
    }

    /// Appends the compressed content to `out`, at most `most` bytes. Returns whether it did.
    fn attempt(context: Option<&mut CCtx<'static>>, content: &[u8], most: usize, out: &mut Vec<u8>) -> bool {
        let start = out.len();
        out.resize(start + most, 0);
        let written = context.and_then(|context| context.compress2(&mut out[start..], content).ok());
        out.truncate(start + written.unwrap_or(0));
        written.is_some()
    }

    impl Coder {
        pub(super) fn compress(&mut self, content: &[u8], effort: Effort, out: &mut Vec<u8>) -> bool {
            let start = out.len();
            // A frame as long as its content would be read as the content.
            let most = content.len().saturating_sub(1);
            let first = match effort {
                Effort::Fast => context_in(&mut self.fast, -5, ParamSwitch::Auto),
                Effort::Compact => context_in(&mut self.literals, LITERALS_ONLY, ParamSwitch::Enable),
            };
            let done = attempt(first, content, most, out);
            // Noise has no matches. Content that codes this short may have some.
            let may_repeat = done && out.len() - start < content.len() / REPEATS_BELOW;
            if effort == Effort::Compact && may_repeat {
                self.attempt.clear();
                let repeats = context_in(&mut self.compact, 1, ParamSwitch::Enable);
                if attempt(repeats, content, most, &mut self.attempt)
                    && self.attempt.len() < out.len() - start
                {
                    out.truncate(start);
                    out.extend_from_slice(&self.attempt);
                }
            }
            if !done {
                out.extend_from_slice(content);
            }
            done
        }

        pub(super) fn decompress(&mut self, frame: &[u8], out: &mut [u8]) -> Option<usize> {
            if self.reader.is_none() {
                self.reader = DCtx::try_create();
            }
            self.reader.as_mut()?.decompress(out, frame).ok()
        }
    }
}

#[cfg(not(target_arch = "wasm32"))]
use native::Coder;

/// Decodes a frame without the C library.
#[cfg(any(target_arch = "wasm32", test))]
fn decompress_in_rust(frame: &[u8], out: &mut [u8]) -> Option<usize> {
    ruzstd::decoding::FrameDecoder::new().decode_all(frame, out).ok()
}

/// Where there is no C library: reads what others compressed, and writes without compression.
#[cfg(target_arch = "wasm32")]
#[derive(Default)]
struct Coder;

#[cfg(target_arch = "wasm32")]
#[expect(clippy::unused_self, reason = "the shape of the other one")]
impl Coder {
    fn compress(&self, content: &[u8], _: Effort, out: &mut Vec<u8>) -> bool {
        out.extend_from_slice(content);
        false
    }

    fn decompress(&self, frame: &[u8], out: &mut [u8]) -> Option<usize> {
        decompress_in_rust(frame, out)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use terrain::hash::mix;

    fn content(seed: u32, length: usize, mask: u8) -> Vec<u8> {
        (0..length).map(|index| mix(seed ^ index as u32) as u8 & mask).collect()
    }

    fn frame(content: &[u8], effort: Effort) -> Option<Vec<u8>> {
        let mut out = Vec::new();
        compress(content, effort, &mut out).then_some(out)
    }

    proptest! {
        #[test]
        fn both_decoders_give_back_what_any_effort_took(seed: u32, length in 20usize..5000, mask: u8) {
            let content = content(seed, length, mask);
            for effort in [Effort::Fast, Effort::Compact] {
                let mut out = vec![9];
                if compress(&content, effort, &mut out) {
                    let frame = &out[1..];
                    prop_assert!(frame.len() < length);
                    let by_c =
                        |frame: &[u8], out: &mut [u8]| decompress(frame, out).ok().map(|()| out.len());
                    for decode in [by_c, decompress_in_rust] {
                        let mut out = vec![0; length];
                        prop_assert_eq!(decode(frame, &mut out), Some(length));
                        prop_assert_eq!(&out, &content);
                    }
                } else {
                    prop_assert_eq!(&out[1..], &content[..]);
                }
            }
        }

        #[test]
        fn both_decoders_agree_on_damaged_frames(seed: u32, at: prop::sample::Index, bit in 0u8..8) {
            let content = content(seed, 3000, 0x1f);
            let mut frame = frame(&content, Effort::Compact).unwrap();
            let at = at.index(frame.len());
            frame[at] ^= 1u8 << bit;
            let (mut by_c, mut by_rust) = (vec![0; 3000], vec![0; 3000]);
            // Neither panics; where both read something, they read the same.
            let is_valid = decompress(&frame, &mut by_c).is_ok();
            if is_valid && decompress_in_rust(&frame, &mut by_rust) == Some(3000) {
                prop_assert_eq!(by_c, by_rust);
            }
        }
    }

    #[test]
    fn a_block_of_a_repeated_byte_takes_one_byte() {
        // RFC 8878: the header of a single segment of 10 bytes; the last block, of type 1, of size
        // 10.
        let mut frame = [&MAGIC[..], &[0x20, 10], &[1 | 1 << 1 | 10 << 3, 0, 0, 7]].concat();
        let mut out = [0; 10];
        assert_eq!(decompress(&frame, &mut out), Ok(()));
        assert_eq!((out, decompress_in_rust(&frame, &mut [0; 10])), ([7; 10], Some(10)));
        frame.push(7);
        assert_eq!(decompress(&frame, &mut out), Err(ChunkError::Compression), "a byte behind it");
    }

    #[test]
    fn a_content_size_has_one_two_four_or_eight_bytes() {
        // RFC 8878, section 3.1.1.1; behind each the last block, raw and empty.
        let headers: [(&[u8], u64); 4] = [
            (&[0x20, 7], 7),
            (&[0x60, 7, 1], 0x0107 + 256),
            (&[0xa0, 1, 2, 3, 4], 0x0403_0201),
            (&[0xe0, 1, 2, 3, 4, 5, 6, 7, 8], 0x0807_0605_0403_0201),
        ];
        for (header, size) in headers {
            let frame = [&MAGIC[..], header, &[1, 0, 0]].concat();
            assert_eq!(stated_size(&frame), Some(size), "{header:x?}");
        }
    }

    #[test]
    fn only_the_plainest_sort_of_frame_of_the_right_size_is_read() {
        let content = content(1, 3000, 3);
        let good = frame(&content, Effort::Compact).unwrap();
        assert_eq!(stated_size(&good), Some(3000));
        for wrong in [0, 1, 2999, 3001, 1 << 20] {
            assert_eq!(decompress(&good, &mut vec![0; wrong]), Err(ChunkError::Compression), "{wrong}");
        }
        let mut out = vec![0; 3000];
        for length in 0..good.len() {
            assert_eq!(decompress(&good[..length], &mut out), Err(ChunkError::Compression), "{length}");
        }
        // A byte, an empty frame and a skippable frame, which decoders read on or skip.
        let empty = [0x28, 0xb5, 0x2f, 0xfd, 0x20, 0, 1, 0, 0];
        for behind in [&[0][..], &empty, &[0x50, 0x2a, 0x4d, 0x18, 1, 0, 0, 0, 7]] {
            let longer = [&good[..], behind].concat();
            assert_eq!(decompress(&longer, &mut out), Err(ChunkError::Compression), "{behind:?}");
        }
        for descriptor in [0x00, 0x21, 0x24, 0x28, 0x30, 0x64, 0xe1] {
            let mut other = good.clone();
            other[4] = descriptor;
            assert_eq!(decompress(&other, &mut out), Err(ChunkError::Compression), "{descriptor:#x}");
        }
        assert_eq!(decompress(&good, &mut out), Ok(()));
        assert_eq!(out, content);
    }

    #[test]
    fn repetitions_are_found_where_there_are_any() {
        // Noise with few values, and a speck in each row.
        let noise = content(7, 4225, 0x0f);
        let specks: Vec<_> = (0..4225).map(|index| u8::from(index % 65 == 0)).collect();
        assert_eq!(frame(&noise, Effort::Fast), None, "literals are not coded");
        let fast = frame(&specks, Effort::Fast).unwrap().len();
        let [noise, specks] = [noise, specks].map(|content| frame(&content, Effort::Compact).unwrap().len());
        assert!((2100..2300).contains(&noise), "half a byte each: {noise}");
        assert!(specks < 100, "single bytes of one bit each would be 529: {specks}");
        assert!(fast > 2 * specks, "one search only: {fast}");
        // Noise that no literals can code is not searched.
        assert_eq!(frame(&content(3, 500, 0xff).repeat(2), Effort::Compact), None);
    }

    #[test]
    fn what_is_in_front_of_a_frame_does_not_change_it() {
        let specks: Vec<_> = (0..4225).map(|index| u8::from(index % 65 == 0)).collect();
        // Shorter by coded literals alone than with matches.
        let sparse: Vec<_> = (0..4225).map(|index| u8::from(mix(index) % 256 < 30)).collect();
        for content in [content(7, 4225, 0x0f), specks, sparse] {
            for effort in [Effort::Fast, Effort::Compact] {
                let mut out = vec![9; 4000];
                let is_compressed = compress(&content, effort, &mut out);
                assert_eq!(frame(&content, effort), is_compressed.then(|| out[4000..].to_vec()));
            }
        }
    }
}
