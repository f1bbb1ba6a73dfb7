//! Chunk streams and the streamer that connects one to the chunk cache.
//!
//! A stream is polled for events in each frame and never waits. Waiting and reconnecting are
//! internal to each implementation. [`LocalStream`] generates one chunk in a poll.

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
