//! Grids: rectangles of vertices of one level.

use crate::constants::{TOP_LEVEL, VERTICES, WORLD_HALF};
use crate::key::ChunkKey;
use crate::octaves::Octaves;
use crate::position::OutsideWorld;

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
    /// `columns` by `rows` vertices of a level from a low corner (units); refused if any vertex lies outside the world.
    ///
    /// # Panics
    /// If `level` is above [`TOP_LEVEL`].
    pub fn new(x: i32, z: i32, level: u8, columns: usize, rows: usize) -> Result<Self, OutsideWorld> {
        assert!(level <= TOP_LEVEL, "level {level} is above {TOP_LEVEL}");
        let spacing_bits = crate::constants::SPACING_BITS + u32::from(level);
        let inside = |low: i32, count: usize| {
            let last = i128::from(low) + ((count.saturating_sub(1) as i128) << spacing_bits);
            low >= -WORLD_HALF && last <= i128::from(WORLD_HALF)
        };
        if inside(x, columns) && inside(z, rows) {
            Ok(Self { x, z, spacing_bits, columns, rows, octaves: Octaves::at_level(level) })
        } else {
            Err(OutsideWorld { x, z })
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

    /// The same vertices with fewer octaves, for measuring what they are worth; never more than the level carries.
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

    /// Position of a vertex, units. At the root the offset reaches 2^31 and wraps; the sum is right modulo 2^32.
    #[must_use]
    pub(crate) fn position(&self, column: usize, row: usize) -> (i32, i32) {
        let step = |low: i32, index: usize| low.wrapping_add((index as i32) << self.spacing_bits);
        (step(self.x, column), step(self.z, row))
    }
}
