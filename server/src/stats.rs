//! Live statistics: positions of the clients and rates of the server. Sampled on request, about
//! once per second at most.
//!
//! A session publishes its view and counts in [`crate::open_sessions::SessionStats`]. The
//! statistics contain no addresses, names or tokens: a session is a number and a position.

use crate::generation::Generation;
use crate::latency::{self, BucketCounts, LatencyHistogram};
use crate::metrics::Metrics;
use crate::open_sessions::{EyePosition, OpenSessions, SessionFigures};
use bytes::Bytes;
use serde::Serialize;
use std::collections::BTreeMap;
use std::sync::{Mutex, PoisonError};
use std::time::{Duration, Instant};
use terrain::constants::UNITS_PER_METRE;

/// Sessions that are listed, the oldest first; the others are only counted.
pub const MAX_LISTED: usize = 256;

/// Minimum age of a snapshot before it is replaced. Slightly below the polling interval of the
/// page, one second.
const REFRESH: Duration = Duration::from_millis(900);

/// Maximum age of the snapshot that rates are computed from: a mean over minutes is not a live
/// rate.
const MAX_SPAN: Duration = Duration::from_secs(10);

/// The last snapshot.
#[derive(Debug)]
pub struct LiveStats {
    started: Instant,
    last: Mutex<Option<Snapshot>>,
}

/// Values at one moment, and the report made of them.
#[derive(Debug)]
struct Snapshot {
    at: Instant,
    totals: Totals,
    /// Chunks and bytes sent, by session.
    sessions: BTreeMap<u64, (u64, u64)>,
    report: Bytes,
}

#[derive(Clone, Debug)]
struct Totals {
    chunks: u64,
    bytes: u64,
    generated: u64,
    latency: BucketCounts,
}

/// The body of `/v1/live`.
#[derive(Serialize)]
struct Report {
    uptime_s: f64,
    /// Interval of rates and quantiles; none without a recent snapshot.
    span_s: Option<f64>,
    sessions: SessionsReport,
    sent: Option<SentReport>,
    generation: GenerationReport,
    /// From the request of a chunk by a session to the end of its write.
    latency: Option<Quantiles>,
}

#[derive(Serialize)]
struct SessionsReport {
    open: u64,
    listed: Vec<SessionReport>,
}

#[derive(Serialize)]
struct SessionReport {
    session: u64,
    /// None before the first view.
    view: Option<ViewPosition>,
    chunks: u64,
    chunks_per_s: Option<f64>,
    bytes_per_s: Option<f64>,
}

#[derive(Serialize)]
struct ViewPosition {
    x_m: f64,
    z_m: f64,
    /// 0 is north, 90 is east; 0 to 360.
    heading_deg: f64,
}

#[derive(Serialize)]
struct SentReport {
    chunks_per_s: f64,
    bytes_per_s: f64,
}

#[derive(Serialize)]
struct GenerationReport {
    queue: i64,
    load: f64,
    chunks_per_s: Option<f64>,
}

#[derive(Serialize)]
struct Quantiles {
    chunks: u64,
    p50_ms: Option<f64>,
    p90_ms: Option<f64>,
    p99_ms: Option<f64>,
}

impl Default for LiveStats {
    fn default() -> Self {
        Self { started: Instant::now(), last: Mutex::default() }
    }
}

impl LiveStats {
    /// The report as JSON. A recent report is reused at any rate of requests.
    #[must_use]
    pub fn report(
        &self,
        now: Instant,
        sessions: &OpenSessions,
        metrics: &Metrics,
        generation: &Generation,
    ) -> Bytes {
        // Nothing under this lock panics in the middle of a change.
        let mut last = self.last.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(snapshot) = last.as_ref().filter(|last| now.saturating_duration_since(last.at) < REFRESH)
        {
            return snapshot.report.clone();
        }
        let latency: &LatencyHistogram = &metrics.sessions.latency;
        let totals = Totals {
            chunks: metrics.sessions.chunks_sent.get(),
            bytes: metrics.sessions.sent_bytes.get(),
            generated: metrics.generation.jobs_completed.get(),
            latency: latency.counts(),
        };
        let before = last.take().filter(|last| now.saturating_duration_since(last.at) < MAX_SPAN);
        let listed = sessions.oldest(MAX_LISTED);
        let snapshot = self.snapshot(now, totals, listed, before.as_ref(), metrics, generation);
        let report = snapshot.report.clone();
        *last = Some(snapshot);
        report
    }

