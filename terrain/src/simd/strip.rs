//! The fractal sum over a strip of a grid, row by row.
//!
//! Every vertex of a grid shares its lattice columns with its neighbours. So a gradient is hashed
//! once per lattice point, the step along z ([`Strip::raise_row`]) is done once per lattice column
//! and row, and a vertex costs two table look-ups, two paired products and two additions per
//! octave. Strips are 64 vertices wide, so that everything they read again and again stays in the
//! first cache level.
//!
//! The statements are those of [`crate::noise`] and [`crate::weights`], on vectors; tests compare
//! every bit.

use super::curves::{PACKED_GRADIENTS, fade, mix};
use super::lanes::{Lanes, MOST_LANES};
use crate::constants::{FINE_OCTAVES, FIRST_CELL_BITS, FRACTION_BITS};
use crate::grid::Grid;
use crate::noise::{Fbm, fine_shift};
use crate::weights::DROPPED_BITS;

/// Vertices of a strip; the last strip may have one more, so that a chunk is one strip.
const STRIP: usize = 64;
/// Vertices of the widest strip, padded to whole vectors of every kernel.
pub(super) const WIDTH: usize = (STRIP + 1).next_multiple_of(MOST_LANES);
/// Lattice columns of all octaves together. An octave has at most one per vertex and two, padded,
/// and a window may be read from its last one; the coarsest that a level carries needs that, every
/// further one half as many.
const LATTICE: usize = {
    let mut sum = 0;
    let mut octave = 0;
    while octave < FINE_OCTAVES {
        sum += ((WIDTH >> octave) + 2).next_multiple_of(MOST_LANES) + MOST_LANES;
        octave += 1;
    }
    sum
};

/// Receiver of the vertices of a strip.
pub(super) trait Sink<L: Lanes> {
    /// Called for each row before its vertices; returns false if the row needs no noise.
    unsafe fn begin_row(&mut self, row: usize) -> bool;
    /// `COUNT` vertices from `column` of the strip on, in 2^-16 m. Vertices beyond the strip's
    /// width are padding.
    unsafe fn put(&mut self, row: usize, column: usize, fine: L);
}

/// The columns of a grid that are evaluated together.
#[derive(Clone, Copy)]
pub(super) struct Columns {
    /// First column of the grid.
    pub(super) first: usize,
    /// How many: at most 65.
    pub(super) count: usize,
}

/// Cuts a grid into strips.
pub(super) fn strips(columns: usize) -> impl Iterator<Item = Columns> {
    let last = columns.saturating_sub(1) / STRIP;
    // A single column left over joins the strip before it.
    let strips = if columns % STRIP == 1 && last > 0 { last } else { last + 1 };
    (0..strips).map(move |index| {
        let first = index * STRIP;
        let count = if index + 1 == strips { columns - first } else { STRIP };
        Columns { first, count }
    })
}

/// Tables of one strip. Per octave `o`, vertex tables start at `o * WIDTH`, lattice tables at
/// `base[o]`.
// Aligned to cache lines, so that no vector of a table lies across two.
#[repr(align(64))]
pub(super) struct Strip {
    /// Per row of the band: steps and lines towards the lattice rows above and below.
    row_step: [i32; FINE_OCTAVES * WIDTH],
    row_line: [i32; FINE_OCTAVES * WIDTH],

    /// Per vertex: which lattice column of its vector's window lies at or below it.
    picker: [i32; FINE_OCTAVES * WIDTH],
    /// Per vertex: line and step towards the low and towards the high lattice column.
    low: [i32; FINE_OCTAVES * WIDTH],
    high: [i32; FINE_OCTAVES * WIDTH],
    /// Per vector: the lattice index of its window.
    window: [[u16; WIDTH]; FINE_OCTAVES],

    base: [usize; FINE_OCTAVES],
    cells: [usize; FINE_OCTAVES],
    /// The lattice row above the current row of vertices.
    cell_z: [Option<i32>; FINE_OCTAVES],
    /// Per lattice column: hash of its x.
    column_hash: [i32; LATTICE],
    /// Per lattice column: the gradient below the row, and both gradients' components in pairs.
    below: [i32; LATTICE],
    pair_x: [i32; LATTICE],
    pair_z: [i32; LATTICE],
    /// Per lattice column: slope and value on a row, for the row in work and the one after it.
    /// Written one row ahead, because a window that is read across two fresh stores would wait for
    /// them.
    edge: [[i32; LATTICE]; 2],
}

