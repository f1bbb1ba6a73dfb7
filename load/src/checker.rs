//! What every chunk goes through that arrives, whichever way: the pyramids always, the whole chunk
//! for a sample.

use crate::counters::Counters;
use crate::regeneration::Regeneration;
use crate::verify;
use protocol::Delivery;
use std::sync::Arc;
use terrain::{Chunk, Land};

/// One client's inspection.
#[derive(Debug)]
pub struct Inspection {
    land: Land,
    /// How chunks are to come.
    asked: Delivery,
    /// One in so many is compared whole; 0 is none.
    every: u32,
    /// Chunks until the next of these.
    until: u32,
    counters: Arc<Counters>,
    regeneration: Regeneration,
}

impl Inspection {
    /// The inspection of client `index`. Clients start at different places of the count, so that
    /// short sessions are sampled too.
    #[must_use]
    pub fn new(
        land: Land,
        asked: Delivery,
        (every, index): (u32, u32),
        counters: &Arc<Counters>,
        regeneration: &Regeneration,
    ) -> Self {
        Self {
            land,
            asked,
            every,
            until: 1 + index % every.max(1),
            counters: Arc::clone(counters),
            regeneration: regeneration.clone(),
        }
    }

    /// Inspects a chunk and lets it go. `delivery` says how it came.
    pub async fn inspect(&mut self, chunk: Box<Chunk>, delivery: Delivery) {
        if let Err(mismatch) = verify::pyramids(&chunk) {
            self.counters.mismatch(&mismatch.to_string());
        }
        // A seed-only frame was generated and verified by the session; its error is the server's
        // word until it is sampled. An exact frame may come in seed-only delivery too, where every
        // chunk is promised to be compared.
        let regenerated = delivery == Delivery::SeedOnly;
        let sampled = self.is_sampled() || (self.asked == Delivery::SeedOnly && !regenerated);
        if sampled || regenerated {
            self.counters.regenerated();
        }
        if sampled {
            self.regeneration.compare(&self.counters, self.land, chunk, delivery).await;
        }
    }

    /// Whether this is the one in `every` chunks that is generated again.
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
