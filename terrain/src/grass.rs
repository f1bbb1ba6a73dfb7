//! The grass seed record: from 261 bytes a client grows every clump of a chunk.

use crate::constants::{CELLS, GRASS_GRID, UNITS_PER_METRE, VERTEX_COUNT, VERTICES};
use crate::hash::{hash2, stream_seed};
use crate::key::ChunkKey;

/// Number of colour palettes that [`GrassSeed::palette`] chooses from.
pub const PALETTES: u8 = 4;

/// What a client needs to expand the grass of one chunk.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct GrassSeed {
    /// Seed of the clump streams of this chunk.
    pub seed: u32,
    /// Colour palette, below [`PALETTES`].
    pub palette: u8,
    /// Share of the densest meadow per block of 4 x 4 cells, 0 (bare) to 255, row by row.
    pub density: Box<[u8; GRASS_GRID * GRASS_GRID]>,
}

impl GrassSeed {
    /// The record of a chunk from its own vertices.
    ///
    /// Grass grows on gentle ground between the beach and the high rock: density falls linearly to zero from
    /// 4 m down to 2 m above the sea, from 180 m up to 260 m, and over slopes from 0.5 to 1. Integers only, so
    /// that every machine grows the same field.
    #[must_use]
    pub fn grow(world_seed: u64, key: ChunkKey, heights: &[i32; VERTEX_COUNT]) -> Self {
        const BLOCK: usize = CELLS / GRASS_GRID;
        let hash = hash2(stream_seed(world_seed, 0x6a55 + u32::from(key.level())), key.x(), key.z());
        let mut density = Box::new([0; GRASS_GRID * GRASS_GRID]);
        for (index, share) in density.iter_mut().enumerate() {
            let (x, z) = (index % GRASS_GRID * BLOCK, index / GRASS_GRID * BLOCK);
            let at = |dx: usize, dz: usize| heights[(z + dz) * VERTICES + x + dx];
            let middle = at(BLOCK / 2, BLOCK / 2);
            let rise = (at(BLOCK, 0) - at(0, 0)).abs().max((at(0, BLOCK) - at(0, 0)).abs());
            let slope_q8 = rise / ((key.spacing() * BLOCK as i32) >> 8);
            let above_beach = ramp(middle, 2 * UNITS_PER_METRE, 4 * UNITS_PER_METRE);
            let below_rock = 255 - ramp(middle, 180 * UNITS_PER_METRE, 260 * UNITS_PER_METRE);
            let gentle = 255 - ramp(slope_q8, 128, 256);
            *share = above_beach.min(below_rock).min(gentle) as u8;
        }
        Self { seed: hash, palette: (hash >> 16) as u8 % PALETTES, density }
    }
}

/// 0 at or below `low`, 255 at or above `high`, linear between.
fn ramp(value: i32, low: i32, high: i32) -> i32 {
    let (value, span) = ((value.clamp(low, high) - low) as u32, (high - low) as u32);
    (value * 255 / span) as i32
}

#[cfg(test)]
mod tests {
    use super::*;

    fn flat(height_m: i32) -> GrassSeed {
        let heights = [height_m * UNITS_PER_METRE; VERTEX_COUNT];
        GrassSeed::grow(1, ChunkKey::new(0, 3, -4).unwrap(), &heights)
    }

    #[test]
    fn density_follows_height_bands() {
        for (height_m, expected) in [(-10, 0), (2, 0), (3, 127), (4, 255), (100, 255), (220, 128), (260, 0)] {
            assert!(flat(height_m).density.iter().all(|share| *share == expected), "{height_m} m");
        }
    }

    #[test]
    fn a_cliff_is_bare() {
        let mut heights = [50 * UNITS_PER_METRE; VERTEX_COUNT];
        for (index, height) in heights.iter_mut().enumerate() {
            *height += (index % VERTICES) as i32 * 4 * UNITS_PER_METRE;
        }
        let grass = GrassSeed::grow(1, ChunkKey::new(0, 0, 0).unwrap(), &heights);
        assert!(grass.density.iter().all(|share| *share == 0));
    }

    #[test]
    fn neighbouring_chunks_have_unrelated_seeds() {
        let heights = [0; VERTEX_COUNT];
        let seed = |x| GrassSeed::grow(1, ChunkKey::new(0, x, 0).unwrap(), &heights).seed;
        assert!((seed(0) ^ seed(1)).count_ones() > 6);
    }
}