impl Strip {
    pub(super) fn new() -> Self {
        Self {
            row_step: [0; _],
            row_line: [0; _],
            picker: [0; _],
            low: [0; _],
            high: [0; _],
            window: [[0; _]; _],
            base: [0; _],
            cells: [0; _],
            cell_z: [None; _],
            column_hash: [0; _],
            below: [0; _],
            pair_x: [0; _],
            pair_z: [0; _],
            edge: [[0; _]; _],
        }
    }

    /// Evaluates the strip.
    ///
    /// # Safety
    /// The CPU has the features of `L`, and `columns.count` is at most 65.
    #[inline(always)]
    pub(super) unsafe fn run<L: Lanes>(
        &mut self,
        fbm: &Fbm,
        grid: &Grid,
        columns: Columns,
        sink: &mut impl Sink<L>,
    ) {
        debug_assert!(columns.count <= STRIP + 1);
        // SAFETY: guaranteed by the caller, here and in the calls below.
        unsafe { self.lay_columns::<L>(fbm, grid, columns) };
        for band in (0..grid.rows).step_by(STRIP) {
            // One row more than the strip is high, because rows are raised one ahead.
            let rows = (grid.rows - band).min(STRIP + 1);
            let last = rows == grid.rows - band;
            // SAFETY: see above.
            unsafe { self.lay_rows::<L>(grid, band, rows) };
            let mut raised = None;
            for row in 0..if last { rows } else { STRIP } {
                // SAFETY: see above.
                unsafe {
                    if !sink.begin_row(band + row) {
                        continue;
                    }
                    if raised != Some(row) {
                        self.raise_row::<L>(grid, band, row);
                    }
                    if row + 1 < rows {
                        self.raise_row::<L>(grid, band, row + 1);
                        raised = Some(row + 1);
                    }
                    if grid.octaves.fine() == FINE_OCTAVES {
                        self.sum_row::<L, true>(FINE_OCTAVES, band + row, row % 2, columns.count, sink);
                    } else {
                        self.sum_row::<L, false>(
                            grid.octaves.fine(),
                            band + row,
                            row % 2,
                            columns.count,
                            sink,
                        );
                    }
                }
            }
            if last {
                break;
            }
        }
    }

    /// Fills the row tables of a band.
    #[inline(always)]
    unsafe fn lay_rows<L: Lanes>(&mut self, grid: &Grid, band: usize, rows: usize) {
        for (octave, shift) in grid.octaves.shifts() {
            let cell_bits = FIRST_CELL_BITS - octave as u32;
            let first_z = grid.position(0, band).1.wrapping_add(shift.1);
            // SAFETY: the caller guarantees the CPU features; tables hold WIDTH integers per
            // octave, a multiple of COUNT.
            unsafe {
                for row in (0..rows).step_by(L::COUNT) {
                    let z = first_z.wrapping_add((row as i32) << grid.spacing_bits);
                    let z = L::splat(z).add(L::ramp().shl(grid.spacing_bits));
                    let inside = z.and(L::splat((1 << cell_bits) - 1));
                    let (line, step) = weights_of(inside.shl(FRACTION_BITS - cell_bits));
                    let at = octave * WIDTH + row;
                    step[0].pack(step[1]).store(self.row_step.as_mut_ptr().add(at));
                    line[0].pack(line[1]).store(self.row_line.as_mut_ptr().add(at));
                }
            }
        }
    }

