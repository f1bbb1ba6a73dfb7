//! Content digests of chunks that were served by address. A frame does not contain the digest of its
//! content, and computing it takes decoding the frame.

use crate::chunk_id::ChunkId;
use protocol::chunk_codec::{self, DIGEST, seed_only};
use protocol::error::ChunkError;
use quick_cache::sync::Cache;
use terrain::WorldDigest;

/// Digests that are kept: about 4 MiB. A full cache evicts the least useful ones; a missing one is
/// computed again.
const CAPACITY: usize = 1 << 16;

/// The content digests of one world's chunks. An edition of a chunk has one content, so an entry
/// never becomes invalid.
pub struct ContentDigests {
    known: Cache<ChunkId, [u8; DIGEST]>,
}

impl Default for ContentDigests {
    fn default() -> Self {
        Self { known: Cache::new(CAPACITY) }
    }
}

impl ContentDigests {
    /// The content digest of an exact frame of a world: known, or by decoding the frame.
    ///
    /// # Errors
    /// The frame is damaged and its digest is not known.
    pub fn of(&self, id: ChunkId, frame: &[u8], world: &WorldDigest) -> Result<[u8; DIGEST], ChunkError> {
        self.known.get_or_insert_with(&id, || {
            let chunk = chunk_codec::decode(frame, world)?;
            Ok(seed_only::digest(&chunk, world))
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use terrain::{ChunkKey, Land};

    #[test]
    fn a_digest_is_that_of_the_content_and_is_computed_once() {
        let land = Land::new(7);
        let world = land.digest();
        let digests = ContentDigests::default();
        let [one, other] = [(0, 0), (1, 0)].map(|(x, z)| land.chunk(ChunkKey::new(0, x, z).unwrap()));
        let frame = chunk_codec::encode(&one, &world);
        // A damaged frame has no digest, and none is kept for it.
        let mut damaged = frame.to_vec();
        damaged[100] ^= 1;
        assert!(digests.of(ChunkId::base(one.key), &damaged, &world).is_err());
        assert_eq!(digests.of(ChunkId::base(one.key), &frame, &world), Ok(seed_only::digest(&one, &world)));
        assert_eq!(
            digests.of(ChunkId::base(one.key), &[], &world),
            Ok(seed_only::digest(&one, &world)),
            "no decoding"
        );
        let frame = chunk_codec::encode(&other, &world);
        assert_ne!(
            digests.of(ChunkId::base(other.key), &frame, &world),
            digests.of(ChunkId::base(one.key), &[], &world)
        );
    }
}
