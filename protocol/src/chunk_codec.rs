//! Chunk frames: one chunk as bytes.
//!
//! Every frame begins with the same 16 bytes: magic, version, kind, key. This file contains them,
//! the header that all kinds with heights share, and the digest. The kinds are:
//!
//! - *exact*: every height, without loss ([`encode`], [`decode`]);
//! - *quantised*: heights within a tolerance ([`quantised`]);
//! - *refined*: exact, for receivers with the parent ([`refined`]);
//! - *seed only*: no heights ([`seed_only`]).
//!
//! Heights are predicted from three neighbours (`left + above - above left`, the plane predictor),
//! the residuals zigzag-mapped, split into plain low bits and byte planes, and these compressed.
//! Data that can be derived from the heights is not sent: the decoder rebuilds the pyramids, and
//! the grass if it follows the land's own rule. Little-endian throughout; layout in
//! `docs/protocol.md`.
//!
//! The digest at the end of the header covers the world, the header and the encoded payload, so a
//! chunk of another world, or a damaged one, is rejected before decompression. It identifies the
//! bytes: equal digests mean equal frames.

mod entropy;
mod kernel;
mod parts;
pub mod quantised;
pub mod refined;
pub mod seed_only;

pub use entropy::Effort;
pub use kernel::Kernel;

use crate::delivery::{Delivery, Tolerance};
use crate::error::ChunkError;
use crate::limits::{CHUNK_HEADER, MAX_CHUNK_FRAME, MAX_PAYLOAD};
use bytes::Bytes;
use kernel::Heights;
use parts::Scratch;
use refined::Known;
use std::cell::RefCell;
use terrain::constants::{GRASS_GRID, HEIGHT_LIMIT, VERTEX_COUNT};
use terrain::grass::PALETTES;
use terrain::{Chunk, ChunkKey, GrassSeed, WorldDigest};

/// First bytes of every chunk frame.
pub const MAGIC: [u8; 4] = *b"TMBC";

/// Version of the chunk format. The predictor, the plane order and the compression are part of it.
pub const VERSION: u16 = 3;

/// Exact heights.
pub const KIND_EXACT: u8 = 0;

/// No heights: the data to generate the chunk and to verify it.
pub const KIND_SEED_ONLY: u8 = 1;

/// Heights within a tolerance of the exact ones.
pub const KIND_QUANTISED: u8 = 2;

/// Exact heights without those of the parent.
pub const KIND_REFINED: u8 = 3;

/// Bytes of a content digest: the first half of a blake3 hash.
pub const DIGEST: usize = 16;

const DIGEST_AT: usize = CHUNK_HEADER - DIGEST;

/// Bytes that all kinds begin with.
const PREFIX: usize = 16;

/// Grass densities are in the payload.
const GRASS_SENT: u8 = 0;

/// Grass densities are [`GrassSeed::density_of`] the heights.
const GRASS_BY_RULE: u8 = 1;

/// The longest frame of any encoder of this module, bytes.
#[must_use]
pub const fn bound() -> usize {
    MAX_CHUNK_FRAME
}

/// Encodes a chunk of a world for a delivery.
#[must_use]
pub fn encode_for(delivery: Delivery, chunk: &Chunk, world: &WorldDigest) -> Bytes {
    encode_with(delivery, Effort::default(), chunk, world)
}

/// Encodes a chunk of a world for a delivery with a given effort; exact if the delivery is not
/// possible for this chunk.
#[must_use]
pub fn encode_with(delivery: Delivery, effort: Effort, chunk: &Chunk, world: &WorldDigest) -> Bytes {
    let exact = || encode_frame(KIND_EXACT, chunk, world, 0, effort, None);
    match delivery {
        Delivery::Exact => exact(),
        Delivery::SeedOnly => seed_only::encode(chunk, world),
        Delivery::Quantised(tolerance) => {
            quantised::encode(chunk, world, tolerance, effort).unwrap_or_else(exact)
        }
        Delivery::Refined => refined::encode_alone(chunk, world, effort).unwrap_or_else(exact),
    }
}

