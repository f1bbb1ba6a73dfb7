//! The steepest triangle of a chunk, and its longest leg, on vectors.

use super::lanes::{Lanes, MOST_LANES};
use crate::constants::{CELLS, VERTEX_COUNT, VERTICES};

/// Largest sum of the squares of a triangle's two legs, units squared, of heights whose neighbours
/// in rows and columns lie within 2^15 of each other: so no sum leaves 31 bits.
///
/// # Safety
/// The CPU has the features of `L`.
#[inline(always)]
pub(super) unsafe fn steepest<L: Lanes>(heights: &[i32; VERTEX_COUNT], worst: &mut i32) {
    let mut lanes = [0; MOST_LANES];
    // SAFETY: the caller guarantees the CPU features; a row of cells reads 65 vertices of two rows.
    unsafe {
        let mut most = L::splat(0);
        for z in 0..CELLS {
            for x in (0..CELLS).step_by(L::COUNT) {
                let vertex = heights.as_ptr().add(z * VERTICES + x);
                let (h00, h10) = (L::load(vertex), L::load(vertex.add(1)));
                let (h01, h11) = (L::load(vertex.add(VERTICES)), L::load(vertex.add(VERTICES + 1)));
                let (north, east) = (h10.sub(h00), h11.sub(h10));
                let (south, west) = (h11.sub(h01), h01.sub(h00));
                let upper = north.mul(north).add(east.mul(east));
                let lower = south.mul(south).add(west.mul(west));
                most = most.max(upper.max(lower));
            }
        }
        most.store(lanes.as_mut_ptr());
    }
    *worst = lanes.into_iter().fold(0, Ord::max);
}

/// Largest difference of two neighbours in a row or a column, units, of heights below 2^24.
///
/// # Safety
/// The CPU has the features of `L`.
#[inline(always)]
pub(super) unsafe fn longest_leg<L: Lanes>(heights: &[i32; VERTEX_COUNT], longest: &mut i32) {
    let mut lanes = [0; MOST_LANES];
    // SAFETY: the caller guarantees the CPU features; a row of cells reads 65 vertices of two rows.
    unsafe {
        let mut most = L::splat(0);
        for z in 0..CELLS {
            for x in (0..CELLS).step_by(L::COUNT) {
                let vertex = heights.as_ptr().add(z * VERTICES + x);
                let (h00, h10) = (L::load(vertex), L::load(vertex.add(1)));
                let (h01, h11) = (L::load(vertex.add(VERTICES)), L::load(vertex.add(VERTICES + 1)));
                let rows = h10.sub(h00).abs().max(h11.sub(h01).abs());
                most = most.max(rows).max(h01.sub(h00).abs()).max(h11.sub(h10).abs());
            }
        }
        most.store(lanes.as_mut_ptr());
    }
    *longest = lanes.into_iter().fold(0, Ord::max);
}
