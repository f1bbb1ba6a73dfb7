//! Grass densities of a chunk, in whole rows that the compiler vectorises.

use crate::constants::{BLOCK_CELLS, GRASS_GRID, UNITS_PER_METRE, VERTEX_COUNT, VERTICES};

/// The densities of blocks whose side is `2^side_bits` metres ([`crate::GrassSeed::density_of`]).
#[inline(always)]
pub(super) fn densities(
    heights: &[i32; VERTEX_COUNT],
    side_bits: u32,
    density: &mut [u8; GRASS_GRID * GRASS_GRID],
) {
    let (vertices, _) = heights.as_chunks::<VERTICES>();
    let (shares, _) = density.as_chunks_mut::<GRASS_GRID>();
    for (shares, rows) in shares.iter_mut().zip(vertices.windows(BLOCK_CELLS + 1).step_by(BLOCK_CELLS)) {
        let (north, middle, south) = (&rows[0], &rows[BLOCK_CELLS / 2], &rows[BLOCK_CELLS]);
        let corners: [i32; GRASS_GRID + 1] = std::array::from_fn(|x| north[x * BLOCK_CELLS]);
        let beyond: [i32; GRASS_GRID] = std::array::from_fn(|x| south[x * BLOCK_CELLS]);
        let middles: [i32; GRASS_GRID] = std::array::from_fn(|x| middle[x * BLOCK_CELLS + BLOCK_CELLS / 2]);
        for (x, share) in shares.iter_mut().enumerate() {
            // Heights are below 2^24, so nothing wraps; overflow checks would prevent
            // vectorisation.
            let [east, south] =
                [corners[x + 1], beyond[x]].map(|end| end.wrapping_sub(corners[x]).wrapping_abs());
            let slope_q8 = east.max(south).wrapping_shr(side_bits);
            let above_beach = ramp(middles[x], 2 * UNITS_PER_METRE, 4 * UNITS_PER_METRE);
            let below_rock = 255 - ramp(middles[x], 420 * UNITS_PER_METRE, 620 * UNITS_PER_METRE);
            let gentle = 255 - ramp(slope_q8, 128, 256);
            *share = above_beach.min(below_rock.min(gentle)) as u8;
        }
    }
}

/// 0 at or below `low`, 255 at or above `high`, linear between. `high - low` is below 2^24, so that
/// 255 times it fits.
#[inline(always)]
fn ramp(value: i32, low: i32, high: i32) -> u32 {
    let above = value.max(low).min(high).wrapping_sub(low) as u32;
    above.wrapping_mul(255) / (high - low) as u32
}
