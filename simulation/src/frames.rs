//! Frames of chunks: real ones, made once however many replicas send them.

use bytes::Bytes;
use protocol::chunk_codec::{self, Effort};
use protocol::{Delivery, chunk_codec::encode_with};
use rustc_hash::{FxBuildHasher, FxHashMap};
use std::hash::BuildHasher;
use std::sync::{Mutex, PoisonError};
use terrain::{ChunkKey, Land, WorldDigest};

/// Parts with a lock each.
const PARTS: usize = 64;

/// See the module.
#[derive(Debug)]
pub struct Frames {
    land: Land,
    world: WorldDigest,
    parts: Vec<Mutex<FxHashMap<(ChunkKey, bool), Bytes>>>,
}

impl Frames {
    /// None is made yet.
    #[must_use]
    pub fn new(land: Land) -> Self {
        let parts = std::iter::repeat_with(Mutex::default).take(PARTS).collect();
        Self { world: land.digest(), land, parts }
    }

    /// The land.
    #[must_use]
    pub const fn land(&self) -> Land {
        self.land
    }

    /// The digest of the world.
    #[must_use]
    pub const fn world(&self) -> WorldDigest {
        self.world
    }

    /// The exact frame of a chunk.
    #[must_use]
    pub fn get(&self, key: ChunkKey, effort: Effort) -> Bytes {
        let name = (key, effort == Effort::Fast);
        let part = &self.parts[FxBuildHasher.hash_one(key) as usize % PARTS];
        let lock = || part.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(frame) = lock().get(&name) {
            return frame.clone();
        }
        // Another replica may make it too: the frames are equal.
        let chunk = self.land.chunk(key);
        let frame = match effort {
            Effort::Fast => encode_with(Delivery::Exact, effort, &chunk, &self.world),
            Effort::Compact => chunk_codec::encode(&chunk, &self.world),
        };
        lock().insert(name, frame.clone());
        frame
    }
}
