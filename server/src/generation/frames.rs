//! Finished frames in memory, bounded by their bytes.

use bytes::Bytes;
use protocol::{Delivery, chunk_codec};
use quick_cache::Weighter;
use quick_cache::sync::Cache;
use terrain::ChunkKey;

/// What a frame is kept under.
type FrameId = (ChunkKey, Delivery);

/// Frames by chunk and delivery.
pub struct Frames {
    cache: Cache<FrameId, Kept, FrameWeight>,
}

/// A finished frame.
#[derive(Clone)]
pub struct Kept {
    /// The frame.
    pub frame: Bytes,
    /// Whether it was coded in haste and is longer than it need be. The first who asks for it when
    /// nothing waits has it made again, with care.
    pub is_hasty: bool,
}

#[derive(Clone)]
struct FrameWeight;

impl Weighter<FrameId, Kept> for FrameWeight {
    fn weight(&self, _id: &FrameId, kept: &Kept) -> u64 {
        // The key, the handle and the map's own share, besides the bytes; for a seed-only frame
        // most of it.
        kept.frame.len() as u64 + 128
    }
}

impl Frames {
    /// Room for so many bytes.
    #[must_use]
    pub fn new(bytes: u64) -> Self {
        // About 4 KiB an exact frame; the estimate only sizes the first tables.
        Self { cache: Cache::with_weighter((bytes / 4096) as usize, bytes, FrameWeight) }
    }

    /// The frame of a chunk for a delivery; none if it was made in haste and there `is_time` to
    /// make a better one.
    #[must_use]
    pub fn get(&self, key: ChunkKey, delivery: Delivery, is_time: impl FnOnce() -> bool) -> Option<Bytes> {
        let Kept { frame, is_hasty } = self.cache.get(&(key, delivery))?;
        (!is_hasty || !is_time()).then_some(frame)
    }

    /// Keeps a frame; others may have to go.
    pub fn insert(&self, key: ChunkKey, delivery: Delivery, kept: Kept) {
        self.cache.insert((key, delivery), kept);
    }

    /// The error of a chunk that was made before and is still kept for some delivery.
    #[must_use]
    pub fn known_error(&self, key: ChunkKey) -> Option<u32> {
        // A peek: this use of a frame is no reason to keep it.
        let kept = [Delivery::Exact, Delivery::Refined, Delivery::SeedOnly]
            .into_iter()
            .find_map(|delivery| self.cache.peek(&(key, delivery)))?;
        chunk_codec::error(&kept.frame)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::generation::gated::{bench, flat_frame, key, wanted};

    #[tokio::test]
    async fn the_cache_stays_within_its_bytes() {
        let budget = 10 * (flat_frame() as u64 + 128);
        let bench = bench(budget, 100);
        for x in 0..50 {
            bench.permit.send(()).unwrap();
            bench.service.flow().frame(wanted(key(x), 1), Delivery::Exact).await.unwrap();
        }
        assert!(bench.service.shared.frames.cache.weight() <= budget);
        assert!(bench.service.shared.frames.cache.len() < 50);
    }
}
