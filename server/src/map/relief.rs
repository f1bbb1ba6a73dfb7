//! The heights of one tile, from the base of the chunks' maximum pyramids, with a rim from the
//! neighbours.
//!
//! A tile of level `k` shows the square of the chunk of level `k`. It is made of the chunks two
//! levels finer, whose 4 x 4 pyramids of 64 texels have one texel a pixel; of the finest there are,
//! a texel covers two or four pixels.

use crate::map::TILE_PIXELS;
use terrain::constants::{CELLS, UNITS_PER_METRE, WORLD_HALF};
use terrain::{Chunk, ChunkKey};

/// Texels around the tile on every side: a slope needs one more on either side, and between pixels
/// slopes are interpolated.
pub const RIM: usize = 2;

/// Levels by which the chunks of a tile are finer than the tile.
const FINER: u8 = 2;

/// A height with its slope.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sample {
    /// Metres above the sea.
    pub height_m: f32,
    /// Rise towards east, metres a metre.
    pub east: f32,
    /// Rise towards south.
    pub south: f32,
}

/// Heights of a tile and its rim.
pub struct Relief {
    /// Texels along one side of the tile, without the rim: 64, 128 or 256.
    side: usize,
    /// Metres from texel to texel.
    spacing_m: f32,
    /// Metres, row by row from the low corner of the rim.
    heights: Vec<f32>,
    /// Rise east and south of all texels but the outermost ring, in the same order with one texel
    /// less on every side.
    slopes: Vec<(f32, f32)>,
}

/// How the chunks of a tile lie: level, and chunks along one side.
const fn parts(key: ChunkKey) -> (u8, i64) {
    let level = key.level().saturating_sub(FINER);
    (level, 1 << (key.level() - level))
}

/// The chunks that a tile is made of, those of its rim included, row by row. Beyond the world there
/// are none.
#[must_use]
pub fn sources(key: ChunkKey) -> Vec<ChunkKey> {
    let (level, parts) = parts(key);
    let (x0, z0) = key.origin();
    let side = i64::from(key.side()) / parts;
    let place = |low: i32, index: i64| {
        let low = i64::from(low) + index * side;
        (-i64::from(WORLD_HALF)..i64::from(WORLD_HALF)).contains(&low).then_some(low as i32)
    };
    let mut keys = Vec::new();
    for row in -1..=parts {
        for column in -1..=parts {
            if let (Some(x), Some(z)) = (place(x0, column), place(z0, row)) {
                keys.push(ChunkKey::containing(level, x, z));
            }
        }
    }
    keys
}

impl Relief {
    /// The relief of a tile. `chunks` are those of [`sources`], in any order; where one is missing
    /// the sea floor of the nearest texel goes on.
    #[must_use]
    pub fn of(key: ChunkKey, chunks: &[Chunk]) -> Self {
        let (_, parts) = parts(key);
        let side = CELLS * parts as usize;
        let (x0, z0) = key.origin();
        let mut relief = Self {
            side,
            spacing_m: (f64::from(key.side()) / side as f64 / f64::from(UNITS_PER_METRE)) as f32,
            heights: vec![f32::NAN; (side + 2 * RIM).pow(2)],
            slopes: Vec::new(),
        };
        for chunk in chunks {
            let (x, z) = chunk.key.origin();
            let texels =
                |from: i32, low: i32| (i64::from(from) - i64::from(low)) / i64::from(chunk.key.spacing());
            relief.copy(chunk.max_pyramid.level(0), texels(x, x0), texels(z, z0));
        }
        relief.extend_over_the_border();
        relief.find_slopes();
        relief
    }

    /// Copies the part of a chunk's texels that lies on the tile or its rim; `x` and `z` is where
    /// the first one belongs, in texels.
    fn copy(&mut self, texels: &[i32], x: i64, z: i64) {
        let (stride, rim) = ((self.side + 2 * RIM) as i64, RIM as i64);
        for row in 0..CELLS {
            let to_row = z + row as i64 + rim;
            if !(0..stride).contains(&to_row) {
                continue;
            }
            for column in 0..CELLS {
                let to = x + column as i64 + rim;
                if (0..stride).contains(&to) {
                    let height = texels[row * CELLS + column];
                    // Heights are below 2^24 units, so this is exact.
                    self.heights[(to_row * stride + to) as usize] = height as f32 / UNITS_PER_METRE as f32;
                }
            }
        }
    }

