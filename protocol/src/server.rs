//! The server's side of a session, without IO.
//!
//! A driver feeds received frames to [`ServerSession::receive`], generates the chunks that
//! [`ServerSession::next_chunk`] returns, passes the results to [`ServerSession::deliver`], and
//! sends the frames of [`ServerSession::poll_transmit`]. A session requests no more chunks than the
//! client granted credits, and all its memory is bounded ([`crate::limits`]).
//!
//! | module | content |
//! | --- | --- |
//! | `session` | the state machine: handshake, messages, views, requests |
//! | `session::credit` | what the client still allows, in chunks and bytes |
//! | `session::chunks` | the next chunk, and its delivery, failure or withdrawal |
//! | `session::in_flight` | requested chunks without a result, and which of them are stale |
//! | `view_queue` | the active view, its pending chunks by priority, prefetch |
//! | `view_selection` | the selection of a view's chunks, in steps of bounded cost |

mod session;
mod view_queue;
mod view_selection;

pub use session::{ChunkRequest, Next, ServerSession, SessionCounts};
pub use view_selection::ViewSelection;

use std::fmt::Debug;
use std::sync::Arc;
use terrain::{Land, WorldDigest};

/// The world and the conditions that a server offers to every session.
#[derive(Clone, Debug)]
pub struct ServerOffer {
    /// The world.
    pub land: Land,
    /// Its digest, computed once.
    pub digest: WorldDigest,
    /// Decides about the token of a client's hello; none admits every client.
    pub token: Option<Arc<dyn TokenCheck>>,
    /// Name and version of the server.
    pub software: String,
}

/// A check of tokens. Every call is an attempt.
pub trait TokenCheck: Debug + Send + Sync {
    /// Whether a client that presents this token, or none, is admitted.
    fn admits(&self, presented: Option<&str>) -> bool;
}

/// A check of one fixed token.
impl TokenCheck for String {
    fn admits(&self, presented: Option<&str>) -> bool {
        // blake3 hashes compare in constant time.
        presented.is_some_and(|presented| blake3::hash(presented.as_bytes()) == blake3::hash(self.as_bytes()))
    }
}
