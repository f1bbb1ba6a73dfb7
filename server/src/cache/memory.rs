//! Frame cache in memory, bounded by bytes.

use crate::chunk_id::ChunkId;
use bytes::Bytes;
use protocol::{Delivery, chunk_codec};
use quick_cache::Weighter;
use quick_cache::sync::Cache;

/// Cache key.
type FrameId = (ChunkId, Delivery);

/// Bytes per entry in addition to the frame: key, handle and the map's share.
const ENTRY_OVERHEAD: u64 = 128;

/// Typical length of an exact frame, bytes; sizes the first tables only.
const TYPICAL_FRAME: u64 = 4096;

/// Frames by chunk and delivery.
pub struct FrameCache {
    cache: Cache<FrameId, CachedFrame, FrameWeight>,
}

/// A finished frame.
#[derive(Clone)]
pub struct CachedFrame {
    /// The encoded frame.
    pub frame: Bytes,
    /// Whether it has the fast encoding, which is longer than the compact one. The first request
    /// for it on an idle server encodes it again.
    pub is_fast_encoded: bool,
}

#[derive(Clone)]
struct FrameWeight;

impl Weighter<FrameId, CachedFrame> for FrameWeight {
    fn weight(&self, _id: &FrameId, cached: &CachedFrame) -> u64 {
        cached.frame.len() as u64 + ENTRY_OVERHEAD
    }
}

impl FrameCache {
    /// A cache of at most `bytes` bytes.
    #[must_use]
    pub fn new(bytes: u64) -> Self {
        Self { cache: Cache::with_weighter((bytes / TYPICAL_FRAME) as usize, bytes, FrameWeight) }
    }

    /// The frame of a chunk for a delivery; none if it is fast-encoded and the server `is_idle`, so
    /// that it can be encoded again.
    #[must_use]
    pub fn get(&self, id: ChunkId, delivery: Delivery, is_idle: impl FnOnce() -> bool) -> Option<Bytes> {
        let CachedFrame { frame, is_fast_encoded } = self.cache.get(&(id, delivery))?;
        (!is_fast_encoded || !is_idle()).then_some(frame)
    }

    /// Inserts a frame; evicts others if necessary.
    pub fn insert(&self, id: ChunkId, delivery: Delivery, frame: CachedFrame) {
        self.cache.insert((id, delivery), frame);
    }

    /// Removes all frames.
    pub fn clear(&self) {
        self.cache.clear();
    }

    /// The error of a chunk from its cached frame of any delivery.
    #[must_use]
    pub fn known_error(&self, id: ChunkId) -> Option<u32> {
        // A peek: this use does not count for the eviction policy.
        let cached = [Delivery::Exact, Delivery::Refined, Delivery::SeedOnly]
            .into_iter()
            .find_map(|delivery| self.cache.peek(&(id, delivery)))?;
        chunk_codec::error(&cached.frame)
    }

    /// Bytes in use, overhead included.
    #[cfg(test)]
    pub fn weight(&self) -> u64 {
        self.cache.weight()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use terrain::ChunkKey;

    #[test]
    fn the_cache_stays_within_its_bytes() {
        let frame = Bytes::from(vec![0; 500]);
        let budget = 10 * (frame.len() as u64 + ENTRY_OVERHEAD);
        let cache = FrameCache::new(budget);
        for x in 0..50 {
            let frame = CachedFrame { frame: frame.clone(), is_fast_encoded: false };
            cache.insert(ChunkId::base(ChunkKey::new(0, x, 0).unwrap()), Delivery::Exact, frame);
        }
        let frames = cache.cache.len() as u64;
        assert!((1..=10).contains(&frames), "{frames}");
        assert_eq!(cache.weight(), frames * budget / 10);
        cache.clear();
        assert_eq!((cache.cache.len(), cache.weight()), (0, 0));
    }
}
