//! Memory, connections that are no sessions, tokens, and rejected requests.

use super::{ReasonLabel, label_value, register, register_fixed};
use prometheus_client::encoding::EncodeLabelSet;
use prometheus_client::metrics::counter::Counter;
use prometheus_client::metrics::family::Family;
use prometheus_client::metrics::gauge::Gauge;
use prometheus_client::registry::Registry;
use protocol::message::RefusalReason;

/// Label set of a rejected request.
#[derive(Clone, Debug, PartialEq, Eq, Hash, EncodeLabelSet)]
struct RejectionLabel {
    transport: &'static str,
    reason: String,
}

/// Metrics of what the server admits.
#[derive(Debug)]
pub struct LimitMetrics {
    /// Memory in use that counts against the limit, bytes.
    pub memory_used_bytes: Gauge,
    /// Memory that the process may use, bytes; 0 if that is not known.
    pub memory_limit_bytes: Gauge,
    /// Times that the caches in memory were cleared for lack of memory.
    pub memory_cache_clears: Counter,
    /// Open connections that are no sessions.
    pub connections: Gauge,
    /// Connections over the limits in all and per client network, closed after accept.
    pub connections_rejected: Counter,
    connections_failed: Family<ReasonLabel, Counter>,
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
    requests_rejected: Family<RejectionLabel, Counter>,
    /// The counters of the WebSocket transport.
    session_rejections: [Counter; RefusalReason::ALL.len()],
    /// Requests and views delayed by the rate limit.
    pub rate_limit_delays: Counter,
    /// Requests rejected by the rate limit.
    pub rate_limit_rejections: Counter,
    /// Pauses of the refusal back-off.
    pub refusal_backoffs: Counter,
}

impl LimitMetrics {
    pub(super) fn register(registry: &mut Registry) -> Self {
        let memory_used_bytes =
            register(registry, "memory_used_bytes", "Memory in use that counts against the limit");
        let memory_limit_bytes =
            register(registry, "memory_limit_bytes", "Memory that the process may use; 0 if not known");
        let memory_cache_clears = register(
            registry,
            "memory_cache_clears",
            "Times that the caches in memory were cleared for lack of memory",
        );
        let connections = register(registry, "connections", "Open connections that are no sessions");
        let connections_rejected = register(
            registry,
            "connections_rejected",
            "Connections over the limits in all and per client network",
        );
        let connections_failed =
            register(registry, "connections_failed", "Connections that ended before a request by reason");
        let [tokens_reload_failed, certificate_reload_failed] = register_fixed(
            registry,
            "reload_failed",
            "1 while a changed file cannot be read",
            "file",
            ["tokens", "certificate"],
        );
        let [tokens_wrong, tokens_expired, tokens_throttled] = register_fixed(
            registry,
            "tokens_refused",
            "Refused tokens by outcome",
            "outcome",
            ["wrong", "expired", "throttled"],
        );
        let requests_rejected: Family<RejectionLabel, Counter> =
            register(registry, "requests_rejected", "Rejected requests by transport and reason");
        let session_rejections = RefusalReason::ALL.map(|reason| {
            let label = RejectionLabel { transport: "websocket", reason: label_value(reason.name()) };
            requests_rejected.get_or_create_owned(&label)
        });
        let [rate_limit_delays, rate_limit_rejections] = register_fixed(
            registry,
            "rate_limited",
            "Actions of the rate limiter by outcome",
            "outcome",
            ["delayed", "rejected"],
        );
        let refusal_backoffs = register(registry, "refusal_backoffs", "Pauses of the refusal back-off");
        Self {
            memory_used_bytes,
            memory_limit_bytes,
            memory_cache_clears,
            connections,
            connections_rejected,
            connections_failed,
            tokens_reload_failed,
            certificate_reload_failed,
            tokens_wrong,
            tokens_expired,
            tokens_throttled,
            requests_rejected,
            session_rejections,
            rate_limit_delays,
            rate_limit_rejections,
            refusal_backoffs,
        }
    }

    /// Creates the counters of ends of connections, so that a rate includes the first event.
    pub fn declare_connection_ends(&self, reasons: impl IntoIterator<Item = &'static str>) {
        for reason in reasons {
            drop(self.connections_failed.get_or_create(&ReasonLabel { reason }));
        }
    }

    /// Counts a connection that ended before a request.
    pub fn connection_failed(&self, reason: &'static str) {
        self.connections_failed.get_or_create(&ReasonLabel { reason }).inc();
    }

    /// Creates the counters of HTTP rejections, so that a rate includes the first event.
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
}

fn http_label(reason: &str) -> RejectionLabel {
    RejectionLabel { transport: "http", reason: label_value(reason) }
}
