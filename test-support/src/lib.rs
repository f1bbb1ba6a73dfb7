//! What test suites of several crates share.

#![forbid(unsafe_code)]

pub mod chunk_fault;
pub mod random;

pub use chunk_fault::ChunkFault;
pub use random::Random;
