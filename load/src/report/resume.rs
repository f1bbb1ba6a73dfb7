//! How clients fared whose session was lost.

use crate::counters::{Counters, get};
use crate::latency::{Latencies, LatencyMs};
use serde::Serialize;

/// Sessions that were lost after they had delivered, over all phases.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct ResumeReport {
    /// Their number.
    pub lost: u64,
    /// Of these, replaced by a session that delivered.
    pub resumed: u64,
    /// From the last chunk or complete view of the lost session to the first of its successor.
    /// Without a successor the time to the end of the phase, a lower bound.
    pub gap_ms: LatencyMs,
    /// Bytes of the chunks that the successors held when they connected.
    pub held_bytes: u64,
    /// Chunks of views that the server sent although the client held them.
    pub chunks_again: u64,
    /// Their bytes.
    pub bytes_again: u64,
    /// Sessions to which the server announced its shutdown.
    pub announced: u64,
    /// Of these, ended by a Close frame.
    pub closed_as_announced: u64,
    /// Time of the last such frame, seconds from the start of the run; 0 without any.
    pub last_close_s: f64,
}

impl ResumeReport {
    /// The sums over the counters of all phases.
    pub(crate) fn of(counters: &[&Counters]) -> Self {
        let sum = |pick: fn(&Counters) -> u64| counters.iter().copied().map(pick).sum();
        let mut gaps = Latencies::default();
        counters.iter().for_each(|counters| gaps.add(&counters.gaps()));
        Self {
            lost: sum(|counters| get(&counters.lost_deliveries)),
            resumed: sum(|counters| get(&counters.resumed)),
            gap_ms: gaps.quantiles(),
            held_bytes: sum(|counters| get(&counters.held_bytes)),
            chunks_again: sum(|counters| get(&counters.chunks_again)),
            bytes_again: sum(|counters| get(&counters.bytes_again)),
            announced: sum(|counters| get(&counters.announced)),
            closed_as_announced: sum(|counters| get(&counters.closed_as_announced)),
            last_close_s: counters
                .iter()
                .map(|counters| counters.last_close().as_secs_f64())
                .fold(0.0, f64::max),
        }
    }
}
