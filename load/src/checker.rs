//! Compares a sample of the chunks that arrive with local generation.

use crate::counters::Counters;
use crate::regeneration::Regeneration;
use protocol::Delivery;
use std::sync::Arc;
use terrain::{Chunk, Land};

/// The checks of one client.
#[derive(Debug)]
pub struct ChunkChecker {
    land: Land,
    /// The requested delivery.
    requested: Delivery,
    /// One chunk in this number is compared with local generation; 0 is none.
    every: u32,
    /// Chunks until the next comparison.
    until: u32,
    counters: Arc<Counters>,
    regeneration: Regeneration,
}

impl ChunkChecker {
    /// The checks of client `index`. Clients start their count at different values, so that short
    /// sessions are sampled too.
    #[must_use]
    pub fn new(
        land: Land,
        requested: Delivery,
        (every, index): (u32, u32),
        counters: &Arc<Counters>,
        regeneration: &Regeneration,
    ) -> Self {
        Self {
            land,
            requested,
            every,
            until: 1 + index % every.max(1),
            counters: Arc::clone(counters),
            regeneration: regeneration.clone(),
        }
    }

    /// Checks a chunk that came with this delivery.
    pub async fn check(&mut self, chunk: Box<Chunk>, delivery: Delivery) {
        // The session generates and verifies seed-only chunks, except their error bound, which only
        // a sample verifies. Exact frames can come in seed-only delivery, where every chunk is to
        // be compared.
        let regenerated = delivery == Delivery::SeedOnly;
        let sampled = self.is_sampled() || (self.requested == Delivery::SeedOnly && !regenerated);
        if sampled || regenerated {
            self.counters.regenerated();
        }
        if sampled {
            self.regeneration.compare(&self.counters, self.land, chunk, delivery).await;
        }
    }

    /// Whether this is the one in `every` chunks that is compared.
    const fn is_sampled(&mut self) -> bool {
        if self.every == 0 {
            return false;
        }
        self.until -= 1;
        if self.until > 0 {
            return false;
        }
        self.until = self.every;
        true
    }
}