/// Encodes a chunk of a world with all its heights.
#[must_use]
pub fn encode(chunk: &Chunk, world: &WorldDigest) -> Bytes {
    encode_for(Delivery::Exact, chunk, world)
}

/// Decodes one whole exact frame of a world.
///
/// Takes at most [`MAX_DECODE_MEMORY`](crate::limits::MAX_DECODE_MEMORY) bytes, the chunk itself
/// included, for any input, and never panics.
///
/// # Errors
/// See [`ChunkError`]. A returned chunk satisfies every invariant of its type: the key exists,
/// heights are in range, extremes and slope are those of the heights.
pub fn decode(frame: &[u8], world: &WorldDigest) -> Result<Chunk, ChunkError> {
    decode_frame(&Frame::read(frame, KIND_EXACT)?, world, None, None)
}

/// Verifies a whole exact or quantised frame of a world by its lengths and its digest, without
/// decoding it. Returns its key and delivery. Sufficient for stored frames of this module's
/// encoders; frames of a peer must be decoded.
///
/// # Errors
/// See [`ChunkError`].
pub fn verify(frame: &[u8], world: &WorldDigest) -> Result<(ChunkKey, Delivery), ChunkError> {
    let (kind, key) = kind_and_key(frame)?;
    if ![KIND_EXACT, KIND_QUANTISED].contains(&kind) {
        return Err(ChunkError::UnknownKind(kind));
    }
    let frame = Frame::read(frame, kind)?;
    let delivery = match (kind, Tolerance::new(frame.tolerance)) {
        (KIND_QUANTISED, Some(tolerance)) => Delivery::Quantised(tolerance),
        (KIND_EXACT, None) if frame.tolerance == 0 => Delivery::Exact,
        _ => return Err(ChunkError::Content("the tolerance is not one of this kind")),
    };
    if frame_digest(world, &frame.header[..DIGEST_AT], None, frame.payload) != frame.header[DIGEST_AT..] {
        return Err(ChunkError::Digest);
    }
    Ok((key, delivery))
}

/// Decodes only the heights of an exact or quantised frame, units, on a given kernel, without
/// verification of the digest: for measurements, and for frames that were verified before.
///
/// # Errors
/// See [`ChunkError`].
pub fn heights_on(kernel: Kernel, frame: &[u8], heights: &mut [i32; VERTEX_COUNT]) -> Result<(), ChunkError> {
    let (kind, _) = kind_and_key(frame)?;
    let kind = if kind == KIND_QUANTISED { kind } else { KIND_EXACT };
    Frame::read(frame, kind)?.heights(kernel, None, heights).map(|_| ())
}

/// Writes the length of the payload and the digest that a frame with these bytes should have, as a
/// hostile server does: for tests of what is behind the digest. `parent` are the heights of the
/// parent, for refined frames. A frame shorter than a header stays as it is; a seed-only frame has
/// another header, and its decoder does all its work before it compares the digest.
#[doc(hidden)]
pub fn rewrite_digest(frame: &mut [u8], world: &WorldDigest, parent: Option<&[i32; VERTEX_COUNT]>) {
    let refined = kind_and_key(frame).ok().filter(|(kind, _)| *kind == KIND_REFINED);
    let known = refined.zip(parent).and_then(|((_, key), parent)| Known::of(key, parent));
    let Some((header, payload)) = frame.split_first_chunk_mut::<CHUNK_HEADER>() else { return };
    header[40..44].copy_from_slice(&(payload.len() as u32).to_le_bytes());
    let digest = frame_digest(world, &header[..DIGEST_AT], known.as_ref(), payload);
    header[DIGEST_AT..].copy_from_slice(&digest);
}

