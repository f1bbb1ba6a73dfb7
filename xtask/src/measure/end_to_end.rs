//! `end-to-end`: how soon a view is complete, how much crosses the wire, how many clients one
//! small machine carries, and what server and viewer take for it.

use super::run::Run;
use crate::server::Server;
use crate::{machine, process};
use anyhow::Result;
use bars::Bar;
use bars::figures::{at, ratio, text, worst};
use serde_json::Value;
use std::process::Command;

/// World of the server.
pub const WORLD_SEED: u64 = 1;

/// Cold and warm starts measured, each on a fresh server; the worst counts.
const STARTS: usize = 3;

/// The 8 km view: over the south of the island, looking north across it.
const CAMERA: &str = "0,250,2500,0,-8";

/// Frames timed after warm-up.
const FRAMES: &str = "30";

/// Clients and seconds of the load.
const LOAD: (u32, u32) = (200, 30);

/// A chunk budget that the 8 km view does not fit into, MiB.
const SMALL_BUDGET_MB: u32 = 8;

const MIB: f64 = (1 << 20) as f64;

/// Starts servers, viewers and the load.
///
/// # Errors
/// A program cannot be started or was interrupted.
pub fn rows(run: &mut Run) -> Result<Vec<Bar>> {
    let (mut cold, mut warm) = (Vec::new(), Vec::new());
    for number in 1..=STARTS {
        let server = Server::start(WORLD_SEED)?;
        cold.push(view(run, process::viewer(), &server, &format!("cold-{number}"), &[])?);
        warm.push(view(run, process::viewer(), &server, &format!("warm-{number}"), &[])?);
    }
    let budget = SMALL_BUDGET_MB.to_string();
    let small =
        view(run, process::viewer(), &Server::start(WORLD_SEED)?, "small-budget", &["--chunk-mb", &budget])?;
    let (load, peak_mib) = load(run)?;
    run.notes.push(how(&load));
    run.adapter = cold.iter().chain(&warm).find_map(|stats| text(stats, "adapter").map(str::to_owned));
    Ok(bars_of([&cold, &warm], &small, &load, peak_mib))
}

/// Every figure beside its bar.
fn bars_of([cold, warm]: [&[Value]; 2], small: &Value, load: &Value, peak_mib: Option<f64>) -> Vec<Bar> {
    let of = |runs: &[Value], field| worst(runs.iter().map(|run| at(run, field)));
    let of_all = |field| worst([of(cold, field), of(warm, field)]);
    let mib = |bytes: Option<f64>| bytes.map(|bytes| bytes / MIB);
    let (complete, picture) = ("seconds_to_complete_view", "seconds_to_first_picture");
    let (clients, seconds) = LOAD;
    let under_load = |what| format!("{clients} clients for {seconds} s: {what}");
    // A run of fewer clients or seconds than promised is no measurement of the promise.
    let is_whole = at(load, "clients") == Some(f64::from(clients))
        && at(load, "never_connected") == Some(0.0)
        && at(load, "seconds") >= Some(f64::from(seconds))
        && at(load, "chunks") > Some(0.0);
    let of_load = |field| at(load, field).filter(|_| is_whole);
    let resident = mib(at(small, "chunk_bytes_resident"));
    vec![
        Bar::under("8 km view complete, cold server", of(cold, complete), "s", 3.0),
        Bar::under("8 km view complete, warm server", of(warm, complete), "s", 0.5),
        Bar::under("first picture of it, cold server", of(cold, picture), "s", 3.0),
        Bar::under("first picture of it, warm server", of(warm, picture), "s", 2.0),
        Bar::under("received for the 8 km view", mib(of_all("bytes_received")), "MiB", 6.0),
        Bar::none(under_load("mismatches"), of_load("mismatches")),
        Bar::none(under_load("dropped sessions"), of_load("dropped")),
        Bar::under(under_load("server memory, peak"), peak_mib.filter(|_| is_whole), "MiB", 400.0),
        Bar::under("640 x 360 frame of the 8 km view, p50", of_all("frame_ms_p50"), "ms", 1000.0),
        Bar::under("640 x 360 frame of the 8 km view, p99", of_all("frame_ms_p99"), "ms", 1000.0),
        Bar::at_most(
            format!("viewer's chunk memory with --chunk-mb {SMALL_BUDGET_MB}"),
            resident,
            "MiB",
            f64::from(SMALL_BUDGET_MB),
        )
        .with_note("resident chunks times the size of a slot, as the viewer counts; no memory is measured"),
    ]
}

