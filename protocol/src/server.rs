//! The server's side of a session, without IO.
//!
//! A driver feeds received frames to [`ServerSession::receive`], generates the chunks that
//! [`ServerSession::next_chunk`] returns, passes the results to [`ServerSession::deliver`], and
//! sends the frames of [`ServerSession::poll_transmit`]. A session requests no more chunks than the
//! client granted credits, and all its memory is bounded ([`crate::limits`]).
//!
//! | module | content |
//! | --- | --- |
//! | `session` | the state machine: handshake, credit, requests, delivery |
//! | `view_queue` | the active view, its pending chunks by priority, prefetch |
//! | `view_selection` | the selection of a view's chunks, in steps of bounded cost |

mod session;
mod view_queue;
mod view_selection;

pub use session::{ChunkRequest, Next, ServerSession, SessionCounts};
pub use view_selection::ViewSelection;

use terrain::{Land, WorldDigest};

/// The world and the conditions that a server offers to every session.
#[derive(Clone, Debug)]
pub struct ServerOffer {
    /// The world.
    pub land: Land,
    /// Its digest, computed once.
    pub digest: WorldDigest,
    /// Token that clients must present; none admits every client.
    pub token: Option<String>,
    /// Name and version of the server.
    pub software: String,
}

/// Whether a presented token satisfies a requirement; without a requirement every token does.
///
/// The comparison does not stop at the first difference, so that its duration reveals nothing about
/// the secret.
#[must_use]
pub fn token_matches(required: Option<&str>, presented: Option<&str>) -> bool {
    let Some(required) = required else { return true };
    // blake3 hashes compare in constant time.
    presented.is_some_and(|presented| blake3::hash(presented.as_bytes()) == blake3::hash(required.as_bytes()))
}
