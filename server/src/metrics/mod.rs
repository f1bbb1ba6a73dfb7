//! Metrics of one server in the OpenMetrics text format. There is no global registry: two servers
//! in one process count separately.
//!
//! Names follow the Prometheus conventions: base units, `_total` for counters, and one family with
//! an `outcome` or `reason` label instead of sibling counters. `docs/operations.md` lists them.
//! Each submodule has those of one part of the server; registering a metric returns it.

mod disk_cache;
mod generation;
mod http;
mod limits;
mod sessions;
mod store;

pub use disk_cache::DiskCacheMetrics;
pub use generation::GenerationMetrics;
pub use http::HttpMetrics;
pub use limits::LimitMetrics;
pub use sessions::SessionMetrics;
pub use store::StoreMetrics;

use prometheus_client::encoding::EncodeLabelSet;
use prometheus_client::encoding::text::encode;
use prometheus_client::metrics::family::Family;
use prometheus_client::metrics::info::Info;
use prometheus_client::registry::{Metric, Registry};
use terrain::constants::GENERATOR_VERSION;

/// A family of fixed metrics with one label.
type FixedFamily<M> = Family<[(&'static str, &'static str); 1], M>;

/// Label set of a reason.
#[derive(Clone, Debug, PartialEq, Eq, Hash, EncodeLabelSet)]
struct ReasonLabel {
    /// A fixed word; never a peer's text.
    reason: &'static str,
}

/// All metrics of one server. Every one is cheap to clone and to update.
#[derive(Debug)]
pub struct Metrics {
    registry: Registry,
    /// Sessions and what they were sent.
    pub sessions: SessionMetrics,
    /// Memory, connections, tokens and rejections.
    pub limits: LimitMetrics,
    /// View selection, frames and generation.
    pub generation: GenerationMetrics,
    /// The cache on disk.
    pub disk_cache: DiskCacheMetrics,
    /// The store that replicas share.
    pub store: StoreMetrics,
    /// Map tiles and HTTP responses.
    pub http: HttpMetrics,
}

impl Default for Metrics {
    fn default() -> Self {
        let mut registry = Registry::with_prefix("tombolo");
        register_build(&mut registry);
        Self {
            sessions: SessionMetrics::register(&mut registry),
            limits: LimitMetrics::register(&mut registry),
            generation: GenerationMetrics::register(&mut registry),
            disk_cache: DiskCacheMetrics::register(&mut registry),
            store: StoreMetrics::register(&mut registry),
            http: HttpMetrics::register(&mut registry),
            registry,
        }
    }
}

impl Metrics {
    /// The OpenMetrics text of all values.
    #[must_use]
    pub fn render(&self) -> String {
        let mut text = String::new();
        // Writing to a string cannot fail.
        let _ = encode(&mut text, &self.registry);
        text
    }
}

fn register_build(registry: &mut Registry) {
    let labels = [
        ("version", env!("CARGO_PKG_VERSION").to_owned()),
        ("generator_version", GENERATOR_VERSION.to_string()),
    ];
    registry.register("build", "Version of the program and of its land", Info::new(labels.to_vec()));
}

/// Registers a metric that starts from its default.
fn register<M: Metric + Clone + Default>(registry: &mut Registry, name: &str, help: &str) -> M {
    register_as(registry, name, help, M::default())
}

/// Registers a metric that has no default, or one with parameters.
fn register_as<M: Metric + Clone>(registry: &mut Registry, name: &str, help: &str, metric: M) -> M {
    registry.register(name, help, metric.clone());
    metric
}

/// Registers a family with one metric per value of a label; returns them in the order of the
/// values.
fn register_fixed<M, const N: usize>(
    registry: &mut Registry,
    name: &str,
    help: &str,
    label: &'static str,
    values: [&'static str; N],
) -> [M; N]
where
    M: Clone + Default,
    FixedFamily<M>: Metric,
{
    let family: FixedFamily<M> = register(registry, name, help);
    values.map(|value| family.get_or_create_owned(&[(label, value)]))
}

/// A label value in snake case.
fn label_value(name: &str) -> String {
    name.replace([' ', '-'], "_")
}

#[cfg(test)]
mod tests {
    use super::*;
    use protocol::message::RefusalReason;

    #[test]
    fn metrics_are_rendered_with_prefix_and_labels() {
        let metrics = Metrics::default();
        metrics.generation.jobs_completed.inc();
        metrics.sessions.declare_ends(["closed"]);
        metrics.sessions.ended("closed");
        metrics.sessions.ended("closed");
        metrics.limits.declare_http_rejections(["no-route"]);
        metrics.limits.request_rejected(RefusalReason::Overloaded, 3);
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