/// How the load ran, for the record.
fn how(load: &Value) -> String {
    let figure =
        |value: Option<f64>, unit| value.map_or("unknown".into(), |value| format!("{value:.1} {unit}"));
    let latency = |path| figure(at(load, path), "ms");
    format!(
        "View times, bytes and frame times are the worst of {STARTS} fresh servers. Under load: {}, \
         request to chunk p50 {}, p99 {}, p99.9 {}.",
        figure(ratio(at(load, "chunks"), at(load, "seconds")), "chunks/s"),
        latency("latency_ms/p50"),
        latency("latency_ms/p99"),
        latency("latency_ms/p999"),
    )
}

/// One viewer's stats. A viewer that fails leaves no figures, and its rows miss.
pub fn view(run: &mut Run, mut viewer: Command, server: &Server, name: &str, more: &[&str]) -> Result<Value> {
    process::quiet_drivers(&mut viewer);
    viewer
        .args(["--connect", &server.stream(), "--scene", "island", "--size", "640x360"])
        .args(["--quality", "medium", "--view-distance", "8000", "--grass", "0", "--trees", "0"])
        .args(["--frames", FRAMES])
        .arg(format!("--camera={CAMERA}"))
        .arg("--shot")
        .arg(run.file(&format!("{name}.png")))
        .args(more);
    run.report(name, viewer, "--stats")
}

/// The load's report and the server's peak memory under it, MiB.
fn load(run: &mut Run) -> Result<(Value, Option<f64>)> {
    let (clients, seconds) = LOAD;
    let mut server = Server::start(WORLD_SEED)?;
    let mut load = process::command(process::program("tombolo-load"));
    load.args(["--connect", &server.stream(), "--clients", &clients.to_string()])
        .args(["--seconds", &seconds.to_string()]);
    let report = run.report("load", load, "--json")?;
    if !server.is_running() {
        run.faults.push("The server died under load.".into());
        return Ok((report, None));
    }
    Ok((report, machine::peak_resident_mib(server.pid())))
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    fn view() -> Value {
        json!({ "adapter": "soft", "bytes_received": 1 << 20, "seconds_to_complete_view": 0.25,
            "seconds_to_first_picture": 1.0,
                "frame_ms_p50": 20.0, "frame_ms_p99": 40.0, "chunk_bytes_resident": 8 << 20 })
    }

    fn load() -> Value {
        json!({
            "clients": 200, "seconds": 30.0, "chunks": 9, "never_connected": 0, "mismatches": 0, "dropped": 0
        })
    }

    fn missed(view: &Value, load: &Value, peak: Option<f64>) -> Vec<String> {
        let views = [view.clone(), view.clone()];
        let rows = bars_of([&views, &views], view, load, peak);
        assert_eq!(rows.len(), 11);
        rows.into_iter().filter(Bar::is_missed).map(|row| row.name).collect()
    }

    #[test]
    fn good_reports_meet_every_bar() {
        assert_eq!(missed(&view(), &load(), Some(399.0)), [""; 0]);
    }

    #[test]
    fn every_missing_field_is_a_miss() {
        for (field, expected) in [
            ("seconds_to_complete_view", 2),
            ("seconds_to_first_picture", 2),
            ("bytes_received", 1),
            ("frame_ms_p50", 1),
            ("frame_ms_p99", 1),
            ("chunk_bytes_resident", 1),
        ] {
            for lost in [None, Some(Value::Null), Some(json!("fast"))] {
                let mut view = view();
                let fields = view.as_object_mut().unwrap();
                fields.remove(field);
                fields.extend(lost.map(|lost| (field.to_string(), lost)));
                assert_eq!(missed(&view, &load(), Some(1.0)).len(), expected, "{field}");
            }
        }
        assert_eq!(missed(&Value::Null, &Value::Null, None).len(), 11);
    }

    #[test]
    fn a_smaller_or_shorter_load_measures_nothing() {
        for (field, value) in [("clients", json!(199)), ("seconds", json!(29.9)), ("chunks", json!(0))] {
            let mut load = load();
            load[field] = value;
            assert_eq!(missed(&view(), &load, Some(1.0)).len(), 3, "{field}");
        }
    }
}
