//! Uniform quadratic B-splines over the base lattice (de Boor, "A Practical Guide to Splines",
//! 1978): smooth, local to 3 x 3 nodes, and inside the hull of their nodes.
//!
//! Nodes lie in the middles of cells of 2^13 units (32 m). Inside a cell, at the fraction `t`, a
//! spline of the nodes `a, b, c` of the cell before, of the cell and of the cell after is
//! `(a + b) / 2 + (b - a) t + (a - 2b + c) t² / 2`.

use crate::ring::mul_hi;

/// log2 of the side of a cell of the base lattice, units.
pub const CELL_BITS: u32 = 13;

/// The cell of a coordinate, and the fraction of the cell, Q13.
#[must_use]
#[inline]
pub const fn cell(coordinate: i32) -> (i32, i32) {
    (coordinate >> CELL_BITS, coordinate & ((1 << CELL_BITS) - 1))
}

/// Position of the node of a cell, units.
#[must_use]
#[inline]
pub const fn node(cell: i32) -> i32 {
    (cell << CELL_BITS) + (1 << (CELL_BITS - 1))
}

/// The spline of heights, 2^-16 m. Differences of neighbours are below 2^29.
#[must_use]
#[inline]
pub const fn height([a, b, c]: [i32; 3], t_q13: i32) -> i32 {
    let (rise, bend) = (b - a, (c - b) - (b - a));
    ((a + b) >> 1)
        + mul_hi(rise << 1, t_q13 << (31 - CELL_BITS))
        + mul_hi(bend, (t_q13 * t_q13) << (31 - 2 * CELL_BITS))
}

/// The weights of three nodes at a fraction of the cell, Q15; their sum is one.
#[must_use]
#[inline]
pub const fn weights(t_q13: i32) -> [i32; 3] {
    let rest = (1 << CELL_BITS) - t_q13;
    let (before, after) = ((rest * rest) >> (2 * CELL_BITS - 14), (t_q13 * t_q13) >> (2 * CELL_BITS - 14));
    [before, (1 << 15) - before - after, after]
}

/// The spline of shares, Q15, rounded to nearest: 16-bit factors, as a paired product takes them.
#[must_use]
#[inline]
pub const fn share([a, b, c]: [i32; 3], weights: [i32; 3]) -> i32 {
    (a * weights[0] + b * weights[1] + c * weights[2] + (1 << 14)) >> 15
}
