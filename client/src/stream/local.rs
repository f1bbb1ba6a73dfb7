//! Chunks without a server, generated on request: for tests, as the reference of streamed images,
//! and for scenes with land of their own. Unlike other streams it works on the caller's thread.

use crate::stream::chunk_stream::{ChunkStream, StreamEvent, Traffic};
use protocol::Delivery;
use protocol::limits::MAX_VIEW_CHUNKS;
use protocol::view::View;
use std::collections::{HashSet, VecDeque};
use terrain::{ChunkKey, Land, lod};

/// Generates one chunk per poll, on the caller's thread.
#[derive(Debug)]
pub struct LocalStream {
    land: Land,
    is_connected: bool,
    /// Keys of the current view to generate, coarse first.
    wanted: VecDeque<ChunkKey>,
    held: HashSet<ChunkKey>,
    /// The view that is settled once `wanted` is empty.
    unsettled: Option<u32>,
}

impl LocalStream {
    /// The stream of a seed's land.
    #[must_use]
    pub fn new(world_seed: u64) -> Self {
        Self {
            land: Land::new(world_seed),
            is_connected: false,
            wanted: VecDeque::new(),
            held: HashSet::new(),
            unsettled: None,
        }
    }
}

impl ChunkStream for LocalStream {
    fn poll(&mut self) -> Option<StreamEvent> {
        if !self.is_connected {
            self.is_connected = true;
            return Some(StreamEvent::Connected {
                world: self.land.digest(),
                world_seed: self.land.world_seed(),
                server: "local land".into(),
            });
        }
        if let Some(key) = self.wanted.pop_front() {
            self.held.insert(key);
            return Some(StreamEvent::Chunk(Box::new(self.land.chunk(key))));
        }
        self.unsettled.take().map(|view| StreamEvent::Settled { view })
    }

    fn set_view(&mut self, view: View) {
        let needed = lod::select(&self.land, &view.viewer(), MAX_VIEW_CHUNKS);
        self.wanted =
            needed.into_iter().map(|needed| needed.key).filter(|key| !self.held.contains(key)).collect();
        self.unsettled = Some(view.id);
    }

    fn release(&mut self, keys: &[ChunkKey]) {
        for key in keys {
            self.held.remove(key);
        }
    }

    fn holding(&mut self, keys: &[ChunkKey]) {
        self.held.extend(keys);
    }

    fn delivery(&self) -> Delivery {
        Delivery::SeedOnly
    }

    fn traffic(&self) -> Traffic {
        Traffic::default()
    }
}
