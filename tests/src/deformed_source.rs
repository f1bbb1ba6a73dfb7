//! Deformed land: the local land with every chunk's heights passed through a function.

use client::stream::{ChunkStream, LocalStream, StreamEvent, Traffic};
use protocol::Delivery;
use protocol::view::View;
use terrain::constants::VERTEX_COUNT;
use terrain::{Chunk, ChunkKey};

/// Changes the heights of a chunk (units) and returns their error.
pub type Deformation = fn(ChunkKey, &mut [i32; VERTEX_COUNT], u32) -> u32;

/// The local land, deformed.
#[derive(Debug)]
pub struct DeformedSource {
    land: LocalStream,
    deformation: Deformation,
}

impl DeformedSource {
    /// The land of a seed, deformed.
    #[must_use]
    pub fn new(world_seed: u64, deformation: Deformation) -> Self {
        Self { land: LocalStream::new(world_seed), deformation }
    }
}

impl ChunkStream for DeformedSource {
    fn poll(&mut self) -> Option<StreamEvent> {
        Some(match self.land.poll()? {
            StreamEvent::Chunk(chunk) => {
                let Chunk { key, mut heights, error, grass, .. } = *chunk;
                let error = (self.deformation)(key, &mut heights, error);
                StreamEvent::Chunk(Box::new(Chunk::from_parts(key, heights, error, grass)))
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
