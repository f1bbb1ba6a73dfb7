//! The distance between a chunk's triangles and finer vertices, in whole cells that the compiler
//! vectorises.

use crate::constants::CELLS;

/// The vertices of level 0 under a chunk of level 1, row by row.
pub struct Window(Vec<i32>);

impl Window {
    /// Vertices along a side.
    pub const SIDE: usize = 2 * CELLS + 1;

    /// All heights 0.
    pub fn new() -> Self {
        Self(vec![0; Self::SIDE * Self::SIDE])
    }

    /// Heights, units.
    pub fn heights_mut(&mut self) -> &mut [i32] {
        &mut self.0
    }

    /// Every `2^level`-th vertex along both axes, row by row.
    pub fn thinned(&self, level: u8) -> Vec<i32> {
        let step = 1 << level;
        let rows = self.0.chunks_exact(Self::SIDE).step_by(step);
        rows.flat_map(|row| row.iter().step_by(step).copied()).collect()
    }
}

/// Largest distance between the drawn surface of `SIDE` x `SIDE` cells and the window, which is
/// `2^DEPTH` times finer, in units times `2^DEPTH`. The rows of heights have `SIDE + 1` vertices.
///
/// The same surface as [`crate::chunk::drawn_height_scaled`]; borders of cells are compared from
/// both sides.
#[inline(always)]
pub(super) fn farthest<const DEPTH: usize, const SIDE: usize>(heights: &[i32], fine: &Window) -> i32 {
    const { assert!(SIDE << DEPTH == Window::SIDE - 1) };
    let step = 1 << DEPTH;
    let row_of = |z: usize| &heights[z * (SIDE + 1)..][..=SIDE];
    let mut worst = 0;
    for z in 0..SIDE {
        let (near, far) = (row_of(z), row_of(z + 1));
        for fz in 0..=step {
            let row = &fine.0[(z * step + fz) * Window::SIDE..][..Window::SIDE];
            for fx in 0..=step {
                // Heights stay below 2^24, times 2^3 well inside 32 bits; overflow checks would
                // prevent vectorisation.
                let (a, b) = (fx as i32, fz as i32);
                let mut farthest = 0;
                for x in 0..SIDE {
                    let (low, high) = (near[x], far[x + 1]);
                    let side = if fx >= fz { near[x + 1] } else { far[x] };
                    let (first, then) = if fx >= fz { (a, b) } else { (b, a) };
                    let drawn = low
                        .wrapping_mul(step as i32)
                        .wrapping_add(side.wrapping_sub(low).wrapping_mul(first))
                        .wrapping_add(high.wrapping_sub(side).wrapping_mul(then));
                    let exact = row[x * step + fx].wrapping_mul(step as i32);
                    farthest = farthest.max(exact.wrapping_sub(drawn).wrapping_abs());
                }
                worst = worst.max(farthest);
            }
        }
    }
    worst
}
