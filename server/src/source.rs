//! Sources of chunks: the interface behind which a baked store or real elevation data can replace
//! the generator.

use crate::chunk_id::{ChunkId, Edition};
use protocol::chunk_codec::seed_only;
use terrain::{Chunk, ChunkKey, Land, WorldDigest};

/// Produces chunks. Called on generation threads; may take milliseconds of processor time.
pub trait ChunkSource: Send + Sync + 'static {
    /// Digest of the world, part of every frame's digest.
    fn world(&self) -> WorldDigest;

    /// The edition of a chunk that sessions are offered now.
    fn edition(&self, _key: ChunkKey) -> Edition {
        Edition::BASE
    }

    /// A chunk. Pure: a key in one edition always gives the same chunk.
    ///
    /// `known_error` is the chunk's error in units if it is known. A source uses it instead of a
    /// measurement, which costs many times more than the heights.
    fn chunk(&self, id: ChunkId, known_error: Option<u32>) -> Chunk;
}

/// Chunks generated from the seed.
#[derive(Clone, Debug)]
pub struct ProceduralSource {
    land: Land,
    world: WorldDigest,
}

impl ProceduralSource {
    /// The source of one world.
    #[must_use]
    pub fn new(land: Land) -> Self {
        Self { world: land.digest(), land }
    }
}

impl ChunkSource for ProceduralSource {
    fn world(&self) -> WorldDigest {
        self.world
    }

    fn chunk(&self, id: ChunkId, known_error: Option<u32>) -> Chunk {
        match known_error {
            None => self.land.chunk(id.key),
            Some(error) => seed_only::complete(&self.land, id.key, error),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_known_error_does_not_change_the_chunk() {
        let source = ProceduralSource::new(Land::new(1));
        for (level, x, z) in [(0, 3, -7), (1, 2, 2), (3, -1, 0), (16, 0, 0)] {
            let id = ChunkId::base(ChunkKey::new(level, x, z).unwrap());
            let measured = source.chunk(id, None);
            assert_eq!(source.chunk(id, Some(measured.error)), measured);
        }
    }
}
