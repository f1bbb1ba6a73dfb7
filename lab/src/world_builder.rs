//! Worlds as a viewer receives them: the chunks that a server sends for a view, cached for the
//! next.

use client::cache::ChunkCache;
use rayon::prelude::*;
use std::collections::{HashMap, HashSet};
use terrain::lod::{self, Viewer};
use terrain::{Chunk, ChunkKey, Land};

/// A world seed with a cache of its chunks.
#[derive(Debug)]
pub struct WorldBuilder {
    land: Land,
    chunks: HashMap<ChunkKey, Chunk>,
}

impl WorldBuilder {
    /// A builder with an empty cache.
    pub fn new(land: Land) -> Self {
        Self { land, chunks: HashMap::new() }
    }

    /// A world of `slots` slots with what a server sends for a view, as far as `has_arrived` says
    /// so.
    pub fn world(
        &mut self,
        viewer: &Viewer,
        slots: u32,
        has_arrived: impl Fn(ChunkKey) -> bool,
    ) -> ChunkCache {
        let keys: Vec<ChunkKey> =
            lod::select(&self.land, viewer, usize::MAX).into_iter().map(|needed| needed.key).collect();
        self.generate(&keys);
        let mut world = ChunkCache::new(slots);
        world.set_land(self.land);
        for key in keys.into_iter().filter(|key| has_arrived(*key)) {
            world.insert(self.chunks[&key].clone());
        }
        world
    }

    /// A world of `slots` slots with what a server sends along a way; all of it must fit.
    ///
    /// # Panics
    /// If it does not fit.
    pub fn world_along(&mut self, viewers: &[Viewer], slots: u32) -> ChunkCache {
        let land = &self.land;
        let keys: HashSet<ChunkKey> = viewers
            .par_iter()
            .flat_map_iter(|viewer| lod::select(land, viewer, usize::MAX))
            .map(|needed| needed.key)
            .collect();
        assert!(keys.len() <= slots as usize, "{} chunks for {slots} slots", keys.len());
        let mut keys: Vec<ChunkKey> = keys.into_iter().collect();
        keys.sort_unstable();
        self.generate(&keys);
        let mut world = ChunkCache::new(slots);
        world.set_land(self.land);
        for key in keys {
            world.insert(self.chunks[&key].clone());
        }
        world
    }

    /// Empties the cache: a chunk with its pyramids takes 60 KB.
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
