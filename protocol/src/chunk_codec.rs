//! Chunk frames: one chunk as bytes, lossless.
//!
//! Every frame begins with the same 16 bytes: magic, version, kind, key. This file owns them and the kind that carries all
//! heights; [`seed_only`] is the kind that carries none.
//!
//! Heights are predicted from three neighbours (`left + above - above left`, the plane predictor), the residuals
//! zigzag-mapped, split into byte planes and LZ4-compressed. Nothing that follows from the heights is sent:
//! the decoder rebuilds the pyramids. Little-endian throughout; layout in `docs/protocol.md`.
//!
//! The digest at the end of the header covers the world, the header and the payload, so a chunk of another world, or a damaged one,
//! is recognised. It identifies the content: equal digests mean equal chunks.

pub mod seed_only;

use crate::delivery::Delivery;
use crate::error::ChunkError;
use crate::limits::{CHUNK_HEADER, GRASS_RECORD, MAX_CHUNK_FRAME, MAX_RAW_PAYLOAD};
use bytes::Bytes;
use terrain::constants::{GRASS_GRID, HEIGHT_LIMIT, VERTEX_COUNT, VERTICES};
use terrain::grass::PALETTES;
use terrain::{Chunk, ChunkKey, GrassSeed, WorldDigest};

/// First bytes of every chunk frame.
pub const MAGIC: [u8; 4] = *b"TMBC";

/// Version of the chunk format. The predictor, the plane order and the compression are part of it.
pub const VERSION: u16 = 1;

/// Exact heights: plane residuals, LZ4 block.
pub const KIND_EXACT_LZ4: u8 = 0;

/// No heights: what is needed to generate the chunk and to verify it.
pub const KIND_SEED_ONLY: u8 = 1;

/// Bytes of a content digest: the first half of a blake3 hash.
pub const DIGEST: usize = 16;

const DIGEST_AT: usize = CHUNK_HEADER - DIGEST;

/// Bytes that all kinds begin with.
const PREFIX: usize = 16;

/// The longest frame that [`encode`] makes, bytes.
#[must_use]
pub const fn bound() -> usize {
    MAX_CHUNK_FRAME
}

/// Encodes a chunk of a world for a delivery.
#[must_use]
pub fn encode_for(delivery: Delivery, chunk: &Chunk, world: &WorldDigest) -> Bytes {
    match delivery {
        Delivery::Exact => encode(chunk, world),
        Delivery::SeedOnly => seed_only::encode(chunk, world),
    }
}

/// Encodes a chunk of a world with all its heights.
#[must_use]
pub fn encode(chunk: &Chunk, world: &WorldDigest) -> Bytes {
    let residuals = residuals(&chunk.heights);
    let widest = residuals.iter().fold(0, |all, residual| all | residual);
    let planes = (4 - widest.leading_zeros() as usize / 8).max(1);

    let mut raw = Vec::with_capacity(raw_length(planes));
    raw.push(planes as u8);
    for plane in 0..planes {
        raw.extend(residuals.iter().map(|residual| residual.to_le_bytes()[plane]));
    }
    push_grass(&mut raw, &chunk.grass);
    let coded = lz4_flex::block::compress(&raw);

    let mut frame = Vec::with_capacity(CHUNK_HEADER + coded.len());
    push_prefix(&mut frame, KIND_EXACT_LZ4, chunk.key);
    let words = [chunk.heights[0], chunk.min(), chunk.max()];
    frame.extend(words.into_iter().flat_map(i32::to_le_bytes));
    let words = [chunk.error, chunk.slope, raw.len() as u32, coded.len() as u32];
    frame.extend(words.into_iter().flat_map(u32::to_le_bytes));
    let digest = content_digest(world, &frame, &raw);
    frame.extend_from_slice(&digest);
    frame.extend_from_slice(&coded);
    frame.into()
}

