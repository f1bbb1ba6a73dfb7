//! The grass seed record: a client derives every clump of a chunk from its 261 bytes.

use crate::constants::{BLOCK_CELLS, GRASS_GRID, UNITS_PER_METRE, VERTEX_COUNT};
use crate::hash::{hash2, stream_seed};
use crate::key::ChunkKey;
use crate::simd::{self, Kernel};

/// Number of colour palettes that [`GrassSeed::palette`] chooses from.
pub const PALETTES: u8 = 4;

/// Chunks of this level and below have the palette of their ancestor there: a region of 4 km.
const PALETTE_LEVEL: u8 = 5;

/// The data from which a client expands the grass of one chunk.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct GrassSeed {
    /// Seed of the clumps' attributes ([`crate::random_attributes`]). The same in every chunk of a
    /// world: a clump depends on this seed and its cell only, so that chunks of all levels have
    /// the same clumps.
    pub seed: u32,
    /// Colour palette, below [`PALETTES`]; the same in all chunks of a region of 4 km.
    pub palette: u8,
    /// Share of the densest meadow per block of 4 x 4 cells, 0 (bare) to 255, row by row.
    pub density: Box<[u8; GRASS_GRID * GRASS_GRID]>,
}

impl GrassSeed {
    /// The record of a chunk from its own vertices.
    #[must_use]
    pub fn grow(world_seed: u64, key: ChunkKey, heights: &[i32; VERTEX_COUNT]) -> Self {
        let region = region(key);
        let hash = hash2(stream_seed(world_seed, 0x6a56), region.x(), region.z());
        Self {
            seed: stream_seed(world_seed, 0x6a55),
            palette: (hash >> 16) as u8 % PALETTES,
            density: Self::density_of(key, heights),
        }
    }

    /// The densities of a chunk, from its own vertices alone.
    ///
    /// Grass covers gentle slopes between the beach and the high rock: density falls linearly to
    /// zero from 4 m down to 2 m above the sea, from 420 m up to 620 m, and over slopes between 0.5
    /// and 1. Integers only, so that every machine computes the same field. Heights are below 2^24
    /// in magnitude.
    #[must_use]
    pub fn density_of(key: ChunkKey, heights: &[i32; VERTEX_COUNT]) -> Box<[u8; GRASS_GRID * GRASS_GRID]> {
        // A block's side is a power of two of metres: the division is a shift.
        let side_bits =
            (key.spacing().unsigned_abs() * BLOCK_CELLS as u32 / UNITS_PER_METRE as u32).trailing_zeros();
        let mut density = Box::new([0; GRASS_GRID * GRASS_GRID]);
        simd::densities(Kernel::best().for_short_rows(), heights, side_bits, &mut density);
        density
    }
}

/// The ancestor that decides the palette; a coarser chunk decides for itself.
fn region(key: ChunkKey) -> ChunkKey {
    std::iter::successors(Some(key), |key| key.parent())
        .find(|above| above.level() >= PALETTE_LEVEL)
        .unwrap_or(key)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::constants::VERTICES;

    fn flat(height_m: i32) -> GrassSeed {
        let heights = [height_m * UNITS_PER_METRE; VERTEX_COUNT];
        GrassSeed::grow(1, ChunkKey::new(0, 3, -4).unwrap(), &heights)
    }

    #[test]
    fn density_follows_height_bands() {
        let bands = [
            (-10, 0),
            (2, 0),
            (3, 127),
            (4, 255),
            (100, 255),
            (420, 255),
            (520, 128),
            (619, 2),
            (620, 0),
            (900, 0),
        ];
        for (height_m, expected) in bands {
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
    fn all_levels_of_a_world_share_seed_and_palette() {
        let heights = [0; VERTEX_COUNT];
        let grow = |world, level, x| GrassSeed::grow(world, ChunkKey::new(level, x, -1).unwrap(), &heights);
        let fine = grow(1, 0, 37);
        assert_eq!((fine.seed, fine.palette), (grow(1, 3, 4).seed, grow(1, 3, 4).palette));
        assert_ne!(fine.seed, grow(2, 0, 37).seed);
        let palettes: std::collections::BTreeSet<u8> = (0..64).map(|x| grow(1, 5, x - 32).palette).collect();
        assert_eq!(palettes.len(), usize::from(PALETTES));
    }
}
