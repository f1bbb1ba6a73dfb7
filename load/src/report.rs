//! The result of a run as JSON and as a verdict. The text table is in `table`.

mod resume;
mod table;

pub use resume::ResumeReport;

use crate::config::LoadConfig;
use crate::counters::{Counters, MAX_PROBLEMS, ProblemKind, get};
use crate::latency::{Latencies, LatencyMs};
use crate::phases::Phase;
use crate::run_stats::RunStats;
use crate::timeline::Second;
use serde::Serialize;
use std::collections::BTreeMap;
use std::ops::Add;
use std::sync::Arc;
use std::time::Duration;

/// The result of a run. Field names are a contract with scripts. Figures are those of all phases
/// together and of measured clients only.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Report {
    /// Measured clients, without slow and silent ones.
    pub clients: u32,
    /// Of these, without a session in the whole run; over HTTP, without the world's description.
    pub never_connected: u64,
    /// Start of the run, seconds since 1970-01-01 UTC by the clock of this machine.
    pub started_unix_s: f64,
    /// Length of the run, seconds.
    pub seconds: f64,
    /// Whether an interrupt ended the run early.
    pub interrupted: bool,
    /// Requested delivery: `exact`, `refined`, `seed` or `quantised`.
    pub delivery: &'static str,
    /// Mode of the clients: `view`, `explicit` or `http`.
    pub mode: &'static str,
    /// How clients moved.
    pub path: &'static str,
    /// `closed` or `open`.
    #[serde(rename = "loop")]
    pub loop_: &'static str,
    /// Intended requests or poses a second over all clients; none in a closed loop.
    pub rate: Option<f64>,
    /// The counts of all phases.
    #[serde(flatten)]
    pub counts: Counts,
    /// The events between which [`Report::latency_ms`] is measured. In an open loop it starts at
    /// the due time.
    pub measures: &'static str,
    /// See [`Report::measures`]. In an open loop a missing answer counts with the time waited.
    pub latency_ms: LatencyMs,
    /// From a pose to the completion of its view or a newer one; only in view mode.
    pub settle_ms: LatencyMs,
    /// From the due time of a request to its sending; only in an open loop. A request is late if it
    /// waited for others on its connection or for this machine: a late run on a fast server
    /// measures the load test.
    pub sent_late_ms: LatencyMs,
    /// Chunks compared with local generation: a sample, or all in seed-only delivery.
    pub regenerated: u64,
    /// Views that the server reported complete.
    pub views_settled: u64,
    /// Of these, checked for missing chunks: one in eight, unless chunks of it were refused or
    /// released. Without a check the run says nothing of missing chunks, which is no error: a short
    /// one may have none.
    pub views_checked: u64,
    /// The first distinct problems as text, most serious first; the counts above include them.
    pub problems: Vec<String>,
    /// Both digests, if the server changed its world during the run. Clients that meet another
    /// world end.
    pub world_changed: Option<String>,
    /// The phases.
    pub phases: Vec<PhaseReport>,
    /// Lost sessions and what followed them.
    pub resume: ResumeReport,
    /// Slow clients, if any.
    pub slow: Option<BackgroundClients>,
    /// Silent clients, if any.
    pub silent: Option<BackgroundClients>,
    /// The run second by second.
    pub timeline: Vec<Second>,
}

/// The counted quantities.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct Counts {
    /// Chunks received.
    pub chunks: u64,
    /// Bytes of the chunks' frames.
    pub bytes: u64,
    /// Answers that a chunk has not changed; only over HTTP.
    pub not_modified: u64,
    /// Invalid chunks, messages and announcements.
    pub mismatches: u64,
    /// Sessions lost before the end of their phase.
    pub dropped: u64,
    /// Sessions not admitted, and chunks or views refused inside sessions.
    pub refused: u64,
    /// Requests sent; in an open loop in view mode, poses.
    pub requests: u64,
    /// Of these, without an answer at the end of their session.
    pub unanswered: u64,
    /// Requests that were due and never sent, and probes that were skipped because 64 had no
    /// answer.
    pub unsent: u64,
    /// Clients that waited at the end of their phase while the server had sent nothing for 5 s.
    pub stalled: u64,
}

/// One phase.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct PhaseReport {
    /// `run`, or `cold` and `warm`.
    pub name: &'static str,
    /// Seconds from the start of the run.
    pub begins_s: f64,
    /// Length, seconds.
    pub seconds: f64,
    /// The counts of the phase.
    #[serde(flatten)]
    pub counts: Counts,
    /// As in [`Report`].
    pub latency_ms: LatencyMs,
    /// As in [`Report`].
    pub settle_ms: LatencyMs,
}

