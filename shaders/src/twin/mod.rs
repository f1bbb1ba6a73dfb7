//! Twins of WGSL modules in plain Rust: same stem, same functions, same statements in the same
//! order, to be read side by side and tested without a GPU. Integer modules, and the floats that
//! results depend on: the bounds of plants, which culling tests. All other floats are compared as
//! pictures. The modules of the terrain (`hash`, `weights`, `noise`, `island`, `land`,
//! `random_attributes`) have their twins in the `terrain` crate.
#![expect(
    clippy::needless_return,
    clippy::cast_possible_truncation,
    reason = "a twin keeps the shape of its WGSL, and chunk sizes fit in 32 bits"
)]

pub mod blade;
pub mod clump;
pub mod clump_cell;
pub mod crown;
pub mod field;
pub mod grid;
pub mod morph;
pub mod placement;
pub mod raymarch_occlusion;
pub mod ring;
pub mod surface;
pub mod terrain_occlusion;
pub mod tree;
pub mod tree_impostor;
pub mod tree_shape;
pub mod tuft;
pub mod visibility;
