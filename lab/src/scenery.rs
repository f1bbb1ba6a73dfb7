//! Land as a viewer gets it: the chunks that a server would send for a view, kept for the next one.

use client::world::World;
use rayon::prelude::*;
use std::collections::HashMap;
use terrain::lod::{self, Viewer};
use terrain::{Chunk, ChunkKey, Land};

/// The land of one world and the chunks of it that were asked for.
#[derive(Debug)]
pub struct Scenery {
    land: Land,
    chunks: HashMap<ChunkKey, Chunk>,
}

impl Scenery {
    /// Land of which nothing has been generated.
    #[must_use]
    pub fn new(land: Land) -> Self {
        Self { land, chunks: HashMap::new() }
    }

    /// The land.
    #[must_use]
    pub fn land(&self) -> &Land {
        &self.land
    }

    /// A world of `slots` slots with what a server sends for a view, as far as `has_arrived` says so.
    pub fn world(&mut self, viewer: &Viewer, slots: u32, has_arrived: impl Fn(ChunkKey) -> bool) -> World {
        let keys: Vec<ChunkKey> =
            lod::select(&self.land, viewer, usize::MAX).into_iter().map(|needed| needed.key).collect();
        self.generate(&keys);
        let mut world = World::new(slots);
        for key in keys.into_iter().filter(|key| has_arrived(*key)) {
            world.insert(self.chunks[&key].clone());
        }
        world
    }

    /// One chunk.
    pub fn chunk(&mut self, key: ChunkKey) -> &Chunk {
        let land = &self.land;
        self.chunks.entry(key).or_insert_with(|| land.chunk(key))
    }

    /// Forgets all chunks: a chunk with its pyramids takes 60 KB.
    pub fn clear(&mut self) {
        self.chunks.clear();
    }

    fn generate(&mut self, keys: &[ChunkKey]) {
        let land = &self.land;
        let missing: Vec<ChunkKey> =
            keys.iter().copied().filter(|key| !self.chunks.contains_key(key)).collect();
        self.chunks.par_extend(missing.into_par_iter().map(|key| (key, land.chunk(key))));
    }
}
