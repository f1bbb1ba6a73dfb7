//! The base field under one strip of a grid: nodes for the whole strip first, then row by row.
//!
//! Up to level 4 a vertex lies in a spline of 3 x 3 nodes, so nodes are evaluated once for a strip,
//! and the spline runs along z once per row and node column, then along x per vertex. Above, no two
//! vertices share a node, and each row of vertices is evaluated directly.

use super::base::{Nodes, nodes};
use super::lanes::{Lanes, MOST_LANES, store_some};
use super::strip::{Columns, WIDTH};
use crate::base::{Base, Node};
use crate::constants::ISLAND_CELL_BITS;
use crate::grid::Grid;
use crate::island::{Archipelago, Lobe, Lobes};
use crate::spline::{self, CELL_BITS};

/// Most node columns of a strip, with room for a whole window beyond the last.
const NODE_COLUMNS: usize = WIDTH + 2 + MOST_LANES;

/// The base field of a strip. Roughness and exposure are kept as pairs of 16 bits, roughness low.
pub(super) struct Field<'a> {
    base: &'a Base,
    archipelago: &'a Archipelago,
    grid: &'a Grid,
    columns: Columns,
    /// The nodes of a splined strip.
    nodes: Option<NodeGrid>,
    /// Of the row in work: per node column, or per vertex where nothing is splined.
    height: [i32; NODE_COLUMNS],
    shares: [i32; NODE_COLUMNS],
    /// Per vector: the node column before its first vertex.
    window: [u16; WIDTH],
    /// Per vertex: its node column from there on, and the factors of its fraction.
    picker: [i32; WIDTH],
    rise: [i32; WIDTH],
    bend: [i32; WIDTH],
    weights: [i32; WIDTH],
    weight_after: [i32; WIDTH],
    /// The lobes of each archipelago cell under the row in work, where nothing is splined.
    cells: Vec<((i32, i32), Lobes)>,
}

/// Nodes around the vertices of a strip, row by row.
struct NodeGrid {
    /// The cell of the first node.
    first: (i32, i32),
    /// Nodes along x, padded.
    stride: usize,
    height: Vec<i32>,
    shares: Vec<i32>,
    /// Rows that hold open sea only.
    sea: Vec<bool>,
}

/// The last cell whose node a spline reads at a coordinate: at the low border of a cell, the node
/// after it has no weight.
fn last_cell(coordinate: i32) -> i32 {
    let (cell, t) = spline::cell(coordinate);
    if t == 0 { cell } else { cell + 1 }
}

impl<'a> Field<'a> {
    /// # Safety
    /// The CPU has the features of `L`, here and below.
    #[inline(always)]
    pub(super) unsafe fn new<L: Lanes>(
        base: &'a Base,
        archipelago: &'a Archipelago,
        grid: &'a Grid,
        columns: Columns,
    ) -> Self {
        let mut field = Self {
            base,
            archipelago,
            grid,
            columns,
            nodes: None,
            height: [0; _],
            shares: [0; _],
            window: [0; _],
            picker: [0; _],
            rise: [0; _],
            bend: [0; _],
            weights: [0; _],
            weight_after: [0; _],
            cells: Vec::new(),
        };
        if grid.octaves.splined() && columns.count > 0 && grid.rows > 0 {
            // SAFETY: guaranteed by the caller.
            unsafe {
                field.lay_columns::<L>();
                field.evaluate::<L>();
            }
        }
        field
    }

    fn position(&self, column: usize, row: usize) -> (i32, i32) {
        self.grid.position(self.columns.first + column, row)
    }

