//! How far a chunk's triangles can be from the land, from the nodes of the base field under them.
//!
//! Inside a cell of the base lattice the land is `coast(S + R F, E)`: splines `S`, `R`, `E` of the
//! 3 x 3 nodes around, and the fine octaves `F`. The weights `w` of a spline are not negative, add
//! up to one, and the mean of the nodes' positions `p_i` under them is the point `p` itself. So
//! with the drawn surface `D`,
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
//! - The coast adds `34 m E` where `S + R F` is above 8 m. `E` is a spline with the same weights,
//!   so there `S(p_i) + 34 m E(p_i)` takes the place of `S(p_i)`. Below -8 m it adds nothing.
//!   Between, it adds at least -1.84 m (the beach) and at most `34 m E` and 1.84 m.
//!
//! All are taken per vertex of the chunk, over the 2 x 2 vertex cells around it: they hold the
//! nodes of every point that is nearer to this vertex than to others along both axes, because a
//! vertex cell has at least 2 x 2 nodes.

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
/// hold 2, 4 or 8 nodes along a side (levels 5 to 7). Evaluates all nodes under the part outside
/// open sea, and those of one row and column of vertex cells before it.
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

    /// The mean distance from a point to its nodes, which the bound of creases rests on: at most
    /// half a cell, and the mean position is the point.
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

    /// Vertex cells agree with the drawn surface, node by node; those at the border with the planes
    /// of their triangles beyond it, too.
    #[test]
    fn nodes_are_compared_with_the_triangles_above_them() {
        let land = Land::new(3);
        // About the origin, and an island far from both axes.
        for (level, x, z) in [(5, 0, -1), (6, 0, -1), (7, 0, -1), (5, 13, 10)] {
            let key = ChunkKey::new(level, x, z).unwrap();
            let heights = land.chunk_heights(key);
            let apart = Comparison::new(key, &heights).cells(&land, (0..CELLS, 0..CELLS));
            let side = key.spacing() as usize >> CELL_BITS;
            let depth = side.trailing_zeros() as u8 + 1;
            // One node more to every side.
            let along = CELLS * side + 2;
            let first = (spline::cell(key.origin().0).0 - 1, spline::cell(key.origin().1).0 - 1);
            let (mut base, mut shares) = (vec![0; along * along], vec![0; along * along]);
            nodes(Kernel::best(), &land, first, along, &mut base, &mut shares);
            let at = |x: usize, z: usize| heights[z * VERTICES + x];
            let of_cell = |cell: usize| {
                cell * side + usize::from(cell > 0)..(cell + 1) * side + 1 + usize::from(cell + 1 == CELLS)
            };
            for (x, z) in (0..CELLS).flat_map(|z| (0..CELLS).map(move |x| (x, z))) {
                let [low, east, south, high] = [at(x, z), at(x + 1, z), at(x, z + 1), at(x + 1, z + 1)];
                let mut expected = NodesApart::NONE;
                for (column, row) in of_cell(z).flat_map(|row| of_cell(x).map(move |column| (column, row))) {
                    // In halves of the distance between nodes, from the corner of the cell.
                    let halves = |node: usize, cell: usize| 2 * (node as i32 - (cell * side) as i32) - 1;
                    let (u, v, scale) = (halves(column, x), halves(row, z), 2 * side as i32);
                    let drawn = scale * low
                        + if u >= v {
                            (east - low) * u + (high - east) * v
                        } else {
                            (south - low) * v + (high - south) * u
                        };
                    if [column, row].iter().all(|node| (1..along - 1).contains(node)) {
                        let stated = drawn_height_scaled(&heights, 2 * column - 1, 2 * row - 1, depth);
                        assert_eq!(i64::from(drawn), stated, "{key} ({column}, {row})");
                    }
                    let node = row * along + column;
                    let (height, exposure) = (base[node] >> 8, shares[node] >> 16);
                    let above = scale * height - drawn;
                    // 34 m of the exposure.
                    let raised = above + scale * ((34 * exposure) >> 7);
                    expected = expected.and(&NodesApart {
                        above,
                        below: -above,
                        above_with_cliff: raised,
                        below_with_cliff: -raised,
                        low: height,
                        high: height,
                        roughness: shares[node] & 0xffff,
                    });
                }
                assert_eq!(apart[z * CELLS + x], expected, "{key} ({x}, {z})");
            }
        }
    }

    #[test]
    fn only_cells_at_the_border_have_nodes_beyond_it() {
        let beyond = |x: usize, z: usize| beyond_the_border((x, z), 2).collect::<Vec<_>>();
        let last = CELLS - 1;
        assert!(beyond(1, 5).is_empty() && beyond(last - 1, last - 1).is_empty());
        assert_eq!(beyond(0, 5), [(-1, 0), (-1, 1)]);
        assert_eq!(beyond(5, last), [(0, 2), (1, 2)]);
        assert_eq!(beyond(last, 0), [(0, -1), (1, -1), (2, -1), (2, 0), (2, 1)]);
    }

    /// Nodes 100, 200, 300 and 400 units away, and a quarter of a unit more, which is rounded up.
    #[test]
    fn the_bound_counts_cliff_and_beach_by_the_heights_of_the_nodes() {
        let beach_bend = 471;
        for (roughness, fine) in [(0, 1), (1 << 14, 2_807)] {
            // The highest and the lowest node at which a cell may reach 8 m above or below the sea.
            let edge = 8 * UNITS_PER_METRE + fine;
            for (low, high, expected) in [
                (edge + 1, 1 << 18, 400),
                (edge, 1 << 18, 300 + beach_bend),
                (-(1 << 14), -edge, 300 + beach_bend),
                (-(1 << 14), -edge - 1, 200),
            ] {
                for rounded_up in [0, 1] {
                    let scaled = |units: i32| 4 * units + rounded_up;
                    let apart = NodesApart {
                        above: scaled(100),
                        below: scaled(200),
                        above_with_cliff: scaled(300),
                        below_with_cliff: scaled(400),
                        low,
                        high,
                        roughness,
                    };
                    assert_eq!(bound(&apart, 2), expected + rounded_up + fine, "{apart:?}");
                }
            }
        }
    }

    #[test]
    fn the_worst_of_some_parts_is_the_largest_bound_and_needs_land() {
        let part = |bound: i32, has_land: bool| Worst { bound: Some(bound), has_land };
        let (low, high) = (part(3, false), part(7, true));
        for both in [low.and(high), high.and(low), high.and(high), Worst::default().and(high)] {
            assert_eq!((both, both.bound()), (high, 12), "5 units more for what is rounded");
        }
        assert_eq!(low.and(low).bound(), 0);
    }
}
