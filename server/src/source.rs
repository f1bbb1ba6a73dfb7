//! Where chunks come from: one narrow seam, so that a baked store or real elevation data can take
//! the place of the generator.

use protocol::chunk_codec::seed_only;
use terrain::{Chunk, ChunkKey, Land, WorldDigest};

/// Makes chunks. Called on generation threads; may take milliseconds and may use the whole core.
pub trait ChunkSource: Send + Sync + 'static {
    /// The world that the chunks belong to: part of every frame's digest.
    fn world(&self) -> WorldDigest;

    /// The chunk of a key. Pure: the same key always gives the same chunk.
    ///
    /// `known_error` is the chunk's error in units where it is known from an earlier making. A
    /// source that would have to measure it, which costs many times what the heights do, takes it
    /// from there.
    fn chunk(&self, key: ChunkKey, known_error: Option<u32>) -> Chunk;
}

/// Chunks computed from the seed.
#[derive(Clone, Debug)]
pub struct Procedural {
    land: Land,
    world: WorldDigest,
}

impl Procedural {
    /// The source of one world.
    #[must_use]
    pub fn new(land: Land) -> Self {
        Self { world: land.digest(), land }
    }
}

impl ChunkSource for Procedural {
    fn world(&self) -> WorldDigest {
        self.world
    }

    fn chunk(&self, key: ChunkKey, known_error: Option<u32>) -> Chunk {
        match known_error {
            None => self.land.chunk(key),
            Some(error) => seed_only::complete(&self.land, key, error),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_known_error_changes_nothing_but_the_cost() {
        let source = Procedural::new(Land::new(1));
        for (level, x, z) in [(0, 3, -7), (1, 2, 2), (3, -1, 0), (16, 0, 0)] {
            let key = ChunkKey::new(level, x, z).unwrap();
            let measured = source.chunk(key, None);
            assert_eq!(source.chunk(key, Some(measured.error)), measured);
        }
    }
}
