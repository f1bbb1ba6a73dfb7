//! `resilience`: a server beside peers that flood, hang up, dribble or do not read, under a limit
//! of memory, and over TLS; a viewer beside a server that sends garbage.
//!
//! The benchmarks are those of `tombolo-server-bench`; that of valid messages is a test of the
//! server, in its long form.

use super::run::Run;
use super::streaming::{cores, separate_cores, server_bench};
use crate::records::record::Record;
use crate::{machine, process};
use anyhow::Result;
use bars::Bar;
use std::process::Command;

/// The benchmarks in the order in which they run, each with its rounds and the length of a timed
/// part in seconds. First those that count, for which a busy machine does not matter.
const BENCHES: [(&str, &str, &str); 8] = [
    ("memory-cap", "1", "10"),
    ("garbage", "1", "600"),
    ("flood", "1", "25"),
    ("downloads", "3", "10"),
    ("unread", "3", "20"),
    ("hang-ups", "1", "1"),
    ("half-open", "3", "20"),
    ("tls", "5", "3"),
];

/// Messages of the stream of valid messages.
const MESSAGES: &str = "1000000";

/// Runs the benchmarks.
///
/// # Errors
/// A program cannot be started or was interrupted.
pub fn rows(run: &mut Run) -> Result<Vec<Bar>> {
    let last_core = separate_cores();
    run.notes.push(format!(
        "`tombolo-server-bench NAME --rounds N --seconds S`, {}: {}.",
        cores(last_core.is_some()),
        BENCHES.map(|(name, rounds, seconds)| format!("{name} {rounds} x {seconds} s")).join(", ")
    ));
    let mut rows = Vec::new();
    for (bench, rounds, seconds) in BENCHES {
        let report = run.report(bench, server_bench(bench, last_core, rounds, seconds), "--json")?;
        rows.extend(run.rows_of(bench, &report));
    }
    let report = run.report_of("messages", messages(run))?;
    rows.extend(run.rows_of("messages", &report));
    let streaming = crate::records::of("streaming")?;
    rows.push(Bar::none(STREAMING, missed_of(&streaming, &machine::Machine::here().slug())));
    Ok(rows)
}

/// Name of the row about the record of `streaming`.
const STREAMING: &str = "bars of `measure streaming` missed, record of this machine and code";

/// Missed bars of the record of a machine; none without one.
fn missed_of(records: &[Record], machine: &str) -> Option<f64> {
    let own = records.iter().find(|record| record.machine() == machine)?;
    Some(own.rows.iter().filter(|row| row.verdict == "MISSED").count() as f64)
}

/// The test of valid messages. It links the server, and so is no part of `tombolo-server-bench`.
fn messages(run: &Run) -> Command {
    let mut command =
        process::cargo("test --profile dist --package tombolo-server --test message_streams valid_streams");
    command.env("TOMBOLO_STREAM_MESSAGES", MESSAGES);
    command.env("TOMBOLO_STREAM_REPORT", run.file("messages.json"));
    command
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn missed_bars_are_those_of_the_own_record() {
        let record = |machine: &str, verdict: &str| {
            let page = format!("| a | 1 | at most 2 | {verdict} |\n| b | 1 | at most 2 | ok |\n");
            Record::parse(&format!("docs/measurements/2026-01-02-{machine}/streaming.md"), &page)
        };
        let records = [record("x", "ok"), record("y", "MISSED")];
        let missed = ["x", "y", "z"].map(|machine| missed_of(&records, machine));
        assert_eq!(missed, [Some(0.0), Some(1.0), None]);
    }
}
