//! Chunk streams and the streamer that connects one to the chunk cache.
//!
//! A stream is polled once a frame and never blocks. Waiting, reconnecting and generating are
//! internal to each implementation.

pub mod chunk_stream;
pub mod expected;
pub mod guarded_session;
pub mod local;
pub mod null;
pub mod retries;
pub mod streamer;
pub mod trust;

pub use chunk_stream::{ChunkStream, StreamEvent, Traffic};
pub use local::LocalStream;
pub use null::NullStream;
