//! Grids: rectangles of vertices of one level.

use crate::constants::{SPACING_BITS, TOP_LEVEL, VERTICES, WORLD_HALF};
use crate::key::ChunkKey;
use crate::octaves::Octaves;
use crate::position::OutsideWorld;
use std::fmt;

/// A rectangle of vertices, all inside the world. Rows run along x, from the low corner.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Grid {
    pub(crate) x: i32,
    pub(crate) z: i32,
    /// log2 of the vertex spacing in units.
    pub(crate) spacing_bits: u32,
    pub(crate) columns: usize,
    pub(crate) rows: usize,
    pub(crate) octaves: Octaves,
}

impl Grid {
    /// `columns` by `rows` vertices of a level from a low corner (units); rejected if a vertex
    /// lies outside the world, the level does not exist, or the vertex count exceeds memory. A grid
    /// without vertices is allowed if its corner lies in the world.
    pub fn new(x: i32, z: i32, level: u8, columns: usize, rows: usize) -> Result<Self, InvalidGrid> {
        if level > TOP_LEVEL {
            return Err(InvalidGrid::NoSuchLevel(level));
        }
        // An allocation is at most isize::MAX bytes; the arithmetic below relies on it.
        if columns.checked_mul(rows).is_none_or(|count| count > isize::MAX as usize / 4) {
            return Err(InvalidGrid::TooManyVertices { columns, rows });
        }
        let spacing_bits = SPACING_BITS + u32::from(level);
        let inside = |low: i32, count: usize| {
            let last = i128::from(low) + ((count.saturating_sub(1) as i128) << spacing_bits);
            low >= -WORLD_HALF && last <= i128::from(WORLD_HALF)
        };
        if inside(x, columns) && inside(z, rows) {
            Ok(Self { x, z, spacing_bits, columns, rows, octaves: Octaves::at_level(level) })
        } else {
            Err(InvalidGrid::OutsideWorld(OutsideWorld { x, z }))
        }
    }

    /// The 65 x 65 vertices of a chunk.
    #[must_use]
    pub fn of_chunk(key: ChunkKey) -> Self {
        let (x, z) = key.origin();
        let spacing_bits = key.spacing().trailing_zeros();
        Self {
            x,
            z,
            spacing_bits,
            columns: VERTICES,
            rows: VERTICES,
            octaves: Octaves::at_level(key.level()),
        }
    }

    /// The same vertices with fewer octaves, for measurements; never more than the level carries.
    #[must_use]
    pub fn keeping(self, octaves: Octaves) -> Self {
        Self { octaves: octaves.min(self.octaves), ..self }
    }

    /// Vertices along x.
    #[must_use]
    pub const fn columns(&self) -> usize {
        self.columns
    }

    /// Vertices along z.
    #[must_use]
    pub const fn rows(&self) -> usize {
        self.rows
    }

    /// Octaves of the fractal sum that its vertices carry.
    #[must_use]
    pub const fn octaves(&self) -> Octaves {
        self.octaves
    }

    /// Number of vertices.
    #[must_use]
    pub const fn vertex_count(&self) -> usize {
        self.columns * self.rows
    }

    /// At most `rows` rows from a row on.
    pub(crate) fn band(&self, row: usize, rows: usize) -> Self {
        Self { z: self.position(0, row).1, rows: rows.min(self.rows - row), ..*self }
    }

    /// Position of a vertex, units. At the root the offset reaches 2^31 and wraps; the sum is right
    /// modulo 2^32.
    #[must_use]
    pub(crate) fn position(&self, column: usize, row: usize) -> (i32, i32) {
        let step = |low: i32, index: usize| low.wrapping_add((index as i32) << self.spacing_bits);
        (step(self.x, column), step(self.z, row))
    }
}

