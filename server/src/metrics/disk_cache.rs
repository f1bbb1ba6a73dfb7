//! The cache on disk.

use super::{register, register_fixed};
use prometheus_client::metrics::counter::Counter;
use prometheus_client::metrics::gauge::Gauge;
use prometheus_client::registry::Registry;

/// Metrics of the cache on disk.
#[derive(Debug)]
pub struct DiskCacheMetrics {
    /// Reads that returned a frame.
    pub hits: Counter,
    /// Reads that returned no frame.
    pub misses: Counter,
    /// Frames written.
    pub writes: Counter,
    /// Frames not written: the queue was full or the folder is unavailable.
    pub dropped: Counter,
    /// Invalid frames, deleted.
    pub corrupt: Counter,
    /// IO errors.
    pub io_errors: Counter,
    /// Reads given up after their timeout.
    pub timeouts: Counter,
    /// Frames deleted to keep the budget.
    pub evictions: Counter,
    /// Bytes in whole blocks, as far as counted.
    pub bytes: Gauge,
    /// 1 while frames can be written.
    pub up: Gauge,
}

impl DiskCacheMetrics {
    pub(super) fn register(registry: &mut Registry) -> Self {
        let [hits, misses] = register_fixed(
            registry,
            "disk_cache_reads",
            "Reads from the disk cache by outcome",
            "outcome",
            ["hit", "miss"],
        );
        let [writes, dropped] = register_fixed(
            registry,
            "disk_cache_writes",
            "Writes to the disk cache by outcome",
            "outcome",
            ["written", "dropped"],
        );
        let [corrupt, io_errors, timeouts] = register_fixed(
            registry,
            "disk_cache_errors",
            "Errors of the disk cache by reason",
            "reason",
            ["corrupt", "io", "timeout"],
        );
        Self {
            hits,
            misses,
            writes,
            dropped,
            corrupt,
            io_errors,
            timeouts,
            evictions: register(registry, "disk_cache_evictions", "Frames deleted to keep the budget"),
            bytes: register(registry, "disk_cache_bytes", "Bytes on disk in whole blocks, as far as counted"),
            up: register(registry, "disk_cache_up", "1 while frames can be written"),
        }
    }
}
