//! Slot data on the CPU, as the shaders read it.

use crate::cache::{ChunkCache, Resident};
use shaders::layout::BLOCK_TEXELS;
use shaders::twin::surface::Slots;

/// Resident chunks by their slots.
#[derive(Debug)]
pub struct BySlot<'a> {
    chunks: Vec<Option<&'a Resident>>,
}

impl<'a> BySlot<'a> {
    /// The resident chunks of a cache.
    #[must_use]
    pub fn new(cache: &'a ChunkCache) -> Self {
        let mut chunks = vec![None; cache.capacity() as usize];
        for chunk in cache.residents() {
            chunks[chunk.slot as usize] = Some(chunk);
        }
        Self { chunks }
    }

    fn get(&self, slot: u32) -> Option<&'a Resident> {
        self.chunks.get(slot as usize).copied().flatten()
    }
}

/// Empty slots read as zeros, as on the GPU before the first upload.
impl Slots for BySlot<'_> {
    fn height(&self, slot: u32, index: u32) -> i32 {
        self.get(slot).map_or(0, |chunk| chunk.heights[index as usize])
    }

    fn top(&self, slot: u32, texel: u32) -> i32 {
        debug_assert!(texel < BLOCK_TEXELS as u32);
        self.get(slot).map_or(0, |chunk| chunk.maxima[texel as usize])
    }

    fn bottom(&self, slot: u32, texel: u32) -> i32 {
        self.get(slot).map_or(0, |chunk| chunk.minima[texel as usize])
    }

    fn density(&self, slot: u32, word: u32) -> u32 {
        self.get(slot).map_or(0, |chunk| chunk.density_word(word as usize))
    }
}
