//! An empty stream, for scenes without chunks.

use crate::stream::chunk_stream::{ChunkStream, StreamEvent, Traffic};
use protocol::Delivery;
use protocol::view::View;
use terrain::ChunkKey;

/// A stream without events.
#[derive(Clone, Copy, Debug, Default)]
pub struct NullStream;

impl ChunkStream for NullStream {
    fn poll(&mut self) -> Option<StreamEvent> {
        None
    }

    fn set_view(&mut self, _: View) {}

    fn release(&mut self, _: &[ChunkKey]) {}

    fn holding(&mut self, _: &[ChunkKey]) {}

    fn delivery(&self) -> Delivery {
        Delivery::default()
    }

    fn traffic(&self) -> Traffic {
        Traffic::default()
    }
}
