//! `resilience`: a server beside peers that flood, hang up, dribble or do not read, under a limit of
//! memory, and over TLS; a viewer beside a server that sends garbage.
//!
//! The benchmarks are those of `tombolo-server-bench`; that of valid messages is a test of the
//! server, in its long form.

use super::run::Run;
use super::streaming::{cores, separate_cores, server_bench};
use crate::process;
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
    Ok(rows)
}

/// The test of valid messages. It links the server, and so is no part of `tombolo-server-bench`.
fn messages(run: &Run) -> Command {
    let mut command =
        process::cargo("test --profile dist --package tombolo-server --test message_streams valid_streams");
    command.env("TOMBOLO_STREAM_MESSAGES", MESSAGES);
    command.env("TOMBOLO_STREAM_REPORT", run.file("messages.json"));
    command
}
