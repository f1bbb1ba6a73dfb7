//! The distance between a chunk's triangles and finer vertices, in whole cells that the compiler
//! vectorises.

use crate::constants::VERTICES;

/// Largest distance between the drawn surface of `SIDE` x `SIDE` cells of a chunk and the grid that is
/// `2^DEPTH` times finer, in units times `2^DEPTH`. `heights` and `fine` begin at the low corner; the
/// rows of heights are a chunk's, those of `fine` are `stride` long.
///
/// The same surface as [`crate::chunk::drawn_height_scaled`]; borders of cells are compared from both
/// sides.
#[inline(always)]
pub(super) fn farthest<const DEPTH: usize, const SIDE: usize>(
    heights: &[i32],
    fine: &[i32],
    stride: usize,
) -> i32 {
    let step = 1 << DEPTH;
    let mut worst = 0;
    for z in 0..SIDE {
        let (near, far) = (&heights[z * VERTICES..][..=SIDE], &heights[(z + 1) * VERTICES..][..=SIDE]);
        for fz in 0..=step {
            let row = &fine[(z * step + fz) * stride..][..SIDE * step + 1];
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