    /// Fills the tables of the vertices.
    #[inline(always)]
    unsafe fn lay_columns<L: Lanes>(&mut self) {
        let (first_cell, _) = spline::cell(self.position(0, 0).0);
        for column in (0..self.columns.count).step_by(L::COUNT) {
            let x = self.position(column, 0).0;
            let window = spline::cell(x).0 - first_cell;
            self.window[column / L::COUNT] = window as u16;
            // SAFETY: guaranteed by the caller; tables hold WIDTH integers, a multiple of COUNT.
            unsafe {
                let x = L::splat(x).add(L::ramp().shl(self.grid.spacing_bits));
                let offset = x.sar(CELL_BITS).sub(L::splat(first_cell + window));
                L::picker(offset).store(self.picker.as_mut_ptr().add(column));
                let t = x.and(L::splat((1 << CELL_BITS) - 1));
                let rest = L::splat(1 << CELL_BITS).sub(t);
                let squared = t.mul(t);
                let before = rest.mul(rest).shr(2 * CELL_BITS - 14);
                let after = squared.shr(2 * CELL_BITS - 14);
                let middle = L::splat(1 << 15).sub(before).sub(after);
                t.shl(31 - CELL_BITS).store(self.rise.as_mut_ptr().add(column));
                squared.shl(31 - 2 * CELL_BITS).store(self.bend.as_mut_ptr().add(column));
                before.pack(middle).store(self.weights.as_mut_ptr().add(column));
                after.store(self.weight_after.as_mut_ptr().add(column));
            }
        }
    }

    /// Evaluates all nodes of the strip, whole vectors across rows.
    #[inline(always)]
    unsafe fn evaluate<L: Lanes>(&mut self) {
        let (x0, z0) = self.position(0, 0);
        let (x1, z1) = self.position(self.columns.count - 1, self.grid.rows - 1);
        let first = (spline::cell(x0).0 - 1, spline::cell(z0).0 - 1);
        let (columns, rows) =
            ((last_cell(x1) - first.0 + 1) as usize, (last_cell(z1) - first.1 + 1) as usize);
        let side = (x1.abs_diff(x0)).max(z1.abs_diff(z0)) + (4 << CELL_BITS);
        let lobes = self.archipelago.lobes_near(x0 - (2 << CELL_BITS), z0 - (2 << CELL_BITS), side);
        let count = columns * rows;
        let stored = count.next_multiple_of(L::COUNT) + NODE_COLUMNS;
        let (mut height, mut shares) = (vec![Node::SEA.height; stored], vec![0; stored]);
        let octaves = self.grid.octaves.base();
        // SAFETY: guaranteed by the caller.
        unsafe {
            evaluate_nodes::<L>(
                self.base,
                &lobes,
                octaves,
                first,
                columns,
                &mut height[..count],
                &mut shares,
            );
        };
        let sea = (0..rows)
            .map(|row| {
                let row = row * columns..(row + 1) * columns;
                height[row.clone()].iter().all(|height| *height == Node::SEA.height)
                    && shares[row].iter().all(|shares| *shares == 0)
            })
            .collect();
        self.nodes = Some(NodeGrid { first, stride: columns, height, shares, sea });
    }

    /// Prepares a row of vertices. Returns false if all of it is open sea.
    #[inline(always)]
    pub(super) unsafe fn begin_row<L: Lanes>(&mut self, row: usize) -> bool {
        // SAFETY: guaranteed by the caller.
        unsafe { if self.nodes.is_some() { self.spline_row::<L>(row) } else { self.evaluate_row::<L>(row) } }
    }

    /// Splines along z: one value per node column.
    #[inline(always)]
    unsafe fn spline_row<L: Lanes>(&mut self, row: usize) -> bool {
        let (_, z) = self.position(0, row);
        let Some(nodes) = &self.nodes else { return false };
        let (cell, t) = spline::cell(z);
        let above = (cell - 1 - nodes.first.1) as usize;
        if nodes.sea.iter().skip(above).take(3).all(|sea| *sea) {
            return false;
        }
        let weights = spline::weights(t);
        // SAFETY: guaranteed by the caller; the nodes are padded by a row and more.
        unsafe {
            let (rise, bend) = (L::splat(t << (31 - CELL_BITS)), L::splat((t * t) << (31 - 2 * CELL_BITS)));
            let pair = L::splat(weights[0] | weights[1] << 16);
            let after = L::splat(weights[2]);
            for column in (0..nodes.stride).step_by(L::COUNT) {
                let at = above * nodes.stride + column;
                let (a, b, c) = (at, at + nodes.stride, at + 2 * nodes.stride);
                let (height, shares) = (nodes.height.as_ptr(), nodes.shares.as_ptr());
                let value = height_spline(
                    L::load(height.add(a)),
                    L::load(height.add(b)),
                    L::load(height.add(c)),
                    rise,
                    bend,
                );
                value.store(self.height.as_mut_ptr().add(column));
                let (a, b, c) = (L::load(shares.add(a)), L::load(shares.add(b)), L::load(shares.add(c)));
                let (roughness, exposure) = share_splines(a, b, c, pair, after);
                roughness.pack(exposure).store(self.shares.as_mut_ptr().add(column));
            }
        }
        true
    }

