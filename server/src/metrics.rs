//! Counters of one server, in the OpenMetrics text format. No globals: two servers in one process
//! count apart.

use crate::http::problem::Kind;
use crate::latency::Latency;
use prometheus_client::encoding::EncodeLabelSet;
use prometheus_client::encoding::text::encode;
use prometheus_client::metrics::counter::Counter;
use prometheus_client::metrics::family::Family;
use prometheus_client::metrics::gauge::Gauge;
use prometheus_client::metrics::histogram::{Histogram, exponential_buckets};
use prometheus_client::registry::Registry;
use protocol::message::RefusalReason;
use std::sync::atomic::AtomicU64;

/// A label set of one reason.
#[derive(Clone, Debug, PartialEq, Eq, Hash, EncodeLabelSet)]
pub struct Reason {
    /// A short fixed word; never a peer's text.
    pub reason: &'static str,
}

/// A label set of one delivery.
#[derive(Clone, Debug, PartialEq, Eq, Hash, EncodeLabelSet)]
pub struct DeliveryLabel {
    /// [`protocol::Delivery::name`].
    pub delivery: &'static str,
}

/// A label set of one HTTP status.
#[derive(Clone, Debug, PartialEq, Eq, Hash, EncodeLabelSet)]
pub struct Status {
    /// The status code.
    pub status: u16,
}

/// All metrics of one server. Every field is cheap to clone and to count.
#[derive(Debug)]
pub struct Metrics {
    registry: Registry,
    /// Sessions open now.
    pub sessions: Gauge,
    /// Sessions ended, by reason.
    pub session_ends: Family<Reason, Counter>,
    /// Chunks sent over sessions.
    pub chunks_sent: Counter,
    /// Bytes of frames sent over sessions.
    pub bytes_sent: Counter,
    /// Chunks sent over sessions, by the delivery that the client chose.
    pub chunks_delivered: Family<DeliveryLabel, Counter>,
    /// Bytes of their frames, likewise.
    pub chunk_bytes_delivered: Family<DeliveryLabel, Counter>,
    /// Refusals sent inside sessions.
    pub refusals: Counter,
    /// The same by reason; every reason is there from the start, so that a rate can be taken of the
    /// first one.
    refusals_by_reason: [Counter; RefusalReason::ALL.len()],
    /// Views selected.
    pub views: Counter,
    /// Views replaced by a newer one before they were selected.
    pub superseded_views: Counter,
    /// Seconds that generation threads spent on views, those that nobody waited for in the end
    /// included.
    pub view_seconds: Counter<f64, AtomicU64>,
    /// Seconds per selected view.
    pub view_selection_seconds: Histogram,
    /// Frames asked of the generation service.
    pub requested: Counter,
    /// Of these, answered from the cache.
    pub cache_hits: Counter,
    /// Of these, joined to a job that was already queued or running.
    pub coalesced: Counter,
    /// Of these, refused because the queue was full.
    pub shed: Counter,
    /// Of these, refused because they waited beyond the deadline.
    pub expired: Counter,
    /// Sessions refused because their address has too many.
    pub address_refusals: Counter,
    /// Connections open that are no sessions.
    pub connections: Gauge,
    /// Connections closed at once because their address has too many.
    pub connection_refusals: Counter,
    /// Requests refused because their address has spent what it may cost.
    pub cost_refusals: Counter,
    /// Times that somebody had to wait for that reason.
    pub cost_waits: Counter,
    /// Times that a session was not listened to for a while because it was refused much.
    pub refusal_pauses: Counter,
    /// Jobs run to the end.
    pub generated: Counter,
    /// Frames coded in haste, because much was waiting.
    pub hasty: Counter,
    /// Jobs dropped unrun because nobody waited any more.
    pub cancelled: Counter,
    /// Jobs that panicked.
    pub failed: Counter,
    /// Jobs queued or running.
    pub queue: Gauge,
    /// Seconds per generated chunk.
    pub generation_seconds: Histogram,
    /// Frames found on disk.
    pub disk_hits: Counter,
    /// Frames looked for on disk in vain.
    pub disk_misses: Counter,
    /// Frames written to disk.
    pub disk_writes: Counter,
    /// Frames not written: the queue was full or the folder cannot be used.
    pub disk_dropped: Counter,
    /// Frames on disk that were not what this server would send.
    pub disk_damaged: Counter,
    /// Frames deleted to keep the budget.
    pub disk_evicted: Counter,
    /// Errors of the system about the folder.
    pub disk_faults: Counter,
    /// Bytes on disk as far as they are counted, in whole blocks.
    pub disk_bytes: Gauge,
    /// 1 while frames can be written.
    pub disk_working: Gauge,
    /// Reads that took too long.
    pub disk_slow: Counter,
    /// From the moment that a session takes a chunk up to the moment that it is written.
    pub latency: Latency,
    /// Tiles of the map asked for.
    pub tiles_requested: Counter,
    /// Of these, answered from the cache.
    pub tile_cache_hits: Counter,
    /// Of these, painted.
    pub tiles_painted: Counter,
    /// HTTP responses, by status.
    pub http_responses: Family<Status, Counter>,
    /// HTTP requests refused, by kind; every kind is there from the start.
    http_refusals: [Counter; Kind::ALL.len()],
}

