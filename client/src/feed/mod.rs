//! The seam between the viewer and whatever brings chunks: a server over a socket, or the land
//! itself.
//!
//! A feed is polled once a frame and never blocks. How it waits, reconnects or generates is its own
//! affair.

pub mod local;
pub mod none;

pub use local::LocalFeed;
pub use none::NoFeed;

use protocol::Delivery;
use protocol::view::View;
use std::time::Duration;
use terrain::{Chunk, ChunkKey, WorldDigest};

/// Something that a feed has to tell.
#[derive(Debug)]
pub enum FeedEvent {
    /// A session began. What is resident belongs to this world or must be dropped.
    Connected {
        /// The world that is served.
        world: WorldDigest,
        /// The seed that it is said to be made from; nothing that is drawn relies on it.
        world_seed: u64,
        /// Who serves it, for people.
        server: String,
    },
    /// A chunk, verified.
    Chunk(Box<Chunk>),
    /// Every chunk of the view with this id has been sent.
    Settled {
        /// The view's id.
        view: u32,
    },
    /// Something asked for will not come.
    Refused {
        /// One sentence.
        detail: String,
    },
    /// The session ended.
    Disconnected {
        /// One sentence with cause and mend.
        cause: String,
        /// Until the next attempt; none if another attempt cannot help.
        retry: Option<Duration>,
    },
}

/// Counters of a feed.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Traffic {
    /// Bytes of frames received since the start, over all sessions.
    pub bytes_received: u64,
    /// Chunks that the server may still send before more credit.
    pub credits: u32,
}

/// What brings chunks.
pub trait Feed {
    /// The next event, if one is there.
    fn poll(&mut self) -> Option<FeedEvent>;
    /// Says what is seen now; replaces the previous view.
    fn set_view(&mut self, view: View);
    /// Says that chunks were dropped and may be needed again.
    fn release(&mut self, keys: &[ChunkKey]);
    /// Says after a reconnect which chunks are here already.
    fn holding(&mut self, keys: &[ChunkKey]);
    /// How chunks come, for the record of a run.
    fn delivery(&self) -> Delivery;
    /// Counters.
    fn traffic(&self) -> Traffic;
}

/// Which feed it is may be decided at run time.
impl Feed for Box<dyn Feed> {
    fn poll(&mut self) -> Option<FeedEvent> {
        (**self).poll()
    }

    fn set_view(&mut self, view: View) {
        (**self).set_view(view);
    }

    fn release(&mut self, keys: &[ChunkKey]) {
        (**self).release(keys);
    }

    fn holding(&mut self, keys: &[ChunkKey]) {
        (**self).holding(keys);
    }

    fn delivery(&self) -> Delivery {
        (**self).delivery()
    }

    fn traffic(&self) -> Traffic {
        (**self).traffic()
    }
}
