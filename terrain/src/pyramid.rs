//! Height pyramids: for every cell, block of cells and the whole chunk, a bound on the drawn
//! surface.
//!
//! A base texel holds the maximum (or minimum) of the four corner vertices of one cell. The cell is
//! drawn as two triangles, so that is the exact extreme of the drawn surface over the cell, never
//! the noise between vertices. Each further level reduces 2 x 2 texels, up to one.

use crate::constants::VERTEX_COUNT;
use crate::simd::{self, Kernel};
use crate::texels::{Texels, offset};

pub use crate::texels::{PYRAMID_LEVELS, PYRAMID_TEXELS, side};

/// One reduced pyramid, heights in units. Level 0 is the base.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Pyramid {
    texels: Box<Texels>,
}

impl Pyramid {
    /// The pyramid of upper bounds.
    #[must_use]
    pub fn of_maxima(heights: &[i32; VERTEX_COUNT]) -> Self {
        Self::of_maxima_on(Kernel::best(), heights)
    }

    /// The pyramid of lower bounds.
    #[must_use]
    pub fn of_minima(heights: &[i32; VERTEX_COUNT]) -> Self {
        Self::of_minima_on(Kernel::best(), heights)
    }

    /// The pyramid of upper bounds, by a given kernel.
    #[must_use]
    pub fn of_maxima_on(kernel: Kernel, heights: &[i32; VERTEX_COUNT]) -> Self {
        Self { texels: simd::pyramid(kernel, heights, true) }
    }

    /// The pyramid of lower bounds, by a given kernel.
    #[must_use]
    pub fn of_minima_on(kernel: Kernel, heights: &[i32; VERTEX_COUNT]) -> Self {
        Self { texels: simd::pyramid(kernel, heights, false) }
    }

    /// The texels of one level, row by row from the low corner; `level` below [`PYRAMID_LEVELS`].
    #[must_use]
    pub fn level(&self, level: usize) -> &[i32] {
        &self.texels.0[offset(level)..][..side(level) * side(level)]
    }

    /// The single texel of the last level: the extreme of the whole chunk.
    #[must_use]
    pub fn top(&self) -> i32 {
        self.texels.0[PYRAMID_TEXELS - 1]
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::constants::VERTICES;
    use crate::hash::mix;

    fn heights(seed: u32) -> Box<[i32; VERTEX_COUNT]> {
        let heights: Vec<_> = (0..VERTEX_COUNT as u32).map(|n| mix(n ^ seed) as i32 >> 8).collect();
        heights.into_boxed_slice().try_into().unwrap()
    }

    /// The obvious extreme over the closed block of vertices under a texel.
    fn naive(heights: &[i32; VERTEX_COUNT], level: usize, x: usize, z: usize, max: bool) -> i32 {
        let step = 1 << level;
        let block = (z * step..=(z + 1) * step)
            .flat_map(|row| (x * step..=(x + 1) * step).map(move |column| heights[row * VERTICES + column]));
        if max { block.max().unwrap() } else { block.min().unwrap() }
    }

    #[test]
    fn every_texel_of_every_level_equals_the_naive_extreme() {
        for seed in 0..4 {
            let heights = heights(seed << 16);
            let by_all = Kernel::available().flat_map(|kernel| {
                [
                    (Pyramid::of_maxima_on(kernel, &heights), true),
                    (Pyramid::of_minima_on(kernel, &heights), false),
                ]
            });
            for (pyramid, max) in by_all {
                for level in 0..PYRAMID_LEVELS {
                    assert_eq!(pyramid.level(level).len(), side(level) * side(level));
                    for (index, texel) in pyramid.level(level).iter().enumerate() {
                        let (x, z) = (index % side(level), index / side(level));
                        assert_eq!(*texel, naive(&heights, level, x, z, max), "level {level} ({x}, {z})");
                    }
                }
                assert_eq!(pyramid.top(), pyramid.level(PYRAMID_LEVELS - 1)[0]);
            }
        }
    }

    #[test]
    fn one_raised_vertex_reaches_the_top() {
        let mut heights = heights(0);
        heights[VERTEX_COUNT - 1] = i32::MAX;
        assert_eq!(Pyramid::of_maxima(&heights).top(), i32::MAX);
        assert_ne!(Pyramid::of_minima(&heights).top(), i32::MAX);
    }
}