impl Default for Metrics {
    fn default() -> Self {
        let mut metrics = Self {
            registry: Registry::with_prefix("tombolo"),
            sessions: Gauge::default(),
            session_ends: Family::default(),
            chunks_sent: Counter::default(),
            bytes_sent: Counter::default(),
            chunks_delivered: Family::default(),
            chunk_bytes_delivered: Family::default(),
            refusals: Counter::default(),
            refusals_by_reason: Default::default(),
            expired: Counter::default(),
            address_refusals: Counter::default(),
            connections: Gauge::default(),
            connection_refusals: Counter::default(),
            cost_refusals: Counter::default(),
            cost_waits: Counter::default(),
            refusal_pauses: Counter::default(),
            views: Counter::default(),
            superseded_views: Counter::default(),
            view_seconds: Counter::default(),
            // 50 us to 0.4 s: a still view of 1 km takes the least, one of 16,384 chunks that moves
            // the most.
            view_selection_seconds: Histogram::new(exponential_buckets(0.00005, 2.0, 14)),
            requested: Counter::default(),
            cache_hits: Counter::default(),
            coalesced: Counter::default(),
            shed: Counter::default(),
            generated: Counter::default(),
            hasty: Counter::default(),
            cancelled: Counter::default(),
            failed: Counter::default(),
            queue: Gauge::default(),
            // 0.1 ms to 0.8 s: a sea chunk takes the least, a coarse chunk with its measured error
            // the most.
            generation_seconds: Histogram::new(exponential_buckets(0.0001, 2.0, 14)),
            disk_hits: Counter::default(),
            disk_misses: Counter::default(),
            disk_writes: Counter::default(),
            disk_dropped: Counter::default(),
            disk_damaged: Counter::default(),
            disk_evicted: Counter::default(),
            disk_faults: Counter::default(),
            disk_bytes: Gauge::default(),
            disk_working: Gauge::default(),
            disk_slow: Counter::default(),
            latency: Latency::default(),
            tiles_requested: Counter::default(),
            tile_cache_hits: Counter::default(),
            tiles_painted: Counter::default(),
            http_responses: Family::default(),
            http_refusals: Default::default(),
        };
        metrics.register();
        metrics
    }
}

