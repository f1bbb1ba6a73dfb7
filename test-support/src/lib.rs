//! The code that test suites of several crates share.

pub mod chunk_fault;
pub mod counting_allocator;
pub mod random;

pub use chunk_fault::ChunkFault;
pub use random::Random;
