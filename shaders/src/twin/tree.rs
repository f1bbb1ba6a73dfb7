//! Twin of `wgsl/shared/tree.wesl`: kinds and sizes of trees.

use super::clump::{Clump, Vec2};
use super::crown::{BROADLEAF, PINE, SPRUCE};
use crate::layout::FINE_PER_METRE;

/// The species of a tree.
#[must_use]
pub fn tree_species(clump: &Clump) -> u32 {
    let height_m = clump.place[1] as f32 / FINE_PER_METRE as f32;
    let steep = 1.0 - clump.normal[1];
    let low = 1.0 - ((height_m - 15.0) / 30.0).clamp(0.0, 1.0);
    let broad = (0.68 - height_m / 330.0 - 2.0 * steep).clamp(0.04, 0.68);
    let pine = (0.10 + 2.5 * steep + 0.16 * low).clamp(0.1, 0.45);
    let number = clump.hue + 0.004;
    if number < broad {
        return BROADLEAF;
    }
    return if number > 1.0 - pine { PINE } else { SPRUCE };
}

/// Width and height of a tree, metres, from those of its clump: neither is greater. No crown is
/// much higher than wide.
#[must_use]
pub fn tree_size_m(species: u32, size_m: Vec2) -> Vec2 {
    if species == SPRUCE {
        return [size_m[0] * 0.88, size_m[1]];
    }
    if species == PINE {
        return [0.9 * size_m[0], (0.95 * size_m[1]).min(2.3 * size_m[0])];
    }
    return [size_m[0], (0.9 * size_m[1]).min(1.6 * size_m[0])];
}