/// The kind and the key of a frame, from its first 16 bytes. Unknown kinds are returned as well.
///
/// # Errors
/// As [`decode`], for the first 16 bytes.
pub fn kind_and_key(frame: &[u8]) -> Result<(u8, ChunkKey), ChunkError> {
    let truncated = ChunkError::Truncated { got: frame.len(), expected: PREFIX };
    let prefix: &[u8; PREFIX] = frame.first_chunk().ok_or(truncated)?;
    if prefix[..4] != MAGIC {
        return Err(ChunkError::BadMagic);
    }
    let version = u16::from_le_bytes([prefix[4], prefix[5]]);
    if version != VERSION {
        return Err(ChunkError::UnknownVersion(version));
    }
    let key = ChunkKey::new(prefix[7], word(prefix, 8) as i32, word(prefix, 12) as i32)?;
    Ok((prefix[6], key))
}

/// The chunk's error (units) in a frame of any kind; none if the frame is not a chunk frame. That
/// of a quantised frame includes the quantisation error.
#[must_use]
pub fn error(frame: &[u8]) -> Option<u32> {
    match kind_and_key(frame).ok()?.0 {
        KIND_SEED_ONLY => seed_only::Header::read(frame).ok().map(|header| header.error),
        kind @ (KIND_EXACT | KIND_QUANTISED | KIND_REFINED) => {
            Frame::read(frame, kind).ok().map(|frame| frame.error)
        }
        _ => None,
    }
}

/// Encodes a frame with heights. `tolerance` (units) is the tolerance of rounded heights, 0 for
/// exact ones; `known` are the heights that the receiver has.
fn encode_frame(
    kind: u8,
    chunk: &Chunk,
    world: &WorldDigest,
    tolerance: u16,
    effort: Effort,
    known: Option<&Known>,
) -> Bytes {
    let kernel = Kernel::best();
    let mut frame = Vec::with_capacity(CHUNK_HEADER + VERTEX_COUNT * 2);
    frame.resize(CHUNK_HEADER, 0);
    frame.extend_from_slice(&chunk.grass.seed.to_le_bytes());
    frame.push(chunk.grass.palette);
    let width = match known {
        Some(known) => known.push(kernel, &chunk.heights, effort, &mut frame),
        None => {
            let mut residuals = [0; VERTEX_COUNT];
            let any = kernel::residuals(kernel, &chunk.heights, shift(tolerance), &mut residuals);
            let width = parts::width(any);
            parts::push(kernel, &residuals, width, effort, &mut frame);
            width
        }
    };
    let by_rule = chunk.grass.density == GrassSeed::density_of(chunk.key, &chunk.heights);
    if !by_rule {
        parts::push_part(&chunk.grass.density[..], effort, &mut frame);
    }

    let mut header = Vec::with_capacity(CHUNK_HEADER);
    push_prefix(&mut header, kind, chunk.key);
    let words = [chunk.heights[0], chunk.min(), chunk.max()];
    header.extend(words.into_iter().flat_map(i32::to_le_bytes));
    header.extend([chunk.error, chunk.slope].into_iter().flat_map(u32::to_le_bytes));
    header.extend([width as u8, if by_rule { GRASS_BY_RULE } else { GRASS_SENT }]);
    header.extend_from_slice(&tolerance.to_le_bytes());
    header.extend_from_slice(&((frame.len() - CHUNK_HEADER) as u32).to_le_bytes());
    let digest = frame_digest(world, &header, known, &frame[CHUNK_HEADER..]);
    header.extend_from_slice(&digest);
    frame[..CHUNK_HEADER].copy_from_slice(&header);
    // Frames stay in caches for long: no more than they need.
    Bytes::copy_from_slice(&frame)
}

