//! Sources of chunks: the interface behind which a baked store or real elevation data can replace
//! the generator.

use crate::chunk_id::{ChunkId, Edition};
use crate::store::FINEST_LEVEL;
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

    /// Whether making a chunk takes less time now than reading it from another machine. Asked for
    /// each chunk on a generation thread: microseconds at most.
    fn is_cheap(&self, _id: ChunkId) -> bool {
        false
    }
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

    /// With a known error, as the selection of a view leaves it, a chunk takes 50 to 150 us; one
    /// finer than all stored levels takes 0.2 ms with its measurement.
    fn is_cheap(&self, id: ChunkId) -> bool {
        let ChunkId { key, edition } = id;
        edition.is_base() && (key.level() < FINEST_LEVEL || self.land.is_error_remembered(key))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_chunk_is_cheap_with_its_error_remembered_or_on_a_level_that_is_not_stored() {
        let source = ProceduralSource::new(Land::new(0x5eed_0004));
        let key = |level| ChunkKey::new(level, -1, 0).unwrap();
        let is_cheap = |level| source.is_cheap(ChunkId::base(key(level)));
        assert_eq!([0, 1, 2, 5, 8].map(is_cheap), [true, true, false, false, true]);
        let _ = source.land.error_of(key(2));
        assert_eq!([2, 5].map(is_cheap), [true, false]);
        let edition = Edition::changed([9; 16]);
        assert!(!source.is_cheap(ChunkId { key: key(2), edition }), "edits are not in the errors");
    }

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
