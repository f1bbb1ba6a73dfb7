//! Traces of chunks: spans from the request to the socket, for a collector of OpenTelemetry.
//!
//! A traced chunk has a span `chunk` with these parts: `queue`, until its job starts; `disk`,
//! `store`, `generate` and `encode`, whichever it needed; `write`, until the system has taken its
//! frame.
//!
//! One requested chunk in `--trace-every` is traced. A chunk is also traced if its GET, or the
//! upgrade of its session, names a recorded trace in `traceparent`. Both have a bound, the second a
//! lower one, because a client chooses the header.
//!
//! Without `--otlp` a job reads the current span of its thread and finds none.

mod config;
#[cfg(feature = "traces")]
mod export;
#[cfg(feature = "traces")]
mod parent;
#[cfg(not(feature = "traces"))]
mod without;

pub use config::{TARGET, TraceConfig};
#[cfg(feature = "traces")]
pub use export::{Exporter, layer};
#[cfg(feature = "traces")]
pub use parent::Parent;
#[cfg(not(feature = "traces"))]
pub use without::{Exporter, Parent, layer};

use protocol::Delivery;
use std::fmt;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Mutex, PoisonError};
use std::time::{Duration, Instant};
use terrain::ChunkKey;
use tracing::Span;

/// Chunks that the server itself chooses within a second. Further ones are not traced.
const MOST_CHOSEN: u32 = 200;

/// Chunks of traces that clients name within a second, all clients together.
const MOST_NAMED: u32 = 20;

/// Which chunks are traced.
#[derive(Debug)]
pub struct Traces {
    /// As in [`TraceConfig`]; none without a collector.
    every: Option<u64>,
    requests: AtomicU64,
    chosen: Mutex<Window>,
    named: Mutex<Window>,
}

/// The current second and its traced chunks.
#[derive(Debug)]
struct Window {
    since: Instant,
    traced: u32,
    most: u32,
}

impl Window {
    fn new(most: u32) -> Mutex<Self> {
        Mutex::new(Self { since: Instant::now(), traced: 0, most })
    }

    /// Counts a chunk; whether it is within the bound.
    fn admit(&mut self, now: Instant) -> bool {
        if now.saturating_duration_since(self.since) >= Duration::from_secs(1) {
            *self = Self { since: now, traced: 0, most: self.most };
        }
        self.traced = self.traced.saturating_add(1);
        self.traced <= self.most
    }
}

impl Traces {
    /// For a configuration.
    #[must_use]
    pub fn new(config: Option<&TraceConfig>) -> Self {
        Self {
            every: config.map(|config| config.every),
            requests: AtomicU64::new(0),
            chosen: Window::new(MOST_CHOSEN),
            named: Window::new(MOST_NAMED),
        }
    }

    /// The trace that a peer names, if there is a collector.
    #[must_use]
    pub fn parent(&self, headers: &axum::http::HeaderMap) -> Option<Parent> {
        self.every.and_then(|_| Parent::of(headers))
    }

    /// The span of a requested chunk; disabled if it is not traced.
    #[must_use]
    pub fn chunk(&self, parent: Option<&Parent>, key: ChunkKey, delivery: Delivery) -> Span {
        let Some(every) = self.every else { return Span::none() };
        if !self.chunk_at(every, parent, Instant::now()) {
            return Span::none();
        }
        span(parent, key, delivery)
    }

    /// Whether a chunk that is requested now is traced.
    fn chunk_at(&self, every: u64, parent: Option<&Parent>, now: Instant) -> bool {
        let is_chosen = every > 0 && self.requests.fetch_add(1, Ordering::Relaxed).is_multiple_of(every);
        let window = match (is_chosen, parent) {
            (true, _) => &self.chosen,
            (false, Some(_)) => &self.named,
            (false, None) => return false,
        };
        window.lock().unwrap_or_else(PoisonError::into_inner).admit(now)
    }
}

fn span(parent: Option<&Parent>, key: ChunkKey, delivery: Delivery) -> Span {
    let span = tracing::info_span!(
        target: TARGET, parent: None, "chunk", chunk = %key, %delivery,
        origin = tracing::field::Empty, outcome = tracing::field::Empty
    );
    if let Some(parent) = parent {
        parent.adopt(&span);
    }
    span
}

