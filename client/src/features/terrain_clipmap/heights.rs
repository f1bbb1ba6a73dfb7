//! Heights of the land under the tiles of the clipmap, cached by chunk.

use rustc_hash::FxHashMap;
use terrain::constants::{CELLS, UNITS_PER_METRE, VERTEX_COUNT, VERTICES};
use terrain::{ChunkKey, Land};

/// Samples along a side of a block: every other vertex of a chunk, which the horizon needs.
pub const BLOCK: usize = CELLS / 2;

/// Most blocks in the cache, 4 KiB each. A full cache is emptied: blocks come again from the land.
const MOST_BLOCKS: usize = 4_096;

/// Heights of every other vertex of one chunk, metres, row by row, with the sea as level ground.
pub type Block = [f32; BLOCK * BLOCK];

/// Heights by chunk.
#[derive(Debug)]
pub struct Heights {
    land: Land,
    vertical_scale: f32,
    blocks: FxHashMap<ChunkKey, Box<Block>>,
}

impl Heights {
    /// The heights of a land, none cached. Those of blocks are multiplied by `vertical_scale`.
    #[must_use]
    pub fn new(land: Land, vertical_scale: f32) -> Self {
        Self { land, vertical_scale, blocks: FxHashMap::default() }
    }

    /// All vertices of a chunk, units, not scaled.
    #[must_use]
    pub fn vertices(&mut self, key: ChunkKey) -> Box<[i32; VERTEX_COUNT]> {
        let vertices = self.land.chunk_heights(key);
        self.keep(key, &vertices);
        vertices
    }

    /// The block of a chunk; level ground outside the world.
    #[must_use]
    pub fn block(&mut self, key: Option<ChunkKey>) -> &Block {
        const SEA: &Block = &[0.0; BLOCK * BLOCK];
        let Some(key) = key else { return SEA };
        if !self.blocks.contains_key(&key) {
            let vertices = self.land.chunk_heights(key);
            self.keep(key, &vertices);
        }
        self.blocks.get(&key).map_or(SEA, |block| block)
    }

    fn keep(&mut self, key: ChunkKey, vertices: &[i32; VERTEX_COUNT]) {
        if self.blocks.len() >= MOST_BLOCKS {
            self.blocks.clear();
        }
        let scale = self.vertical_scale / UNITS_PER_METRE as f32;
        let at = |index: usize| {
            let vertex = 2 * (index / BLOCK) * VERTICES + 2 * (index % BLOCK);
            vertices[vertex].max(0) as f32 * scale
        };
        self.blocks.insert(key, Box::new(std::array::from_fn(at)));
    }
}
