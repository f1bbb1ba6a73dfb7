//! Chunks: 65 x 65 vertices of one level, and the data derived from them.

use crate::constants::{CELLS, UNITS_PER_METRE, VERTEX_COUNT, VERTICES};
use crate::grass::GrassSeed;
use crate::grid::Grid;
use crate::key::ChunkKey;
use crate::land::Land;
use crate::lod;
use crate::pyramid::Pyramid;
use crate::simd::{self, Kernel};

pub use crate::triangles::drawn_height_scaled;

/// One chunk of the land.
///
/// A vertex is the height at its place with the octaves that its level carries
/// ([`Octaves::at_level`]): levels 0 to 2 share every octave and so agree bit for bit where they
/// share a vertex.
///
/// [`Octaves::at_level`]: crate::Octaves::at_level
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Chunk {
    /// Where and how coarse.
    pub key: ChunkKey,
    /// Heights in units of 2^-8 m: row by row from the low corner, x fastest.
    pub heights: Box<[i32; VERTEX_COUNT]>,
    /// Bound, in units, of the vertical distance between this chunk's drawn triangles and any
    /// level-0 vertex under them. Exact up to [`lod::MEASURED_LEVEL`], proved above
    /// ([`lod::errors`]).
    pub error: u32,
    /// Upper bound of the gradient of the drawn triangles, Q8 (256 is 45 degrees), rounded up.
    pub slope: u32,
    /// Per-cell and per-block upper bounds of the drawn surface.
    pub max_pyramid: Pyramid,
    /// Per-cell and per-block lower bounds of the drawn surface.
    pub min_pyramid: Pyramid,
    /// Seed record of the grass on this chunk.
    pub grass: GrassSeed,
}

impl Chunk {
    /// Completes a chunk: pyramids, extremes and slope are derived from the heights.
    #[must_use]
    pub fn from_parts(
        key: ChunkKey,
        heights: Box<[i32; VERTEX_COUNT]>,
        error: u32,
        grass: GrassSeed,
    ) -> Self {
        let (max_pyramid, min_pyramid) = (Pyramid::of_maxima(&heights), Pyramid::of_minima(&heights));
        let relief = max_pyramid.top().abs_diff(min_pyramid.top());
        let slope = slope_bound(&heights, relief, key.spacing());
        Self { key, heights, error, slope, max_pyramid, min_pyramid, grass }
    }

    /// Lowest vertex, units.
    #[must_use]
    pub fn min(&self) -> i32 {
        self.min_pyramid.top()
    }

    /// Highest vertex, units.
    #[must_use]
    pub fn max(&self) -> i32 {
        self.max_pyramid.top()
    }

    /// Height of the vertex in column `x`, row `z` (both below 65), units.
    #[must_use]
    pub fn vertex(&self, x: usize, z: usize) -> i32 {
        self.heights[z * VERTICES + x]
    }
}

impl Land {
    /// Generates one chunk.
    #[must_use]
    pub fn chunk(&self, key: ChunkKey) -> Chunk {
        let heights = self.chunk_heights(key);
        let error = self.chunk_error(key, &heights);
        let grass = GrassSeed::grow(self.world_seed(), key, &heights);
        Chunk::from_parts(key, heights, error, grass)
    }

    /// The heights of one chunk alone, for digests, comparisons and timings.
    #[must_use]
    pub fn chunk_heights(&self, key: ChunkKey) -> Box<[i32; VERTEX_COUNT]> {
        let mut heights = Box::new([0; VERTEX_COUNT]);
        self.heights(&Grid::of_chunk(key), &mut heights[..]);
        heights
    }

    /// See [`Chunk::error`]. Above the sampled levels the land is nowhere lower or higher than its
    /// range, nor are the triangles.
    fn chunk_error(&self, key: ChunkKey, heights: &[i32; VERTEX_COUNT]) -> u32 {
        let known = self.error_of(key);
        if key.level() <= lod::SAMPLED_LEVEL {
            return known;
        }
        let (low, high) =
            heights.iter().fold((i32::MAX, i32::MIN), |(low, high), h| (low.min(*h), high.max(*h)));
        (lod::SUMMIT - low).max(high - lod::LOWEST).unsigned_abs()
    }
}