    /// Evaluates every vertex of a row, in runs that lie in one cell of the archipelago.
    #[inline(always)]
    unsafe fn evaluate_row<L: Lanes>(&mut self, row: usize) -> bool {
        let (x0, z) = self.position(0, row);
        let cell_z = Archipelago::cell(z);
        self.cells.retain(|((_, kept), _)| *kept == cell_z);
        let mut first = 0;
        let mut land = false;
        while first < self.columns.count {
            let (x, _) = self.position(first, row);
            let cell_x = Archipelago::cell(x);
            let border = ((i64::from(cell_x) + 1) << ISLAND_CELL_BITS) - (1 << (ISLAND_CELL_BITS - 1));
            let inside =
                (border - i64::from(x) + (1 << self.grid.spacing_bits) - 1) >> self.grid.spacing_bits;
            let end = self.columns.count.min(first + inside.max(1) as usize);
            let lobes = self.lobes_of((cell_x, cell_z));
            land |= !self.cells[lobes].1.is_empty();
            for column in (first..end).step_by(L::COUNT) {
                // SAFETY: guaranteed by the caller; the row's arrays are padded by a vector.
                unsafe {
                    let x = L::splat(x0.wrapping_add((column as i32) << self.grid.spacing_bits));
                    let x = x.add(L::ramp().shl(self.grid.spacing_bits));
                    let lobes = &self.cells[lobes].1;
                    let node = if lobes.is_empty() {
                        let (height, zero) = (L::splat(Node::SEA.height), L::splat(0));
                        Nodes { height, roughness: zero, exposure: zero }
                    } else {
                        nodes(self.base, lobes, x, L::splat(z), self.grid.octaves.base())
                    };
                    node.height.store(self.height.as_mut_ptr().add(column));
                    node.roughness.pack(node.exposure).store(self.shares.as_mut_ptr().add(column));
                }
            }
            first = end;
        }
        land
    }

    /// Index of the lobes of a cell, kept for the rows that cross it.
    fn lobes_of(&mut self, cell: (i32, i32)) -> usize {
        if let Some(index) = self.cells.iter().position(|(kept, _)| *kept == cell) {
            return index;
        }
        let low = |cell: i32| {
            let low = (i64::from(cell) << ISLAND_CELL_BITS) - (1 << (ISLAND_CELL_BITS - 1));
            low.clamp(i64::from(i32::MIN), i64::from(i32::MAX)) as i32
        };
        let lobes = self.archipelago.lobes_near(low(cell.0), low(cell.1), (1 << ISLAND_CELL_BITS) - 1);
        self.cells.push((cell, lobes));
        self.cells.len() - 1
    }

