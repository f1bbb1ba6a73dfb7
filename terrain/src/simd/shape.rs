//! The heights of a strip from its base field and its fine octaves: the statements of
//! [`crate::land`] and [`crate::shape`] on vectors.

use super::curves::{clamp, smoothstep};
use super::field::Field;
use super::lanes::{Lanes, store_some};
use super::strip::{Columns, Sink};
use crate::constants::{BEACH_M, CLIFF_FOOT_M, CLIFF_M, FINE_BITS, UNIT_BITS};
use crate::grid::Grid;
use crate::land::SEA_FLOOR;
use crate::shape::{CUBIC_Q30, LINEAR_Q29, QUINTIC_Q30};

/// Shapes the vertices of one strip and writes them into the grid's heights.
pub(super) struct Shaper<'a> {
    field: Field<'a>,
    grid: &'a Grid,
    columns: Columns,
    out: *mut i32,
}

impl<'a> Shaper<'a> {
    /// `out` holds the heights of the whole grid.
    pub(super) fn new(field: Field<'a>, grid: &'a Grid, columns: Columns, out: &'a mut [i32]) -> Self {
        assert_eq!(out.len(), grid.vertex_count());
        Self { field, grid, columns, out: out.as_mut_ptr() }
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
        // SAFETY: the caller guarantees the CPU features.
        if unsafe { self.field.begin_row::<L>(row) } {
            return true;
        }
        let (to, count) = self.place(row, 0);
        // SAFETY: the strip's row lies in the grid.
        unsafe { core::slice::from_raw_parts_mut(to, count) }.fill(SEA_FLOOR);
        false
    }

    #[inline(always)]
    unsafe fn put(&mut self, row: usize, column: usize, fine: L) {
        // SAFETY: the caller guarantees the CPU features; `store_some` stays inside the row.
        unsafe {
            let node = self.field.at::<L>(column);
            let raw = node.height.add(fine.shl(9).mul_hi(node.roughness.shl(8)));
            let (to, count) = self.place(row, column);
            store_some(coast(raw, node.exposure), to, count);
        }
    }
}

/// [`crate::shape::coast`] of every lane.
#[inline(always)]
unsafe fn coast<L: Lanes>(raw: L, exposure: L) -> L {
    // SAFETY: the caller guarantees the CPU features.
    unsafe {
        let low = beach(raw);
        let difference = raw.add(cliff(raw)).sub(low);
        let fine = low.add(difference.shl(8).mul_hi(exposure.shl(9)));
        fine.add(L::splat(1 << (FINE_BITS - UNIT_BITS - 1))).sar(FINE_BITS - UNIT_BITS)
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

/// The cliff.
#[inline(always)]
unsafe fn cliff<L: Lanes>(fine: L) -> L {
    const WIDTH: i32 = BEACH_M << FINE_BITS;
    // SAFETY: the caller guarantees the CPU features.
    unsafe {
        let x = clamp(fine.add(L::splat(CLIFF_FOOT_M << FINE_BITS)), 0, WIDTH - 1);
        let share = smoothstep(x.shl(30 - FINE_BITS - BEACH_M.trailing_zeros()));
        share.mul_hi(L::splat(CLIFF_M << (FINE_BITS + 2)))
    }
}
