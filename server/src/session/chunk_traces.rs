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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::traces::TraceConfig;
    use std::fmt::Debug;
    use std::sync::{Arc, Mutex};
    use tracing::Subscriber;
    use tracing::field::{Field, Visit};
    use tracing::span::{Id, Record};
    use tracing_subscriber::layer::{Context, Layer, SubscriberExt};

    /// What spans record after their begin: the outcomes.
    #[derive(Clone, Debug, Default)]
    struct Outcomes(Arc<Mutex<Vec<String>>>);

    impl Outcomes {
        fn seen(&self) -> Vec<String> {
            self.0.lock().unwrap().clone()
        }
    }

    impl Visit for Outcomes {
        fn record_str(&mut self, _: &Field, text: &str) {
            self.0.lock().unwrap().push(text.into());
        }

        fn record_debug(&mut self, field: &Field, value: &dyn Debug) {
            panic!("{field} is {value:?}");
        }
    }

    impl<S: Subscriber> Layer<S> for Outcomes {
        fn on_record(&self, _: &Id, values: &Record<'_>, _: Context<'_, S>) {
            values.record(&mut self.clone());
        }
    }

    #[test]
    fn every_traced_chunk_has_one_outcome() {
        let outcomes = Outcomes::default();
        tracing::subscriber::with_default(tracing_subscriber::registry().with(outcomes.clone()), || {
            let endpoint = url::Url::parse("http://127.0.0.1:4318/v1/traces").unwrap();
            let traces = Traces::new(Some(&TraceConfig { endpoint, every: 1 }));
            let mut session = ChunkTraces::new(None);
            let key = |x| ChunkKey::new(0, x, 0).unwrap();
            for x in 0..6 {
                drop(session.begin(&traces, key(x), Delivery::Exact));
            }
            session.end(key(3), "failed");
            session.end(key(3), "overloaded");
            assert_eq!(outcomes.seen(), ["failed"], "it is not in generation any more");
            session.deliver(key(1));
            session.flushed(true);
            session.deliver(key(0));
            session.flushed(false);
            assert_eq!(outcomes.seen(), ["failed", "sent", "unsent"]);
            // One in a flush, and two in generation.
            session.deliver(key(5));
            drop(session);
            let expected = ["failed", "sent", "unsent", "unsent", "cancelled", "cancelled"];
            assert_eq!(outcomes.seen(), expected);
        });
    }
}
