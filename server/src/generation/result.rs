//! Results of requests to the generation service.

use bytes::Bytes;
use protocol::server::ChunkRequest;
use thiserror::Error;

/// Why a frame is not available.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Error)]
pub enum GenerationError {
    /// The queue is full, or the request exceeded its deadline.
    #[error("the server is overloaded, retry later")]
    Overloaded,
    /// The job panicked; the panic was caught and logged.
    #[error("the chunk could not be generated")]
    Failed,
}

/// A frame, or why it is not available.
pub type FrameResult = Result<Bytes, GenerationError>;

/// A request with its result.
pub type Completion = (ChunkRequest, FrameResult);