/// Slow or silent clients, whose figures are separate.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct BackgroundClients {
    /// Number of clients.
    pub clients: u32,
    /// Of these, admitted.
    pub admitted: u64,
    /// Refused in the handshake or later.
    pub refused: u64,
    /// Closed by the server, by reason.
    pub closed: BTreeMap<String, u64>,
    /// Still connected at the end of the run.
    pub stayed: u64,
    /// Chunks received.
    pub chunks: u64,
    /// Bytes of their frames.
    pub bytes: u64,
    /// Invalid data, which is a fault here too.
    pub mismatches: u64,
    /// The same as text.
    pub problems: Vec<String>,
}

impl Report {
    /// The report of a run with these options that took so long.
    #[must_use]
    pub fn new(config: &LoadConfig, stats: &RunStats, took: Duration) -> Self {
        let phases: Vec<_> =
            stats.phases.iter().map(|(phase, counters)| PhaseReport::new(phase, counters, took)).collect();
        let counters = || stats.phases.iter().map(|(_, counters)| counters);
        let all = |pick: fn(&Counters) -> Latencies| {
            let mut all = Latencies::default();
            counters().for_each(|counters| all.add(&pick(counters)));
            all.quantiles()
        };
        let problems = first(counters().flat_map(|counters| counters.problems()).collect());
        let is_open = config.rate.is_some();
        let background = |clients: u32, counters: &Counters| {
            (clients > 0).then(|| BackgroundClients::new(clients, counters))
        };
        Self {
            clients: config.clients,
            never_connected: get(&stats.never_connected),
            started_unix_s: stats.started_unix.as_secs_f64(),
            seconds: phases.iter().map(|phase| phase.seconds).sum(),
            interrupted: false,
            delivery: config.delivery.name(),
            mode: config.mode.name(),
            path: config.path.name(),
            loop_: if is_open { "open" } else { "closed" },
            rate: config.rate,
            counts: phases.iter().fold(Counts::default(), |sum, phase| sum + phase.counts),
            measures: config.mode.measures(is_open),
            latency_ms: all(Counters::latencies),
            settle_ms: all(Counters::settling),
            sent_late_ms: if is_open { all(Counters::lateness) } else { LatencyMs::default() },
            regenerated: counters().map(|counters| get(&counters.regenerated)).sum(),
            views_settled: counters().map(|counters| get(&counters.views_settled)).sum(),
            views_checked: counters().map(|counters| get(&counters.views_checked)).sum(),
            problems,
            world_changed: counters().find_map(|counters| counters.world_change()),
            resume: ResumeReport::of(&counters().map(Arc::as_ref).collect::<Vec<_>>()),
            slow: background(config.slow, &stats.slow),
            silent: background(config.silent, &stats.silent),
            timeline: timeline(stats, took),
            phases,
        }
    }

    /// Whether the server passed.
    ///
    /// # Errors
    /// One line with what was wrong.
    pub fn verdict(&self) -> Result<(), String> {
        if let Some(change) = &self.world_changed {
            return Err(change.clone());
        }
        let because = self.problems.first().map(|problem| format!("; first: {problem}")).unwrap_or_default();
        if self.counts.mismatches > 0 {
            return Err(format!(
                "{} mismatches in {} chunks{because}",
                self.counts.mismatches, self.counts.chunks
            ));
        }
        let background = [("slow", &self.slow), ("silent", &self.silent)];
        for (name, background) in
            background.into_iter().filter_map(|(name, background)| Some((name, background.as_ref()?)))
        {
            if background.mismatches > 0 {
                let first = background.problems.first().map(String::as_str).unwrap_or_default();
                return Err(format!(
                    "{} mismatches of {name} clients; first: {first}",
                    background.mismatches
                ));
            }
        }
        if self.counts.dropped > 0 {
            return Err(format!("{} sessions ended before their time{because}", self.counts.dropped));
        }
        if self.counts.stalled > 0 {
            return Err(format!("{} clients waited for a silent server{because}", self.counts.stalled));
        }
        // What a run lacks is no fault of the server if the run was cut short.
        if self.interrupted {
            return Err(format!("interrupted after {:.1} s", self.seconds));
        }
        if self.counts.chunks + self.counts.not_modified == 0 {
            let because = if because.is_empty() { "; is the run long enough?".into() } else { because };
            return Err(format!("no chunk arrived in {:.0} s{because}", self.seconds));
        }
        if self.never_connected > 0 {
            return Err(format!(
                "{} of {} clients never had a session{because}",
                self.never_connected, self.clients
            ));
        }
        Ok(())
    }
}

