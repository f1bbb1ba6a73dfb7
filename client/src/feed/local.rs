//! Chunks without a server: generated when asked for. What tests render from, and the reference
//! that a streamed picture must equal.

use crate::feed::{Feed, FeedEvent, Traffic};
use protocol::Delivery;
use protocol::view::View;
use std::collections::{HashSet, VecDeque};
use terrain::{ChunkKey, Land, lod};

/// The land as a feed. Generates one chunk per poll, on the caller's thread.
#[derive(Debug)]
pub struct LocalFeed {
    land: Land,
    greeted: bool,
    /// Keys of the current view that are still to be generated, coarse first.
    wanted: VecDeque<ChunkKey>,
    held: HashSet<ChunkKey>,
    /// The view to be declared settled when `wanted` is empty.
    unsettled: Option<u32>,
}

impl LocalFeed {
    /// The land of a seed.
    #[must_use]
    pub fn new(world_seed: u64) -> Self {
        Self {
            land: Land::new(world_seed),
            greeted: false,
            wanted: VecDeque::new(),
            held: HashSet::new(),
            unsettled: None,
        }
    }
}

impl Feed for LocalFeed {
    fn poll(&mut self) -> Option<FeedEvent> {
        if !self.greeted {
            self.greeted = true;
            return Some(FeedEvent::Connected {
                world: self.land.digest(),
                world_seed: self.land.world_seed(),
                server: "local land".into(),
            });
        }
        if let Some(key) = self.wanted.pop_front() {
            self.held.insert(key);
            return Some(FeedEvent::Chunk(Box::new(self.land.chunk(key))));
        }
        self.unsettled.take().map(|view| FeedEvent::Settled { view })
    }

    fn set_view(&mut self, view: View) {
        let needed = lod::select(&self.land, &view.viewer(), usize::MAX);
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
