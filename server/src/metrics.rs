//! Metrics of one server in the OpenMetrics text format. There is no global registry: two servers
//! in one process count separately.
//!
//! Names follow the Prometheus conventions: base units, `_total` for counters, and one family with
//! an `outcome` or `reason` label instead of sibling counters. `docs/operations.md` lists them.

use crate::latency::LatencyHistogram;
use prometheus_client::encoding::EncodeLabelSet;
use prometheus_client::encoding::text::encode;
use prometheus_client::metrics::counter::Counter;
use prometheus_client::metrics::family::Family;
use prometheus_client::metrics::gauge::Gauge;
use prometheus_client::metrics::histogram::{Histogram, exponential_buckets};
use prometheus_client::metrics::info::Info;
use prometheus_client::registry::{Metric, Registry};
use protocol::message::RefusalReason;
use std::sync::atomic::AtomicU64;
use terrain::constants::GENERATOR_VERSION;

/// Label set of a reason.
#[derive(Clone, Debug, PartialEq, Eq, Hash, EncodeLabelSet)]
pub struct ReasonLabel {
    /// A fixed word; never a peer's text.
    pub reason: &'static str,
}

/// Label set of a delivery.
#[derive(Clone, Debug, PartialEq, Eq, Hash, EncodeLabelSet)]
pub struct DeliveryLabel {
    /// [`protocol::Delivery::name`].
    pub delivery: &'static str,
}

/// Label set of an HTTP status.
#[derive(Clone, Debug, PartialEq, Eq, Hash, EncodeLabelSet)]
pub struct StatusLabel {
    /// The status code.
    pub status: u16,
}

/// Label set of a rejected request.
#[derive(Clone, Debug, PartialEq, Eq, Hash, EncodeLabelSet)]
struct RejectionLabel {
    transport: &'static str,
    reason: String,
}

/// A family of fixed counters with one label.
type FixedFamily = Family<[(&'static str, &'static str); 1], Counter>;