/// Decodes one whole exact frame of a world.
///
/// Takes at most [`MAX_RAW_PAYLOAD`] bytes besides the chunk itself, whatever the frame says, and never panics.
///
/// # Errors
/// See [`ChunkError`]. A chunk that is returned keeps every promise of its type: the key exists, heights are in
/// range, extremes and slope are those of the heights.
pub fn decode(frame: &[u8], world: &WorldDigest) -> Result<Chunk, ChunkError> {
    let header = Header::read(frame)?;
    let coded = &frame[CHUNK_HEADER..];
    let mut raw = vec![0; header.raw_length];
    match lz4_flex::block::decompress_into(coded, &mut raw) {
        Ok(written) if written == raw.len() => {}
        _ => return Err(ChunkError::Compression),
    }
    if content_digest(world, &frame[..DIGEST_AT], &raw) != frame[DIGEST_AT..CHUNK_HEADER] {
        return Err(ChunkError::Digest);
    }
    let heights = heights(header.base, &raw)?;
    let grass = grass(&raw[raw.len() - GRASS_RECORD..])?;
    let chunk = Chunk::from_parts(header.key, heights, header.error, grass);
    if (chunk.min(), chunk.max(), chunk.slope) != (header.min, header.max, header.slope) {
        return Err(ChunkError::Content("extremes or slope differ from the heights"));
    }
    Ok(chunk)
}

/// The kind and the key of a frame, without looking further. A kind that this side does not know is returned as well.
///
/// # Errors
/// As [`decode`], for what the first 16 bytes can tell.
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

/// The chunk's error (units) as a frame of either kind states it; none if the frame is no chunk frame.
#[must_use]
pub fn error(frame: &[u8]) -> Option<u32> {
    match kind_and_key(frame).ok()?.0 {
        KIND_EXACT_LZ4 => Header::read(frame).ok().map(|header| header.error),
        KIND_SEED_ONLY => seed_only::Header::read(frame).ok().map(|header| header.error),
        _ => None,
    }
}

/// The content digest of a frame made by [`encode`]; none if the frame is too short to hold one.
#[must_use]
pub fn digest(frame: &[u8]) -> Option<[u8; DIGEST]> {
    frame.get(DIGEST_AT..CHUNK_HEADER)?.try_into().ok()
}

struct Header {
    key: ChunkKey,
    base: i32,
    min: i32,
    max: i32,
    error: u32,
    slope: u32,
    raw_length: usize,
}

