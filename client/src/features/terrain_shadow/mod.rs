//! Shadows of the terrain on itself.
//!
//! | file | job |
//! | --- | --- |
//! | [`sun`] | shader parameters of the sun |
//! | [`page_table`] | quadtree of the drawn chunks |
//! | [`schedule`] | which chunks to trace next |
//! | [`pass`] | the compute pass |
//!
//! The result depends on the drawn chunks and the sun only: not on arrival order, slots or other
//! resident chunks.

pub mod page_table;
pub mod pass;
pub mod schedule;
pub mod sun;

pub use page_table::{Page, PageTable};
pub use pass::TerrainShadowPass;
pub use schedule::{Candidate, Quota, Schedule, ShadowBatch};
pub use sun::sun_params;
