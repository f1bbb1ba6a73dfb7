//! Land of another shape: the local land with every chunk's heights passed through a function.

use client::feed::{Feed, FeedEvent, LocalFeed, Traffic};
use protocol::Delivery;
use protocol::view::View;
use terrain::constants::VERTEX_COUNT;
use terrain::{Chunk, ChunkKey};

/// Changes the heights of a chunk (units) and returns the error that they have then.
pub type Mold = fn(ChunkKey, &mut [i32; VERTEX_COUNT], u32) -> u32;

/// The local land, molded.
#[derive(Debug)]
pub struct Molded {
    land: LocalFeed,
    mold: Mold,
}

impl Molded {
    /// The land of a seed in another shape.
    #[must_use]
    pub fn new(world_seed: u64, mold: Mold) -> Self {
        Self { land: LocalFeed::new(world_seed), mold }
    }
}

impl Feed for Molded {
    fn poll(&mut self) -> Option<FeedEvent> {
        Some(match self.land.poll()? {
            FeedEvent::Chunk(chunk) => {
                let Chunk { key, mut heights, error, grass, .. } = *chunk;
                let error = (self.mold)(key, &mut heights, error);
                FeedEvent::Chunk(Box::new(Chunk::from_parts(key, heights, error, grass)))
            }
            event => event,
        })
    }

    fn set_view(&mut self, view: View) {
        self.land.set_view(view);
    }

    fn release(&mut self, keys: &[ChunkKey]) {
        self.land.release(keys);
    }

    fn holding(&mut self, keys: &[ChunkKey]) {
        self.land.holding(keys);
    }

    fn delivery(&self) -> Delivery {
        self.land.delivery()
    }

    fn traffic(&self) -> Traffic {
        self.land.traffic()
    }
}
