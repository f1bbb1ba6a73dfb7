//! Twin of `wgsl/shared/grid.wesl`; the client builds its index buffer with [`grid_index`], the
//! inverse.

use terrain::constants::{VERTEX_COUNT, VERTICES};

const COLUMN_BITS: u32 = 7;
const COLUMN_MASK: u32 = 127;

/// A vertex of the chunk mesh.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct GridVertex {
    /// 0 to 64, west to east.
    pub column: u32,
    /// 0 to 64, north to south.
    pub row: u32,
}

/// The vertex that an index of the shared index buffer means.
#[must_use]
pub fn grid_vertex(index: u32) -> GridVertex {
    let column = index & COLUMN_MASK;
    let row = (index >> COLUMN_BITS) & COLUMN_MASK;
    return GridVertex { column, row };
}

/// Index of a height in the pool: slots follow each other, rows inside a slot, columns inside a
/// row.
#[must_use]
pub fn height_index(slot: u32, column: u32, row: u32) -> u32 {
    return slot
        .wrapping_mul(VERTEX_COUNT as u32)
        .wrapping_add(row.wrapping_mul(VERTICES as u32))
        .wrapping_add(column);
}

/// The index that [`grid_vertex`] takes apart; `column` and `row` up to 64.
#[must_use]
pub const fn grid_index(column: u16, row: u16) -> u16 {
    (row << COLUMN_BITS) | column
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_vertex_of_the_grid_survives_the_round_trip() {
        for row in 0..VERTICES as u16 {
            for column in 0..VERTICES as u16 {
                let vertex = grid_vertex(u32::from(grid_index(column, row)));
                assert_eq!(vertex, GridVertex { column: column.into(), row: row.into() });
            }
        }
    }

    #[test]
    fn slots_tile_the_pool_without_gap_or_overlap() {
        assert_eq!(height_index(0, 0, 0), 0);
        assert_eq!(height_index(0, 64, 64) + 1, height_index(1, 0, 0));
        assert_eq!(height_index(3, 5, 7), 3 * 4225 + 7 * 65 + 5);
    }
}
