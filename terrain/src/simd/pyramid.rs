//! Height pyramids on vectors: the statements of [`crate::pyramid`].

use super::lanes::Lanes;
use crate::constants::{CELLS, VERTEX_COUNT, VERTICES};
use crate::texels::{PYRAMID_LEVELS, offset, side};

/// Fills a pyramid with the maxima (or minima) of the cells' corners and of blocks of cells.
///
/// # Safety
/// The CPU has the features of `L`.
#[inline(always)]
pub(super) unsafe fn reduce<L: Lanes, const MAX: bool>(
    heights: &[i32; VERTEX_COUNT],
    texels: &mut super::UninitTexels,
) {
    // SAFETY: the caller guarantees the CPU features. A row of vertices has 65, of the base 64
    // texels, a multiple of twice COUNT.
    unsafe {
        let texels: *mut i32 = texels.as_mut_ptr().cast();
        // The base and the level above it in one walk down each pair of vectors: a row of vertices
        // is read once.
        let next = texels.add(offset(1));
        for x in (0..CELLS).step_by(2 * L::COUNT) {
            let mut row = along::<L, MAX>(heights.as_ptr().add(x));
            for z in (0..CELLS).step_by(2) {
                let under = along::<L, MAX>(heights.as_ptr().add((z + 1) * VERTICES + x));
                let below = along::<L, MAX>(heights.as_ptr().add((z + 2) * VERTICES + x));
                let cells = [pick::<L, MAX>(row.0, under.0), pick::<L, MAX>(row.1, under.1)];
                cells[0].store(texels.add(z * CELLS + x));
                cells[1].store(texels.add(z * CELLS + x + L::COUNT));
                let more = [pick::<L, MAX>(under.0, below.0), pick::<L, MAX>(under.1, below.1)];
                more[0].store(texels.add((z + 1) * CELLS + x));
                more[1].store(texels.add((z + 1) * CELLS + x + L::COUNT));
                let (left, right) = (pick::<L, MAX>(cells[0], more[0]), pick::<L, MAX>(cells[1], more[1]));
                pick_pairs::<L, MAX>(left, right).store(next.add(z / 2 * (CELLS / 2) + x / 2));
                row = below;
            }
        }
        for level in 2..PYRAMID_LEVELS {
            let (side, below) = (side(level), 2 * side(level));
            let from = texels.add(offset(level - 1));
            let to = texels.add(offset(level));
            for z in 0..side {
                let near = from.add(2 * z * below);
                let to = to.add(z * side);
                halve_any::<L, MAX>(near, below, to);
            }
        }
    }
}

/// Reduces two rows of `below` texels to one of half as many, by the widest vectors that the result
/// fills.
#[inline(always)]
unsafe fn halve_any<L: Lanes, const MAX: bool>(near: *const i32, below: usize, to: *mut i32) {
    // SAFETY: the caller guarantees the CPU features, and two rows of `below` texels at `near`.
    unsafe {
        if below / 2 >= L::COUNT {
            halve::<L, MAX>(near, below, to);
        } else if below / 2 >= L::Half::COUNT {
            halve::<L::Half, MAX>(near, below, to);
        } else {
            halve::<i32, MAX>(near, below, to);
        }
    }
}

/// Reduces two rows of `below` texels to one of half as many.
#[inline(always)]
unsafe fn halve<L: Lanes, const MAX: bool>(near: *const i32, below: usize, to: *mut i32) {
    // SAFETY: the caller guarantees the CPU features, and two rows of `below` texels at `near`, a
    // multiple of twice COUNT.
    unsafe {
        for x in (0..below / 2).step_by(L::COUNT) {
            let pair = near.add(2 * x);
            let left = pick::<L, MAX>(L::load(pair), L::load(pair.add(below)));
            let pair = pair.add(L::COUNT);
            let right = pick::<L, MAX>(L::load(pair), L::load(pair.add(below)));
            pick_pairs::<L, MAX>(left, right).store(to.add(x));
        }
    }
}

#[inline(always)]
unsafe fn pick<L: Lanes, const MAX: bool>(a: L, b: L) -> L {
    // SAFETY: the caller guarantees the CPU features.
    unsafe { if MAX { a.max(b) } else { a.min(b) } }
}

#[inline(always)]
unsafe fn pick_pairs<L: Lanes, const MAX: bool>(left: L, right: L) -> L {
    // SAFETY: the caller guarantees the CPU features.
    unsafe { if MAX { left.max_of_pairs(right) } else { left.min_of_pairs(right) } }
}

/// The extremes of every vertex and the one after it, over two vectors.
#[inline(always)]
unsafe fn along<L: Lanes, const MAX: bool>(vertices: *const i32) -> (L, L) {
    // SAFETY: the caller guarantees the CPU features, and twice COUNT + 1 vertices.
    unsafe {
        let next = vertices.add(L::COUNT);
        (
            pick::<L, MAX>(L::load(vertices), L::load(vertices.add(1))),
            pick::<L, MAX>(L::load(next), L::load(next.add(1))),
        )
    }
}
