//! A feed that brings nothing, for scenes that need nothing.

use crate::feed::{Feed, FeedEvent, Traffic};
use protocol::Delivery;
use protocol::view::View;
use terrain::ChunkKey;

/// Nothing.
#[derive(Clone, Copy, Debug, Default)]
pub struct NoFeed;

impl Feed for NoFeed {
    fn poll(&mut self) -> Option<FeedEvent> {
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
