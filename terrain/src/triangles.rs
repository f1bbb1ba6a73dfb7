//! The surface that a chunk is drawn as: two triangles a cell.

use crate::constants::{CELLS, VERTEX_COUNT, VERTICES};

/// Height of the drawn surface at a point of the grid that is `2^depth` times finer, in units times
/// `2^depth`.
///
/// `column` and `row` count points of the finer grid from the low corner, up to `64 * 2^depth`. The
/// diagonal rule: every cell is cut from its low corner to its high corner.
#[must_use]
pub fn drawn_height_scaled(heights: &[i32; VERTEX_COUNT], column: usize, row: usize, depth: u8) -> i64 {
    let step = 1usize << depth;
    // The last column and row belong to the last cell.
    let (x, z) = ((column >> depth).min(CELLS - 1), (row >> depth).min(CELLS - 1));
    let (fx, fz) = ((column - x * step) as i64, (row - z * step) as i64);
    let corner = |dx: usize, dz: usize| i64::from(heights[(z + dz) * VERTICES + x + dx]);
    let (low, high) = (corner(0, 0), corner(1, 1));
    if fx >= fz {
        let side = corner(1, 0);
        low * step as i64 + (side - low) * fx + (high - side) * fz
    } else {
        let side = corner(0, 1);
        low * step as i64 + (side - low) * fz + (high - side) * fx
    }
}
