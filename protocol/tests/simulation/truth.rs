//! Chunks by direct generation, kept for all simulations of the process.

use bytes::Bytes;
use protocol::view::View;
use protocol::{Delivery, Tolerance, chunk_codec};
use std::collections::{BTreeMap, BTreeSet};
use std::sync::{Arc, LazyLock, Mutex, PoisonError};
use terrain::{Chunk, ChunkKey, Land, WorldDigest, lod};

static LAND: LazyLock<(Land, WorldDigest)> = LazyLock::new(|| {
    let land = Land::new(1);
    (land, land.digest())
});

/// The world of all simulations.
pub fn land() -> Land {
    LAND.0
}

/// Its digest.
pub fn digest() -> WorldDigest {
    LAND.1
}

/// The chunk of a key.
pub fn chunk(key: ChunkKey) -> Arc<Chunk> {
    static CHUNKS: Mutex<BTreeMap<ChunkKey, Arc<Chunk>>> = Mutex::new(BTreeMap::new());
    let mut chunks = CHUNKS.lock().unwrap_or_else(PoisonError::into_inner);
    Arc::clone(chunks.entry(key).or_insert_with(|| Arc::new(land().chunk(key))))
}

/// Its frame for a delivery.
pub fn frame(key: ChunkKey, delivery: Delivery) -> Bytes {
    static FRAMES: Mutex<BTreeMap<(ChunkKey, &'static str), Bytes>> = Mutex::new(BTreeMap::new());
    // All quantised sessions have one tolerance.
    let mut frames = FRAMES.lock().unwrap_or_else(PoisonError::into_inner);
    let encode = || chunk_codec::encode_for(delivery, &chunk(key), &digest());
    frames.entry((key, delivery.name())).or_insert_with(encode).clone()
}

/// The deliveries of the clients.
pub fn deliveries() -> [Delivery; 4] {
    [Delivery::Exact, Delivery::Refined, Delivery::SeedOnly, Delivery::Quantised(Tolerance::COARSEST)]
}

/// Whether a received chunk is that of direct generation: all of it, and within the tolerance where
/// heights were rounded.
pub fn is_right(received: &Chunk, delivery: Delivery) -> bool {
    let truth = chunk(received.key);
    match delivery {
        Delivery::Quantised(tolerance) => {
            let most = i32::from(tolerance.units());
            received.heights.iter().zip(truth.heights.iter()).all(|(a, b)| (a - b).abs() <= most)
        }
        _ => *received == *truth,
    }
}

/// The chunks that a view needs.
pub fn needed(view: &View) -> BTreeSet<ChunkKey> {
    let selected = lod::select(&land(), &view.viewer(), protocol::limits::MAX_VIEW_CHUNKS);
    selected.iter().map(|needed| needed.key).collect()
}
