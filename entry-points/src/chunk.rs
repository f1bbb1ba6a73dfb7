//! Chunk frames, by every decoder.

use crate::world::{DELIVERIES, WORLD, frame, key};
use protocol::Tolerance;
use protocol::chunk_codec::{self, Kernel, quantised, refined, seed_only};
use terrain::Chunk;
use terrain::constants::VERTEX_COUNT;

/// Decodes a frame. A decoded chunk keeps the invariants of its type.
///
/// # Panics
/// It does not.
#[must_use]
pub fn run(bytes: &[u8]) -> bool {
    let (land, world, parent) = (&WORLD.land, &WORLD.digest, &WORLD.parent);
    let mut heights = Box::new([0; VERTEX_COUNT]);
    let _ = chunk_codec::heights_on(Kernel::best(), bytes, &mut heights);
    let _ = chunk_codec::verify(bytes, world);
    let decoded = [
        chunk_codec::decode(bytes, world),
        quantised::decode(bytes, world, Tolerance::COARSEST),
        refined::decode(bytes, world, parent),
        seed_only::decode(bytes, land, world),
    ];
    let mut is_accepted = false;
    for chunk in decoded.into_iter().flatten() {
        let again = Chunk::from_parts(chunk.key, chunk.heights.clone(), chunk.error, chunk.grass.clone());
        assert_eq!(again, chunk);
        is_accepted = true;
    }
    is_accepted
}

/// One frame of each kind.
#[must_use]
pub fn seeds() -> Vec<Vec<u8>> {
    let frames = DELIVERIES.map(|delivery| frame(key(0, 0, 0), delivery).to_vec());
    frames.into_iter().chain([frame(key(9, -1, 0), DELIVERIES[0]).to_vec()]).collect()
}
