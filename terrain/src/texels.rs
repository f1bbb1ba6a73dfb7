//! Texel layout of a height pyramid, shared by [`crate::pyramid`] and the SIMD kernels.

use crate::constants::CELLS;

/// Levels of a pyramid: 64 x 64 up to 1 x 1.
pub const PYRAMID_LEVELS: usize = CELLS.trailing_zeros() as usize + 1;

/// Texels over all levels: 64² + 32² + ... + 1.
pub const PYRAMID_TEXELS: usize = (4 * CELLS * CELLS - 1) / 3;

/// The texels of all levels, base first. Aligned to cache lines: a vector store across two lines
/// costs twice.
#[derive(Clone, Debug, PartialEq, Eq)]
#[repr(C, align(64))]
pub(crate) struct Texels(pub(crate) [i32; PYRAMID_TEXELS]);

/// Texels along one side of a level.
#[must_use]
pub const fn side(level: usize) -> usize {
    CELLS >> level
}

/// Index of the first texel of a level.
pub(crate) const fn offset(level: usize) -> usize {
    PYRAMID_TEXELS - (4 * side(level) * side(level) - 1) / 3
}
