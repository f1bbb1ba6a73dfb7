//! Map tiles and HTTP responses.

use super::{register, register_fixed};
use prometheus_client::encoding::EncodeLabelSet;
use prometheus_client::metrics::counter::Counter;
use prometheus_client::metrics::family::Family;
use prometheus_client::registry::Registry;

/// Label set of an HTTP status.
#[derive(Clone, Debug, PartialEq, Eq, Hash, EncodeLabelSet)]
struct StatusLabel {
    status: u16,
}

/// Metrics of HTTP.
#[derive(Debug)]
pub struct HttpMetrics {
    /// Map tile requests served from memory.
    pub tile_cache_hits: Counter,
    /// Map tile requests that rendered the tile.
    pub tiles_rendered: Counter,
    /// Map tile requests that were rejected or failed.
    pub tiles_failed: Counter,
    responses: Family<StatusLabel, Counter>,
}

impl HttpMetrics {
    pub(super) fn register(registry: &mut Registry) -> Self {
        let [tile_cache_hits, tiles_rendered, tiles_failed] = register_fixed(
            registry,
            "map_tile_requests",
            "Map tile requests by outcome",
            "outcome",
            ["cache_hit", "rendered", "failed"],
        );
        let responses = register(registry, "http_responses", "HTTP responses by status");
        Self { tile_cache_hits, tiles_rendered, tiles_failed, responses }
    }

    /// Counts a response.
    pub fn responded(&self, status: u16) {
        self.responses.get_or_create(&StatusLabel { status }).inc();
    }
}
