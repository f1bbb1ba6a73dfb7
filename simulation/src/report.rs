//! What came of a simulation.

use load::latency::{Latencies, LatencyMs};
use rustc_hash::FxHasher;
use serde::Serialize;
use std::hash::{Hash, Hasher};

/// Counts and times of some replicas.
#[derive(Clone, Debug, Default)]
pub struct Report {
    /// Clients.
    pub clients: u64,
    /// Replicas.
    pub replicas: u64,
    /// Chunks that clients received.
    pub chunks: u64,
    /// Bytes of their frames.
    pub bytes: u64,
    /// Chunks that replicas made.
    pub made: u64,
    /// Views that were selected.
    pub views: u64,
    /// Views that became complete.
    pub settled: u64,
    /// Refused requests.
    pub refused: u64,
    /// Probes without an answer at the end.
    pub unanswered: u64,
    /// Frames that a client rejected; 0 if the state machines agree.
    pub wrong: u64,
    /// Processor time of the replicas, seconds.
    pub processor_s: f64,
    /// Of it, the clients' work.
    pub client_s: f64,
    /// From a request to its chunk. One without an answer counts with its wait if that is a second
    /// or more, as in the load test.
    pub latency: Latencies,
    /// From a pose to the completion of its view.
    pub settling: Latencies,
    /// Events that were simulated.
    pub events: u64,
    /// Hash of all events in order: equal if and only if two runs were.
    pub trace: u64,
}

/// A report as JSON. Names as in the report of the load test.
#[derive(Debug, Serialize)]
pub struct Summary {
    clients: u64,
    replicas: u64,
    chunks: u64,
    bytes: u64,
    chunks_made: u64,
    views: u64,
    views_settled: u64,
    refused: u64,
    unanswered: u64,
    wrong: u64,
    processor_s: f64,
    client_processor_s: f64,
    latency_ms: LatencyMs,
    settle_ms: LatencyMs,
    events: u64,
    trace: String,
}

impl Report {
    /// Both together.
    #[must_use]
    pub fn and(mut self, other: &Self) -> Self {
        self.clients += other.clients;
        self.replicas += other.replicas;
        self.chunks += other.chunks;
        self.bytes += other.bytes;
        self.made += other.made;
        self.views += other.views;
        self.settled += other.settled;
        self.refused += other.refused;
        self.unanswered += other.unanswered;
        self.wrong += other.wrong;
        self.processor_s += other.processor_s;
        self.client_s += other.client_s;
        self.latency.add(&other.latency);
        self.settling.add(&other.settling);
        self.events += other.events;
        let mut hasher = FxHasher::default();
        (self.trace, other.trace).hash(&mut hasher);
        self.trace = hasher.finish();
        self
    }

    /// For JSON.
    #[must_use]
    pub fn summary(&self) -> Summary {
        Summary {
            clients: self.clients,
            replicas: self.replicas,
            chunks: self.chunks,
            bytes: self.bytes,
            chunks_made: self.made,
            views: self.views,
            views_settled: self.settled,
            refused: self.refused,
            unanswered: self.unanswered,
            wrong: self.wrong,
            processor_s: self.processor_s,
            client_processor_s: self.client_s,
            latency_ms: self.latency.quantiles(),
            settle_ms: self.settling.quantiles(),
            events: self.events,
            trace: format!("{:016x}", self.trace),
        }
    }
}
