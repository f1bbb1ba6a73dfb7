//! Content digests of chunks that were served by address. A frame does not contain the digest of
//! its content, and computing it takes decoding the frame.

use crate::chunk_id::ChunkId;
use crate::limits::rate_limit::TokenBucket;
use protocol::chunk_codec::{self, DIGEST, seed_only};
use protocol::error::ChunkError;
use quick_cache::sync::Cache;
use terrain::WorldDigest;
use tokio::time::Instant;

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
    /// The content digest of an exact frame of a world: known, or by decoding the frame, which is
    /// charged to `bucket`.
    ///
    /// # Errors
    /// The frame is damaged and its digest is not known.
    pub fn of(
        &self,
        id: ChunkId,
        frame: &[u8],
        world: &WorldDigest,
        bucket: &TokenBucket,
    ) -> Result<[u8; DIGEST], ChunkError> {
        self.known.get_or_insert_with(&id, || {
            let started = Instant::now();
            let digest = chunk_codec::decode(frame, world).map(|chunk| seed_only::digest(&chunk, world));
            let now = Instant::now();
            bucket.charge_work((now - started).as_micros() as i64, now);
            digest
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::limits::rate_limit::RateLimiter;
    use terrain::{ChunkKey, Land};

    #[test]
    fn a_digest_is_that_of_the_content_and_is_computed_once() {
        let land = Land::new(7);
        let world = land.digest();
        let digests = ContentDigests::default();
        // It never refills.
        let bucket = RateLimiter::new(Some(0)).bucket(Some("10.0.0.1".parse().unwrap()));
        let [one, other] = [(0, 0), (1, 0)].map(|(x, z)| land.chunk(ChunkKey::new(0, x, z).unwrap()));
        let frame = chunk_codec::encode(&one, &world);
        // A damaged frame has no digest, and none is kept for it.
        let mut damaged = frame.to_vec();
        damaged[100] ^= 1;
        assert!(digests.of(ChunkId::base(one.key), &damaged, &world, &bucket).is_err());
        assert_eq!(
            digests.of(ChunkId::base(one.key), &frame, &world, &bucket),
            Ok(seed_only::digest(&one, &world))
        );
        assert_eq!(
            digests.of(ChunkId::base(one.key), &[], &world, &bucket),
            Ok(seed_only::digest(&one, &world)),
            "no decoding"
        );
        let charged = bucket.tokens();
        assert!(charged < 0.0);
        digests.of(ChunkId::base(one.key), &frame, &world, &bucket).unwrap();
        assert!((bucket.tokens() - charged).abs() < 1e-6, "a known digest costs nothing");
        let frame = chunk_codec::encode(&other, &world);
        assert_ne!(
            digests.of(ChunkId::base(other.key), &frame, &world, &bucket),
            digests.of(ChunkId::base(one.key), &[], &world, &bucket)
        );
    }
}