    /// Fills the vertex tables and hashes the lattice columns.
    #[inline(always)]
    unsafe fn lay_columns<L: Lanes>(&mut self, fbm: &Fbm, grid: &Grid, columns: Columns) {
        let mut base = 0;
        for (octave, shift) in grid.octaves.shifts() {
            let cell_bits = FIRST_CELL_BITS - octave as u32;
            // Every window relies on this; `Octaves::at_level` ensures it.
            assert!(grid.spacing_bits <= cell_bits, "a vector's vertices share a window");
            let first_x = grid.position(columns.first, 0).0.wrapping_add(shift.0);
            let first_cell = first_x >> cell_bits;
            self.base[octave] = base;
            self.cell_z[octave] = None;
            // SAFETY: the caller guarantees the CPU features; tables hold WIDTH integers per
            // octave, a multiple of COUNT.
            unsafe {
                let mut last_cell = 0;
                for column in (0..columns.count).step_by(L::COUNT) {
                    let x = first_x.wrapping_add((column as i32) << grid.spacing_bits);
                    let window = (x >> cell_bits) - first_cell;
                    self.window[octave][column / L::COUNT] = window as u16;
                    let x = L::splat(x).add(L::ramp().shl(grid.spacing_bits));
                    let offset = x.sar(cell_bits).sub(L::splat(first_cell + window));
                    let inside = x.and(L::splat((1 << cell_bits) - 1));
                    let at = octave * WIDTH + column;
                    L::picker(offset).store(self.picker.as_mut_ptr().add(at));
                    self.weigh::<L>(at, inside.shl(FRACTION_BITS - cell_bits));
                    last_cell = window as usize + (((L::COUNT - 1) << grid.spacing_bits) >> cell_bits) + 1;
                }
                // Cells 0 to `last_cell`, and the far side of the last.
                let cells = (last_cell + 2).next_multiple_of(L::COUNT);
                self.cells[octave] = cells;
                for cell in (0..cells).step_by(L::COUNT) {
                    let x = L::splat(first_cell + cell as i32).add(L::ramp());
                    let x = x.mul(L::splat(0x9e37_79b9_u32 as i32));
                    mix(L::splat(fbm.seeds[octave] as i32).xor(x))
                        .store(self.column_hash.as_mut_ptr().add(base + cell));
                }
                base += cells + MOST_LANES;
            }
        }
        assert!(base <= LATTICE, "the tables hold every lattice column");
    }

    /// Stores the weights of `COUNT` vertices from their fractions.
    #[inline(always)]
    unsafe fn weigh<L: Lanes>(&mut self, at: usize, fraction: L) {
        // SAFETY: see `lay_columns`.
        unsafe {
            let (line, step) = weights_of(fraction);
            line[0].pack(step[0]).store(self.low.as_mut_ptr().add(at));
            line[1].pack(step[1]).store(self.high.as_mut_ptr().add(at));
        }
    }

    /// Joins the gradients above and below a row into the edges of all its lattice columns.
    #[inline(always)]
    unsafe fn raise_row<L: Lanes>(&mut self, grid: &Grid, band: usize, row: usize) {
        let parity = row % 2;
        for (octave, shift) in grid.octaves.shifts() {
            let cell_bits = FIRST_CELL_BITS - octave as u32;
            let z = grid.position(0, band + row).1.wrapping_add(shift.1);
            let table = octave * WIDTH + row;
            // SAFETY: the caller guarantees the CPU features; `cells` columns from `base` on lie in
            // the lattice tables.
            unsafe {
                self.enter_lattice_row::<L>(octave, z >> cell_bits);
                let base = self.base[octave];
                let (step, line) = (L::splat(self.row_step[table]), L::splat(self.row_line[table]));
                let half = L::splat(1 << 14);
                for at in (base..base + self.cells[octave]).step_by(L::COUNT) {
                    let slope = L::load(self.pair_x.as_ptr().add(at)).dot(step).add(half).sar(15);
                    let value = L::load(self.pair_z.as_ptr().add(at)).dot(line).add(half).sar(15);
                    slope.pack(value).store(self.edge[parity].as_mut_ptr().add(at));
                }
            }
        }
    }

    /// Makes `cell_z` the lattice row above the row in work. Rows come in order, so the one below
    /// is often the next above.
    #[inline(always)]
    unsafe fn enter_lattice_row<L: Lanes>(&mut self, octave: usize, cell_z: i32) {
        if self.cell_z[octave] == Some(cell_z) {
            return;
        }
        let follows = self.cell_z[octave].is_some_and(|above| above + 1 == cell_z);
        self.cell_z[octave] = Some(cell_z);
        let base = self.base[octave];
        for at in (base..base + self.cells[octave]).step_by(L::COUNT) {
            // SAFETY: see `raise_row`.
            unsafe {
                let hash = L::load(self.column_hash.as_ptr().add(at));
                let above =
                    if follows { L::load(self.below.as_ptr().add(at)) } else { gradients(hash, cell_z) };
                let below = gradients(hash, cell_z + 1);
                below.store(self.below.as_mut_ptr().add(at));
                above.pack(below).store(self.pair_x.as_mut_ptr().add(at));
                above.sar(16).pack(below.sar(16)).store(self.pair_z.as_mut_ptr().add(at));
            }
        }
    }

