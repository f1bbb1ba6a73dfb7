//! View selection, requests for frames, generation and encoding.

use super::{register, register_as, register_fixed};
use prometheus_client::metrics::counter::Counter;
use prometheus_client::metrics::gauge::Gauge;
use prometheus_client::metrics::histogram::{Histogram, exponential_buckets};
use prometheus_client::registry::Registry;
use std::sync::atomic::AtomicU64;

/// Metrics of generation.
#[derive(Debug)]
pub struct GenerationMetrics {
    /// Views selected.
    pub views_selected: Counter,
    /// Views replaced by a newer one before their selection finished.
    pub views_superseded: Counter,
    /// Time of the generation threads in view selection, superseded views included.
    pub view_busy_seconds: Counter<f64, AtomicU64>,
    /// Time per selected view.
    pub view_seconds: Histogram,
    /// Frame requests served from memory.
    pub cache_hits: Counter,
    /// Frame requests that joined a queued or running job.
    pub coalesced: Counter,
    /// Frame requests that queued a job.
    pub enqueued: Counter,
    /// Frame requests rejected because the queue was full.
    pub rejected: Counter,
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
    pub seconds: Histogram,
    /// Frames encoded with the fast encoding.
    pub encoded_fast: Counter,
    /// Frames encoded with the compact encoding.
    pub encoded_compact: Counter,
}

impl GenerationMetrics {
    pub(super) fn register(registry: &mut Registry) -> Self {
        let [views_selected, views_superseded] =
            register_fixed(registry, "views", "Views by outcome", "outcome", ["selected", "superseded"]);
        let view_busy_seconds = register(
            registry,
            "view_selection_busy_seconds",
            "Time of the generation threads in view selection",
        );
        // 50 us to 0.4 s: a static view of 1 km takes the least, a moving one of 16,384 chunks the
        // most.
        let view_seconds = register_as(
            registry,
            "view_selection_duration_seconds",
            "Time per selected view",
            Histogram::new(exponential_buckets(0.00005, 2.0, 14)),
        );
        let [cache_hits, coalesced, enqueued, rejected] = register_fixed(
            registry,
            "frame_requests",
            "Frame requests by outcome",
            "outcome",
            ["cache_hit", "coalesced", "enqueued", "rejected"],
        );
        let [jobs_completed, jobs_failed, jobs_cancelled, jobs_expired] = register_fixed(
            registry,
            "generation_jobs",
            "Generation jobs by outcome",
            "outcome",
            ["completed", "failed", "cancelled", "expired"],
        );
        let pending_jobs = register(registry, "generation_pending_jobs", "Generation jobs queued or running");
        // 0.1 ms to 0.8 s: a sea chunk takes the least, a coarse chunk with its measured error the
        // most.
        let seconds = register_as(
            registry,
            "generation_duration_seconds",
            "Time of generation and encoding per generated chunk, without reads",
            Histogram::new(exponential_buckets(0.0001, 2.0, 14)),
        );
        let [encoded_fast, encoded_compact] = register_fixed(
            registry,
            "frames_encoded",
            "Frames encoded by effort",
            "effort",
            ["fast", "compact"],
        );
        Self {
            views_selected,
            views_superseded,
            view_busy_seconds,
            view_seconds,
            cache_hits,
            coalesced,
            enqueued,
            rejected,
            jobs_completed,
            jobs_failed,
            jobs_cancelled,
            jobs_expired,
            pending_jobs,
            seconds,
            encoded_fast,
            encoded_compact,
        }
    }

    /// Frame requests of all outcomes.
    #[must_use]
    pub fn frame_requests(&self) -> u64 {
        [&self.cache_hits, &self.coalesced, &self.enqueued, &self.rejected].map(Counter::get).iter().sum()
    }
}
