//! Height pyramids: for every cell, block of cells and the whole chunk, a bound on the drawn surface.
//!
//! A base texel holds the maximum (or minimum) of the four corner vertices of one cell. The cell is drawn as two
//! triangles, so that is the exact extreme of the drawn surface over the cell, never the noise between vertices.
//! Each further level reduces 2 x 2 texels, up to one.

use crate::constants::{CELLS, VERTEX_COUNT, VERTICES};

/// Levels of a pyramid: 64 x 64 up to 1 x 1.
pub const PYRAMID_LEVELS: usize = CELLS.trailing_zeros() as usize + 1;

/// Texels over all levels: 64² + 32² + ... + 1.
pub const PYRAMID_TEXELS: usize = (4 * CELLS * CELLS - 1) / 3;

/// One reduced pyramid, heights in units. Level 0 is the base.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Pyramid {
    texels: Box<[i32]>,
}

impl Pyramid {
    /// The pyramid of upper bounds.
    #[must_use]
    pub fn of_maxima(heights: &[i32; VERTEX_COUNT]) -> Self {
        Self::build(heights, i32::max)
    }

    /// The pyramid of lower bounds.
    #[must_use]
    pub fn of_minima(heights: &[i32; VERTEX_COUNT]) -> Self {
        Self::build(heights, i32::min)
    }

    fn build(heights: &[i32; VERTEX_COUNT], pick: impl Fn(i32, i32) -> i32 + Copy) -> Self {
        let mut texels = Vec::with_capacity(PYRAMID_TEXELS);
        for z in 0..CELLS {
            let near = &heights[z * VERTICES..][..VERTICES];
            let far = &heights[(z + 1) * VERTICES..][..VERTICES];
            for x in 0..CELLS {
                texels.push(pick(pick(near[x], near[x + 1]), pick(far[x], far[x + 1])));
            }
        }
        for level in 1..PYRAMID_LEVELS {
            let (below, below_side) = (offset(level - 1), side(level - 1));
            for z in 0..side(level) {
                for x in 0..side(level) {
                    let first = below + 2 * z * below_side + 2 * x;
                    let near = pick(texels[first], texels[first + 1]);
                    let far = pick(texels[first + below_side], texels[first + below_side + 1]);
                    texels.push(pick(near, far));
                }
            }
        }
        Self { texels: texels.into_boxed_slice() }
    }

    /// The texels of one level, row by row from the low corner; `level` below [`PYRAMID_LEVELS`].
    #[must_use]
    pub fn level(&self, level: usize) -> &[i32] {
        &self.texels[offset(level)..][..side(level) * side(level)]
    }

    /// The single texel of the last level: the extreme of the whole chunk.
    #[must_use]
    pub fn top(&self) -> i32 {
        self.texels[PYRAMID_TEXELS - 1]
    }
}

/// Texels along one side of a level.
#[must_use]
pub const fn side(level: usize) -> usize {
    CELLS >> level
}

/// Index of the first texel of a level.
const fn offset(level: usize) -> usize {
    PYRAMID_TEXELS - (4 * side(level) * side(level) - 1) / 3
}

#[cfg(test)]
mod tests {
    use super::*;
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
            for (pyramid, max) in
                [(Pyramid::of_maxima(&heights), true), (Pyramid::of_minima(&heights), false)]
            {
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
