//! The height of a row of vertices from its noise: the statements of [`crate::land`] on vectors.

use super::lanes::Lanes;
use super::strip::{Columns, Sink, WIDTH};
use crate::constants::{BEACH_M, FINE_BITS, ISLAND_CELL_BITS, RIDGE_M, SEA_FLOOR_M, UNIT_BITS};
use crate::grid::Grid;
use crate::island::{Archipelago, Island};
use crate::land::{CREST_SHIFT, CUBIC_Q30, LINEAR_Q29, QUINTIC_Q30, SEA_FLOOR};

/// Shapes the vertices of one strip and writes them into the grid's heights.
pub(super) struct Shaper<'a> {
    archipelago: &'a Archipelago,
    grid: &'a Grid,
    columns: Columns,
    out: *mut i32,
    /// The row of archipelago cells in work, and the island of the strip there.
    cell_z: Option<i32>,
    island: Option<Island>,
    /// Per vertex: the share of x in the squared distance from the island's centre, Q24 of its
    /// radius.
    distance_x: [i32; WIDTH],
    /// The least of them.
    least_distance_x: i32,
    /// What the current row leaves of the square of the radius, Q24: the falloff ends where
    /// `distance_x` exceeds it.
    rest_z: i32,
}

impl<'a> Shaper<'a> {
    /// `out` holds the heights of the whole grid; the columns lie in one archipelago cell, borders
    /// included.
    pub(super) fn new(
        archipelago: &'a Archipelago,
        grid: &'a Grid,
        columns: Columns,
        out: &'a mut [i32],
    ) -> Self {
        assert_eq!(out.len(), grid.vertex_count());
        let out = out.as_mut_ptr();
        Self {
            archipelago,
            grid,
            columns,
            out,
            cell_z: None,
            island: None,
            distance_x: [0; _],
            least_distance_x: 0,
            rest_z: 0,
        }
    }

    /// Cuts columns at the borders of archipelago cells. A border is under no island, so it may end
    /// a part.
    pub(super) fn parts(grid: &Grid, columns: Columns) -> impl Iterator<Item = Columns> {
        let end = columns.first + columns.count;
        let mut first = columns.first;
        std::iter::from_fn(move || {
            let (x, _) = grid.position(first, 0);
            let border = (Archipelago::cell(x) << ISLAND_CELL_BITS) + (1 << (ISLAND_CELL_BITS - 1));
            let inside = ((border - x) >> grid.spacing_bits) as usize + 1;
            let part = Columns { first, count: inside.min(end - first) };
            first += part.count;
            (part.count > 0).then_some(part)
        })
    }

    fn enter_cell(&mut self, cell_z: i32) {
        self.cell_z = Some(cell_z);
        let x_of = |column: usize| self.grid.position(self.columns.first + column, 0).0;
        self.island = self.archipelago.island(Archipelago::cell(x_of(0)), cell_z);
        let Some(island) = self.island else { return };
        let distances = &mut self.distance_x[..self.columns.count];
        for (column, distance) in distances.iter_mut().enumerate() {
            *distance = island.distance(x_of(column), island.centre.0);
        }
        self.least_distance_x = distances.iter().copied().min().unwrap_or(i32::MAX);
    }

    /// Pointer to a vertex of the grid and the number of vertices of the strip from there on.
    fn place(&self, row: usize, column: usize) -> (*mut i32, usize) {
        let index = row * self.grid.columns + self.columns.first + column;
        (self.out.wrapping_add(index), self.columns.count - column)
    }
}

impl<L: Lanes> Sink<L> for Shaper<'_> {
    #[inline(always)]
    unsafe fn begin_row(&mut self, row: usize) -> bool {
        let (_, z) = self.grid.position(0, row);
        let cell_z = Archipelago::cell(z);
        if self.cell_z != Some(cell_z) {
            self.enter_cell(cell_z);
        }
        self.rest_z = match self.island {
            Some(island) => (1 << 24) - 1 - island.distance(z, island.centre.1),
            None => 0,
        };
        if self.rest_z > self.least_distance_x {
            return true;
        }
        let (to, count) = self.place(row, 0);
        // SAFETY: the strip's row lies in the grid.
        unsafe { core::slice::from_raw_parts_mut(to, count) }.fill(SEA_FLOOR);
        false
    }

    #[inline(always)]
    unsafe fn put(&mut self, row: usize, column: usize, hills: L, folds: L) {
        let dome_m = self.island.map_or(0, |island| island.dome_m);
        // SAFETY: the caller guarantees the CPU features; tables hold WIDTH integers; `store_some`
        // stays inside the row.
        unsafe {
            let rest = L::splat(self.rest_z).sub(L::load(self.distance_x.as_ptr().add(column)));
            let inside = rest.max(L::splat(0)).shl(8);
            let weight = inside.mul_hi_u(inside).shr(1);
            let squared = weight.mul_hi(weight);
            let crest = L::splat(RIDGE_M << FINE_BITS).sub(folds.abs()).max(L::splat(0)).shl(CREST_SHIFT);
            let ridge = crest.mul_hi(crest).sar(CREST_SHIFT - 2);
            let rise = weight.mul_hi(L::splat(dome_m << FINE_BITS).add(hills.shl(1)).shl(1));
            let bend = squared.mul_hi(ridge.sub(hills).shl(2));
            let fine = rise.add(bend).sub(L::splat(SEA_FLOOR_M << FINE_BITS));
            // Where the falloff is zero this rounds to the sea floor, as it must: nothing is
            // selected.
            let fine = beach(fine);
            let height = fine.add(L::splat(1 << (FINE_BITS - UNIT_BITS - 1))).sar(FINE_BITS - UNIT_BITS);
            let (to, count) = self.place(row, column);
            store_some(height, to, count);
        }
    }
}

/// The beach; vectors without land near sea level skip it.
#[inline(always)]
unsafe fn beach<L: Lanes>(fine: L) -> L {
    const EDGE: i32 = BEACH_M << FINE_BITS;
    // SAFETY: the caller guarantees the CPU features.
    unsafe {
        let near = fine.abs().select_below(L::splat(EDGE), L::splat(-1), L::splat(0));
        if !near.any() {
            return fine;
        }
        let r = fine.shl(31 - FINE_BITS - BEACH_M.trailing_zeros());
        let r2 = r.mul_hi(r).shl(1);
        let r4 = r2.mul_hi(r2).shl(1);
        let slope =
            L::splat(LINEAR_Q29).add(r2.mul_hi(L::splat(CUBIC_Q30))).sub(r4.mul_hi(L::splat(QUINTIC_Q30)));
        let flat = fine.shl(3).mul_hi(slope);
        near.select_below(L::splat(0), flat, fine)
    }
}

/// Stores the first `count` lanes, or all of them.
#[inline(always)]
pub(super) unsafe fn store_some<L: Lanes>(lanes: L, to: *mut i32, count: usize) {
    // SAFETY: the caller guarantees `count` integers at `to` and the CPU features.
    unsafe {
        if count >= L::COUNT {
            lanes.store(to);
        } else {
            let mut all = [0; super::lanes::MOST_LANES];
            lanes.store(all.as_mut_ptr());
            for (index, value) in all.iter().enumerate().take(count) {
                *to.add(index) = *value;
            }
        }
    }
}