    /// Gives the rim beyond the world's border the heights at the border.
    fn extend_over_the_border(&mut self) {
        let stride = self.side + 2 * RIM;
        for row in 0..stride {
            for column in 0..stride {
                if self.heights[row * stride + column].is_nan() {
                    let inside = |v: usize| v.clamp(RIM, RIM + self.side - 1);
                    // On a corner of the world one of the two axes may still be inside it.
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

    /// Slopes by the weights of B. K. P. Horn, "Hill shading and the reflectance map", Proceedings
    /// of the IEEE 69 (1981).
    fn find_slopes(&mut self) {
        let (stride, inner) = (self.side + 2 * RIM, self.side + 2 * RIM - 2);
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

    /// Metres that a pixel covers.
    #[must_use]
    pub fn pixel_m(&self) -> f32 {
        self.spacing_m * self.side as f32 / TILE_PIXELS as f32
    }

    /// What the middle of a pixel shows; both coordinates below [`TILE_PIXELS`].
    #[must_use]
    pub fn sample(&self, column: usize, row: usize) -> Sample {
        if self.side == TILE_PIXELS {
            return self.texel(column + RIM, row + RIM);
        }
        // In texels from the middle of the rim's first; pixels of coarser texels lie at odd
        // eighths, so nothing is rounded.
        let place =
            |pixel: usize| (pixel as f32 + 0.5) * self.side as f32 / TILE_PIXELS as f32 - 0.5 + RIM as f32;
        let (x, z) = (place(column), place(row));
        let (column, row) = (x as usize, z as usize);
        let (fx, fz) = (x - column as f32, z - row as f32);
        let (low, high) = (
            self.texel(column, row).towards(self.texel(column + 1, row), fx),
            self.texel(column, row + 1).towards(self.texel(column + 1, row + 1), fx),
        );
        low.towards(high, fz)
    }

    /// A texel by its place counted from the rim's corner, not on the rim's outermost ring.
    fn texel(&self, column: usize, row: usize) -> Sample {
        let height_m = self.heights[row * (self.side + 2 * RIM) + column];
        let (east, south) = self.slopes[(row - 1) * (self.side + 2 * RIM - 2) + column - 1];
        Sample { height_m, east, south }
    }
}

impl Sample {
    /// Linear interpolation.
    fn towards(self, other: Self, share: f32) -> Self {
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

    fn relief(land: &Land, key: ChunkKey) -> Relief {
        let chunks: Vec<Chunk> = sources(key).into_iter().map(|key| land.chunk(key)).collect();
        Relief::of(key, &chunks)
    }

    #[test]
    fn a_tile_is_made_of_the_chunks_under_it_and_the_ring_around_them() {
        for (level, count) in [(0, 9), (1, 16), (2, 36), (9, 36)] {
            assert_eq!(sources(key(level, 1, -1)).len(), count, "level {level}");
        }
        assert_eq!(sources(key(TOP_LEVEL, 0, 0)).len(), 16, "nothing lies around the world");
        assert_eq!(sources(key(0, -32_768, 32_767)).len(), 4, "nor beyond its corner");
        assert_eq!(sources(key(2, 3, 1))[0], key(0, 11, 3));
    }

    #[test]
    fn a_pixel_of_a_far_tile_is_the_texel_of_the_chunk_that_is_sent() {
        let land = Land::new(1);
        let tile = key(4, -1, 0);
        let relief = relief(&land, tile);
        let chunk = land.chunk(key(2, -3, 2));
        for (column, row) in [(0, 0), (63, 5), (17, 63)] {
            let texel = chunk.max_pyramid.level(0)[row * CELLS + column];
            // The chunk is the second of four from the west and the third from the north.
            let sample = relief.sample(64 + column, 128 + row);
            assert_eq!(sample.height_m, texel as f32 / 256.0);
        }
    }

    #[test]
    fn neighbouring_tiles_agree_on_heights_and_slopes_across_their_seam() {
        let land = Land::new(1);
        for (west, east) in [
            (key(0, -1, 5), key(0, 0, 5)),
            (key(1, 2, -3), key(1, 3, -3)),
            (key(3, -1, 0), key(3, 0, 0)),
            (key(6, -1, -1), key(6, 0, -1)),
        ] {
            let (left, right) = (relief(&land, west), relief(&land, east));
            let mut differs = false;
            for row in 0..left.side {
                // The last texel of the west tile lies on the rim of the east one.
                let (theirs, ours) =
                    (left.texel(RIM + left.side - 1, row + RIM), right.texel(RIM - 1, row + RIM));
                assert_eq!(theirs, ours, "{west} and {east} at {row}");
                assert_eq!(left.texel(RIM + left.side, row + RIM), right.texel(RIM, row + RIM));
                differs |= ours != right.texel(RIM, row + RIM);
            }
            assert!(differs, "the control: a shift by one texel is noticed");
        }
    }

    #[test]
    fn between_texels_heights_are_interpolated_and_a_plane_stays_a_plane() {
        let mut relief = relief(&Land::new(1), key(0, 3, 3));
        let stride = relief.side + 2 * RIM;
        for (index, height) in relief.heights.iter_mut().enumerate() {
            *height = (index % stride) as f32 * 2.0 - (index / stride) as f32;
        }
        relief.slopes.clear();
        relief.find_slopes();
        let first = relief.sample(0, 0);
        assert_eq!((first.east, first.south), (1.0, -0.5));
        for (column, row) in [(1, 0), (0, 1), (100, 37), (255, 255)] {
            let sample = relief.sample(column, row);
            assert_eq!((sample.east, sample.south), (1.0, -0.5));
            let expected = first.height_m + (column as f32 * 2.0 - row as f32) / 4.0;
            assert!((sample.height_m - expected).abs() < 1e-3, "{} {expected}", sample.height_m);
        }
    }

    #[test]
    fn the_border_of_the_world_has_no_cliff() {
        let relief = relief(&Land::new(1), key(TOP_LEVEL, 0, 0));
        assert!(relief.heights.iter().all(|height| height.is_finite()));
        for row in 0..TILE_PIXELS {
            assert!(relief.sample(0, row).height_m >= -80.0);
        }
    }
}
