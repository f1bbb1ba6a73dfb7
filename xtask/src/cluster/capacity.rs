//! Cost of one client for a server: processor time, bytes and memory, flying and walking, over land
//! that no client has seen and over land that the server has cached. docs/scale.md counts with it.

use super::load::Load;
use crate::server::Server;
use anyhow::{Context, Result, ensure};
use bars::Bar;
use bars::figures::at;
use std::fs::read_to_string;

/// Clients, and how long they move, seconds.
const CLIENTS: u32 = 100;
const SECONDS: u64 = 20;

/// Clock ticks of `/proc/PID/stat` in a second, on every Linux.
const TICKS_PER_S: f64 = 100.0;

/// How clients move, for `--path`.
const PATHS: [&str; 2] = ["fly", "walk"];

/// The rows. None has a bar: capacity is a property of the machine.
///
/// # Errors
/// A process does not start, or the system has no `/proc`.
pub fn rows() -> Result<Vec<Bar>> {
    let mut rows = Vec::new();
    for path in PATHS {
        let server = Server::start(super::WORLD_SEED)?;
        let empty_kib = memory_kib(&server)?;
        // The second load moves along the paths of the first.
        for state in ["new land", "cached land"] {
            let before_s = processor_s(&server)?;
            let more = ["--path", path, "--verify-every", "0"];
            let report = Load::start(server.address(), CLIENTS, SECONDS, &more)?.report()?;
            let spent_s = processor_s(&server)? - before_s;
            ensure!(at(&report, "never_connected") == Some(0.0), "some clients had no session");
            let client_s = f64::from(CLIENTS) * SECONDS as f64;
            let name = |what: &str| format!("{path}, {state}: {what}");
            rows.extend([
                Bar::reported(
                    name("processor time of the server for a client"),
                    Some(100.0 * spent_s / client_s),
                    "%",
                ),
                Bar::reported(
                    name("chunks of a client in a second"),
                    at(&report, "chunks").map(|chunks| chunks / client_s),
                    "",
                ),
                Bar::reported(
                    name("bytes of a client in an hour"),
                    at(&report, "bytes").map(|bytes| bytes / client_s * 3600.0 / 1e9),
                    "GB",
                ),
                Bar::reported(name("p99 of requested chunks"), at(&report, "latency_ms/p99"), "ms"),
                Bar::none(name("frames that a client rejected"), at(&report, "mismatches")),
            ]);
        }
        let kib = (memory_kib(&server)? - empty_kib) / f64::from(CLIENTS);
        rows.push(Bar::reported(
            format!("{path}: memory of the server for a client, caches included"),
            Some(kib),
            "KiB",
        ));
    }
    Ok(rows)
}

/// Processor time of a server so far, seconds.
pub fn processor_s(server: &Server) -> Result<f64> {
    seconds_of(&server.pid().to_string(), OWN)
}

/// Processor time of all programs that this one has started and waited for, seconds.
pub fn ended_processor_s() -> Result<f64> {
    seconds_of("self", ENDED)
}

/// The first of two fields of `/proc/PID/stat`, counted after the name: user and system time of a
/// process itself, and of its children that have ended.
const OWN: usize = 11;
const ENDED: usize = 13;

fn seconds_of(process: &str, field: usize) -> Result<f64> {
    let stat = read_to_string(format!("/proc/{process}/stat")).context("no /proc")?;
    ticks(&stat, field).map(|ticks| ticks / TICKS_PER_S).context("/proc/PID/stat is not understood")
}

/// The sum of two fields in the text of `/proc/PID/stat`. The name of the program may have spaces.
fn ticks(stat: &str, field: usize) -> Option<f64> {
    let fields: Vec<&str> = stat.rsplit_once(')')?.1.split_whitespace().collect();
    Some(fields.get(field)?.parse::<f64>().ok()? + fields.get(field + 1)?.parse::<f64>().ok()?)
}

/// Greatest memory of a server so far, KiB.
fn memory_kib(server: &Server) -> Result<f64> {
    status_kib(server, "VmHWM:")
}

/// Resident memory of a server now, KiB.
pub fn resident_kib(server: &Server) -> Result<f64> {
    status_kib(server, "VmRSS:")
}

fn status_kib(server: &Server, field: &str) -> Result<f64> {
    let status = read_to_string(format!("/proc/{}/status", server.pid())).context("no /proc")?;
    let line = status.lines().find_map(|line| line.strip_prefix(field));
    line.and_then(|line| line.split_whitespace().next()?.parse().ok())
        .with_context(|| format!("/proc/PID/status has no {field}"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn times_are_read_behind_any_name() {
        let stat = "12 (a server) x) S 1 2 3 4 5 6 7 8 9 10 250 50 7 1 20 0 9 0 1 2 3";
        assert_eq!((ticks(stat, OWN), ticks(stat, ENDED)), (Some(300.0), Some(8.0)));
        assert_eq!(ticks("12 (server) S 1", OWN), None);
    }
}
