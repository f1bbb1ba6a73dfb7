//! Sky visibility: the share of the sky's light on level ground that the land around leaves.
//!
//! For each texel the horizon is found in eight directions over samples whose spacing grows with
//! their distance (horizon mapping: Max, "Horizon Mapping: Shadows for Bump-Mapped Surfaces", The
//! Visual Computer 4, 1988). Under a uniform sky a horizon at elevation e leaves cos²(e) of a
//! direction's part of the irradiance. The share is relative to a plane with the slope of the
//! place, because the light of a tilted surface is already reduced by its normal.

use super::heights::{BLOCK, Heights};
use super::window::{FINEST_SPACING_M, chunk_of};

/// Texels along a side of a tile: half as many as those of the slopes, visibility changes slowly.
pub const SKY_TEXELS: usize = BLOCK;

/// Directions, as parts along both axes.
const DIRECTIONS: [(f32, f32); 8] = {
    const DIAGONAL: f32 = std::f32::consts::FRAC_1_SQRT_2;
    [
        (1.0, 0.0),
        (DIAGONAL, DIAGONAL),
        (0.0, 1.0),
        (-DIAGONAL, DIAGONAL),
        (-1.0, 0.0),
        (-DIAGONAL, -DIAGONAL),
        (0.0, -1.0),
        (DIAGONAL, -DIAGONAL),
    ]
};

/// Distances in steps of a ring's spacing: those of the first ring, from the texel on, and those of
/// the rings after it, each with twice the spacing.
const NEAR_STEPS: [f32; 6] = [1.0, 2.0, 3.0, 4.0, 6.0, 8.0];
const FAR_STEPS: [f32; 3] = [5.0, 6.5, 8.0];

/// Rings: the horizon is found up to `8 * 2^(RINGS - 1)` texels away, 2 km on the finest level.
const RINGS: u32 = 7;

/// Samples around a tile that the largest step needs.
const MARGIN: i32 = 9;

/// Largest level of a chunk that a ring reads.
const TOP_LEVEL: u32 = 16;

/// Sky visibility of a tile's texels, 0 to 255, row by row; texel `(i, j)` lies on vertex
/// `(2i, 2j)` of the chunk.
#[must_use]
pub fn sky_visibility(heights: &mut Heights, level: u32, tile: (i32, i32)) -> Vec<u8> {
    let own = Surroundings::of(heights, level, tile, 0);
    // Tangents of the horizon, and of the plane through the place, by direction.
    let mut horizons = [const { [0.0_f32; TEXELS] }; DIRECTIONS.len()];
    let mut planes = horizons;
    for (plane, (x, z)) in planes.iter_mut().zip(DIRECTIONS) {
        own.for_each(plane, |own, column, row, tangent| {
            let slope = |x, z| own.at(column + x, row + z) - own.at(column - x, row - z);
            *tangent = ((x * slope(1, 0) + z * slope(0, 1)) / (2.0 * own.spacing_m)).max(0.0);
        });
    }
    let mut here = [0.0; TEXELS];
    own.for_each(&mut here, |own, column, row, height_m| *height_m = own.at(column, row));
    for ring in 0..RINGS.min(TOP_LEVEL - level + 1) {
        let around = Surroundings::of(heights, level, tile, ring);
        let steps: &[f32] = if ring == 0 { &NEAR_STEPS } else { &FAR_STEPS };
        for (horizon, (x, z)) in horizons.iter_mut().zip(DIRECTIONS) {
            for step in steps {
                let [east, south] = [x, z].map(|part| (part * step).round() as i32);
                let nearness = 1.0 / ((east as f32).hypot(south as f32) * around.spacing_m);
                let mut texel = 0;
                around.for_each(horizon, |around, column, row, tangent| {
                    let rise_m = around.at(column + east, row + south) - here[texel];
                    *tangent = tangent.max(rise_m * nearness);
                    texel += 1;
                });
            }
        }
    }
    let left = |tangent: f32| 1.0 / (1.0 + tangent * tangent);
    let visibility = |texel: usize| {
        let (mut seen, mut whole) = (0.0, 0.0);
        for (horizon, plane) in horizons.iter().zip(&planes) {
            seen += left(horizon[texel].max(plane[texel]));
            whole += left(plane[texel]);
        }
        (255.0 * seen / whole).round() as u8
    };
    (0..TEXELS).map(visibility).collect()
}

