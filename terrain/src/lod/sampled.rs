//! How far a chunk's triangles can be from the land, from the nodes of the base field under them.
//!
//! Inside a cell of the base lattice the land is `coast(S + R F, E)`: splines `S`, `R`, `E` of the
//! 3 x 3 nodes around, and the fine octaves `F`. The weights `w` of a spline are not negative, add
//! up to one, and the mean of the nodes' positions `p_i` under them is the point `p` itself. So with
//! the drawn surface `D`,
//!
//! `S(p) - D(p) = Σ w_i (S(p_i) - D(p_i)) + Σ w_i (D(p_i) - D(p))`.
//!
//! - The first sum is at most the largest difference at a node, and at least the smallest.
//! - The second is 0 where `D` is one plane under all nodes. Otherwise let the slopes of the
//!   triangles under them along each axis lie within ranges of the widths `J_x` and `J_z`. `D` less
//!   the plane with the middle slopes changes by at most `J_x / 2` and `J_z / 2` a length along the
//!   axes, and the mean distance `Σ w_i |p_i - p|` along an axis is at most half a cell, 16 m: the
//!   mean of its square is a quarter of a cell's for every `p`. So the sum is at most `8 m (J_x +
//!   J_z)`. Nodes half a cell outside the chunk are compared with the planes of its outermost
//!   triangles, whose slopes are among those.
//! - `R F` is at most 21.93 m of the largest `R`.
//! - The coast adds `34 m E` where `S + R F` is above 8 m. `E` is a spline with the same weights, so
//!   there `S(p_i) + 34 m E(p_i)` takes the place of `S(p_i)`. Below -8 m it adds nothing. Between,
//!   it adds at least -1.84 m (the beach) and at most `34 m E` and 1.84 m.
//!
//! All are taken per vertex of the chunk, over the 2 x 2 vertex cells around it: they hold the nodes
//! of every point that is nearer to this vertex than to others along both axes, because a vertex
//! cell has at least 2 x 2 nodes.

use crate::constants::{BEACH_M, CELLS, UNIT_BITS, UNITS_PER_METRE, VERTEX_COUNT, VERTICES};
use crate::key::ChunkKey;
use crate::land::Land;
use crate::simd::{Corners, Kernel, NodesApart, nodes, nodes_apart};
use crate::spline::{self, CELL_BITS};
use std::ops;

/// Bound of the fine octaves, units: `0.7072 (16 + 8 + 4 + 2 + 1)` m.
const FINE: i32 = 5_613;

/// Largest distance between a beach and its raw height, units: 0.229 of 8 m.
const BEACH_BEND: i32 = 471;

/// Bound of what is rounded, units: the height of a node and its cliff by up to 1, the splines of
/// both shares by up to 2^-14 (34 m), the land by 1/2.
const ROUNDED: i32 = 5;

/// log2 of the side of the squares of which open sea is passed over, units (1,024 m).
const SQUARE_BITS: u32 = 18;

/// Squares of a part: in a row along x. A chunk of level 5 has 4 along a side.
const PART_SQUARES: usize = 4;

/// The largest bound among the vertices of some parts.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) struct Worst {
    /// Units; none before the first part.
    bound: Option<i32>,
    /// Whether a vertex cell has land or lies near it.
    has_land: bool,
}

impl Worst {
    /// Of the parts of both.
    pub const fn and(self, other: Self) -> Self {
        let bound = match (self.bound, other.bound) {
            (Some(one), Some(two)) => Some(if one > two { one } else { two }),
            (one, two) => {
                if one.is_some() {
                    one
                } else {
                    two
                }
            }
        };
        Self { bound, has_land: self.has_land | other.has_land }
    }

    /// Bound of the chunk's error with all its parts, units.
    pub fn bound(self) -> u32 {
        if !self.has_land {
            return 0;
        }
        (self.bound.unwrap_or(0) + ROUNDED) as u32
    }
}

/// Vertex cells along the side of a square.
const fn square_cells(key: ChunkKey) -> usize {
    (1usize << SQUARE_BITS) / key.spacing() as usize
}

/// Vertex cells of a part along both axes.
const fn part_cells(key: ChunkKey) -> (usize, usize) {
    (PART_SQUARES * square_cells(key), square_cells(key))
}

/// Parts of a chunk of levels 5 to 7: 4, 16 or 64.
pub(super) const fn parts(key: ChunkKey) -> u8 {
    let (columns, rows) = part_cells(key);
    (CELLS / columns * (CELLS / rows)) as u8
}

