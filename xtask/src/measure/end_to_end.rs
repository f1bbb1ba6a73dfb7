//! `end-to-end`: how soon a view is complete, how much crosses the wire, how many clients one
//! small machine carries, and what server and viewer take for it.

use super::record::{self, Heading};
use super::report::{self, number};
use crate::server::Server;
use crate::setup::{self, Extent};
use crate::{machine, process};
use anyhow::{Context, Result};
use bars::{Bar, Limit, worst};
use serde_json::Value;
use std::path::PathBuf;

const WORLD_SEED: u64 = 1;

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

/// Builds, measures, prints, records.
///
/// # Errors
/// The build or the record failed, or a bar was missed.
pub fn run() -> Result<()> {
    setup::run(Extent::Headless)?;
    process::run(process::build(&["tombolo-server", "tombolo-view", "tombolo-load"]))
        .context("measure: the build failed")?;
    let folder = process::target().join("measure/end-to-end");
    std::fs::create_dir_all(&folder)
        .with_context(|| format!("measure: cannot create {}", folder.display()))?;
    let mut measurement = EndToEnd { folder, notes: Vec::new() };

    let (mut cold, mut warm) = (Vec::new(), Vec::new());
    for number in 1..=STARTS {
        let server = Server::start(WORLD_SEED).context("measure")?;
        cold.push(measurement.view(&server, &format!("cold-{number}"), &[])?);
        warm.push(measurement.view(&server, &format!("warm-{number}"), &[])?);
    }
    let budget = SMALL_BUDGET_MB.to_string();
    let small = {
        let server = Server::start(WORLD_SEED).context("measure")?;
        measurement.view(&server, "small-budget", &["--chunk-mb", &budget])?
    };
    let (load, peak_mib) = measurement.load()?;

    let all: Vec<_> = cold.iter().chain(&warm).cloned().collect();
    let rows = rows(&cold, &warm, &all, &small, &load, peak_mib);
    measurement.notes.insert(0, how(&load));
    let adapter = all.iter().find_map(|stats| stats.get("adapter")?.as_str());
    let path = record::write(&Heading { name: "end-to-end", adapter, notes: &measurement.notes }, &rows)?;
    super::judge(&rows, &path)
}

/// Every figure beside its bar.
fn rows(
    cold: &[Value],
    warm: &[Value],
    all: &[Value],
    small: &Value,
    load: &Value,
    peak_mib: Option<f64>,
) -> Vec<Bar> {
    let worst_of = |runs: &[Value], field: &str, scale: f64| {
        let figures: Vec<_> = runs.iter().map(|run| number(run, field).map(|value| value / scale)).collect();
        worst(&figures)
    };
    let complete = "seconds_to_complete_view";
    let (clients, seconds) = LOAD;
    let under_load = format!("{clients} clients for {seconds} s");
    // A run of fewer clients or seconds than promised is no measurement of the promise.
    let is_whole = number(load, "clients") == Some(f64::from(clients))
        && number(load, "seconds").is_some_and(|measured| measured >= f64::from(seconds))
        && number(load, "chunks").is_some_and(|chunks| chunks > 0.0);
    let of_load = |field| number(load, field).filter(|_| is_whole);
    vec![
        Bar::new("8 km view complete, cold server", worst_of(cold, complete, 1.0), "s", Limit::Under(3.0)),
        Bar::new("8 km view complete, warm server", worst_of(warm, complete, 1.0), "s", Limit::Under(0.5)),
        Bar::new(
            "first picture of it, warm server",
            worst_of(warm, "seconds_to_first_picture", 1.0),
            "s",
            Limit::Reported,
        ),
        Bar::new(
            "received for the 8 km view",
            worst_of(all, "bytes_received", MIB),
            "MiB",
            Limit::Under(6.0),
        ),
        Bar::new(format!("{under_load}: mismatches"), of_load("mismatches"), "", Limit::AtMost(0.0)),
        Bar::new(format!("{under_load}: dropped sessions"), of_load("dropped"), "", Limit::AtMost(0.0)),
        Bar::new(
            format!("{under_load}: server memory, peak"),
            peak_mib.filter(|_| is_whole),
            "MiB",
            Limit::Under(400.0),
        ),
        Bar::new(
            "640 x 360 frame of the 8 km view, p50",
            worst_of(all, "frame_ms_p50", 1.0),
            "ms",
            Limit::Under(1000.0),
        ),
        Bar::new(
            "640 x 360 frame of the 8 km view, p99",
            worst_of(all, "frame_ms_p99", 1.0),
            "ms",
            Limit::Under(1000.0),
        ),
        Bar::new(
            format!("viewer's chunk memory with --chunk-mb {SMALL_BUDGET_MB}"),
            number(small, "chunk_bytes_resident").map(|bytes| bytes / MIB),
            "MiB",
            Limit::AtMost(f64::from(SMALL_BUDGET_MB)),
        ),
    ]
}