impl Metrics {
    fn register(&mut self) {
        let r = &mut self.registry;
        r.register("sessions", "Sessions open now", self.sessions.clone());
        r.register("session_ends", "Sessions ended, by reason", self.session_ends.clone());
        r.register("chunks_sent", "Chunks sent over sessions", self.chunks_sent.clone());
        r.register("bytes_sent", "Bytes of frames sent over sessions", self.bytes_sent.clone());
        r.register(
            "chunks_delivered",
            "Chunks sent over sessions, by delivery",
            self.chunks_delivered.clone(),
        );
        r.register(
            "chunk_bytes_delivered",
            "Bytes of chunk frames sent over sessions, by delivery",
            self.chunk_bytes_delivered.clone(),
        );
        r.register("refusals", "Refusals sent inside sessions", self.refusals.clone());
        let by_reason = Family::<Reason, Counter>::default();
        for (reason, counter) in RefusalReason::ALL.iter().zip(&mut self.refusals_by_reason) {
            *counter = by_reason.get_or_create_owned(&Reason { reason: reason.name() });
        }
        r.register("refusals_by_reason", "Refusals sent inside sessions, by reason", by_reason);
        r.register("expired", "Frames refused because they waited beyond the deadline", self.expired.clone());
        r.register(
            "address_refusals",
            "Sessions refused because their address has too many",
            self.address_refusals.clone(),
        );
        r.register("connections", "Connections open that are no sessions", self.connections.clone());
        r.register(
            "connection_refusals",
            "Connections closed at once because their address has too many",
            self.connection_refusals.clone(),
        );
        r.register(
            "cost_refusals",
            "Requests refused because their address has spent what it may cost",
            self.cost_refusals.clone(),
        );
        r.register(
            "cost_waits",
            "Waits because an address has spent what it may cost",
            self.cost_waits.clone(),
        );
        r.register(
            "refusal_pauses",
            "Pauses in listening to a session that was refused much",
            self.refusal_pauses.clone(),
        );
        r.register("views", "Views selected", self.views.clone());
        r.register(
            "views_superseded",
            "Views replaced by a newer one before they were selected",
            self.superseded_views.clone(),
        );
        r.register(
            "view_seconds",
            "Seconds that generation threads spent on the selection of views",
            self.view_seconds.clone(),
        );
        r.register(
            "view_selection_seconds",
            "Seconds per selected view",
            self.view_selection_seconds.clone(),
        );
        r.register("frames_requested", "Frames asked of the generation service", self.requested.clone());
        r.register("cache_hits", "Frames answered from the cache", self.cache_hits.clone());
        r.register("coalesced", "Frames joined to a job under way", self.coalesced.clone());
        r.register("shed", "Frames refused because the generation queue was full", self.shed.clone());
        r.register("generated", "Generation jobs run to the end", self.generated.clone());
        r.register("hasty", "Frames coded in haste because much was waiting", self.hasty.clone());
        r.register("cancelled", "Generation jobs dropped because nobody waited", self.cancelled.clone());
        r.register("failed", "Generation jobs that panicked", self.failed.clone());
        r.register("generation_queue", "Generation jobs queued or running", self.queue.clone());
        r.register("generation_seconds", "Seconds per generated chunk", self.generation_seconds.clone());
        r.register("disk_hits", "Frames found on disk", self.disk_hits.clone());
        r.register("disk_misses", "Frames looked for on disk in vain", self.disk_misses.clone());
        r.register("disk_writes", "Frames written to disk", self.disk_writes.clone());
        r.register(
            "disk_slow",
            "Reads from disk that were given up because they took too long",
            self.disk_slow.clone(),
        );
        r.register(
            "disk_dropped",
            "Frames not written: queue full or folder unusable",
            self.disk_dropped.clone(),
        );
        r.register("disk_damaged", "Frames on disk that were refused and deleted", self.disk_damaged.clone());
        r.register("disk_evicted", "Frames deleted to keep the budget", self.disk_evicted.clone());
        r.register("disk_faults", "Errors of the system about the folder", self.disk_faults.clone());
        r.register("disk_bytes", "Bytes on disk in whole blocks, as far as counted", self.disk_bytes.clone());
        r.register("disk_working", "Whether frames can be written to disk", self.disk_working.clone());
        r.register(
            "chunk_latency_seconds",
            "From the moment that a session takes a chunk up to the moment that it is written",
            self.latency.clone(),
        );
        r.register("map_tiles_requested", "Tiles of the map asked for", self.tiles_requested.clone());
        r.register(
            "map_tile_cache_hits",
            "Tiles of the map answered from the cache",
            self.tile_cache_hits.clone(),
        );
        r.register("map_tiles_painted", "Tiles of the map painted", self.tiles_painted.clone());
        r.register("http_responses", "HTTP responses, by status", self.http_responses.clone());
        let by_kind = Family::<Reason, Counter>::default();
        for (kind, counter) in Kind::ALL.iter().zip(&mut self.http_refusals) {
            *counter = by_kind.get_or_create_owned(&Reason { reason: kind.name() });
        }
        r.register("http_refusals", "HTTP requests refused, by kind", by_kind);
    }

    /// Counts refusals of one reason.
    pub fn refused(&self, reason: RefusalReason, count: u64) {
        self.refusals.inc_by(count);
        self.refusals_by_reason[reason.index()].inc_by(count);
    }

    /// Counts a refused HTTP request.
    pub fn http_refused(&self, kind: Kind) {
        self.http_refusals[kind.index()].inc();
    }

    /// The OpenMetrics text of all values.
    #[must_use]
    pub fn render(&self) -> String {
        let mut text = String::new();
        // Writing to a string cannot fail.
        let _ = encode(&mut text, &self.registry);
        text
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_metric_is_rendered_under_the_prefix() {
        let metrics = Metrics::default();
        metrics.generated.inc();
        metrics.session_ends.get_or_create(&Reason { reason: "closed" }).inc_by(2);
        let text = metrics.render();
        assert!(text.contains("tombolo_generated_total 1"), "{text}");
        assert!(text.contains("tombolo_session_ends_total{reason=\"closed\"} 2"), "{text}");
        assert!(text.ends_with("# EOF\n"));
    }
}
