//! The traced chunks of one session.

use crate::traces::{Parent, TARGET, Traces};
use protocol::Delivery;
use terrain::ChunkKey;
use tracing::Span;

/// Spans of the session's traced chunks; most sessions have none.
pub struct ChunkTraces {
    /// The trace that the upgrade request named.
    parent: Option<Parent>,
    /// In generation.
    open: Vec<(ChunkKey, Span)>,
    /// In the next flush: the part `write`, then its chunk.
    unwritten: Vec<Span>,
}

impl ChunkTraces {
    /// For a session.
    #[must_use]
    pub fn new(parent: Option<Parent>) -> Self {
        Self { parent, open: Vec::new(), unwritten: Vec::new() }
    }

    /// A chunk is requested from the generation service: its span.
    pub fn begin(&mut self, traces: &Traces, key: ChunkKey, delivery: Delivery) -> Span {
        let span = traces.chunk(self.parent.as_ref(), key, delivery);
        if !span.is_disabled() {
            self.open.push((key, span.clone()));
        }
        span
    }

    /// Its frame goes to the next flush.
    pub fn deliver(&mut self, key: ChunkKey) {
        if let Some(chunk) = self.remove(key) {
            self.unwritten.push(tracing::info_span!(target: TARGET, parent: &chunk, "write"));
            self.unwritten.push(chunk);
        }
    }

    /// It gets no frame: `cancelled`, `overloaded` or `failed`.
    pub fn end(&mut self, key: ChunkKey, outcome: &'static str) {
        if let Some(chunk) = self.remove(key) {
            end(&chunk, outcome);
        }
    }

    /// The system has taken all frames, or the flush failed.
    pub fn flushed(&mut self, is_sent: bool) {
        for span in self.unwritten.drain(..) {
            end(&span, if is_sent { "sent" } else { "unsent" });
        }
    }

    fn remove(&mut self, key: ChunkKey) -> Option<Span> {
        let index = self.open.iter().position(|(open, _)| *open == key)?;
        Some(self.open.swap_remove(index).1)
    }
}

impl Drop for ChunkTraces {
    fn drop(&mut self) {
        self.flushed(false);
        for (_, chunk) in self.open.drain(..) {
            end(&chunk, "cancelled");
        }
    }
}

/// Marks the end of a span that is dropped now. The part `write` has no outcome.
fn end(span: &Span, outcome: &'static str) {
    span.record("outcome", outcome);
    // The export takes the last exit of a span as its end.
    span.in_scope(|| ());
}
