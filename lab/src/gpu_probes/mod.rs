//! What the viewer does not need: chunks generated on the GPU, materials read back, and the culling
//! of plants on the CPU as the reference of the GPU passes.

pub mod cpu_cull;
pub mod fill;
pub mod tiling;