    fn snapshot(
        &self,
        now: Instant,
        totals: Totals,
        open: Vec<(u64, SessionFigures)>,
        before: Option<&Snapshot>,
        metrics: &Metrics,
        generation: &Generation,
    ) -> Snapshot {
        let span_s = before.map(|before| now.saturating_duration_since(before.at).as_secs_f64());
        let rate = |now: u64, before: u64| span_s.map(|span_s| now.saturating_sub(before) as f64 / span_s);
        let (mut listed, mut sessions) = (Vec::new(), BTreeMap::new());
        for (number, SessionFigures { eye, chunks, bytes }) in open {
            // A session opened since the last snapshot had sent nothing then.
            let (chunks_before, bytes_before) =
                before.and_then(|before| before.sessions.get(&number)).copied().unwrap_or_default();
            listed.push(SessionReport {
                session: number,
                view: eye.map(position),
                chunks,
                chunks_per_s: rate(chunks, chunks_before),
                bytes_per_s: rate(bytes, bytes_before),
            });
            sessions.insert(number, (chunks, bytes));
        }
        let report = Report {
            uptime_s: now.saturating_duration_since(self.started).as_secs_f64(),
            span_s,
            sessions: SessionsReport { open: metrics.sessions.open.get().max(0).cast_unsigned(), listed },
            sent: before.zip(span_s).map(|(before, span_s)| SentReport {
                chunks_per_s: totals.chunks.saturating_sub(before.totals.chunks) as f64 / span_s,
                bytes_per_s: totals.bytes.saturating_sub(before.totals.bytes) as f64 / span_s,
            }),
            generation: GenerationReport {
                queue: metrics.generation.pending_jobs.get(),
                load: generation.load(),
                chunks_per_s: before.and_then(|before| rate(totals.generated, before.totals.generated)),
            },
            latency: before.map(|before| {
                let (before, after) = (&before.totals.latency, &totals.latency);
                let at = |share| latency::quantile_ms(before, after, share);
                Quantiles {
                    chunks: latency::count(before, after),
                    p50_ms: at(0.5),
                    p90_ms: at(0.9),
                    p99_ms: at(0.99),
                }
            }),
        };
        // Serialising plain numbers and lists cannot fail.
        let report = serde_json::to_vec(&report).unwrap_or_default().into();
        Snapshot { at: now, totals, sessions, report }
    }
}

