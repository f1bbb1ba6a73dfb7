//! Where chunks come from: one narrow seam, so that a baked store or real elevation data can take the place of
//! the generator.

use bytes::Bytes;
use protocol::chunk_codec;
use terrain::{ChunkKey, Land, WorldDigest};

/// Makes chunk frames. Called on generation threads; may take milliseconds and may use the whole core.
pub trait ChunkSource: Send + Sync + 'static {
    /// The encoded chunk of a key. Pure: the same key always gives the same chunk.
    fn frame(&self, key: ChunkKey) -> Bytes;
}

/// Chunks computed from the seed.
#[derive(Clone, Debug)]
pub struct Procedural {
    land: Land,
    digest: WorldDigest,
}

impl Procedural {
    /// The source of one world.
    #[must_use]
    pub fn new(land: Land) -> Self {
        Self { digest: land.digest(), land }
    }
}

impl ChunkSource for Procedural {
    fn frame(&self, key: ChunkKey) -> Bytes {
        chunk_codec::encode(&self.land.chunk(key), &self.digest)
    }
}
