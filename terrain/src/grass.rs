//! The grass seed record: from 261 bytes a client grows every clump of a chunk.

use crate::constants::{CELLS, GRASS_GRID, UNITS_PER_METRE, VERTEX_COUNT, VERTICES};
use crate::hash::{hash2, stream_seed};
use crate::key::ChunkKey;
use crate::simd::{self, Kernel};

/// Number of colour palettes that [`GrassSeed::palette`] chooses from.
pub const PALETTES: u8 = 4;

/// Chunks of this level and below have the palette of their ancestor there: a region of 4 km.
const PALETTE_LEVEL: u8 = 5;

/// What a client needs to expand the grass of one chunk.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct GrassSeed {
    /// Seed of the clump streams ([`crate::streams`]). The same in every chunk of a world: a clump
    /// follows from it and from the place of its cell, so that chunks of all levels grow the same
    /// clumps.
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

    /// The densities that a chunk's own vertices give; they depend on nothing else.
    ///
    /// Grass grows on gentle ground between the beach and the high rock: density falls linearly to
    /// zero from 4 m down to 2 m above the sea, from 180 m up to 260 m, and over slopes from 0.5 to
    /// 1. Integers only, so that every machine grows the same field. Heights are below 2^24 in
    /// magnitude.
    #[must_use]
    pub fn density_of(key: ChunkKey, heights: &[i32; VERTEX_COUNT]) -> Box<[u8; GRASS_GRID * GRASS_GRID]> {
        // A block's side is a power of two of metres: shifting by it is a division that costs
        // nothing.
        let side_bits =
            (key.spacing().unsigned_abs() * BLOCK as u32 / UNITS_PER_METRE as u32).trailing_zeros();
        let mut density = Box::new([0; GRASS_GRID * GRASS_GRID]);
        simd::densities(Kernel::best().for_short_rows(), heights, side_bits, &mut density);
        density
    }
}

/// Cells along the side of a block.
const BLOCK: usize = CELLS / GRASS_GRID;

/// The densities of blocks whose side is `2^side_bits` metres. For [`crate::simd`]: whole rows side
/// by side, of which compilers make vectors.
#[inline(always)]
pub(crate) fn densities(
    heights: &[i32; VERTEX_COUNT],
    side_bits: u32,
    density: &mut [u8; GRASS_GRID * GRASS_GRID],
) {
    let (vertices, _) = heights.as_chunks::<VERTICES>();
    let (shares, _) = density.as_chunks_mut::<GRASS_GRID>();
    for (shares, rows) in shares.iter_mut().zip(vertices.windows(BLOCK + 1).step_by(BLOCK)) {
        let (north, middle, south) = (&rows[0], &rows[BLOCK / 2], &rows[BLOCK]);
        let corners: [i32; GRASS_GRID + 1] = std::array::from_fn(|x| north[x * BLOCK]);
        let beyond: [i32; GRASS_GRID] = std::array::from_fn(|x| south[x * BLOCK]);
        let middles: [i32; GRASS_GRID] = std::array::from_fn(|x| middle[x * BLOCK + BLOCK / 2]);
        for (x, share) in shares.iter_mut().enumerate() {
            // Heights are below 2^24, so that nothing wraps; checking it would keep this from
            // becoming vectors.
            let [east, south] =
                [corners[x + 1], beyond[x]].map(|end| end.wrapping_sub(corners[x]).wrapping_abs());
            let slope_q8 = east.max(south).wrapping_shr(side_bits);
            let above_beach = ramp(middles[x], 2 * UNITS_PER_METRE, 4 * UNITS_PER_METRE);
            let below_rock = 255 - ramp(middles[x], 180 * UNITS_PER_METRE, 260 * UNITS_PER_METRE);
            let gentle = 255 - ramp(slope_q8, 128, 256);
            *share = above_beach.min(below_rock.min(gentle)) as u8;
        }
    }
}

/// The ancestor that decides the palette; a coarser chunk decides for itself.
fn region(key: ChunkKey) -> ChunkKey {
    std::iter::successors(Some(key), |key| key.parent())
        .find(|above| above.level() >= PALETTE_LEVEL)
        .unwrap_or(key)
}

/// 0 at or below `low`, 255 at or above `high`, linear between; `high - low` is at most 2^15.
#[inline(always)]
fn ramp(value: i32, low: i32, high: i32) -> u32 {
    let above = value.max(low).min(high).wrapping_sub(low) as u32;
    above.wrapping_mul(255) / (high - low) as u32
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
    fn all_levels_of_a_world_share_seed_and_palette_and_other_worlds_have_others() {
        let heights = [0; VERTEX_COUNT];
        let grow = |world, level, x| GrassSeed::grow(world, ChunkKey::new(level, x, -1).unwrap(), &heights);
        let fine = grow(1, 0, 37);
        assert_eq!((fine.seed, fine.palette), (grow(1, 3, 4).seed, grow(1, 3, 4).palette));
        assert_ne!(fine.seed, grow(2, 0, 37).seed);
        let palettes: std::collections::BTreeSet<u8> = (0..64).map(|x| grow(1, 5, x - 32).palette).collect();
        assert_eq!(palettes.len(), usize::from(PALETTES));
    }
}
