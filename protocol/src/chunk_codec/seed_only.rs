//! The chunk frame without heights, for a client that generates the chunk itself.
//!
//! 36 bytes: the prefix of all kinds, the error, a digest. The error is sent because measuring it
//! costs many times the generation of the heights; the client cannot verify it, as in exact frames.
//! The digest covers the world, the header, the heights and the grass record, so that a difference
//! of one unit is detected.

use super::{DIGEST, KIND_SEED_ONLY, PREFIX, content_digest, kind_and_key, push_prefix, word};
use crate::error::ChunkError;
use crate::limits::{GRASS_RECORD, SEED_ONLY_FRAME};
use bytes::Bytes;
use terrain::constants::VERTEX_COUNT;
use terrain::{Chunk, ChunkKey, GrassSeed, Land, WorldDigest};

const DIGEST_AT: usize = PREFIX + 4;

const _: () = assert!(DIGEST_AT + DIGEST == SEED_ONLY_FRAME);

/// Encodes a chunk of a world as its key, its error and a digest.
#[must_use]
pub fn encode(chunk: &Chunk, world: &WorldDigest) -> Bytes {
    let mut frame = Vec::with_capacity(SEED_ONLY_FRAME);
    push_header(&mut frame, chunk);
    let digest = digest(chunk, world);
    frame.extend_from_slice(&digest);
    frame.into()
}

/// The digest of a chunk's content: world, key, error, heights and grass record. Equal for every
/// encoding of the chunk, on every server of the world; the ETag of the chunk's address.
#[must_use]
pub fn digest(chunk: &Chunk, world: &WorldDigest) -> [u8; DIGEST] {
    let mut header = Vec::with_capacity(DIGEST_AT);
    push_header(&mut header, chunk);
    content_digest(world, [&header, &content(chunk)])
}

fn push_header(frame: &mut Vec<u8>, chunk: &Chunk) {
    push_prefix(frame, KIND_SEED_ONLY, chunk.key);
    frame.extend_from_slice(&chunk.error.to_le_bytes());
}

/// Generates the chunk that a frame names and verifies it. `world` is the digest of `land`,
/// computed once by the caller.
///
/// Costs as much as the heights of one chunk, for any input, and never panics.
///
/// # Errors
/// See [`ChunkError`]; [`ChunkError::Regenerated`] if the chunk generated here has another digest.
pub fn decode(frame: &[u8], land: &Land, world: &WorldDigest) -> Result<Chunk, ChunkError> {
    let header = Header::read(frame)?;
    let chunk = complete(land, header.key, header.error);
    if content_digest(world, [&frame[..DIGEST_AT], &content(&chunk)]) != header.digest {
        return Err(ChunkError::Regenerated(header.key));
    }
    Ok(chunk)
}

/// The chunk of a key with a known error (units), without measuring the error.
#[must_use]
pub fn complete(land: &Land, key: ChunkKey, error: u32) -> Chunk {
    let heights = land.chunk_heights(key);
    let grass = GrassSeed::grow(land.world_seed(), key, &heights);
    Chunk::from_parts(key, heights, error, grass)
}

/// A frame's fields, checked against the length of the whole frame.
pub(super) struct Header {
    pub(super) key: ChunkKey,
    /// Units.
    pub(super) error: u32,
    digest: [u8; DIGEST],
}

impl Header {
    pub(super) fn read(frame: &[u8]) -> Result<Self, ChunkError> {
        let (kind, key) = kind_and_key(frame)?;
        if kind != KIND_SEED_ONLY {
            return Err(ChunkError::UnknownKind(kind));
        }
        let truncated = ChunkError::Truncated { got: frame.len(), expected: SEED_ONLY_FRAME };
        let (header, rest) = frame.split_first_chunk::<SEED_ONLY_FRAME>().ok_or(truncated)?;
        if !rest.is_empty() {
            return Err(ChunkError::Trailing(rest.len()));
        }
        let mut digest = [0; DIGEST];
        digest.copy_from_slice(&header[DIGEST_AT..]);
        Ok(Self { key, error: word(header, PREFIX), digest })
    }
}

