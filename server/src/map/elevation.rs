//! Heights and slopes of one tile, from the base of the chunks' maximum pyramids, with a margin
//! from the neighbours.
//!
//! A tile of level `k` covers the chunk of level `k`. Its sources are the chunks two levels finer,
//! 4 x 4 of 64 texels, one texel per pixel; at levels 0 and 1 a texel covers four or two pixels.

use terrain::constants::{CELLS, UNITS_PER_METRE, WORLD_HALF};
use terrain::{Chunk, ChunkKey};

/// Pixels per side of a tile.
pub const TILE_PIXELS: usize = 256;

/// Texels around the tile on every side: one for slopes, one for their interpolation.
pub const MARGIN: usize = 2;

/// Levels by which the chunks of a tile are finer than the tile.
const FINER: u8 = 2;

/// A height with its slope.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sample {
    /// Metres above the sea.
    pub height_m: f32,
    /// Slope towards east, metres per metre.
    pub east: f32,
    /// Slope towards south, metres per metre.
    pub south: f32,
}

/// Heights and slopes of a tile and its margin.
pub struct ElevationGrid {
    /// Texels per side of the tile, without the margin: 64, 128 or 256.
    side: usize,
    /// Metres between texels.
    spacing_m: f32,
    /// Metres, row by row from the low corner of the margin.
    heights: Vec<f32>,
    /// Slopes east and south of all texels but the outermost ring, in the same order.
    slopes: Vec<(f32, f32)>,
}

/// Level of a tile's chunks, and chunks per side.
const fn chunk_layout(key: ChunkKey) -> (u8, i64) {
    let level = key.level().saturating_sub(FINER);
    (level, 1 << (key.level() - level))
}

/// The chunks of a tile, those of its margin included, row by row. There are none outside the
/// world.
#[must_use]
pub fn sources(key: ChunkKey) -> Vec<ChunkKey> {
    let (level, per_side) = chunk_layout(key);
    let (x0, z0) = key.origin();
    let side = i64::from(key.side()) / per_side;
    let origin = |low: i32, index: i64| {
        let low = i64::from(low) + index * side;
        (-i64::from(WORLD_HALF)..i64::from(WORLD_HALF)).contains(&low).then_some(low as i32)
    };
    let mut keys = Vec::new();
    for row in -1..=per_side {
        for column in -1..=per_side {
            if let (Some(x), Some(z)) = (origin(x0, column), origin(z0, row)) {
                keys.push(ChunkKey::containing(level, x, z));
            }
        }
    }
    keys
}

impl ElevationGrid {
    /// The grid of a tile. `chunks` are those of [`sources`], in any order; texels of a missing
    /// chunk get the height of the nearest one.
    #[must_use]
    pub fn new(key: ChunkKey, chunks: &[Chunk]) -> Self {
        let (_, per_side) = chunk_layout(key);
        let side = CELLS * per_side as usize;
        let (x0, z0) = key.origin();
        let mut grid = Self {
            side,
            spacing_m: (f64::from(key.side()) / side as f64 / f64::from(UNITS_PER_METRE)) as f32,
            heights: vec![f32::NAN; (side + 2 * MARGIN).pow(2)],
            slopes: Vec::new(),
        };
        for chunk in chunks {
            let (x, z) = chunk.key.origin();
            let texels =
                |from: i32, low: i32| (i64::from(from) - i64::from(low)) / i64::from(chunk.key.spacing());
            grid.copy(chunk.max_pyramid.level(0), texels(x, x0), texels(z, z0));
        }
        grid.extend_border();
        grid.compute_slopes();
        grid
    }

    /// Copies a chunk's texels on the tile and its margin; `x` and `z` are the position of the
    /// first one, in texels.
    fn copy(&mut self, texels: &[i32], x: i64, z: i64) {
        let (stride, margin) = ((self.side + 2 * MARGIN) as i64, MARGIN as i64);
        for row in 0..CELLS {
            let to_row = z + row as i64 + margin;
            if !(0..stride).contains(&to_row) {
                continue;
            }
            for column in 0..CELLS {
                let to = x + column as i64 + margin;
                if (0..stride).contains(&to) {
                    let height = texels[row * CELLS + column];
                    // Heights are below 2^24 units, so this is exact.
                    self.heights[(to_row * stride + to) as usize] = height as f32 / UNITS_PER_METRE as f32;
                }
            }
        }
    }