/// The largest bound of a part of a chunk, row by row from its low corner. The chunk's vertex cells
/// hold 2, 4 or 8 nodes along a side (levels 5 to 7). Evaluates all nodes under the part outside open
/// sea, and those of one row and column of vertex cells before it.
#[must_use]
pub(super) fn sampled(land: &Land, key: ChunkKey, part: u8) -> Worst {
    let (columns, rows) = part_cells(key);
    let along = CELLS / columns;
    let first = (usize::from(part) % along * columns, usize::from(part) / along * rows);
    let cells = |first: usize, count: usize| first.saturating_sub(1)..first + count;
    let cells = (cells(first.0, columns), cells(first.1, rows));
    let vertices = |first: usize, count: usize| {
        let end = first + count;
        first..end + usize::from(end == CELLS)
    };
    let heights = land.heights_of_rows(key, cells.1.start..cells.1.end + 1);
    let apart = Comparison::new(key, &heights).cells(land, cells);
    let at = |x: usize, z: usize| heights[z * VERTICES + x];
    let side = key.spacing() >> CELL_BITS;
    let around = |vertex: usize| vertex.saturating_sub(1)..(vertex + 1).min(CELLS);
    let mut worst = 0;
    for vertex_z in vertices(first.1, rows) {
        for vertex_x in vertices(first.0, columns) {
            let mut all = NodesApart::NONE;
            let (mut along, mut across) = (Range::NONE, Range::NONE);
            for z in around(vertex_z) {
                for x in around(vertex_x) {
                    all = all.and(&apart[z * CELLS + x]);
                    let [low, east, south, high] = [at(x, z), at(x + 1, z), at(x, z + 1), at(x + 1, z + 1)];
                    along = along.with(east - low).with(high - south);
                    across = across.with(south - low).with(high - east);
                }
            }
            // Rises over a vertex cell; 8 m are a quarter of a cell of the base lattice.
            let creased = (along.width() + across.width()) / (4 * side) + 1;
            worst = worst.max(bound(&all, side) + creased);
        }
    }
    Worst { bound: Some(worst), has_land: apart.iter().any(|cell| *cell != NodesApart::SEA) }
}

/// Bound of the distance from the triangles where they have no crease, units.
fn bound(apart: &NodesApart, side: i32) -> i32 {
    let fine = ((FINE * apart.roughness) >> 15) + 1;
    let units = |scaled: i32| (scaled + 2 * side - 1) / (2 * side);
    let beach = BEACH_M * UNITS_PER_METRE;
    let apart = if apart.low - fine > beach {
        units(apart.above_with_cliff.max(apart.below_with_cliff))
    } else if apart.high + fine < -beach {
        units(apart.above.max(apart.below))
    } else {
        units(apart.above_with_cliff.max(apart.below)) + BEACH_BEND
    };
    apart + fine
}

/// What some numbers lie between.
#[derive(Clone, Copy)]
struct Range(i32, i32);

impl Range {
    const NONE: Self = Self(i32::MAX, i32::MIN);

    fn with(self, value: i32) -> Self {
        Self(self.0.min(value), self.1.max(value))
    }

    const fn width(self) -> i32 {
        self.1 - self.0
    }
}

/// Some columns or rows of vertex cells.
type Cells = ops::Range<usize>;

/// The comparison of a chunk with the nodes under it.
struct Comparison<'a> {
    key: ChunkKey,
    heights: &'a [i32; VERTEX_COUNT],
    /// Per vertex cell.
    apart: Vec<NodesApart>,
}

impl<'a> Comparison<'a> {
    fn new(key: ChunkKey, heights: &'a [i32; VERTEX_COUNT]) -> Self {
        Self { key, heights, apart: vec![NodesApart::SEA; CELLS * CELLS] }
    }

    /// Per vertex cell of the chunk, row by row; only some columns and rows are compared.
    fn cells(mut self, land: &Land, (columns, rows): (Cells, Cells)) -> Vec<NodesApart> {
        let side = square_cells(self.key);
        let squares = |cells: &Cells| (cells.start / side * side..cells.end).step_by(side);
        let within = |cells: &Cells, from: usize| cells.start.max(from)..cells.end.min(from + side);
        for z in squares(&rows) {
            for x in squares(&columns) {
                self.square(land, (x, z), (within(&columns, x), within(&rows, z)));
            }
        }
        self.apart
    }

    /// Compares some columns and rows of vertex cells of the square from one cell on. A square at a
    /// border of the chunk has one more row of nodes beyond it.
    fn square(&mut self, land: &Land, from: (usize, usize), (cell_columns, cell_rows): (Cells, Cells)) {
        let vertex_cells = square_cells(self.key);
        let nodes_along = (self.key.spacing() >> CELL_BITS) as usize;
        let origin = self.key.origin();
        let before = |from: usize| usize::from(from == 0);
        let beyond = |end: usize| usize::from(end == CELLS);
        let first = |origin: i32, from: usize| {
            spline::cell(origin).0 + (from * nodes_along) as i32 - before(from) as i32
        };
        let count = |from: usize, end: usize| (end - from) * nodes_along + before(from) + beyond(end);
        // The whole square is open sea or not, whichever of its cells are compared.
        let corner = (first(origin.0, from.0), first(origin.1, from.1));
        let longest = count(from.0, from.0 + vertex_cells).max(count(from.1, from.1 + vertex_cells));
        let reach = (longest as u32) << CELL_BITS;
        if land.archipelago().is_open_sea(corner.0 << CELL_BITS, corner.1 << CELL_BITS, reach) {
            return;
        }
        let first = (first(origin.0, cell_columns.start), first(origin.1, cell_rows.start));
        let columns = count(cell_columns.start, cell_columns.end);
        let rows = count(cell_rows.start, cell_rows.end);
        let (mut heights, mut shares) = (vec![0; columns * rows], vec![0; columns * rows]);
        nodes(Kernel::best(), land, first, columns, &mut heights, &mut shares);
        for z in cell_rows.clone() {
            for x in cell_columns.clone() {
                let row = (z - cell_rows.start) * nodes_along + before(cell_rows.start);
                let column = (x - cell_columns.start) * nodes_along + before(cell_columns.start);
                let low = row * columns + column;
                let corners = self.corners(x, z);
                let mut apart = NodesApart::NONE;
                nodes_apart(
                    Kernel::best(),
                    corners,
                    nodes_along,
                    &heights[low..],
                    &shares[low..],
                    columns,
                    &mut apart,
                );
                for (x, z) in beyond_the_border((x, z), nodes_along) {
                    let at = low.wrapping_add_signed(z as isize * columns as isize + x as isize);
                    apart.add(nodes_along as i32, corners, (x, z), heights[at], shares[at]);
                }
                self.apart[z * CELLS + x] = apart;
            }
        }
    }