    /// Sums the octaves of one row.
    #[inline(always)]
    unsafe fn sum_row<L: Lanes, const ALL: bool>(
        &self,
        octaves: usize,
        row: usize,
        parity: usize,
        count: usize,
        sink: &mut impl Sink<L>,
    ) {
        for column in (0..count).step_by(L::COUNT) {
            // SAFETY: the caller guarantees the CPU features; `column` is below WIDTH.
            unsafe {
                let mut fine = L::splat(0);
                // Spelled out: a shift by a constant is cheaper than one by a variable, and a loop
                // would not unroll.
                macro_rules! octave {
                    ($octave:literal) => {
                        if ALL || $octave < octaves {
                            fine = fine.add(self.octave_at::<L, $octave>(parity, column));
                        }
                    };
                }
                octave!(0);
                octave!(1);
                octave!(2);
                octave!(3);
                octave!(4);
                sink.put(row, column, fine);
            }
        }
    }

    /// One octave of `COUNT` vertices, 2^-16 m.
    #[inline(always)]
    unsafe fn octave_at<L: Lanes, const OCTAVE: usize>(&self, parity: usize, column: usize) -> L {
        let at = OCTAVE * WIDTH + column;
        let cell = self.base[OCTAVE] + usize::from(self.window[OCTAVE][column / L::COUNT]);
        debug_assert!(cell + 1 + L::COUNT <= LATTICE);
        // SAFETY: the caller guarantees the CPU features; a window and the one beside it end inside
        // the lattice tables.
        unsafe {
            let picker = L::load(self.picker.as_ptr().add(at));
            let (low, high) = (L::load(self.low.as_ptr().add(at)), L::load(self.high.as_ptr().add(at)));
            let edge = self.edge[parity].as_ptr().add(cell);
            let (edge_low, edge_high) = (L::window(edge, picker), L::window(edge.add(1), picker));
            edge_low.dot(low).add(edge_high.dot(high)).sar(fine_shift(OCTAVE))
        }
    }
}

// Functions, not closures: only these can be made to inherit the caller's instruction set.

/// [`crate::weights::weights`] of every lane: lines and steps, low side first.
#[inline(always)]
unsafe fn weights_of<L: Lanes>(fraction: L) -> ([L; 2], [L; 2]) {
    // SAFETY: the caller guarantees the CPU features.
    unsafe {
        let high = fade(fraction.shl(31 - FRACTION_BITS));
        let low = L::splat(i32::MIN).sub(high);
        let zero = L::splat(0);
        let from_low = fraction.shl(32 - FRACTION_BITS);
        let from_high = zero.sub(from_low);
        let line = [from_low.mul_hi_u(low).shr(7), zero.sub(from_high.mul_hi_u(high).shr(7))];
        let step = [high.sar(8).sub(L::splat(1 << 23)), zero.sub(high.sar(8))];
        ([narrow(line[0]), narrow(line[1])], [narrow(step[0]), narrow(step[1])])
    }
}

/// A weight of 16 bits, rounded to nearest.
#[inline(always)]
unsafe fn narrow<L: Lanes>(wide: L) -> L {
    // SAFETY: the caller guarantees the CPU features.
    unsafe { wide.add(L::splat(1 << (DROPPED_BITS - 1))).sar(DROPPED_BITS) }
}

/// The gradients of the lattice points on row `cell_z` of columns with these hashes.
#[inline(always)]
unsafe fn gradients<L: Lanes>(column_hash: L, cell_z: i32) -> L {
    let z = (cell_z as u32).wrapping_mul(0x85eb_ca6b) as i32;
    // SAFETY: the caller guarantees the CPU features, and an index of 5 bits is below 32.
    unsafe { L::lookup(&PACKED_GRADIENTS, mix(column_hash.add(L::splat(z))).shr(27)) }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn strips_cover_every_column_once_and_a_chunk_is_one_strip() {
        for columns in 1..400 {
            let mut next = 0;
            for strip in strips(columns) {
                assert_eq!(strip.first, next);
                assert!((1..=STRIP + 1).contains(&strip.count));
                next += strip.count;
            }
            assert_eq!(next, columns);
        }
        assert_eq!(strips(65).count(), 1);
        assert_eq!(strips(0).map(|strip| strip.count).sum::<usize>(), 0);
    }
}