fn position(eye: EyePosition) -> ViewPosition {
    let metres = |units: i32| f64::from(units) / f64::from(UNITS_PER_METRE);
    ViewPosition {
        x_m: metres(eye.x),
        z_m: metres(eye.z),
        heading_deg: f64::from(eye.yaw_mdeg.rem_euclid(360_000)) / 1000.0,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::generation::Limits;
    use crate::source::ProceduralSource;
    use protocol::view::View;
    use serde_json::Value;
    use std::sync::Arc;
    use terrain::Land;

    struct Fixture {
        live: LiveStats,
        sessions: OpenSessions,
        metrics: Arc<Metrics>,
        generation: Generation,
        start: Instant,
    }

    impl Fixture {
        fn new() -> Self {
            let metrics = Arc::new(Metrics::default());
            let limits = Limits {
                threads: 1,
                cache_bytes: 1 << 20,
                jobs: 10,
                deadline: Duration::from_secs(1),
                without: None,
            };
            let generation =
                Generation::new(ProceduralSource::new(Land::new(1)), limits, Arc::clone(&metrics)).unwrap();
            Self {
                live: LiveStats::default(),
                sessions: OpenSessions::default(),
                metrics,
                generation,
                start: Instant::now(),
            }
        }

        fn at(&self, milliseconds: u64) -> Value {
            let now = self.start + Duration::from_millis(milliseconds);
            let report = self.live.report(now, &self.sessions, &self.metrics, &self.generation);
            serde_json::from_slice(&report).unwrap()
        }
    }

    #[test]
    fn rates_and_quantiles_cover_the_time_between_two_snapshots() {
        let fixture = Fixture::new();
        let stats = fixture.sessions.register(7, None);
        let first = fixture.at(0);
        assert_eq!(
            (&first["span_s"], &first["sent"], &first["latency"]),
            (&Value::Null, &Value::Null, &Value::Null)
        );
        fixture.metrics.sessions.chunks_sent.inc_by(30);
        fixture.metrics.sessions.sent_bytes.inc_by(9000);
        fixture.metrics.sessions.latency.observe(Duration::from_millis(8), 30);
        stats.set_sent(30, 9000);
        let second = fixture.at(2000);
        assert_eq!(second["sent"]["chunks_per_s"], 15.0);
        assert_eq!(second["sessions"]["listed"][0]["bytes_per_s"], 4500.0);
        assert_eq!(second["latency"]["chunks"], 30);
        assert!((second["latency"]["p99_ms"].as_f64().unwrap() - 8.0).abs() < 0.6);
        let third = fixture.at(3000);
        assert_eq!(
            (&third["sent"]["chunks_per_s"], &third["latency"]["p50_ms"]),
            (&Value::from(0.0), &Value::Null)
        );
    }

    #[test]
    fn a_recent_snapshot_is_reused_and_an_old_one_is_not_compared() {
        let fixture = Fixture::new();
        let first = fixture.at(0);
        fixture.metrics.sessions.chunks_sent.inc_by(30);
        assert_eq!(fixture.at(500), first);
        assert_ne!(fixture.at(1000), first);
        assert_eq!(fixture.at(60_000)["sent"], Value::Null);
    }

    #[test]
    fn a_session_is_listed_with_its_position_until_it_ends() {
        let fixture = Fixture::new();
        let (near, far) = (fixture.sessions.register(1, None), fixture.sessions.register(2, None));
        let eye = [-4_000_000 * 256, 0, 250 * 256];
        far.set_view(&View { eye, yaw_mdeg: -90_000, ..test_support::view(1, 100) });
        let sessions = &fixture.at(0)["sessions"]["listed"];
        assert_eq!(sessions[0]["view"], Value::Null);
        let position = &sessions[1]["view"];
        assert_eq!(
            (&position["x_m"], &position["z_m"], &position["heading_deg"]),
            (&Value::from(-4_000_000.0), &Value::from(250.0), &Value::from(270.0))
        );
        drop(near);
        let left = fixture.at(1000);
        assert_eq!(left["sessions"]["listed"].as_array().unwrap().len(), 1);
        assert_eq!(left["sessions"]["listed"][0]["session"], 2);
    }

    #[test]
    fn sessions_over_the_limit_are_counted_but_not_listed() {
        let fixture = Fixture::new();
        let guards: Vec<_> =
            (0..2 * MAX_LISTED as u64).map(|number| fixture.sessions.register(number, None)).collect();
        fixture.metrics.sessions.open.set(guards.len() as i64);
        let sessions = &fixture.at(0)["sessions"];
        assert_eq!(sessions["open"], 2 * MAX_LISTED);
        let listed = sessions["listed"].as_array().unwrap();
        assert_eq!(
            (listed.len(), &listed[MAX_LISTED - 1]["session"]),
            (MAX_LISTED, &Value::from(MAX_LISTED - 1))
        );
    }
}