/// Verifies a frame with heights and makes its chunk. `tolerance` is the coarsest that the receiver
/// takes; none for exact heights.
fn decode_frame(
    frame: &Frame<'_>,
    world: &WorldDigest,
    tolerance: Option<Tolerance>,
    known: Option<&Known>,
) -> Result<Chunk, ChunkError> {
    match tolerance.map(Tolerance::units) {
        None if frame.tolerance != 0 => {
            return Err(ChunkError::Content("an exact frame states a tolerance"));
        }
        Some(_) if Tolerance::new(frame.tolerance).is_none() => {
            return Err(ChunkError::Content("the tolerance is no power of two from 1 to 128 units"));
        }
        Some(ours) if frame.tolerance > ours => {
            return Err(ChunkError::Tolerance { theirs: frame.tolerance, ours });
        }
        _ => {}
    }
    if frame_digest(world, &frame.header[..DIGEST_AT], known, frame.payload) != frame.header[DIGEST_AT..] {
        return Err(ChunkError::Digest);
    }
    let mut heights = Box::new([0; VERTEX_COUNT]);
    let (seed, palette, rest) = frame.heights(Kernel::best(), known, &mut heights)?;
    let density = frame.density(&heights, rest)?;
    let grass = GrassSeed { seed, palette, density };
    let chunk = Chunk::from_parts(frame.key, heights, frame.error, grass);
    if (chunk.min(), chunk.max(), chunk.slope) != (frame.min, frame.max, frame.slope) {
        return Err(ChunkError::Content("extremes or slope differ from the heights"));
    }
    Ok(chunk)
}

/// A frame with heights whose lengths have been checked.
struct Frame<'a> {
    header: &'a [u8; CHUNK_HEADER],
    payload: &'a [u8],
    key: ChunkKey,
    first: i32,
    min: i32,
    max: i32,
    error: u32,
    slope: u32,
    /// Bits of the widest residual.
    width: u32,
    grass: u8,
    /// Units.
    tolerance: u16,
}

impl<'a> Frame<'a> {
    /// Reads the header of a frame of a kind and checks it against the length of the whole frame.
    fn read(frame: &'a [u8], expected: u8) -> Result<Self, ChunkError> {
        if frame.len() > MAX_CHUNK_FRAME {
            return Err(ChunkError::TooLong(frame.len()));
        }
        let (kind, key) = kind_and_key(frame)?;
        if kind != expected {
            return Err(ChunkError::UnknownKind(kind));
        }
        let truncated = ChunkError::Truncated { got: frame.len(), expected: CHUNK_HEADER };
        let (header, payload) = frame.split_first_chunk::<CHUNK_HEADER>().ok_or(truncated)?;
        let signed = |at: usize| word(header, at) as i32;
        let length = word(header, 40);
        if length as usize > MAX_PAYLOAD {
            return Err(ChunkError::Length { field: "payload", value: length });
        }
        let expected = CHUNK_HEADER + length as usize;
        if frame.len() < expected {
            return Err(ChunkError::Truncated { got: frame.len(), expected });
        }
        if frame.len() > expected {
            return Err(ChunkError::Trailing(frame.len() - expected));
        }
        Ok(Self {
            header,
            payload,
            key,
            first: signed(16),
            min: signed(20),
            max: signed(24),
            error: word(header, 28),
            slope: word(header, 32),
            width: u32::from(header[36]),
            grass: header[37],
            tolerance: u16::from_le_bytes([header[38], header[39]]),
        })
    }

    /// Decodes the heights. Returns the seed and the palette of the grass, and what of the payload
    /// is left.
    fn heights(
        &self,
        kernel: Kernel,
        known: Option<&Known>,
        heights: &mut Heights,
    ) -> Result<(u32, u8, &'a [u8]), ChunkError> {
        let (grass, mut rest) = self.payload.split_first_chunk::<5>().ok_or(ChunkError::Part)?;
        let palette = grass[4];
        if palette >= PALETTES {
            return Err(ChunkError::Content("the grass palette does not exist"));
        }
        ROOM.with_borrow_mut(|scratch| match known {
            Some(known) => known.take(kernel, scratch, self.width, &mut rest, heights),
            None => {
                let planes = scratch.take(kernel, self.width, VERTEX_COUNT, &mut rest)?;
                let shift = shift(self.tolerance);
                let (low, high) = kernel::restore(kernel, planes.get(), self.first >> shift, heights);
                // Before the shift, which would hide what it pushes out.
                if low <= -HEIGHT_LIMIT >> shift || high >= HEIGHT_LIMIT >> shift {
                    return Err(ChunkError::Content("a height is out of range"));
                }
                if shift > 0 {
                    heights.iter_mut().for_each(|height| *height <<= shift);
                }
                Ok(())
            }
        })?;
        if heights[0] != self.first {
            return Err(ChunkError::Content("the first height is not the one in the header"));
        }
        Ok((word(grass, 0), palette, rest))
    }

