//! Sessions, and the chunks and bytes that they were sent.

use super::{ReasonLabel, register};
use crate::latency::LatencyHistogram;
use prometheus_client::encoding::EncodeLabelSet;
use prometheus_client::metrics::counter::Counter;
use prometheus_client::metrics::family::Family;
use prometheus_client::metrics::gauge::Gauge;
use prometheus_client::registry::Registry;
use protocol::Delivery;

/// Label set of a delivery.
#[derive(Clone, Debug, PartialEq, Eq, Hash, EncodeLabelSet)]
struct DeliveryLabel {
    /// [`Delivery::name`].
    delivery: &'static str,
}

/// Metrics of sessions.
#[derive(Debug)]
pub struct SessionMetrics {
    /// Open sessions.
    pub open: Gauge,
    /// Sessions that may be open.
    pub limit: Gauge,
    ended: Family<ReasonLabel, Counter>,
    /// Chunks sent, all deliveries. Not exported: their sum by delivery is.
    pub chunks_sent: Counter,
    chunks_sent_by_delivery: Family<DeliveryLabel, Counter>,
    chunk_sent_bytes: Family<DeliveryLabel, Counter>,
    /// Bytes of all messages sent.
    pub sent_bytes: Counter,
    /// From the request of a chunk to the end of its write.
    pub latency: LatencyHistogram,
}

impl SessionMetrics {
    pub(super) fn register(registry: &mut Registry) -> Self {
        Self {
            open: register(registry, "sessions", "Open sessions"),
            limit: register(registry, "sessions_limit", "Sessions that may be open"),
            ended: register(registry, "sessions_ended", "Ended sessions by reason"),
            chunks_sent: Counter::default(),
            chunks_sent_by_delivery: register(
                registry,
                "chunks_sent",
                "Chunks sent over sessions by delivery",
            ),
            chunk_sent_bytes: register(
                registry,
                "chunk_sent_bytes",
                "Bytes of chunk frames sent over sessions by delivery",
            ),
            sent_bytes: register(registry, "session_sent_bytes", "Bytes of all messages sent over sessions"),
            latency: register(
                registry,
                "chunk_latency_seconds",
                "From the request of a chunk by a session to the end of its write",
            ),
        }
    }

    /// Creates the counters of ends, so that a rate includes the first event.
    pub fn declare_ends(&self, reasons: impl IntoIterator<Item = &'static str>) {
        for reason in reasons {
            drop(self.ended.get_or_create(&ReasonLabel { reason }));
        }
    }

    /// Counts the end of a session.
    pub fn ended(&self, reason: &'static str) {
        self.ended.get_or_create(&ReasonLabel { reason }).inc();
    }

    /// Sessions that ended for a reason.
    #[must_use]
    pub fn ended_for(&self, reason: &'static str) -> u64 {
        self.ended.get_or_create(&ReasonLabel { reason }).get()
    }

    /// Counts chunks of one delivery, and the bytes of their frames.
    pub fn count_chunks(&self, delivery: Delivery, chunks: u64, bytes: u64) {
        let label = DeliveryLabel { delivery: delivery.name() };
        self.chunks_sent.inc_by(chunks);
        self.chunks_sent_by_delivery.get_or_create(&label).inc_by(chunks);
        self.chunk_sent_bytes.get_or_create(&label).inc_by(bytes);
    }
}
