//! Chunk frames, by every decoder: as they are, and with the digest that a hostile server would
//! write.
//!
//! A changed frame ends at its digest. So each frame is decoded a second time with the length and
//! the digest of its bytes, and what is behind the digest reads hostile bytes, too.

use crate::world::{DELIVERIES, WORLD, frame, key, rough};
use protocol::Tolerance;
use protocol::chunk_codec::{self, Effort, Kernel, quantised, refined, seed_only};
use protocol::limits::CHUNK_HEADER;
use protocol::{ChunkError, Delivery};
use terrain::Chunk;
use terrain::constants::VERTEX_COUNT;

/// Decodes a frame, with its digest and with that of its bytes. A decoded chunk keeps the
/// invariants of its type.
///
/// # Panics
/// It does not.
#[must_use]
pub fn run(bytes: &[u8]) -> bool {
    let mut heights = Box::new([0; VERTEX_COUNT]);
    let _ = chunk_codec::heights_on(Kernel::best(), bytes, &mut heights);
    let _ = chunk_codec::verify(bytes, &WORLD.digest);
    let _ = refined::decode(bytes, &WORLD.digest, &WORLD.parent);
    // Its decoder does all its work before it compares the digest.
    let generated = seed_only::decode(bytes, &WORLD.land, &WORLD.digest);
    let resealed = resealed(bytes);
    let frames = [Some(bytes), resealed.as_deref()].into_iter().flatten();
    let decoded = frames.flat_map(|frame| decode(frame, &WORLD.parent.heights)).chain([generated]);
    let mut is_accepted = false;
    for chunk in decoded.flatten() {
        let again = Chunk::from_parts(chunk.key, chunk.heights.clone(), chunk.error, chunk.grass.clone());
        assert_eq!(again, chunk);
        is_accepted = true;
    }
    is_accepted
}

/// Decodes a frame as each kind with heights, over the heights of a parent of any key.
fn decode(frame: &[u8], parent: &[i32; VERTEX_COUNT]) -> [Result<Chunk, ChunkError>; 3] {
    [
        chunk_codec::decode(frame, &WORLD.digest),
        quantised::decode(frame, &WORLD.digest, Tolerance::COARSEST),
        refined::decode_over(frame, &WORLD.digest, parent),
    ]
}

/// The frame with the length and the digest of its bytes; none for bytes that no decoder takes for
/// a frame with heights.
fn resealed(bytes: &[u8]) -> Option<Vec<u8>> {
    let is_frame = bytes.starts_with(&chunk_codec::MAGIC) && bytes.len() >= CHUNK_HEADER;
    let mut frame = is_frame.then(|| bytes.to_vec())?;
    chunk_codec::rewrite_digest(&mut frame, &WORLD.digest, Some(&WORLD.parent.heights));
    Some(frame)
}

/// The frame that is decoded behind its digest, if it is; with `reseals` that of [`run`]'s second
/// decoding, else that of the first. For tests of what [`run`] covers.
#[must_use]
pub fn read(bytes: &[u8], reseals: bool) -> Vec<Vec<u8>> {
    let frame = if reseals { resealed(bytes) } else { Some(bytes.to_vec()) };
    frame.filter(|frame| is_read(frame, &WORLD.parent.heights)).into_iter().collect()
}

/// Whether a decoder reads what is behind a frame's digest: it rejects another digest as such, and
/// this one not.
pub(crate) fn is_read(frame: &[u8], parent: &[i32; VERTEX_COUNT]) -> bool {
    let fails = |frame: &[u8]| decode(frame, parent).contains(&Err(ChunkError::Digest));
    let mut other = frame.to_vec();
    let Some(last) = other.get_mut(CHUNK_HEADER - 1) else { return false };
    *last ^= 1;
    fails(&other) && !fails(frame)
}

/// Frames of each kind: of land, and of a chunk with all byte planes and with grass densities.
#[must_use]
pub fn seeds() -> Vec<Vec<u8>> {
    let land = DELIVERIES.map(|delivery| frame(key(0, 0, 0), delivery));
    let rough = [Delivery::Exact, Delivery::Refined, DELIVERIES[3]]
        .map(|delivery| chunk_codec::encode_with(delivery, Effort::Fast, &rough(), &WORLD.digest));
    let coarse = frame(key(9, -1, 0), DELIVERIES[0]);
    land.iter().chain(&rough).chain([&coarse]).map(|frame| frame.to_vec()).collect()
}