/// The texts of the first distinct problems, most serious first: the verdict quotes the first as
/// its cause.
fn first(mut problems: Vec<(ProblemKind, String)>) -> Vec<String> {
    problems.sort_by_key(|(kind, _)| *kind);
    let mut texts: Vec<String> = Vec::new();
    for (_, problem) in problems {
        if texts.len() < MAX_PROBLEMS && !texts.contains(&problem) {
            texts.push(problem);
        }
    }
    texts
}

/// All seconds, except idle ones after the end of the run, in which sessions were closed and
/// comparisons finished.
fn timeline(stats: &RunStats, took: Duration) -> Vec<Second> {
    let mut seconds = stats.timeline.seconds();
    let is_idle = |second: &Second| second.chunks + second.answers == 0;
    let lasts = stats.duration().min(took).as_secs_f64().ceil() as u64;
    while seconds.last().is_some_and(|second| second.second >= lasts && is_idle(second)) {
        seconds.pop();
    }
    seconds
}

impl Counts {
    fn of(counters: &Counters) -> Self {
        Self {
            chunks: get(&counters.chunks),
            bytes: get(&counters.bytes),
            not_modified: get(&counters.not_modified),
            mismatches: get(&counters.mismatches),
            dropped: get(&counters.dropped),
            refused: get(&counters.refused),
            requests: get(&counters.requests),
            unanswered: get(&counters.unanswered),
            unsent: get(&counters.unsent),
            stalled: get(&counters.stalled),
        }
    }
}

impl Add for Counts {
    type Output = Self;

    fn add(self, other: Self) -> Self {
        Self {
            chunks: self.chunks + other.chunks,
            bytes: self.bytes + other.bytes,
            not_modified: self.not_modified + other.not_modified,
            mismatches: self.mismatches + other.mismatches,
            dropped: self.dropped + other.dropped,
            refused: self.refused + other.refused,
            requests: self.requests + other.requests,
            unanswered: self.unanswered + other.unanswered,
            unsent: self.unsent + other.unsent,
            stalled: self.stalled + other.stalled,
        }
    }
}

impl PhaseReport {
    /// A phase of a run that took so long as a whole.
    fn new(phase: &Phase, counters: &Counters, took: Duration) -> Self {
        // Closing and late comparisons do not count as load; late answers of an open loop do.
        let length = took.saturating_sub(phase.start).min(phase.length);
        let until = counters.last_chunk().saturating_sub(phase.start);
        Self {
            name: phase.name,
            begins_s: phase.start.as_secs_f64(),
            seconds: length.max(until).as_secs_f64(),
            counts: Counts::of(counters),
            latency_ms: counters.latencies().quantiles(),
            settle_ms: counters.settling().quantiles(),
        }
    }
}