/// All metrics of one server. Every field is cheap to clone and to update.
#[derive(Debug)]
pub struct Metrics {
    registry: Registry,
    /// Open sessions.
    pub sessions: Gauge,
    /// Sessions that may be open.
    pub sessions_limit: Gauge,
    /// Ended sessions by reason.
    pub sessions_ended: Family<ReasonLabel, Counter>,
    /// Open connections that are no sessions.
    pub connections: Gauge,
    /// Connections over the limit per client network, closed after accept.
    pub connections_rejected: Counter,
    /// Connections that ended before a request by reason.
    pub connections_failed: Family<ReasonLabel, Counter>,
    /// 1 while the tokens' file has changed and cannot be read.
    pub tokens_reload_failed: Gauge,
    /// Likewise the files of the certificate and its key.
    pub certificate_reload_failed: Gauge,
    /// Unknown tokens that clients presented.
    pub tokens_wrong: Counter,
    /// Tokens that were presented after their end.
    pub tokens_expired: Counter,
    /// Tokens that were not looked at, because the address had guessed too often.
    pub tokens_throttled: Counter,
    /// Chunks sent over sessions, all deliveries. Not exported; see `chunks_sent_by_delivery`.
    pub chunks_sent: Counter,
    /// Chunks sent over sessions by delivery.
    pub chunks_sent_by_delivery: Family<DeliveryLabel, Counter>,
    /// Bytes of these chunks' frames by delivery.
    pub chunk_sent_bytes: Family<DeliveryLabel, Counter>,
    /// Bytes of all messages sent over sessions.
    pub sent_bytes: Counter,
    /// From the request of a chunk by a session to the end of its write.
    pub latency: LatencyHistogram,
    /// Rejected requests by transport and reason.
    requests_rejected: Family<RejectionLabel, Counter>,
    /// The counters of the WebSocket transport.
    session_rejections: [Counter; RefusalReason::ALL.len()],
    /// Requests and views delayed by the rate limit.
    pub rate_limit_delays: Counter,
    /// Requests rejected by the rate limit.
    pub rate_limit_rejections: Counter,
    /// Pauses of the refusal back-off.
    pub refusal_backoffs: Counter,
    /// Views selected.
    pub views_selected: Counter,
    /// Views replaced by a newer one before their selection finished.
    pub views_superseded: Counter,
    /// Time of the generation threads in view selection, superseded views included.
    pub view_busy_seconds: Counter<f64, AtomicU64>,
    /// Time per selected view.
    pub view_selection_seconds: Histogram,
    /// Frame requests served from memory.
    pub frame_cache_hits: Counter,
    /// Frame requests that joined a queued or running job.
    pub frames_coalesced: Counter,
    /// Frame requests that queued a job.
    pub frames_enqueued: Counter,
    /// Frame requests rejected because the queue was full.
    pub frames_rejected: Counter,
    /// Jobs that generated a chunk.
    pub jobs_completed: Counter,
    /// Jobs that panicked.
    pub jobs_failed: Counter,
    /// Requests and jobs cancelled by their clients.
    pub jobs_cancelled: Counter,
    /// Requests rejected because they exceeded the deadline.
    pub jobs_expired: Counter,
    /// Jobs queued or running.
    pub pending_jobs: Gauge,
    /// Time of generation and encoding per generated chunk.
    pub generation_seconds: Histogram,
    /// Frames encoded with the fast encoding.
    pub frames_encoded_fast: Counter,
    /// Frames encoded with the compact encoding.
    pub frames_encoded_compact: Counter,
    /// Reads from disk that returned a frame.
    pub disk_hits: Counter,
    /// Reads from disk that returned no frame.
    pub disk_misses: Counter,
    /// Frames written to disk.
    pub disk_writes: Counter,
    /// Frames not written: the queue was full or the folder is unavailable.
    pub disk_dropped: Counter,
    /// Frames deleted to keep the budget.
    pub disk_evictions: Counter,
    /// Invalid frames on disk, deleted.
    pub disk_corrupt: Counter,
    /// Reads over the deadline.
    pub disk_timeouts: Counter,
    /// IO errors.
    pub disk_io_errors: Counter,
    /// Bytes on disk in whole blocks, as far as counted.
    pub disk_bytes: Gauge,
    /// 1 while frames can be written.
    pub disk_up: Gauge,
    /// Reads from the store that returned a valid chunk.
    pub store_hits: Counter,
    /// Reads of chunks that the store does not have.
    pub store_misses: Counter,
    /// Reads that took longer than the chunk was worth.
    pub store_reads_late: Counter,
    /// Objects that were no valid chunk.
    pub store_reads_invalid: Counter,
    /// Reads that failed or were not answered at all.
    pub store_reads_failed: Counter,
    /// Reads not sent: making the chunk is quicker, too many are in flight, or the store is late or
    /// fails.
    pub store_reads_skipped: Counter,
    /// Chunks written to the store.
    pub store_writes: Counter,
    /// Writes that failed or were not answered.
    pub store_writes_failed: Counter,
    /// Writes that the store refused.
    pub store_writes_refused: Counter,
    /// Writes not sent: the queue was full or the breaker open.
    pub store_writes_dropped: Counter,
    /// Writes not sent: making the chunk again is quicker than reading it.
    pub store_writes_skipped: Counter,
    /// Time per read from the store.
    pub store_read_seconds: Histogram,
    /// Time per write to the store.
    pub store_write_seconds: Histogram,
    /// 1 while the store answers.
    pub store_up: Gauge,
    /// Memory in use that counts against the limit, bytes.
    pub memory_used_bytes: Gauge,
    /// Memory that the process may use, bytes; 0 if that is not known.
    pub memory_limit_bytes: Gauge,
    /// Map tile requests served from memory.
    pub tile_cache_hits: Counter,
    /// Map tile requests that rendered the tile.
    pub tiles_rendered: Counter,
    /// Map tile requests that were rejected or failed.
    pub tiles_failed: Counter,
    /// HTTP responses by status.
    pub http_responses: Family<StatusLabel, Counter>,
}

