//! Error of a chunk against its parent, block by block.

use shaders::twin::grid::GridVertex;
use shaders::twin::morph::parent_height;
use terrain::ChunkKey;
use terrain::constants::{CELLS, VERTEX_COUNT, VERTICES};

/// Blocks along one side of a chunk: those of the finest level of
/// [`Resident::maxima`](crate::cache::Resident::maxima).
pub const BLOCKS: usize = 8;

/// Cells along one side of a block.
const BLOCK_CELLS: usize = CELLS / BLOCKS;

/// Upper bound of the vertical distance between a chunk's vertices and its parent's surface in each
/// block, units: the largest distance, and 1 for the rounding. Row by row from the north-west.
pub type BlockErrors = [u32; BLOCKS * BLOCKS];

/// The block errors of the chunk `key` against its parent.
#[must_use]
pub fn block_errors(key: ChunkKey, own: &[i32; VERTEX_COUNT], parent: &[i32; VERTEX_COUNT]) -> BlockErrors {
    let (east, south) = key.quarter();
    let quarter = (east as u32, south as u32);
    let mut errors = [0; BLOCKS * BLOCKS];
    for row in 0..VERTICES {
        for column in 0..VERTICES {
            let vertex = GridVertex { column: column as u32, row: row as u32 };
            let height = own[row * VERTICES + column];
            // Plus 1 because the parent's surface is rounded down by up to half a unit.
            let error = height.abs_diff(parent_height(parent, quarter, vertex)) + 1;
            // A vertex on a line between blocks belongs to both.
            for z in blocks_of(row) {
                for x in blocks_of(column) {
                    errors[z * BLOCKS + x] = error.max(errors[z * BLOCKS + x]);
                }
            }
        }
    }
    errors
}

/// The blocks that a column or row of vertices lies in: one, or the two that it separates.
fn blocks_of(line: usize) -> std::ops::RangeInclusive<usize> {
    let low = line.saturating_sub(1) / BLOCK_CELLS;
    low..=(line / BLOCK_CELLS).min(BLOCKS - 1)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cache::ChunkCache;
    use terrain::Land;

    #[test]
    fn block_errors_are_the_largest_vertex_errors() {
        let land = Land::new(1);
        for (level, x, z) in [(0, 3, -2), (1, -4, 5), (2, 1, 1)] {
            let key = ChunkKey::new(level, x, z).unwrap();
            let (own, parent) = (land.chunk_heights(key), land.chunk_heights(key.parent().unwrap()));
            let (east, south) = key.quarter();
            let block_errors = block_errors(key, &own, &parent);
            let largest = |block: usize| {
                let (x, z) = (block % BLOCKS * BLOCK_CELLS, block / BLOCKS * BLOCK_CELLS);
                let vertices = (z..=z + BLOCK_CELLS)
                    .flat_map(|row| (x..=x + BLOCK_CELLS).map(move |column| (column, row)));
                let error = |(column, row): (usize, usize)| {
                    let vertex = GridVertex { column: column as u32, row: row as u32 };
                    own[row * VERTICES + column].abs_diff(parent_height(
                        &parent,
                        (east as u32, south as u32),
                        vertex,
                    ))
                };
                vertices.map(error).max().unwrap()
            };
            for (block, error) in block_errors.iter().enumerate() {
                assert_eq!(*error, largest(block) + 1, "{key} block {block}");
            }
        }
    }

    #[test]
    fn block_errors_do_not_depend_on_arrival_order() {
        let land = Land::new(1);
        let child = ChunkKey::new(0, 3, -2).unwrap();
        let parent = child.parent().unwrap();
        let rises_after = |order: [ChunkKey; 2]| {
            let mut cache = ChunkCache::new(4);
            for key in order {
                cache.insert(land.chunk(key));
            }
            cache.get(child).unwrap().block_errors
        };
        let block_errors = rises_after([parent, child]);
        assert!(block_errors.is_some() && block_errors == rises_after([child, parent]));
    }
}