/// Why a grid is invalid.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum InvalidGrid {
    /// A vertex lies outside the world; the low corner is named.
    OutsideWorld(OutsideWorld),
    /// The level is above [`TOP_LEVEL`].
    NoSuchLevel(u8),
    /// More vertices than this machine can hold.
    TooManyVertices {
        /// Vertices along x.
        columns: usize,
        /// Vertices along z.
        rows: usize,
    },
}

impl fmt::Display for InvalidGrid {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::OutsideWorld(OutsideWorld { x, z }) => {
                write!(
                    f,
                    "a grid from ({x}, {z}) leaves the world: every vertex must lie within \
                     ±{WORLD_HALF} units"
                )
            }
            Self::TooManyVertices { columns, rows } => {
                write!(f, "{columns} x {rows} vertices are more than memory can hold: choose a smaller grid")
            }
            Self::NoSuchLevel(level) => write!(f, "there is no level {level}: levels are 0 to {TOP_LEVEL}"),
        }
    }
}

impl std::error::Error for InvalidGrid {}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_grid_may_touch_every_border_but_not_cross_it() {
        for level in 0..=TOP_LEVEL {
            let spacing = 1i64 << (SPACING_BITS + u32::from(level));
            let low = (i64::from(WORLD_HALF) - spacing) as i32;
            assert!(Grid::new(low, low, level, 2, 2).is_ok());
            assert_eq!(
                Grid::new(low, low, level, 2, 3),
                Err(InvalidGrid::OutsideWorld(OutsideWorld { x: low, z: low }))
            );
            assert!(Grid::new(low + 1, low, level, 2, 2).is_err());
            assert!(Grid::new(-WORLD_HALF, -WORLD_HALF, level, 2, 2).is_ok());
            assert!(Grid::new(-WORLD_HALF - 1, 0, level, 2, 2).is_err());
        }
        assert!(Grid::new(0, 0, 0, usize::MAX, 1).is_err());
    }

    #[test]
    fn a_grid_larger_than_memory_is_rejected() {
        let half = 1 << (usize::BITS / 2);
        for (columns, rows) in [(half, half), (half + 1, half + 1), (usize::MAX, 2)] {
            assert_eq!(
                Grid::new(0, 0, 0, columns, rows),
                Err(InvalidGrid::TooManyVertices { columns, rows })
            );
        }
    }

    #[test]
    fn a_level_above_the_top_is_rejected() {
        assert_eq!(Grid::new(0, 0, TOP_LEVEL + 1, 2, 2), Err(InvalidGrid::NoSuchLevel(TOP_LEVEL + 1)));
    }

    #[test]
    fn the_grid_of_a_chunk_at_the_border_ends_on_the_border() {
        for level in 0..=TOP_LEVEL {
            let key = ChunkKey::containing(level, WORLD_HALF, WORLD_HALF);
            assert_eq!(Grid::of_chunk(key).position(64, 64), (WORLD_HALF, WORLD_HALF));
        }
    }

    #[test]
    fn a_refused_grid_is_named_with_what_is_allowed() {
        let refused = |level, columns| Grid::new(5, -7, level, columns, 2).unwrap_err().to_string();
        for (text, parts) in [
            (refused(0, 1 << 30), ["(5, -7)", "±1073741824"]),
            (refused(17, 1), ["level 17", "0 to 16"]),
            (refused(0, usize::MAX), ["x 2 vertices", "memory"]),
        ] {
            assert!(parts.iter().all(|part| text.contains(*part)), "{text}");
        }
    }

    #[test]
    fn bands_cover_the_rows_of_a_grid() {
        let grid = Grid::new(-512, 1024, 1, 3, 10).unwrap();
        assert_eq!((grid.columns(), grid.rows(), grid.vertex_count()), (3, 10, 30));
        for (row, rows) in [(0, 4), (4, 4), (8, 2)] {
            let band = grid.band(row, 4);
            assert_eq!((band.columns(), band.rows(), band.octaves()), (3, rows, grid.octaves()));
            assert_eq!(band.position(2, 0), grid.position(2, row));
        }
        assert_eq!(grid.position(2, 8), (1536, 9216));
    }
}