    /// The grass densities: those that follow from the heights, or the payload's last part.
    fn density(
        &self,
        heights: &Heights,
        mut rest: &[u8],
    ) -> Result<Box<[u8; GRASS_GRID * GRASS_GRID]>, ChunkError> {
        let density = match self.grass {
            GRASS_BY_RULE => GrassSeed::density_of(self.key, heights),
            GRASS_SENT => {
                let mut density = Box::new([0; GRASS_GRID * GRASS_GRID]);
                let mut scratch = [0; GRASS_GRID * GRASS_GRID];
                density.copy_from_slice(parts::take_part(&mut rest, &mut scratch)?);
                density
            }
            _ => return Err(ChunkError::Content("grass comes in no such way")),
        };
        if rest.is_empty() { Ok(density) } else { Err(ChunkError::Trailing(rest.len())) }
    }
}

thread_local! {
    /// Where parts are decompressed to. Made once by every thread that decodes.
    static ROOM: RefCell<Box<Scratch>> = RefCell::new(Box::new(Scratch::new()));

    /// The input of a digest, in one piece: at most a frame and the known heights.
    static WHOLE: RefCell<Vec<u8>> = const { RefCell::new(Vec::new()) };
}

/// Bits that a height lost to a tolerance in units, 0 or a power of two.
const fn shift(tolerance: u16) -> u32 {
    if tolerance == 0 { 0 } else { tolerance.trailing_zeros() + 1 }
}

/// Magic, version, kind, key.
fn push_prefix(frame: &mut Vec<u8>, kind: u8, key: ChunkKey) {
    frame.extend_from_slice(&MAGIC);
    frame.extend_from_slice(&VERSION.to_le_bytes());
    frame.push(kind);
    frame.push(key.level());
    frame.extend_from_slice(&key.x().to_le_bytes());
    frame.extend_from_slice(&key.z().to_le_bytes());
}

/// The u32 at an offset that the caller has checked.
fn word(bytes: &[u8], at: usize) -> u32 {
    u32::from_le_bytes([bytes[at], bytes[at + 1], bytes[at + 2], bytes[at + 3]])
}

/// Digest of a frame with heights: the world, the header up to the digest, what the receiver must
/// have, the payload.
fn frame_digest(world: &WorldDigest, header: &[u8], known: Option<&Known>, payload: &[u8]) -> [u8; DIGEST] {
    match known {
        Some(known) => content_digest(world, [header, known.bytes().as_flattened(), payload]),
        None => content_digest(world, [header, payload]),
    }
}

/// Digest of a world and what belongs to it. The kind is in the header, so frames of two kinds
/// never share one.
fn content_digest<const N: usize>(world: &WorldDigest, content: [&[u8]; N]) -> [u8; DIGEST] {
    // In one piece: given in parts, what does not end at a multiple of 1 KiB keeps the hash from
    // its vectors.
    WHOLE.with_borrow_mut(|whole| {
        whole.clear();
        whole.extend_from_slice(&world.0);
        content.iter().for_each(|bytes| whole.extend_from_slice(bytes));
        let mut digest = [0; DIGEST];
        digest.copy_from_slice(&blake3::hash(whole).as_bytes()[..DIGEST]);
        digest
    })
}

#[cfg(test)]
mod tests;