/// How the load ran, for the record.
fn how(load: &Value) -> String {
    let figure =
        |value: Option<f64>, unit| value.map_or("unknown".into(), |value| format!("{value:.1} {unit}"));
    let latency = |name| load.get("latency_ms").and_then(|latency| number(latency, name));
    let rate = number(load, "chunks").zip(number(load, "seconds")).map(|(chunks, seconds)| chunks / seconds);
    format!(
        "View times, bytes and frame times are the worst of {STARTS} fresh servers. Under load: {}, \
         request to chunk p50 {}, p99 {}, p99.9 {}.",
        figure(rate, "chunks/s"),
        figure(latency("p50"), "ms"),
        figure(latency("p99"), "ms"),
        figure(latency("p999"), "ms"),
    )
}

/// The runs' folder and what went wrong in them.
struct EndToEnd {
    folder: PathBuf,
    notes: Vec<String>,
}

impl EndToEnd {
    /// One viewer's stats. A viewer that fails leaves no figures, and its rows miss.
    fn view(&mut self, server: &Server, name: &str, more: &[&str]) -> Result<Value> {
        println!("measure: viewer, {name}");
        let stats = self.folder.join(name).with_extension("json");
        let mut viewer = process::viewer();
        viewer
            .args(["--connect", &server.stream(), "--scene", "island", "--size", "640x360"])
            .args(["--view-distance", "8000", "--frames", FRAMES])
            .arg(format!("--camera={CAMERA}"))
            .arg("--shot")
            .arg(self.folder.join(name).with_extension("png"))
            .arg("--stats")
            .arg(&stats)
            .args(more);
        report::of(viewer, &stats, &mut self.notes)
    }

    /// The load's report and the server's peak memory under it, MiB.
    fn load(&mut self) -> Result<(Value, Option<f64>)> {
        let (clients, seconds) = LOAD;
        println!("measure: {clients} clients for {seconds} s");
        let mut server = Server::start(WORLD_SEED).context("measure")?;
        let json = self.folder.join("load.json");
        let mut load = process::command(process::program("tombolo-load"));
        load.args(["--connect", &server.stream(), "--clients", &clients.to_string()])
            .args(["--seconds", &seconds.to_string(), "--json"])
            .arg(&json);
        let report = report::of(load, &json, &mut self.notes)?;
        if !server.is_running() {
            self.notes.push("The server died under load.".into());
            return Ok((report, None));
        }
        Ok((report, machine::peak_resident_mib(server.pid())))
    }
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
        json!({ "clients": 200, "seconds": 30.0, "chunks": 9, "mismatches": 0, "dropped": 0 })
    }

    fn missed(view: &Value, load: &Value, peak: Option<f64>) -> Vec<String> {
        let views = [view.clone(), view.clone()];
        let rows = rows(&views, &views, &views, view, load, peak);
        assert_eq!(rows.len(), 10);
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
            ("seconds_to_first_picture", 1),
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
        assert_eq!(missed(&Value::Null, &Value::Null, None).len(), 10);
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
