//! Resident chunks: a cache of fixed capacity with least-recently-used eviction.

pub mod block_errors;
pub mod chunk_cache;
pub mod vertical_scale;

pub use chunk_cache::{Arrival, ChunkCache, Resident, SLOT_BYTES};