impl Default for Metrics {
    fn default() -> Self {
        let mut metrics = Self {
            registry: Registry::with_prefix("tombolo"),
            sessions: Gauge::default(),
            sessions_limit: Gauge::default(),
            sessions_ended: Family::default(),
            connections: Gauge::default(),
            connections_rejected: Counter::default(),
            connections_failed: Family::default(),
            tokens_reload_failed: Gauge::default(),
            certificate_reload_failed: Gauge::default(),
            tokens_wrong: Counter::default(),
            tokens_expired: Counter::default(),
            tokens_throttled: Counter::default(),
            chunks_sent: Counter::default(),
            chunks_sent_by_delivery: Family::default(),
            chunk_sent_bytes: Family::default(),
            sent_bytes: Counter::default(),
            latency: LatencyHistogram::default(),
            requests_rejected: Family::default(),
            session_rejections: Default::default(),
            rate_limit_delays: Counter::default(),
            rate_limit_rejections: Counter::default(),
            refusal_backoffs: Counter::default(),
            views_selected: Counter::default(),
            views_superseded: Counter::default(),
            view_busy_seconds: Counter::default(),
            // 50 us to 0.4 s: a static view of 1 km takes the least, a moving one of 16,384 chunks
            // the most.
            view_selection_seconds: Histogram::new(exponential_buckets(0.00005, 2.0, 14)),
            frame_cache_hits: Counter::default(),
            frames_coalesced: Counter::default(),
            frames_enqueued: Counter::default(),
            frames_rejected: Counter::default(),
            jobs_completed: Counter::default(),
            jobs_failed: Counter::default(),
            jobs_cancelled: Counter::default(),
            jobs_expired: Counter::default(),
            pending_jobs: Gauge::default(),
            // 0.1 ms to 0.8 s: a sea chunk takes the least, a coarse chunk with its measured error
            // the most.
            generation_seconds: Histogram::new(exponential_buckets(0.0001, 2.0, 14)),
            frames_encoded_fast: Counter::default(),
            frames_encoded_compact: Counter::default(),
            disk_hits: Counter::default(),
            disk_misses: Counter::default(),
            disk_writes: Counter::default(),
            disk_dropped: Counter::default(),
            disk_evictions: Counter::default(),
            disk_corrupt: Counter::default(),
            disk_timeouts: Counter::default(),
            disk_io_errors: Counter::default(),
            disk_bytes: Gauge::default(),
            disk_up: Gauge::default(),
            store_hits: Counter::default(),
            store_misses: Counter::default(),
            store_reads_late: Counter::default(),
            store_reads_invalid: Counter::default(),
            store_reads_failed: Counter::default(),
            store_reads_skipped: Counter::default(),
            store_writes: Counter::default(),
            store_writes_failed: Counter::default(),
            store_writes_refused: Counter::default(),
            store_writes_dropped: Counter::default(),
            store_writes_skipped: Counter::default(),
            // 0.2 ms to 3 s: a local folder, and the timeout.
            store_read_seconds: Histogram::new(exponential_buckets(0.0002, 2.0, 14)),
            store_write_seconds: Histogram::new(exponential_buckets(0.0002, 2.0, 15)),
            store_up: Gauge::default(),
            memory_used_bytes: Gauge::default(),
            memory_limit_bytes: Gauge::default(),
            tile_cache_hits: Counter::default(),
            tiles_rendered: Counter::default(),
            tiles_failed: Counter::default(),
            http_responses: Family::default(),
        };
        metrics.register_build();
        metrics.register_sessions();
        metrics.register_limits();
        metrics.register_generation();
        metrics.register_disk_cache();
        metrics.register_store();
        metrics.register_http();
        metrics
    }
}

impl Metrics {
    fn register_build(&mut self) {
        let labels = [
            ("version", env!("CARGO_PKG_VERSION").to_owned()),
            ("generator_version", GENERATOR_VERSION.to_string()),
        ];
        self.registry.register("build", "Version of the program and of its land", Info::new(labels.to_vec()));
    }

    fn register_sessions(&mut self) {
        self.register("sessions", "Open sessions", &self.sessions.clone());
        self.register("sessions_limit", "Sessions that may be open", &self.sessions_limit.clone());
        self.register("sessions_ended", "Ended sessions by reason", &self.sessions_ended.clone());
        self.register(
            "chunks_sent",
            "Chunks sent over sessions by delivery",
            &self.chunks_sent_by_delivery.clone(),
        );
        self.register(
            "chunk_sent_bytes",
            "Bytes of chunk frames sent over sessions by delivery",
            &self.chunk_sent_bytes.clone(),
        );
        self.register(
            "session_sent_bytes",
            "Bytes of all messages sent over sessions",
            &self.sent_bytes.clone(),
        );
        self.register(
            "chunk_latency_seconds",
            "From the request of a chunk by a session to the end of its write",
            &self.latency.clone(),
        );
    }