    fn corners(&self, x: usize, z: usize) -> Corners {
        let at = |x: usize, z: usize| self.heights[z * VERTICES + x];
        [at(x, z), at(x + 1, z), at(x, z + 1), at(x + 1, z + 1)]
    }
}

/// The nodes half a cell outside the chunk that belong to one of its vertex cells, counted from the
/// first node of that cell.
fn beyond_the_border((x, z): (usize, usize), nodes_along: usize) -> impl Iterator<Item = (i32, i32)> {
    let side = nodes_along as i32;
    let range = move |cell: usize| -i32::from(cell == 0)..side + i32::from(cell + 1 == CELLS);
    let is_inside = move |node: i32| (0..side).contains(&node);
    let is_at_border = |cell: usize| cell == 0 || cell + 1 == CELLS;
    let all = (is_at_border(x) || is_at_border(z))
        .then(move || range(z).flat_map(move |z| range(x).map(move |x| (x, z))));
    all.into_iter().flatten().filter(move |(x, z)| !(is_inside(*x) && is_inside(*z)))
}

/// Heights of nodes are 2^-16 m, compared in units.
const _: () = assert!(crate::constants::FINE_BITS - UNIT_BITS == 8);

#[cfg(test)]
mod tests {
    use super::*;
    use crate::triangles::drawn_height_scaled;

    /// The mean distance from a point to its nodes, which the bound of creases rests on: at most half
    /// a cell, and the mean position is the point.
    #[test]
    fn nodes_of_a_spline_lie_half_a_cell_from_its_point_in_their_mean() {
        let mut farthest = 0.0_f64;
        for t in 0..1 << CELL_BITS {
            let place = f64::from(t) / f64::from(1 << CELL_BITS);
            let weights = spline::weights(t).map(|weight| f64::from(weight) / 32_768.0);
            let from = [-0.5, 0.5, 1.5].map(|node: f64| node - place);
            let mean: f64 = weights.iter().zip(from).map(|(weight, from)| weight * from).sum();
            assert!(mean.abs() < 2f64.powi(-13), "at {t}");
            farthest = farthest.max(weights.iter().zip(from).map(|(weight, from)| weight * from.abs()).sum());
        }
        assert!(farthest < 0.5001 && farthest > 0.4999, "{farthest}");
    }

    /// Whole vertex cells and rows beyond them agree with the drawn surface, node by node.
    #[test]
    fn nodes_are_compared_with_the_triangles_above_them() {
        let land = Land::new(3);
        for level in 5..=7 {
            let key = ChunkKey::new(level, 0, -1).unwrap();
            let heights = land.chunk_heights(key);
            let apart = Comparison::new(key, &heights).cells(&land, (0..CELLS, 0..CELLS));
            let side = key.spacing() as usize >> CELL_BITS;
            let depth = side.trailing_zeros() as u8 + 1;
            let (first, along) =
                ((spline::cell(key.origin().0).0, spline::cell(key.origin().1).0), CELLS * side);
            let (mut base, mut shares) = (vec![0; along * along], vec![0; along * along]);
            nodes(Kernel::best(), &land, first, along, &mut base, &mut shares);
            for (x, z) in (1..CELLS - 1).flat_map(|z| (1..CELLS - 1).map(move |x| (x, z))) {
                let (mut above, mut roughness) = (i64::MIN, 0);
                for (column, row) in (0..side * side).map(|n| (x * side + n % side, z * side + n / side)) {
                    let drawn = drawn_height_scaled(&heights, 2 * column + 1, 2 * row + 1, depth);
                    let node = row * along + column;
                    above = above.max((i64::from(base[node] >> 8) << depth) - drawn);
                    roughness = roughness.max(shares[node] & 0xffff);
                }
                let found = &apart[z * CELLS + x];
                assert_eq!((i64::from(found.above), found.roughness), (above, roughness), "{key} ({x}, {z})");
            }
        }
    }
}
