//! Vegetation: grass and trees around the eye.
//!
//! | file | job |
//! | --- | --- |
//! | [`settings`] | user settings |
//! | [`species`] | shader parameters of one species, per frame |
//! | [`occlusion_grid`] | drawn land around the eye, as the occlusion tests read it |
//! | [`by_slot`] | slot data on the CPU, as the shaders read it |
//! | [`cull_pipelines`] | pipelines of the culling passes by method |
//! | [`gpu_cull`] | culling on the GPU: blocks, prefix sums, clumps |
//! | [`tree_cells`] | the trees around the eye in cells, for their shadows |
//! | [`prepare`] | what all vertices of a visible clump share, once a frame |
//! | [`draw`] | indirect draws of visible clumps |
//! | [`far_trees`] | trees beyond the range of per-tree culling: patches of a frame |
//! | [`far_tree_pass`] | their passes and buffers |
//! | [`renderer`] | passes and buffers of all species |

pub mod by_slot;
pub mod cull_pipelines;
pub mod draw;
pub mod far_tree_pass;
pub mod far_trees;
pub mod gpu_cull;
pub mod occlusion_grid;
pub mod prepare;
pub mod renderer;
pub mod settings;
pub mod species;
pub mod stats;
pub mod tree_cells;

pub use occlusion_grid::OcclusionGrid;
pub use settings::{Cull, PlantShadows, VegetationSettings};
pub use species::{SpeciesParams, VegetationFrame};