    fn register_limits(&mut self) {
        self.register(
            "memory_used_bytes",
            "Memory in use that counts against the limit",
            &self.memory_used_bytes.clone(),
        );
        self.register(
            "memory_limit_bytes",
            "Memory that the process may use; 0 if not known",
            &self.memory_limit_bytes.clone(),
        );
        self.register("connections", "Open connections that are no sessions", &self.connections.clone());
        self.register(
            "connections_rejected",
            "Connections over the limit per client network",
            &self.connections_rejected.clone(),
        );
        self.register(
            "connections_failed",
            "Connections that ended before a request by reason",
            &self.connections_failed.clone(),
        );
        let reloads: Family<[(&'static str, &'static str); 1], Gauge> = Family::default();
        for (file, gauge) in
            [("tokens", &mut self.tokens_reload_failed), ("certificate", &mut self.certificate_reload_failed)]
        {
            *gauge = reloads.get_or_create_owned(&[("file", file)]);
        }
        self.register("reload_failed", "1 while a changed file cannot be read", &reloads);
        let refused = fixed_family(
            "outcome",
            [
                ("wrong", &mut self.tokens_wrong),
                ("expired", &mut self.tokens_expired),
                ("throttled", &mut self.tokens_throttled),
            ],
        );
        self.register("tokens_refused", "Refused tokens by outcome", &refused);
        for (reason, counter) in RefusalReason::ALL.iter().zip(&mut self.session_rejections) {
            let label = RejectionLabel { transport: "websocket", reason: label_value(reason.name()) };
            *counter = self.requests_rejected.get_or_create_owned(&label);
        }
        self.register(
            "requests_rejected",
            "Rejected requests by transport and reason",
            &self.requests_rejected.clone(),
        );
        let rate_limited = fixed_family(
            "outcome",
            [("delayed", &mut self.rate_limit_delays), ("rejected", &mut self.rate_limit_rejections)],
        );
        self.register("rate_limited", "Actions of the rate limiter by outcome", &rate_limited);
        self.register("refusal_backoffs", "Pauses of the refusal back-off", &self.refusal_backoffs.clone());
    }

    fn register_generation(&mut self) {
        let views = fixed_family(
            "outcome",
            [("selected", &mut self.views_selected), ("superseded", &mut self.views_superseded)],
        );
        self.register("views", "Views by outcome", &views);
        self.register(
            "view_selection_busy_seconds",
            "Time of the generation threads in view selection",
            &self.view_busy_seconds.clone(),
        );
        self.register(
            "view_selection_duration_seconds",
            "Time per selected view",
            &self.view_selection_seconds.clone(),
        );
        let requests = fixed_family(
            "outcome",
            [
                ("cache_hit", &mut self.frame_cache_hits),
                ("coalesced", &mut self.frames_coalesced),
                ("enqueued", &mut self.frames_enqueued),
                ("rejected", &mut self.frames_rejected),
            ],
        );
        self.register("frame_requests", "Frame requests by outcome", &requests);
        let jobs = fixed_family(
            "outcome",
            [
                ("completed", &mut self.jobs_completed),
                ("failed", &mut self.jobs_failed),
                ("cancelled", &mut self.jobs_cancelled),
                ("expired", &mut self.jobs_expired),
            ],
        );
        self.register("generation_jobs", "Generation jobs by outcome", &jobs);
        self.register(
            "generation_pending_jobs",
            "Generation jobs queued or running",
            &self.pending_jobs.clone(),
        );
        self.register(
            "generation_duration_seconds",
            "Time of generation and encoding per generated chunk, without reads",
            &self.generation_seconds.clone(),
        );
        let encoded = fixed_family(
            "effort",
            [("fast", &mut self.frames_encoded_fast), ("compact", &mut self.frames_encoded_compact)],
        );
        self.register("frames_encoded", "Frames encoded by effort", &encoded);
    }

    fn register_disk_cache(&mut self) {
        let reads = fixed_family("outcome", [("hit", &mut self.disk_hits), ("miss", &mut self.disk_misses)]);
        self.register("disk_cache_reads", "Reads from the disk cache by outcome", &reads);
        let writes = fixed_family(
            "outcome",
            [("written", &mut self.disk_writes), ("dropped", &mut self.disk_dropped)],
        );
        self.register("disk_cache_writes", "Writes to the disk cache by outcome", &writes);
        let errors = fixed_family(
            "reason",
            [
                ("corrupt", &mut self.disk_corrupt),
                ("io", &mut self.disk_io_errors),
                ("timeout", &mut self.disk_timeouts),
            ],
        );
        self.register("disk_cache_errors", "Errors of the disk cache by reason", &errors);
        self.register(
            "disk_cache_evictions",
            "Frames deleted to keep the budget",
            &self.disk_evictions.clone(),
        );
        self.register(
            "disk_cache_bytes",
            "Bytes on disk in whole blocks, as far as counted",
            &self.disk_bytes.clone(),
        );
        self.register("disk_cache_up", "1 while frames can be written", &self.disk_up.clone());
    }

