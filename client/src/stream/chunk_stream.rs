//! The interface of chunk streams.

use protocol::Delivery;
use protocol::view::View;
use std::time::Duration;
use terrain::{Chunk, ChunkKey, WorldDigest};

/// An event of a stream.
#[derive(Debug)]
pub enum StreamEvent {
    /// A session began. Resident chunks of another world must be dropped.
    Connected {
        /// Digest of the served world.
        world: WorldDigest,
        /// Seed that the server announces, not verified.
        world_seed: u64,
        /// Name and version of the server, for display.
        server: String,
    },
    /// A verified chunk.
    Chunk(Box<Chunk>),
    /// Every chunk of the view with this id was sent or refused, or is held.
    Settled {
        /// The view's id.
        view: u32,
    },
    /// A chunk was invalid or refused. The parent is drawn and the chunk is requested again.
    Missed {
        /// The chunk; none if a bad frame names no chunk that may arrive.
        key: Option<ChunkKey>,
        /// One sentence.
        detail: String,
    },
    /// A view or a grant of credit was refused.
    Refused {
        /// The view's id; none for a grant of credit.
        view: Option<u32>,
        /// One sentence.
        detail: String,
    },
    /// The session ended.
    Disconnected {
        /// One sentence: the cause and what to do.
        cause: String,
        /// Delay until the next attempt; none if another attempt cannot help.
        retry: Option<Duration>,
    },
}

/// Counters of a stream.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Traffic {
    /// Bytes of frames received since the start, over all sessions.
    pub bytes_received: u64,
    /// Chunks that the server may still send before more credit.
    pub credits: u32,
    /// Events that wait for [`ChunkStream::poll`].
    pub waiting_events: usize,
    /// Chunks that were invalid or unrequested, over all sessions.
    pub bad_chunks: u64,
    /// Chunks that the server refused, over all sessions.
    pub refused_chunks: u64,
    /// Requests for bad and refused chunks, over all sessions.
    pub retried_chunks: u64,
}

/// A source of chunks for the viewer.
pub trait ChunkStream {
    /// The next event, if there is one.
    fn poll(&mut self) -> Option<StreamEvent>;
    /// Sets the current view; replaces the previous one.
    fn set_view(&mut self, view: View);
    /// Reports evicted chunks to the server, which may send them again.
    fn release(&mut self, keys: &[ChunkKey]);
    /// Reports the resident chunks after a reconnect.
    fn holding(&mut self, keys: &[ChunkKey]);
    /// Delivery mode, for the statistics.
    fn delivery(&self) -> Delivery;
    /// Counters.
    fn traffic(&self) -> Traffic;
}

/// The implementation may be chosen at run time.
impl ChunkStream for Box<dyn ChunkStream> {
    fn poll(&mut self) -> Option<StreamEvent> {
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