/// See [`Chunk::slope`].
fn slope_bound(heights: &[i32; VERTEX_COUNT], relief: u32, spacing: i32) -> u32 {
    // With legs below 128 m, as in nearly every chunk, the squares fit 31 bits and go through
    // vectors.
    let kernel = Kernel::best();
    let worst = if relief < 1 << 15 || simd::longest_leg(kernel, heights) < 1 << 15 {
        u64::from(simd::steepest(kernel, heights).unsigned_abs())
    } else {
        steepest(heights)
    };
    // ceil(256 * sqrt(worst) / spacing): sqrt rounded up first, so the bound can only grow.
    let root = worst.isqrt() + u64::from(!is_square(worst));
    (root * UNITS_PER_METRE as u64).div_ceil(spacing as u64) as u32
}

/// Largest sum of squares of a triangle's two legs, units squared, of any heights below 2^24.
fn steepest(heights: &[i32; VERTEX_COUNT]) -> u64 {
    let mut worst = 0u64;
    for z in 0..CELLS {
        for x in 0..CELLS {
            let at = |dx: usize, dz: usize| i64::from(heights[(z + dz) * VERTICES + x + dx]);
            let (h00, h10, h01, h11) = (at(0, 0), at(1, 0), at(0, 1), at(1, 1));
            let square = |east: i64, south: i64| east.unsigned_abs().pow(2) + south.unsigned_abs().pow(2);
            worst = worst.max(square(h10 - h00, h11 - h10)).max(square(h11 - h01, h01 - h00));
        }
    }
    worst
}