impl Header {
    /// Reads and checks the header against the length of the whole frame.
    fn read(frame: &[u8]) -> Result<Self, ChunkError> {
        if frame.len() > MAX_CHUNK_FRAME {
            return Err(ChunkError::TooLong(frame.len()));
        }
        let (kind, key) = kind_and_key(frame)?;
        if kind != KIND_EXACT_LZ4 {
            return Err(ChunkError::UnknownKind(kind));
        }
        let truncated = ChunkError::Truncated { got: frame.len(), expected: CHUNK_HEADER };
        let header: &[u8; CHUNK_HEADER] = frame.first_chunk().ok_or(truncated)?;
        let signed = |at: usize| word(header, at) as i32;
        let (raw, coded) = (word(header, 36), word(header, 40));
        if !(1..=4).any(|planes| raw as usize == raw_length(planes)) {
            return Err(ChunkError::Length { field: "raw", value: raw });
        }
        let expected = CHUNK_HEADER.saturating_add(coded as usize);
        if expected > MAX_CHUNK_FRAME {
            return Err(ChunkError::Length { field: "coded", value: coded });
        }
        if frame.len() < expected {
            return Err(ChunkError::Truncated { got: frame.len(), expected });
        }
        if frame.len() > expected {
            return Err(ChunkError::Trailing(frame.len() - expected));
        }
        Ok(Self {
            key,
            base: signed(16),
            min: signed(20),
            max: signed(24),
            error: word(header, 28),
            slope: word(header, 32),
            raw_length: raw as usize,
        })
    }
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

/// The u32 at an offset below the header's end, which the caller has checked.
fn word(header: &[u8], at: usize) -> u32 {
    u32::from_le_bytes([header[at], header[at + 1], header[at + 2], header[at + 3]])
}

const fn raw_length(planes: usize) -> usize {
    1 + planes * VERTEX_COUNT + GRASS_RECORD
}

const _: () = assert!(raw_length(4) == MAX_RAW_PAYLOAD);

/// The plane predictor: what a height would be if the land were flat through three decoded neighbours.
fn predict(heights: &[i32], index: usize) -> i32 {
    let (x, z) = (index % VERTICES, index / VERTICES);
    match (x, z) {
        (0, 0) => heights[0],
        (_, 0) => heights[index - 1],
        (0, _) => heights[index - VERTICES],
        _ => heights[index - 1]
            .wrapping_add(heights[index - VERTICES])
            .wrapping_sub(heights[index - VERTICES - 1]),
    }
}

/// Zigzag residuals of all vertices; the first is zero because its height is in the header.
fn residuals(heights: &[i32; VERTEX_COUNT]) -> Vec<u32> {
    let residual = |index: usize| heights[index].wrapping_sub(predict(heights, index));
    (0..VERTEX_COUNT).map(|index| zigzag(residual(index))).collect()
}

fn heights(base: i32, raw: &[u8]) -> Result<Box<[i32; VERTEX_COUNT]>, ChunkError> {
    let planes = usize::from(raw[0]);
    if raw.len() != raw_length(planes) {
        return Err(ChunkError::Content("plane count does not fit the payload length"));
    }
    let mut heights = Box::new([base; VERTEX_COUNT]);
    for index in 0..VERTEX_COUNT {
        let byte = |plane: usize| u32::from(raw[1 + plane * VERTEX_COUNT + index]) << (8 * plane);
        let residual = (0..planes).fold(0u32, |word, plane| word | byte(plane));
        heights[index] = predict(&heights[..], index).wrapping_add(unzigzag(residual));
    }
    if heights.iter().any(|height| height.unsigned_abs() >= HEIGHT_LIMIT as u32) {
        return Err(ChunkError::Content("a height is out of range"));
    }
    Ok(heights)
}

/// The grass record: [`GRASS_RECORD`] bytes.
fn push_grass(raw: &mut Vec<u8>, grass: &GrassSeed) {
    raw.extend_from_slice(&grass.seed.to_le_bytes());
    raw.push(grass.palette);
    raw.extend_from_slice(&grass.density[..]);
}

fn grass(record: &[u8]) -> Result<GrassSeed, ChunkError> {
    let palette = record[4];
    if palette >= PALETTES {
        return Err(ChunkError::Content("the grass palette does not exist"));
    }
    let mut density = Box::new([0; GRASS_GRID * GRASS_GRID]);
    density.copy_from_slice(&record[5..]);
    Ok(GrassSeed { seed: u32::from_le_bytes([record[0], record[1], record[2], record[3]]), palette, density })
}

/// Digest of a world, a header up to its digest, and what the frame stands for. The kind is in the header, so frames of
/// two kinds never share one.
fn content_digest(world: &WorldDigest, header: &[u8], content: &[u8]) -> [u8; DIGEST] {
    let mut hasher = blake3::Hasher::new();
    hasher.update(&world.0).update(header).update(content);
    let mut digest = [0; DIGEST];
    hasher.finalize_xof().fill(&mut digest);
    digest
}

const fn zigzag(value: i32) -> u32 {
    ((value << 1) ^ (value >> 31)) as u32
}

const fn unzigzag(value: u32) -> i32 {
    (value >> 1) as i32 ^ -((value & 1) as i32)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use terrain::Land;

    fn sample(level: u8, x: i32, z: i32) -> (Chunk, WorldDigest, Bytes) {
        let land = Land::new(1);
        let chunk = land.chunk(ChunkKey::new(level, x, z).unwrap());
        let world = land.digest();
        let frame = encode(&chunk, &world);
        (chunk, world, frame)
    }

    #[test]
    fn chunks_survive_the_wire_at_every_level() {
        for (level, x, z) in [(0, 3, -7), (0, 60, 60), (1, -3, -3), (4, 0, -1), (9, 2, 2), (16, 0, 0)] {
            let (chunk, world, frame) = sample(level, x, z);
            assert!(frame.len() <= bound());
            assert_eq!(decode(&frame, &world), Ok(chunk.clone()));
            assert_eq!(kind_and_key(&frame), Ok((KIND_EXACT_LZ4, chunk.key)));
            assert_eq!(error(&frame), Some(chunk.error));
        }
    }

    #[test]
    fn land_takes_about_a_byte_and_a_half_a_vertex_and_the_sea_next_to_nothing() {
        assert!(sample(0, 3, -7).2.len() < VERTEX_COUNT * 2);
        assert!(sample(0, 60, 60).2.len() < 200);
    }

    #[test]
    fn every_truncation_and_every_extension_is_refused() {
        let (_, world, frame) = sample(0, 3, -7);
        for length in 0..frame.len() {
            assert!(
                matches!(decode(&frame[..length], &world), Err(ChunkError::Truncated { .. })),
                "{length}"
            );
        }
        let longer = [&frame[..], &[0]].concat();
        assert_eq!(decode(&longer, &world), Err(ChunkError::Trailing(1)));
        assert!(matches!(decode(&vec![0; MAX_CHUNK_FRAME + 1], &world), Err(ChunkError::TooLong(_))));
    }

    #[test]
    fn every_flipped_bit_is_refused_or_changes_nothing() {
        let (chunk, world, frame) = sample(1, 2, 2);
        let mut refused = 0;
        for bit in 0..frame.len() * 8 {
            let mut damaged = frame.to_vec();
            damaged[bit / 8] ^= 1 << (bit % 8);
            // LZ4 can say the same payload in two ways; the digest covers the payload, not its coding.
            match decode(&damaged, &world) {
                Ok(same) => assert_eq!(same, chunk, "bit {bit}"),
                Err(_) => refused += 1,
            }
        }
        assert!(refused > frame.len() * 7, "{refused} of {} bits", frame.len() * 8);
    }

    #[test]
    fn a_chunk_of_another_world_is_refused() {
        let (_, _, frame) = sample(0, 3, -7);
        assert_eq!(decode(&frame, &Land::new(2).digest()), Err(ChunkError::Digest));
    }

    #[test]
    fn length_fields_at_their_extremes_are_refused_without_allocation() {
        let (_, world, frame) = sample(0, 3, -7);
        for (at, field) in [(36, "raw"), (40, "coded")] {
            for value in [u32::MAX, MAX_CHUNK_FRAME as u32] {
                let mut damaged = frame.to_vec();
                damaged[at..at + 4].copy_from_slice(&value.to_le_bytes());
                assert_eq!(decode(&damaged, &world), Err(ChunkError::Length { field, value }));
            }
        }
    }

    #[test]
    fn a_well_signed_chunk_with_lying_extremes_is_refused() {
        let (mut chunk, world, _) = sample(0, 3, -7);
        chunk.slope += 1;
        let lie = ChunkError::Content("extremes or slope differ from the heights");
        assert_eq!(decode(&encode(&chunk, &world), &world), Err(lie));
        chunk.slope -= 1;
        chunk.grass.palette = PALETTES;
        assert!(matches!(decode(&encode(&chunk, &world), &world), Err(ChunkError::Content(_))));
    }

    proptest! {
        #[test]
        fn any_heights_survive(seed: u32, amplitude in 0u32..24, palette in 0..PALETTES) {
            let mut heights = Box::new([0; VERTEX_COUNT]);
            for (index, height) in heights.iter_mut().enumerate() {
                let word = terrain::hash::mix(seed.wrapping_add(index as u32)) as i32;
                *height = word.checked_shr(32 - amplitude).unwrap_or(0).clamp(1 - HEIGHT_LIMIT, HEIGHT_LIMIT - 1);
            }
            let grass = GrassSeed { seed, palette, density: Box::new([seed as u8; 256]) };
            let chunk = Chunk::from_parts(ChunkKey::new(0, 1, 1).unwrap(), heights, seed, grass);
            let world = WorldDigest([7; 32]);
            prop_assert_eq!(decode(&encode(&chunk, &world), &world), Ok(chunk));
        }

        #[test]
        fn garbage_never_panics(bytes in proptest::collection::vec(any::<u8>(), 0..400)) {
            prop_assert!(decode(&bytes, &WorldDigest([0; 32])).is_err());
            let mut framed = sample(0, 60, 60).2.to_vec();
            framed.truncate(CHUNK_HEADER);
            framed.extend(&bytes);
            framed[40..44].copy_from_slice(&(bytes.len() as u32).to_le_bytes());
            prop_assert!(decode(&framed, &Land::new(1).digest()).is_err());
        }
    }
}