/// Texels of a tile.
const TEXELS: usize = SKY_TEXELS * SKY_TEXELS;

/// Heights in and around a tile with the spacing of a ring.
struct Surroundings {
    /// Metres, row by row.
    heights_m: Vec<f32>,
    side: i32,
    spacing_m: f32,
    /// Column and row of the sample nearest to each column and row of texels.
    columns: [i32; SKY_TEXELS],
    rows: [i32; SKY_TEXELS],
}

impl Surroundings {
    fn of(heights: &mut Heights, level: u32, tile: (i32, i32), ring: u32) -> Self {
        let block = BLOCK as i32;
        // Samples of the ring, counted from the origin of the world.
        let nearest = |tile: i32| -> [i32; SKY_TEXELS] {
            let half = (1 << ring) >> 1;
            std::array::from_fn(|texel| (tile * block + texel as i32 + half) >> ring)
        };
        let (columns, rows) = (nearest(tile.0), nearest(tile.1));
        let first = [columns[0], rows[0]].map(|low| low - MARGIN);
        let last = [columns[SKY_TEXELS - 1], rows[SKY_TEXELS - 1]].map(|high| high + MARGIN);
        let side = last[0].max(first[0] + last[1] - first[1]) - first[0] + 1;
        let mut heights_m = vec![0.0; (side * side) as usize];
        for z in first[1].div_euclid(block)..=last[1].div_euclid(block) {
            for x in first[0].div_euclid(block)..=last[0].div_euclid(block) {
                let source = heights.block(chunk_of(level + ring, (x, z)));
                let (low, high) = (first[0].max(x * block), last[0].min((x + 1) * block - 1));
                for row in first[1].max(z * block)..=last[1].min((z + 1) * block - 1) {
                    let from = ((row - z * block) * block + low - x * block) as usize;
                    let to = ((row - first[1]) * side + low - first[0]) as usize;
                    let length = (high - low + 1) as usize;
                    heights_m[to..to + length].copy_from_slice(&source[from..from + length]);
                }
            }
        }
        let spacing_m = 2.0 * FINEST_SPACING_M * f64::from(1_u32 << (level + ring));
        Self {
            heights_m,
            side,
            spacing_m: spacing_m as f32,
            columns: columns.map(|column| column - first[0]),
            rows: rows.map(|row| row - first[1]),
        }
    }

    /// A sample, metres.
    fn at(&self, column: i32, row: i32) -> f32 {
        self.heights_m[(row * self.side + column) as usize]
    }

