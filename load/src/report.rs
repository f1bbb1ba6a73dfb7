//! What a run found: as JSON, as a table, and as a verdict.

use serde::Serialize;
use std::fmt;

/// The result of a run. Field names are a contract with scripts.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Report {
    /// Clients that were run.
    pub clients: u32,
    /// Length of the run, seconds.
    pub seconds: f64,
    /// How chunks were to come: `exact` or `seed`.
    pub delivery: &'static str,
    /// Chunks received.
    pub chunks: u64,
    /// Bytes of the chunks' frames.
    pub bytes: u64,
    /// Things that arrived and were not what they should be.
    pub mismatches: u64,
    /// Sessions that ended before their time.
    pub dropped: u64,
    /// Sessions not admitted, and chunks or views refused inside sessions.
    pub refused: u64,
    /// From request to chunk.
    pub latency_ms: LatencyMs,
    /// Chunks that were compared with local generation: a sample, in seed-only delivery all.
    pub regenerated: u64,
    /// Views that the server reported complete.
    pub views_settled: u64,
    /// Explicit requests sent.
    pub requests: u64,
    /// Of these, without an answer when their session ended.
    pub unanswered: u64,
    /// The first distinct troubles, in words; they are in the counts above.
    pub problems: Vec<String>,
}

/// Latency from an explicit request to its chunk, milliseconds; none where no request was answered.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct LatencyMs {
    /// Median.
    pub p50: Option<f64>,
    /// 99th percentile.
    pub p99: Option<f64>,
    /// 99.9th percentile.
    pub p999: Option<f64>,
}

impl Report {
    /// Whether the server passed.
    ///
    /// # Errors
    /// One line with what was wrong.
    pub fn verdict(&self) -> Result<(), String> {
        let because = self.problems.first().map(|problem| format!("; first: {problem}")).unwrap_or_default();
        if self.mismatches > 0 {
            return Err(format!("{} mismatches in {} chunks{because}", self.mismatches, self.chunks));
        }
        if self.dropped > 0 {
            return Err(format!("{} sessions ended before their time{because}", self.dropped));
        }
        if self.chunks == 0 {
            let because = if because.is_empty() { "; is the run long enough?".into() } else { because };
            return Err(format!("no chunk arrived in {:.0} s{because}", self.seconds));
        }
        Ok(())
    }

    fn per_second(&self, count: f64) -> f64 {
        count / self.seconds.max(f64::MIN_POSITIVE)
    }
}

impl fmt::Display for Report {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let megabytes = self.bytes as f64 / 1e6;
        let ms = |value: Option<f64>| value.map_or("-".into(), |value| format!("{value:.1}"));
        let LatencyMs { p50, p99, p999 } = self.latency_ms;
        let rows = [
            ("clients", format!("{} for {:.1} s", self.clients, self.seconds)),
            ("delivery", self.delivery.to_owned()),
            ("chunks", format!("{} ({:.0} a second)", self.chunks, self.per_second(self.chunks as f64))),
            ("data", format!("{megabytes:.1} MB ({:.2} MB/s)", self.per_second(megabytes))),
            ("views settled", self.views_settled.to_string()),
            ("requests", format!("{} ({} unanswered)", self.requests, self.unanswered)),
            ("latency p50", format!("{} ms", ms(p50))),
            ("latency p99", format!("{} ms", ms(p99))),
            ("latency p99.9", format!("{} ms", ms(p999))),
            ("regenerated", self.regenerated.to_string()),
            ("refused", self.refused.to_string()),
            ("dropped", self.dropped.to_string()),
            ("mismatches", self.mismatches.to_string()),
        ];
        for (name, value) in rows {
            writeln!(f, "{name:<14} {value}")?;
        }
        self.problems.iter().try_for_each(|problem| writeln!(f, "  ! {problem}"))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Tally;
    use protocol::Delivery;

    fn good() -> Report {
        let tally = Tally::default();
        tally.chunk(1000);
        tally.report(2, 10.0, Delivery::Exact)
    }

    #[test]
    fn a_run_passes_only_with_chunks_and_without_faults() {
        assert_eq!(good().verdict(), Ok(()));
        let silent = Tally::default();
        silent.refused("connection refused");
        let verdict = silent.report(2, 10.0, Delivery::Exact).verdict().unwrap_err();
        assert!(verdict.contains("no chunk") && verdict.contains("connection refused"), "{verdict}");
        let mismatched = Report { mismatches: 1, ..good() };
        assert!(mismatched.verdict().unwrap_err().contains("1 mismatches"));
        let dropped = Report { dropped: 3, ..good() };
        assert!(dropped.verdict().unwrap_err().contains("3 sessions"));
        let refused = Report { refused: 3, ..good() };
        assert_eq!(refused.verdict(), Ok(()), "shedding load is allowed");
    }

    #[test]
    fn json_has_the_fields_that_scripts_read() {
        let json = serde_json::to_value(good()).unwrap();
        for field in ["clients", "seconds", "chunks", "bytes", "mismatches", "dropped", "refused"] {
            assert!(json[field].is_number(), "{field}");
        }
        assert_eq!(json["delivery"], "exact");
        for field in ["p50", "p99", "p999"] {
            assert!(json["latency_ms"].as_object().unwrap().contains_key(field), "{field}");
        }
    }

    #[test]
    fn the_table_names_rates_and_units() {
        let table = good().to_string();
        assert!(table.contains("1 (0 a second)") && table.contains("MB/s"), "{table}");
        assert!(table.contains("latency p99.9  - ms"), "no answer is not zero: {table}");
    }
}
