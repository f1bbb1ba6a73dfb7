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
    cache: Cache<FrameId, Bytes, FrameWeight>,
}

#[derive(Clone)]
struct FrameWeight;

impl Weighter<FrameId, Bytes> for FrameWeight {
    fn weight(&self, _id: &FrameId, frame: &Bytes) -> u64 {
        // The key, the handle and the map's own share, besides the bytes; for a seed-only frame most of it.
        frame.len() as u64 + 128
    }
}

impl Frames {
    /// Room for so many bytes.
    #[must_use]
    pub fn new(bytes: u64) -> Self {
        // About 4 KiB an exact frame; the estimate only sizes the first tables.
        Self { cache: Cache::with_weighter((bytes / 4096) as usize, bytes, FrameWeight) }
    }

    /// The frame of a chunk for a delivery.
    #[must_use]
    pub fn get(&self, key: ChunkKey, delivery: Delivery) -> Option<Bytes> {
        self.cache.get(&(key, delivery))
    }

    /// Keeps a frame; others may have to go.
    pub fn insert(&self, key: ChunkKey, delivery: Delivery, frame: Bytes) {
        self.cache.insert((key, delivery), frame);
    }

    /// The error of a chunk that was made before and is still kept for some delivery.
    #[must_use]
    pub fn known_error(&self, key: ChunkKey) -> Option<u32> {
        // A peek: this use of a frame is no reason to keep it.
        let frame = [Delivery::Exact, Delivery::Refined, Delivery::SeedOnly]
            .into_iter()
            .find_map(|delivery| self.cache.peek(&(key, delivery)))?;
        chunk_codec::error(&frame)
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