fn is_square(value: u64) -> bool {
    value.isqrt().pow(2) == value
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::constants::{TOP_LEVEL, WORLD_HALF};
    use crate::hash::mix;
    use crate::octaves::Octaves;
    use crate::position::Position;

    fn key(level: u8, x: i32, z: i32) -> ChunkKey {
        ChunkKey::new(level, x, z).unwrap()
    }

    #[test]
    fn every_vertex_is_the_height_with_the_octaves_of_its_level() {
        let land = Land::new(4);
        for key in [key(0, 0, 0), key(0, -1, 5), key(3, -2, 1), key(9, 3, -3), key(TOP_LEVEL, 0, 0)] {
            let heights = land.chunk_heights(key);
            let (x0, z0) = key.origin();
            for (index, height) in heights.iter().enumerate() {
                let (column, row) = ((index % VERTICES) as i64, (index / VERTICES) as i64);
                let spacing = i64::from(key.spacing());
                let (x, z) = (i64::from(x0) + column * spacing, i64::from(z0) + row * spacing);
                let position = Position::new(x as i32, z as i32).unwrap();
                let expected = land.height_keeping(position, Octaves::at_level(key.level()));
                assert_eq!(*height, expected, "{key} vertex ({column}, {row})");
            }
        }
    }

    #[test]
    fn neighbours_share_border_heights_at_every_level() {
        let land = Land::new(77);
        for level in 0..TOP_LEVEL {
            let last = ChunkKey::containing(level, WORLD_HALF, WORLD_HALF).x();
            for (x, z) in [(-1, -1), (-1, 2.min(last)), (last - 1, last), (-last - 1, -1)] {
                let here = land.chunk_heights(key(level, x, z));
                let east = land.chunk_heights(key(level, x + 1, z));
                for row in 0..VERTICES {
                    assert_eq!(
                        here[row * VERTICES + CELLS],
                        east[row * VERTICES],
                        "level {level} ({x}, {z})"
                    );
                }
            }
        }
    }

    #[test]
    fn levels_with_the_same_octaves_agree_on_shared_vertices() {
        let land = Land::new(77);
        let has_same = |level: &u8| Octaves::at_level(*level) == Octaves::at_level(*level - 1);
        let levels: Vec<u8> = (1..=TOP_LEVEL).filter(has_same).collect();
        assert!(levels.starts_with(&[1, 2]) && levels.ends_with(&[TOP_LEVEL - 1, TOP_LEVEL]), "{levels:?}");
        for level in levels {
            let parent = ChunkKey::containing(level, 40_000, -90_000);
            let coarse = land.chunk_heights(parent);
            for (child, (dx, dz)) in
                parent.children().unwrap().into_iter().zip([(0, 0), (32, 0), (0, 32), (32, 32)])
            {
                let fine = land.chunk_heights(child);
                for row in (0..VERTICES).step_by(2) {
                    for column in (0..VERTICES).step_by(2) {
                        let above = coarse[(row / 2 + dz) * VERTICES + column / 2 + dx];
                        assert_eq!(fine[row * VERTICES + column], above, "{child}");
                    }
                }
            }
        }
    }

    #[test]
    fn extremes_slope_and_pyramids_follow_from_the_heights() {
        let chunk = Land::new(1).chunk(key(0, 10, -7));
        assert_eq!(chunk.min(), *chunk.heights.iter().min().unwrap());
        assert_eq!(chunk.max(), *chunk.heights.iter().max().unwrap());
        let steepest = (0..CELLS)
            .flat_map(|z| (0..CELLS).map(move |x| (x, z)))
            .flat_map(|(x, z)| {
                let h = |dx: usize, dz: usize| f64::from(chunk.vertex(x + dx, z + dz)) / 512.0;
                [(h(1, 0) - h(0, 0)).hypot(h(1, 1) - h(1, 0)), (h(1, 1) - h(0, 1)).hypot(h(0, 1) - h(0, 0))]
            })
            .fold(0.0, f64::max);
        assert!(
            (f64::from(chunk.slope) / 256.0 - steepest).abs() < 0.01
                && f64::from(chunk.slope) >= steepest * 256.0
        );
    }

    #[test]
    fn vectors_find_the_steepest_triangle_that_wide_arithmetic_finds() {
        for seed in 0..8 {
            let low = -20_000 + seed * 5_000;
            let mut heights = Box::new([0; VERTEX_COUNT]);
            for (index, height) in heights.iter_mut().enumerate() {
                // The whole range that vectors may be given: 2^15 - 1 between the lowest and the
                // highest.
                *height = low + (mix(index as u32 ^ (seed as u32) << 16) >> 17) as i32;
            }
            (heights[0], heights[1]) = (low, low + (1 << 15) - 1);
            for kernel in Kernel::available() {
                assert_eq!(simd::steepest(kernel, &heights) as u64, steepest(&heights), "{kernel}");
            }
        }
    }

    /// Ramps of 16 km and more: steps of less than 2^15 units are for vectors, others are not.
    #[test]
    fn the_longest_leg_decides_between_vectors_and_wide_arithmetic() {
        for leg in [(1 << 15) - 1, 1 << 15, 1 << 16] {
            let heights = Box::new(std::array::from_fn(|index| {
                let (x, z) = (index % VERTICES, index / VERTICES);
                (x + z) as i32 * leg - (1 << 21)
            }));
            for kernel in Kernel::available() {
                assert_eq!(simd::longest_leg(kernel, &heights), leg, "{kernel}");
                let by_vectors = i64::from(simd::steepest(kernel, &heights)) as u64;
                assert_eq!(by_vectors == steepest(&heights), leg < 1 << 15, "{kernel}");
            }
            let exact = (f64::from(leg) * 2f64.sqrt()).ceil() as u64 * UNITS_PER_METRE as u64;
            for relief in [1 << 15, 1 << 22] {
                assert_eq!(u64::from(slope_bound(&heights, relief, 1)), exact);
            }
        }
    }

    #[test]
    fn above_the_sampled_levels_an_error_reaches_to_the_far_end_of_all_heights() {
        let land = Land::new(1);
        for (height_m, error_m) in [(1_472, 1_558), (-86, 1_558), (0, 1_472)] {
            let heights = [height_m * UNITS_PER_METRE; VERTEX_COUNT];
            assert_eq!(land.chunk_error(key(8, 0, 0), &heights), error_m * UNITS_PER_METRE as u32);
        }
    }

    #[test]
    fn open_sea_is_flat_without_error_or_grass() {
        let chunk = Land::new(1).chunk(key(0, 60, 60));
        assert_eq!((chunk.min(), chunk.max(), chunk.error, chunk.slope), (-64 * 256, -64 * 256, 0, 0));
        assert!(chunk.grass.density.iter().all(|share| *share == 0));
    }
}