    /// The field under `COUNT` vertices of the row in work.
    #[inline(always)]
    pub(super) unsafe fn at<L: Lanes>(&self, column: usize) -> Nodes<L> {
        // SAFETY: guaranteed by the caller; a window and the two after it end inside the row.
        unsafe {
            if self.nodes.is_none() {
                let shares = L::load(self.shares.as_ptr().add(column));
                return Nodes {
                    height: L::load(self.height.as_ptr().add(column)),
                    roughness: shares.and(L::splat(0xffff)),
                    exposure: shares.shr(16),
                };
            }
            let first = usize::from(self.window[column / L::COUNT]);
            let picker = L::load(self.picker.as_ptr().add(column));
            let (height, shares) = (self.height.as_ptr().add(first), self.shares.as_ptr().add(first));
            let height = height_spline(
                L::window(height, picker),
                L::window(height.add(1), picker),
                L::window(height.add(2), picker),
                L::load(self.rise.as_ptr().add(column)),
                L::load(self.bend.as_ptr().add(column)),
            );
            let (roughness, exposure) = share_splines(
                L::window(shares, picker),
                L::window(shares.add(1), picker),
                L::window(shares.add(2), picker),
                L::load(self.weights.as_ptr().add(column)),
                L::load(self.weight_after.as_ptr().add(column)),
            );
            Nodes { height, roughness, exposure }
        }
    }
}

/// Evaluates a rectangle of nodes, row by row, from a first cell on; `height` holds exactly its
/// nodes, and `shares` at least as many. Whole vectors go across rows.
#[inline(always)]
pub(super) unsafe fn evaluate_nodes<L: Lanes>(
    base: &Base,
    lobes: &[Lobe],
    octaves: usize,
    first: (i32, i32),
    columns: usize,
    height: &mut [i32],
    shares: &mut [i32],
) {
    let (mut column, mut row) = (0, 0);
    let places = std::iter::from_fn(|| {
        let place = (spline::node(first.0 + column), spline::node(first.1 + row));
        column += 1;
        if column == columns as i32 {
            (column, row) = (0, row + 1);
        }
        Some(place)
    });
    // SAFETY: guaranteed by the caller.
    unsafe { evaluate_places::<L>(base, lobes, octaves, places, height, shares) };
}

/// Evaluates the field at places; `height` holds exactly as many, and `shares` at least as many.
#[inline(always)]
pub(super) unsafe fn evaluate_places<L: Lanes>(
    base: &Base,
    lobes: &[Lobe],
    octaves: usize,
    mut places: impl Iterator<Item = (i32, i32)>,
    height: &mut [i32],
    shares: &mut [i32],
) {
    let count = height.len();
    assert!(shares.len() >= count);
    height.fill(Node::SEA.height);
    shares.fill(0);
    if lobes.is_empty() {
        return;
    }
    let (mut x, mut z) = ([0; MOST_LANES], [0; MOST_LANES]);
    for at in (0..count).step_by(L::COUNT) {
        for (lane, place) in (0..L::COUNT).zip(&mut places) {
            (x[lane], z[lane]) = place;
        }
        // SAFETY: guaranteed by the caller; stores end at the last place.
        unsafe {
            let node = nodes(base, lobes, L::load(x.as_ptr()), L::load(z.as_ptr()), octaves);
            let left = count - at;
            store_some(node.height, height.as_mut_ptr().add(at), left);
            store_some(node.roughness.pack(node.exposure), shares.as_mut_ptr().add(at), left);
        }
    }
}

/// [`spline::height`] of every lane.
#[inline(always)]
unsafe fn height_spline<L: Lanes>(a: L, b: L, c: L, rise: L, bend: L) -> L {
    // SAFETY: guaranteed by the caller.
    unsafe {
        let step = b.sub(a);
        let change = c.sub(b).sub(step);
        a.add(b).sar(1).add(step.shl(1).mul_hi(rise)).add(change.mul_hi(bend))
    }
}

/// [`spline::share`] of pairs of shares: roughness and exposure.
#[inline(always)]
unsafe fn share_splines<L: Lanes>(a: L, b: L, c: L, pair: L, after: L) -> (L, L) {
    // SAFETY: guaranteed by the caller.
    unsafe {
        let half = L::splat(1 << 14);
        let low = a.pack(b).dot(pair).add(c.dot(after)).add(half).sar(15);
        let high = a.shr(16).pack(b.shr(16)).dot(pair).add(c.shr(16).dot(after)).add(half).sar(15);
        (low, high)
    }
}