/// The current span if it is one of a trace; disabled otherwise.
#[must_use]
pub fn current() -> Span {
    let span = Span::current();
    if span.metadata().is_some_and(|metadata| metadata.target() == TARGET) { span } else { Span::none() }
}

/// The spans that a request carries through the queue.
pub struct RequestTrace {
    /// Its chunk's span.
    pub chunk: Span,
    /// Until its job starts, or ends where it joined a running one.
    queue: Span,
}

impl RequestTrace {
    /// Of the current span.
    #[must_use]
    pub fn current() -> Self {
        let chunk = current();
        let queue = if chunk.is_disabled() {
            Span::none()
        } else {
            tracing::info_span!(target: TARGET, parent: &chunk, "queue")
        };
        Self { chunk, queue }
    }

    /// Ends its wait.
    pub fn start(&mut self) {
        self.queue = Span::none();
    }
}

impl fmt::Debug for RequestTrace {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_tuple("RequestTrace").field(&self.chunk.id()).finish()
    }
}

/// A part of the current span, until the end of the block; nothing where nothing is traced.
macro_rules! part {
    ($name:literal) => {
        if $crate::traces::current().is_disabled() {
            tracing::Span::none().entered()
        } else {
            tracing::info_span!(target: $crate::traces::TARGET, $name).entered()
        }
    };
}
pub(crate) use part;

#[cfg(all(test, feature = "traces"))]
mod tests {
    use super::*;

    const NAMED: &str = "00-0af7651916cd43dd8448eb211c80319c-b7ad6b7169203331-01";

    /// Chunks that are traced among 1,000 of one moment.
    fn traced(every: u64, parent: Option<&Parent>) -> usize {
        let endpoint = url::Url::parse("http://127.0.0.1:4318/v1/traces").unwrap();
        let traces = Traces::new(Some(&TraceConfig { endpoint, every }));
        let now = Instant::now();
        (0..1000).filter(|_| traces.chunk_at(every, parent, now)).count()
    }

    #[test]
    fn one_chunk_of_many_is_traced_and_those_of_a_named_trace_up_to_their_bounds() {
        let parent = Parent::of(&Parent::headers(&[("traceparent", NAMED)])).unwrap();
        let (most_chosen, most_named) = (MOST_CHOSEN as usize, MOST_NAMED as usize);
        assert_eq!(traced(100, None), 10);
        assert_eq!(traced(0, None), 0);
        assert_eq!(traced(1, None), most_chosen);
        assert_eq!(traced(0, Some(&parent)), most_named);
        // A client that names a trace takes nothing from the server's own choice.
        assert_eq!(traced(100, Some(&parent)), 10 + most_named);
    }

    #[test]
    fn without_a_collector_nothing_is_traced() {
        let traces = Traces::new(None);
        let headers = Parent::headers(&[("traceparent", NAMED)]);
        assert!(traces.parent(&headers).is_none());
        tracing::subscriber::with_default(tracing_subscriber::registry(), || {
            let parent = Parent::of(&headers);
            let key = ChunkKey::new(0, 1, 2).unwrap();
            assert!(traces.chunk(parent.as_ref(), key, Delivery::Exact).is_disabled());
            // The control.
            assert!(!span(parent.as_ref(), key, Delivery::Exact).is_disabled());
        });
    }

    #[test]
    fn the_bound_is_of_each_second() {
        let start = Instant::now();
        let mut window = Window { since: start, traced: 0, most: 7 };
        let admitted = |window: &mut Window, now| (0..1000).filter(|_| window.admit(now)).count();
        assert_eq!(admitted(&mut window, start), 7);
        assert_eq!(admitted(&mut window, start + Duration::from_millis(999)), 0);
        assert_eq!(admitted(&mut window, start + Duration::from_secs(1)), 7);
    }

    #[test]
    fn spans_of_others_are_no_part_of_a_trace() {
        tracing::subscriber::with_default(tracing_subscriber::registry(), || {
            let _other = tracing::info_span!("request").entered();
            assert!(current().is_disabled());
            let _chunk = tracing::info_span!(target: TARGET, "chunk").entered();
            assert!(!current().is_disabled());
        });
    }
}