    /// Extends the heights at the world's border over the margin outside it.
    fn extend_border(&mut self) {
        let stride = self.side + 2 * MARGIN;
        for row in 0..stride {
            for column in 0..stride {
                if self.heights[row * stride + column].is_nan() {
                    let inside = |v: usize| v.clamp(MARGIN, MARGIN + self.side - 1);
                    // Near a corner of the world one of the axes may be inside it.
                    let nearest =
                        [(row, inside(column)), (inside(row), column), (inside(row), inside(column))]
                            .into_iter()
                            .map(|(row, column)| self.heights[row * stride + column])
                            .find(|height| !height.is_nan());
                    self.heights[row * stride + column] = nearest.unwrap_or(0.0);
                }
            }
        }
    }

    /// Slopes with the weights of B. K. P. Horn, "Hill shading and the reflectance map",
    /// Proceedings of the IEEE 69 (1981).
    fn compute_slopes(&mut self) {
        let (stride, inner) = (self.side + 2 * MARGIN, self.side + 2 * MARGIN - 2);
        let scale = 1.0 / (8.0 * self.spacing_m);
        self.slopes.reserve(inner * inner);
        for row in 1..=inner {
            for column in 1..=inner {
                let at =
                    |east: usize, south: usize| self.heights[(row + south - 1) * stride + column + east - 1];
                let (nw, n, ne) = (at(0, 0), at(1, 0), at(2, 0));
                let (w, e) = (at(0, 1), at(2, 1));
                let (sw, s, se) = (at(0, 2), at(1, 2), at(2, 2));
                let east = (ne + 2.0 * e + se) - (nw + 2.0 * w + sw);
                let south = (sw + 2.0 * s + se) - (nw + 2.0 * n + ne);
                self.slopes.push((east * scale, south * scale));
            }
        }
    }

    /// Metres per pixel.
    #[must_use]
    pub fn pixel_m(&self) -> f32 {
        self.spacing_m * self.side as f32 / TILE_PIXELS as f32
    }

    /// The sample at the centre of a pixel; both coordinates below [`TILE_PIXELS`].
    #[must_use]
    pub fn sample(&self, column: usize, row: usize) -> Sample {
        if self.side == TILE_PIXELS {
            return self.texel(column + MARGIN, row + MARGIN);
        }
        // In texels from the centre of the margin's first texel. Positions are odd eighths, so
        // nothing is rounded.
        let position =
            |pixel: usize| (pixel as f32 + 0.5) * self.side as f32 / TILE_PIXELS as f32 - 0.5 + MARGIN as f32;
        let (x, z) = (position(column), position(row));
        let (column, row) = (x as usize, z as usize);
        let (fx, fz) = (x - column as f32, z - row as f32);
        let (low, high) = (
            self.texel(column, row).lerp(self.texel(column + 1, row), fx),
            self.texel(column, row + 1).lerp(self.texel(column + 1, row + 1), fx),
        );
        low.lerp(high, fz)
    }

    /// A texel, counted from the corner of the margin, not on its outermost ring.
    fn texel(&self, column: usize, row: usize) -> Sample {
        let height_m = self.heights[row * (self.side + 2 * MARGIN) + column];
        let (east, south) = self.slopes[(row - 1) * (self.side + 2 * MARGIN - 2) + column - 1];
        Sample { height_m, east, south }
    }
}