    fn register_store(&mut self) {
        let reads = fixed_family(
            "outcome",
            [
                ("hit", &mut self.store_hits),
                ("miss", &mut self.store_misses),
                ("late", &mut self.store_reads_late),
                ("invalid", &mut self.store_reads_invalid),
                ("failed", &mut self.store_reads_failed),
                ("skipped", &mut self.store_reads_skipped),
            ],
        );
        self.register("store_reads", "Reads from the store by outcome", &reads);
        let writes = fixed_family(
            "outcome",
            [
                ("written", &mut self.store_writes),
                ("failed", &mut self.store_writes_failed),
                ("refused", &mut self.store_writes_refused),
                ("dropped", &mut self.store_writes_dropped),
                ("skipped", &mut self.store_writes_skipped),
            ],
        );
        self.register("store_writes", "Writes to the store by outcome", &writes);
        self.register(
            "store_read_duration_seconds",
            "Time per read from the store",
            &self.store_read_seconds.clone(),
        );
        self.register(
            "store_write_duration_seconds",
            "Time per write to the store",
            &self.store_write_seconds.clone(),
        );
        self.register("store_up", "1 while the store answers, be it late", &self.store_up.clone());
    }

    fn register_http(&mut self) {
        let tiles = fixed_family(
            "outcome",
            [
                ("cache_hit", &mut self.tile_cache_hits),
                ("rendered", &mut self.tiles_rendered),
                ("failed", &mut self.tiles_failed),
            ],
        );
        self.register("map_tile_requests", "Map tile requests by outcome", &tiles);
        self.register("http_responses", "HTTP responses by status", &self.http_responses.clone());
    }

    fn register<M: Metric + Clone>(&mut self, name: &str, help: &str, metric: &M) {
        self.registry.register(name, help, metric.clone());
    }

    /// Creates the counters of ends of sessions and of connections, so that a rate includes the
    /// first event.
    pub fn declare_ends(
        &self,
        of_sessions: impl IntoIterator<Item = &'static str>,
        of_connections: impl IntoIterator<Item = &'static str>,
    ) {
        for reason in of_sessions {
            drop(self.sessions_ended.get_or_create(&ReasonLabel { reason }));
        }
        for reason in of_connections {
            drop(self.connections_failed.get_or_create(&ReasonLabel { reason }));
        }
    }

    /// Creates the counters of HTTP rejections, likewise.
    pub fn declare_http_rejections(&self, reasons: impl IntoIterator<Item = &'static str>) {
        for reason in reasons {
            drop(self.requests_rejected.get_or_create(&http_label(reason)));
        }
    }

    /// Counts a rejected HTTP request.
    pub fn http_request_rejected(&self, reason: &'static str) {
        self.requests_rejected.get_or_create(&http_label(reason)).inc();
    }

    /// Counts rejected requests of a session.
    pub fn request_rejected(&self, reason: RefusalReason, count: u64) {
        self.session_rejections[reason.index()].inc_by(count);
    }

    /// Frame requests of all outcomes.
    #[must_use]
    pub fn frame_requests(&self) -> u64 {
        [&self.frame_cache_hits, &self.frames_coalesced, &self.frames_enqueued, &self.frames_rejected]
            .map(Counter::get)
            .iter()
            .sum()
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

fn http_label(reason: &str) -> RejectionLabel {
    RejectionLabel { transport: "http", reason: label_value(reason) }
}

/// A label value in snake case.
fn label_value(name: &str) -> String {
    name.replace([' ', '-'], "_")
}

/// A family with one counter per value of a label; replaces the counters by those of the family.
fn fixed_family<const N: usize>(
    label: &'static str,
    counters: [(&'static str, &mut Counter); N],
) -> FixedFamily {
    let family = FixedFamily::default();
    for (value, counter) in counters {
        *counter = family.get_or_create_owned(&[(label, value)]);
    }
    family
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn metrics_are_rendered_with_prefix_and_labels() {
        let metrics = Metrics::default();
        metrics.jobs_completed.inc();
        metrics.sessions_ended.get_or_create(&ReasonLabel { reason: "closed" }).inc_by(2);
        metrics.declare_http_rejections(["no-route"]);
        metrics.request_rejected(RefusalReason::Overloaded, 3);
        let text = metrics.render();
        for line in [
            "tombolo_generation_jobs_total{outcome=\"completed\"} 1",
            "tombolo_generation_jobs_total{outcome=\"failed\"} 0",
            "tombolo_sessions_ended_total{reason=\"closed\"} 2",
            "tombolo_requests_rejected_total{transport=\"http\",reason=\"no_route\"} 0",
            "tombolo_requests_rejected_total{transport=\"websocket\",reason=\"overloaded\"} 3",
        ] {
            assert!(text.lines().any(|found| found == line), "{line} is not in {text}");
        }
        assert!(text.ends_with("# EOF\n"));
    }
}
