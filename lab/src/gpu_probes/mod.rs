//! What only measuring needs of the renderer: chunks generated on the GPU, materials read back, and
//! the culling of plants on the CPU, with which the GPU passes are compared.

pub mod cpu_cull;
pub mod fill;
pub mod tiling;