impl Sample {
    /// Linear interpolation.
    fn lerp(self, other: Self, share: f32) -> Self {
        let mix = |a: f32, b: f32| a + (b - a) * share;
        Self {
            height_m: mix(self.height_m, other.height_m),
            east: mix(self.east, other.east),
            south: mix(self.south, other.south),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use terrain::Land;
    use terrain::constants::TOP_LEVEL;

    fn key(level: u8, x: i32, z: i32) -> ChunkKey {
        ChunkKey::new(level, x, z).unwrap()
    }

    fn grid(land: &Land, key: ChunkKey) -> ElevationGrid {
        let chunks: Vec<Chunk> = sources(key).into_iter().map(|key| land.chunk(key)).collect();
        ElevationGrid::new(key, &chunks)
    }

    #[test]
    fn sources_are_the_chunks_of_the_tile_and_one_ring() {
        for (level, count) in [(0, 9), (1, 16), (2, 36), (9, 36)] {
            assert_eq!(sources(key(level, 1, -1)).len(), count, "level {level}");
        }
        assert_eq!(sources(key(TOP_LEVEL, 0, 0)).len(), 16, "the world has no neighbours");
        assert_eq!(sources(key(0, -32_768, 32_767)).len(), 4, "nor has its corner");
        assert_eq!(sources(key(2, 3, 1))[0], key(0, 11, 3));
    }

    #[test]
    fn a_pixel_of_a_coarse_tile_is_a_texel_of_the_sent_chunk() {
        let land = Land::new(1);
        let tile = key(4, -1, 0);
        let grid = grid(&land, tile);
        let chunk = land.chunk(key(2, -3, 2));
        for (column, row) in [(0, 0), (63, 5), (17, 63)] {
            let texel = chunk.max_pyramid.level(0)[row * CELLS + column];
            // The chunk is the second of four from the west and the third from the north.
            let sample = grid.sample(64 + column, 128 + row);
            assert_eq!(sample.height_m, texel as f32 / 256.0);
        }
    }

    #[test]
    fn neighbouring_tiles_share_heights_and_slopes_at_the_seam() {
        let land = Land::new(1);
        for (west, east) in [
            (key(0, -1, 5), key(0, 0, 5)),
            (key(1, 2, -3), key(1, 3, -3)),
            (key(3, -1, 0), key(3, 0, 0)),
            (key(6, -1, -1), key(6, 0, -1)),
        ] {
            let (left, right) = (grid(&land, west), grid(&land, east));
            let mut differs = false;
            for row in 0..left.side {
                // The last texel of the west tile lies in the margin of the east one.
                let (theirs, ours) =
                    (left.texel(MARGIN + left.side - 1, row + MARGIN), right.texel(MARGIN - 1, row + MARGIN));
                assert_eq!(theirs, ours, "{west} and {east} at {row}");
                assert_eq!(left.texel(MARGIN + left.side, row + MARGIN), right.texel(MARGIN, row + MARGIN));
                differs |= ours != right.texel(MARGIN, row + MARGIN);
            }
            assert!(differs, "the control: a shift by one texel is detected");
        }
    }

    #[test]
    fn interpolation_preserves_a_plane() {
        let mut grid = grid(&Land::new(1), key(0, 3, 3));
        let stride = grid.side + 2 * MARGIN;
        for (index, height) in grid.heights.iter_mut().enumerate() {
            *height = (index % stride) as f32 * 2.0 - (index / stride) as f32;
        }
        grid.slopes.clear();
        grid.compute_slopes();
        let first = grid.sample(0, 0);
        assert_eq!((first.east, first.south), (1.0, -0.5));
        for (column, row) in [(1, 0), (0, 1), (100, 37), (255, 255)] {
            let sample = grid.sample(column, row);
            assert_eq!((sample.east, sample.south), (1.0, -0.5));
            let expected = first.height_m + (column as f32 * 2.0 - row as f32) / 4.0;
            assert!((sample.height_m - expected).abs() < 1e-3, "{} {expected}", sample.height_m);
        }
    }

    #[test]
    fn the_border_of_the_world_has_no_cliff() {
        let grid = grid(&Land::new(1), key(TOP_LEVEL, 0, 0));
        assert!(grid.heights.iter().all(|height| height.is_finite()));
        for row in 0..TILE_PIXELS {
            assert!(grid.sample(0, row).height_m >= -87.0);
        }
    }
}