/// The content that a client must reproduce: all heights, i32 each, and the grass record.
fn content(chunk: &Chunk) -> Vec<u8> {
    let mut content = Vec::with_capacity(4 * VERTEX_COUNT + GRASS_RECORD);
    content.resize(4 * VERTEX_COUNT, 0);
    for (bytes, height) in content.chunks_exact_mut(4).zip(&chunk.heights[..]) {
        bytes.copy_from_slice(&height.to_le_bytes());
    }
    content.extend_from_slice(&chunk.grass.seed.to_le_bytes());
    content.push(chunk.grass.palette);
    content.extend_from_slice(&chunk.grass.density[..]);
    content
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::chunk_codec;
    use proptest::prelude::*;

    fn sample(level: u8, x: i32, z: i32) -> (Chunk, Land, WorldDigest, Bytes) {
        let land = Land::new(1);
        let (chunk, world) = (land.chunk(ChunkKey::new(level, x, z).unwrap()), land.digest());
        let frame = encode(&chunk, &world);
        (chunk, land, world, frame)
    }

    #[test]
    fn regenerated_chunks_equal_exact_frames_at_every_level() {
        for (level, x, z) in [(0, 3, -7), (0, 60, 60), (1, -3, -3), (4, 0, -1), (9, 2, 2), (16, 0, 0)] {
            let (chunk, land, world, frame) = sample(level, x, z);
            assert_eq!(frame.len(), SEED_ONLY_FRAME);
            let exact = chunk_codec::decode(&chunk_codec::encode(&chunk, &world), &world);
            assert_eq!(decode(&frame, &land, &world), exact);
            assert_eq!(exact, Ok(chunk.clone()));
            assert_eq!(chunk_codec::error(&frame), Some(chunk.error));
            assert_eq!(complete(&land, chunk.key, chunk.error), chunk);
        }
    }

    #[test]
    fn every_truncation_and_every_extension_is_refused() {
        let (_, land, world, frame) = sample(0, 3, -7);
        for length in 0..frame.len() {
            let cut = decode(&frame[..length], &land, &world);
            assert!(matches!(cut, Err(ChunkError::Truncated { .. })), "{length}: {cut:?}");
            assert_eq!(chunk_codec::error(&frame[..length]), None);
        }
        for extra in [1, 24, 1 << 20] {
            let longer = [&frame[..], &vec![0; extra]].concat();
            assert_eq!(decode(&longer, &land, &world), Err(ChunkError::Trailing(extra)));
        }
    }

    #[test]
    fn every_flipped_bit_is_refused() {
        let (_, land, world, frame) = sample(1, 2, 2);
        for bit in 0..frame.len() * 8 {
            let mut damaged = frame.to_vec();
            damaged[bit / 8] ^= 1 << (bit % 8);
            assert!(decode(&damaged, &land, &world).is_err(), "bit {bit}");
        }
    }

    #[test]
    fn one_unit_one_grass_byte_or_another_world_is_detected() {
        let (chunk, land, world, _) = sample(0, 3, -7);
        let expected = Err(ChunkError::Regenerated(chunk.key));
        for vertex in [0, 64, 2000, VERTEX_COUNT - 1] {
            let mut lie = chunk.clone();
            lie.heights[vertex] += 1;
            assert_eq!(decode(&encode(&lie, &world), &land, &world), expected, "vertex {vertex}");
        }
        let mut lie = chunk.clone();
        lie.grass.density[7] ^= 1;
        assert_eq!(decode(&encode(&lie, &world), &land, &world), expected);
        assert_eq!(decode(&encode(&chunk, &Land::new(2).digest()), &land, &world), expected);
        assert_eq!(decode(&encode(&chunk, &world), &Land::new(2), &world), expected);
    }

    #[test]
    fn neither_kind_is_taken_for_the_other() {
        let (chunk, land, world, frame) = sample(0, 3, -7);
        assert_eq!(
            chunk_codec::decode(&frame, &world),
            Err(ChunkError::UnknownKind(KIND_SEED_ONLY)),
            "a short frame is identified by its kind, not by its length"
        );
        let exact = chunk_codec::encode(&chunk, &world);
        assert_eq!(decode(&exact, &land, &world), Err(ChunkError::UnknownKind(chunk_codec::KIND_EXACT)));
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(64))]

        #[test]
        fn garbage_never_panics(bytes in proptest::collection::vec(any::<u8>(), 0..80), kind in 0u8..4) {
            let land = Land::new(1);
            let world = land.digest();
            prop_assert!(decode(&bytes, &land, &world).is_err());
            let mut framed = sample(0, 60, 60).3.to_vec();
            framed[6] = kind;
            framed.truncate(PREFIX);
            framed.extend(&bytes);
            prop_assert!(decode(&framed, &land, &world).is_err());
            let _ = chunk_codec::error(&framed);
        }
    }
}
