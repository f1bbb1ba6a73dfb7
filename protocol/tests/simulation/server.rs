//! The simulated server's end of one connection: the real session machine, driven as the server
//! drives it.

use crate::generation::Generation;
use crate::plant::Plant;
use crate::truth;
use bytes::Bytes;
use protocol::Delivery;
use protocol::server::{Next, ServerOffer, ServerSession, ViewSelection};
use std::collections::BTreeSet;
use terrain::ChunkKey;

/// Chunks of a session in generation.
const WINDOW: usize = 16;

/// Ready chunks in one batch.
const BATCH: usize = 16;

#[derive(Debug)]
pub struct ServerEnd {
    pub session: ServerSession,
    pub in_generation: usize,
    /// A selection that runs elsewhere.
    pub selection: Option<ViewSelection>,
}

/// The results of one round of a session.
#[derive(Debug, Default)]
pub struct Round {
    /// Frames to send.
    pub frames: Vec<Bytes>,
    /// A selection has begun.
    pub begins_selection: bool,
}

impl ServerEnd {
    pub fn new(number: u32) -> Self {
        let offer = ServerOffer {
            land: truth::land(),
            digest: truth::digest(),
            token: None,
            software: "simulation".into(),
        };
        Self { session: ServerSession::new(offer, number.into()), in_generation: 0, selection: None }
    }

    /// Requests chunks, cancels outdated ones and collects what is to be sent.
    pub fn run(
        &mut self,
        number: u32,
        generation: &mut Generation,
        cached: &BTreeSet<(ChunkKey, &'static str)>,
        plant: Plant,
    ) -> Round {
        let mut round = Round::default();
        for key in self.session.take_stale() {
            for request in generation.cancel(number, key) {
                self.in_generation -= 1;
                self.session.withdraw(request);
            }
        }
        if self.selection.is_none()
            && let Some(selection) = self.session.take_view()
        {
            self.selection = Some(selection);
            round.begins_selection = true;
        }
        let ready = |key, delivery: Delivery| {
            cached.contains(&(key, delivery.name())).then(|| truth::frame(key, delivery))
        };
        let mut batch = 0;
        while self.in_generation < WINDOW && batch < BATCH {
            match self.session.next_chunk_with(ready) {
                Next::Nothing => break,
                Next::Delivered => batch += 1,
                Next::Generate(request, delivery) => {
                    if generation.request(number, request, delivery, plant) {
                        self.in_generation += 1;
                    } else {
                        let reason = protocol::message::RefusalReason::Overloaded;
                        self.session.fail(request, reason, "the queue is full");
                        // As after a refusal in the server: the session goes on with the next
                        // event.
                        break;
                    }
                }
            }
        }
        while let Some(frame) = self.session.poll_transmit() {
            round.frames.push(frame);
        }
        round
    }
}
