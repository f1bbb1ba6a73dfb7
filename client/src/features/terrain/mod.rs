//! Terrain: chunk data on the GPU and the pass that draws it.

pub mod draw;
pub mod instance;
pub mod mesh;
pub mod pool;

pub use draw::TerrainPass;
pub use pool::ChunkPool;
