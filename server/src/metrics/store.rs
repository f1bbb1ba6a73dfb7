//! The store that replicas share.

use super::{register, register_as, register_fixed};
use prometheus_client::metrics::counter::Counter;
use prometheus_client::metrics::gauge::Gauge;
use prometheus_client::metrics::histogram::{Histogram, exponential_buckets};
use prometheus_client::registry::Registry;

/// Metrics of the store.
#[derive(Debug)]
pub struct StoreMetrics {
    /// Reads that returned a valid chunk.
    pub hits: Counter,
    /// Reads of chunks that the store does not have.
    pub misses: Counter,
    /// Reads that took longer than the chunk was worth.
    pub reads_late: Counter,
    /// Reads of objects that were no valid chunk, or no valid index of a pack.
    pub reads_invalid: Counter,
    /// Reads that failed or were not answered at all.
    pub reads_failed: Counter,
    /// Reads not sent: making the chunk is quicker, too many are in flight, or the store is late or
    /// fails.
    pub reads_skipped: Counter,
    /// Chunks written.
    pub writes: Counter,
    /// Writes that failed or were not answered.
    pub writes_failed: Counter,
    /// Writes that the store refused.
    pub writes_refused: Counter,
    /// Writes not sent: the queue was full or the breaker open.
    pub writes_dropped: Counter,
    /// Writes not sent: making the chunk again is quicker than reading it.
    pub writes_skipped: Counter,
    /// Time per read.
    pub read_seconds: Histogram,
    /// Time per write.
    pub write_seconds: Histogram,
    /// 1 while the store answers.
    pub up: Gauge,
}

impl StoreMetrics {
    pub(super) fn register(registry: &mut Registry) -> Self {
        let [hits, misses, reads_late, reads_invalid, reads_failed, reads_skipped] = register_fixed(
            registry,
            "store_reads",
            "Reads from the store by outcome",
            "outcome",
            ["hit", "miss", "late", "invalid", "failed", "skipped"],
        );
        let [writes, writes_failed, writes_refused, writes_dropped, writes_skipped] = register_fixed(
            registry,
            "store_writes",
            "Writes to the store by outcome",
            "outcome",
            ["written", "failed", "refused", "dropped", "skipped"],
        );
        // 0.2 ms: a local folder. A read without an answer takes longer than its timeout: 2 s, or
        // the least wait of a chunk, which is 10 s at most.
        let read_seconds = register_as(
            registry,
            "store_read_duration_seconds",
            "Time per read from the store",
            Histogram::new(exponential_buckets(0.0002, 2.0, 14).chain([2.0, 5.0, 10.0])),
        );
        let write_seconds = register_as(
            registry,
            "store_write_duration_seconds",
            "Time per write to the store",
            Histogram::new(exponential_buckets(0.0002, 2.0, 15)),
        );
        let up = register(registry, "store_up", "1 while the store answers, be it late");
        Self {
            hits,
            misses,
            reads_late,
            reads_invalid,
            reads_failed,
            reads_skipped,
            writes,
            writes_failed,
            writes_refused,
            writes_dropped,
            writes_skipped,
            read_seconds,
            write_seconds,
            up,
        }
    }
}