impl BackgroundClients {
    fn new(clients: u32, counters: &Counters) -> Self {
        Self {
            clients,
            admitted: get(&counters.admitted),
            refused: get(&counters.refused),
            closed: counters.closes(),
            stayed: get(&counters.stayed),
            chunks: get(&counters.chunks),
            bytes: get(&counters.bytes),
            mismatches: get(&counters.mismatches),
            problems: first(counters.problems()),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn config() -> LoadConfig {
        LoadConfig { clients: 2, ..LoadConfig::new("ws://127.0.0.1:1/v1/stream".parse().unwrap()) }
    }

    fn report(config: &LoadConfig, count: impl Fn(&RunStats)) -> Report {
        let stats = RunStats::new(config);
        count(&stats);
        Report::new(config, &stats, Duration::from_secs(3600))
    }

    fn good() -> Report {
        report(&config(), |stats| stats.phases[0].1.chunk(1000))
    }

    fn counted(counts: Counts) -> Report {
        Report { counts, ..good() }
    }

    #[test]
    fn a_run_passes_only_with_chunks_and_without_faults() {
        assert_eq!(good().verdict(), Ok(()));
        let silent = report(&config(), |stats| stats.phases[0].1.refused("connection refused"));
        let verdict = silent.verdict().unwrap_err();
        assert!(verdict.contains("no chunk") && verdict.contains("connection refused"), "{verdict}");
        let mismatched = counted(Counts { mismatches: 1, ..good().counts });
        assert!(mismatched.verdict().unwrap_err().contains("1 mismatches"));
        let dropped = counted(Counts { dropped: 3, ..good().counts });
        assert!(dropped.verdict().unwrap_err().contains("3 sessions"));
        let refused = counted(Counts { refused: 3, ..good().counts });
        assert_eq!(refused.verdict(), Ok(()), "rejecting load is allowed");
        let without = Report { never_connected: 1, ..good() };
        assert!(without.verdict().unwrap_err().contains("1 of 2 clients never had a session"));
        let unchanged = counted(Counts { chunks: 0, not_modified: 1, ..good().counts });
        assert_eq!(unchanged.verdict(), Ok(()), "304 is an answer");
    }

    #[test]
    fn an_interrupted_run_does_not_pass_and_names_faults_before_the_interrupt() {
        let cut = |report: Report| Report { interrupted: true, ..report };
        assert_eq!(cut(good()).verdict(), Err("interrupted after 10.0 s".into()));
        let empty = report(&config(), |_| ());
        assert!(empty.verdict().unwrap_err().contains("no chunk"), "control");
        assert_eq!(cut(empty).verdict(), Err("interrupted after 10.0 s".into()));
        let wrong = cut(counted(Counts { mismatches: 1, ..good().counts }));
        assert!(wrong.verdict().unwrap_err().contains("1 mismatches"));
        assert!(wrong.to_string().contains("2 for 10.0 s, interrupted"), "{wrong}");
    }

    #[test]
    fn slow_and_silent_clients_are_separate_and_only_mismatches_fail() {
        let config = LoadConfig { slow: 3, silent: 2, ..config() };
        let count = |stats: &RunStats| {
            stats.phases[0].1.chunk(1000);
            stats.slow.chunk(7);
            stats.slow.closed("the connection ended without a close frame");
            stats.silent.closed("handshake timed out (4408)");
        };
        let with = report(&config, count);
        assert_eq!((with.counts.chunks, with.counts.bytes, with.counts.dropped), (1, 1000, 0));
        assert_eq!(with.timeline.iter().map(|second| second.chunks).sum::<u64>(), 1);
        assert_eq!(with.silent.as_ref().unwrap().closed["handshake timed out (4408)"], 1);
        assert_eq!(with.verdict(), Ok(()));
        let wrong = report(&config, |stats| {
            count(stats);
            stats.slow.mismatch("a bit");
        });
        assert!(wrong.verdict().unwrap_err().contains("slow clients; first: a bit"));
    }

    #[test]
    fn the_totals_are_sums_over_the_phases() {
        let config = LoadConfig { warm_up_s: 5, ..config() };
        let report = report(&config, |stats| {
            for (index, (_, counters)) in stats.phases.iter().enumerate() {
                (0..=index).for_each(|_| counters.chunk(10));
                counters.request(Duration::ZERO);
                counters.answered(Duration::from_millis(100 - 90 * index as u64));
            }
        });
        assert_eq!(
            (report.counts.chunks, report.counts.bytes, report.counts.requests, report.seconds),
            (3, 30, 2, 15.0)
        );
        let max: Vec<_> = report.phases.iter().map(|phase| phase.latency_ms.max.map(f64::round)).collect();
        assert_eq!(max, [Some(100.0), Some(10.0)]);
        assert_eq!(report.latency_ms.max.map(f64::round), Some(100.0));
    }

    #[test]
    fn json_has_the_fields_that_scripts_read() {
        let json = serde_json::to_value(good()).unwrap();
        for field in
            ["clients", "seconds", "chunks", "bytes", "mismatches", "dropped", "refused", "views_checked"]
        {
            assert!(json[field].is_number(), "{field}");
        }
        assert_eq!((&json["delivery"], &json["loop"]), (&"exact".into(), &"closed".into()));
        for field in ["p50", "p90", "p99", "p999", "max"] {
            assert!(json["latency_ms"].as_object().unwrap().contains_key(field), "{field}");
        }
        assert!(json["phases"][0]["latency_ms"].is_object() && json["timeline"][0]["chunks"].is_number());
    }

    #[test]
    fn a_run_lasts_as_long_as_it_took_up_to_its_option() {
        let stats = RunStats::new(&config());
        let seconds = |took| Report::new(&config(), &stats, Duration::from_secs(took)).seconds;
        assert_eq!((seconds(3), seconds(11)), (3.0, 10.0));
    }
}