    /// Visits the texels of the tile, row by row, with the sample nearest to each.
    fn for_each(&self, texels: &mut [f32; TEXELS], mut visit: impl FnMut(&Self, i32, i32, &mut f32)) {
        for (line, row) in texels.chunks_exact_mut(SKY_TEXELS).zip(self.rows) {
            for (texel, column) in line.iter_mut().zip(self.columns) {
                visit(self, column, row, texel);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use terrain::{Land, Position};

    /// Sky visibility by a search along 32 directions over the heights themselves, every 2 m to 64
    /// m and then in steps that grow by a fiftieth.
    fn reference(land: &Land, x_m: f64, z_m: f64) -> f64 {
        let height = |x_m: f64, z_m: f64| {
            let place = Position::new((x_m * 256.0) as i32, (z_m * 256.0) as i32).unwrap();
            f64::from(land.height_at(place).max(0)) / 256.0
        };
        let here = height(x_m, z_m);
        let (east, south) = (
            (height(x_m + 4.0, z_m) - height(x_m - 4.0, z_m)) / 8.0,
            (height(x_m, z_m + 4.0) - height(x_m, z_m - 4.0)) / 8.0,
        );
        let (mut seen, mut whole) = (0.0, 0.0);
        for direction in 0..32 {
            let (sin, cos) = (f64::from(direction) * std::f64::consts::TAU / 32.0).sin_cos();
            let plane = (east * cos + south * sin).max(0.0);
            let mut horizon = plane;
            let mut distance = 4.0;
            while distance < 2_000.0 {
                let rise = height(x_m + cos * distance, z_m + sin * distance) - here;
                horizon = horizon.max(rise / distance);
                distance += (distance / 50.0_f64).max(2.0);
            }
            seen += 1.0 / (1.0 + horizon * horizon);
            whole += 1.0 / (1.0 + plane * plane);
        }
        seen / whole
    }

    #[test]
    fn visibility_agrees_with_a_search_of_the_whole_horizon_and_is_lower_in_valleys() {
        let land = Land::new(1);
        let mut heights = Heights::new(land, 1.0);
        let (mut errors, mut seen) = (Vec::new(), Vec::new());
        for tile in [(-9, 4), (3, -6), (5, 7), (-14, -9)] {
            let texels = sky_visibility(&mut heights, 0, tile);
            for texel in (0..TEXELS).step_by(37) {
                let at = |tile: i32, texel: usize| f64::from(tile) * 128.0 + 4.0 * texel as f64;
                let (x, z) = (at(tile.0, texel % SKY_TEXELS), at(tile.1, texel / SKY_TEXELS));
                let found = f64::from(texels[texel]) / 255.0;
                errors.push((found - reference(&land, x, z)).abs());
                seen.push(found);
            }
        }
        let mean = errors.iter().sum::<f64>() / errors.len() as f64;
        let worst = errors.iter().fold(0.0, |worst: f64, error| worst.max(*error));
        let (least, most) = seen.iter().fold((1.0_f64, 0.0_f64), |(l, m), s| (l.min(*s), m.max(*s)));
        assert!(mean < 0.015 && worst < 0.12, "mean {mean}, worst {worst}");
        assert!(least < 0.8 && most > 0.98, "places differ: {least} to {most}");
        // Control: a sky that is open everywhere is farther from the reference.
        let open = seen.iter().map(|seen| 1.0 - seen).sum::<f64>() / seen.len() as f64;
        assert!(open > 2.0 * mean, "an open sky is {open} off, the found one {mean}");
    }

    #[test]
    fn higher_land_hides_more_of_the_sky() {
        let open = |scale: f32| -> u64 {
            let texels = sky_visibility(&mut Heights::new(Land::new(1), scale), 0, (3, -6));
            texels.into_iter().map(u64::from).sum()
        };
        assert!(open(4.0) < open(1.0) && open(1.0) < open(0.25));
    }

    #[test]
    fn a_tile_depends_on_its_key_alone() {
        let land = Land::new(7);
        let first = sky_visibility(&mut Heights::new(land, 1.0), 2, (1, -1));
        let mut used = Heights::new(land, 1.0);
        for tile in [(0, 0), (1, 0), (2, -1), (7, 7)] {
            let _ = sky_visibility(&mut used, 2, tile);
        }
        assert!(sky_visibility(&mut used, 2, (1, -1)) == first);
        assert!(sky_visibility(&mut used, 2, (1, 0)) != first);
    }

    #[test]
    fn the_open_sea_and_the_end_of_the_world_see_the_whole_sky() {
        let mut heights = Heights::new(Land::new(1), 1.0);
        let end = (1 << 15) - 1;
        for (level, tile) in [(0, (end, end)), (9, (100, 100)), (11, (-1_000_000, 0))] {
            let texels = sky_visibility(&mut heights, level, tile);
            assert!(texels.iter().all(|texel| *texel > 100), "level {level}, {tile:?}");
        }
        assert!(sky_visibility(&mut heights, 11, (-1_000_000, 0)).iter().all(|texel| *texel == 255));
    }
}
