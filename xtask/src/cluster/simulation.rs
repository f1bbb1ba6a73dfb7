//! The simulation beside real clients: the same paths, with the costs that this machine has. Costs
//! of generation, views and encoding are measured by the simulation itself, the others are built
//! in; all are then scaled by the processor time of a load of as many real clients. Another such
//! load is compared.

use super::capacity::{ended_processor_s, processor_s};
use crate::process;
use crate::server::Server;
use anyhow::{Context, Result, ensure};
use bars::Bar;
use bars::figures::{at, ratio};
use serde_json::{Value, json};
use std::path::Path;
use std::process::Stdio;

/// Real and simulated clients, and how long they fly.
const CLIENTS: &str = "1000";
const SECONDS: &str = "20";

/// Real clients of a smaller load. Costs that follow from it are reported beside the others: with
/// few clients each write and each read has fewer messages, so one of them costs more.
const FEW_CLIENTS: &str = "100";

/// Simulations until the processor time is that of the real load: where the processors are full it
/// is not in proportion to the costs.
const SCALINGS: usize = 4;

/// The cost of a client; the others are the server's.
const CLIENT: &str = "client_chunk_us";

/// Costs that the record shows.
const SHOWN: [&str; 4] = ["view_us", "receive_us", "write_us", CLIENT];

/// How far a figure may be off, percent.
const WITHIN: f64 = 10.0;

/// Compared figures: names in both reports.
const FIGURES: [(&str, &str); 3] =
    [("chunks", "chunks"), ("bytes", "bytes"), ("p99 of requested chunks", P99)];

/// The figure that shows how full the processors are.
const P99: &str = "latency_ms/p99";

/// Simulated clients of the control of chunks and bytes: half as many.
const HALF_CLIENTS: &str = "500";

/// By which the work of one simulation costs more, to show how much the p99 depends on it.
const COSTLIER: f64 = 0.1;

/// The rows.
///
/// # Errors
/// A program does not run or leaves no report.
pub fn rows() -> Result<Vec<Bar>> {
    let folder = super::folder("simulation")?;
    let costs = process::output(simulate(&["--measure-costs"]))?;
    let built_in: Value = serde_json::from_str(&costs).context("the costs are not JSON")?;
    let few = load(&folder.join("few.json"), FEW_CLIENTS)?;
    let before = load(&folder.join("before.json"), CLIENTS)?;
    let costs = calibrated(&folder, &built_in, &before, CLIENTS)?;
    let simulated = simulation(&folder, &costs, CLIENTS)?;
    let free = simulation(&folder, &free(&costs), CLIENTS)?;
    let half = simulation(&folder, &costs, HALF_CLIENTS)?;
    let costlier = simulation(&folder, &scaled(&costs, 1.0 + COSTLIER), CLIENTS)?;
    let of_few = calibrated(&folder, &built_in, &few, FEW_CLIENTS)?;
    let of_few = simulation(&folder, &of_few, CLIENTS)?;
    let Load { report: real, .. } = load(&folder.join("load.json"), CLIENTS)?;
    let off = |report: &Value, path: &str| off_from(report, &real, path);
    let mut rows =
        vec![Bar::none("simulation: frames that a state machine rejected", at(&simulated, "wrong"))];
    for cost in SHOWN {
        rows.push(Bar::reported(
            format!("simulation: {cost}, by 1,000 real clients"),
            at(&costs, cost),
            "us",
        ));
    }
    for (name, path) in FIGURES {
        rows.extend([
            Bar::reported(format!("1,000 real clients, 20 s: {name}"), at(&real, path), ""),
            Bar::reported(format!("1,000 simulated clients, 20 s: {name}"), at(&simulated, path), ""),
            Bar::at_most(format!("simulation: {name}, off by"), off(&simulated, path), "%", WITHIN),
        ]);
    }
    rows.extend([
        Bar::reported(
            "1,000 real clients before: p99 of requested chunks, off by",
            off(&before.report, P99),
            "%",
        ),
        Bar::reported(
            "simulation with costs by 100 real clients: p99 of requested chunks, off by",
            off(&of_few, P99),
            "%",
        ),
        Bar::reported(
            "simulation, all work 10 % costlier: p99 of requested chunks, off by",
            off_from(&costlier, &simulated, P99),
            "%",
        ),
    ]);
    rows.extend(controls(&half, &free, &real));
    // Results of a build may stay: a failed removal is harmless.
    let _ = std::fs::remove_dir_all(&folder);
    Ok(rows)
}

/// How far a figure of a report is off the same one of another report, percent.
fn off_from(report: &Value, truth: &Value, path: &str) -> Option<f64> {
    ratio(at(report, path), at(truth, path)).map(|ratio| 100.0 * (ratio - 1.0).abs())
}

/// The controls of all compared figures: simulations that differ from the real load by more than
/// the bar. Half as many clients get fewer chunks, also where 1,000 have only 60 % of their chunks.
fn controls(half: &Value, free: &Value, real: &Value) -> [Bar; 3] {
    [
        ("control: chunks of 500 simulated clients, off by", half, "chunks"),
        ("control: bytes of 500 simulated clients, off by", half, "bytes"),
        ("control: p99 of a simulation whose work costs nothing, off by", free, P99),
    ]
    .map(|(name, report, path)| Bar::at_least(name, off_from(report, real, path), "%", WITHIN))
}

fn simulate(arguments: &[&str]) -> std::process::Command {
    let mut command = process::command(process::program("tombolo-simulate"));
    command.args(arguments);
    command
}

/// A load against a server of its own.
struct Load {
    report: Value,
    /// Processor time of the server and of the load test, seconds.
    server_s: f64,
    clients_s: f64,
}

fn load(json: &Path, clients: &str) -> Result<Load> {
    let server = Server::start(super::WORLD_SEED)?;
    let before_s = (processor_s(&server)?, ended_processor_s()?);
    let mut load = process::command(process::program("tombolo-load"));
    load.args(["--connect", &server.stream(), "--clients", clients, "--seconds", SECONDS, "--quiet"])
        .arg("--json")
        .arg(json)
        .stdout(Stdio::null());
    // A refused request is no fault of this comparison.
    process::status(&mut load)?;
    let (server_s, clients_s) = (processor_s(&server)? - before_s.0, ended_processor_s()? - before_s.1);
    let report: Value = serde_json::from_slice(&std::fs::read(json).context("tombolo-load left no report")?)?;
    ensure!(at(&report, "mismatches") == Some(0.0), "real clients received wrong chunks");
    ensure!(at(&report, "never_connected") == Some(0.0), "some real clients had no session");
    Ok(Load { report, server_s, clients_s })
}

/// The control: the same costs, all of them nothing.
fn free(costs: &Value) -> Value {
    scaled(costs, 0.0)
}

/// All costs times a factor.
fn scaled(costs: &Value, factor: f64) -> Value {
    let fields = costs.as_object().into_iter().flatten();
    fields.map(|(name, cost)| (name.clone(), times(cost, factor))).collect()
}

/// The costs scaled so that the simulation of as many clients takes the processor time of the real
/// ones: those of the server by one factor, that of a client by another.
fn calibrated(folder: &Path, costs: &Value, real: &Load, clients: &str) -> Result<Value> {
    let mut costs = costs.clone();
    for _ in 0..SCALINGS {
        let simulated = simulation(folder, &costs, clients)?;
        let seconds = |field: &str| at(&simulated, field).with_context(|| format!("no {field}"));
        let (server, client) =
            (real.server_s / seconds("processor_s")?, real.clients_s / seconds("client_processor_s")?);
        for (name, cost) in costs.as_object_mut().context("the costs are no object")? {
            *cost = times(cost, if name == CLIENT { client } else { server });
        }
    }
    Ok(costs)
}

/// A cost, or a list of them, times a factor.
fn times(cost: &Value, factor: f64) -> Value {
    match cost {
        Value::Array(list) => list.iter().map(|cost| times(cost, factor)).collect(),
        other => other.as_f64().map_or_else(|| other.clone(), |cost| json!(cost * factor)),
    }
}

/// The report of a simulation with these costs, of clients on the processors of the server.
fn simulation(folder: &Path, costs: &Value, clients: &str) -> Result<Value> {
    let file = folder.join("costs.json");
    std::fs::write(&file, costs.to_string())?;
    let processors = std::thread::available_parallelism()?.to_string();
    let mut command = simulate(&["--clients", clients, "--clients-per-replica", clients]);
    command.args(["--seconds", SECONDS, "--shared", "--processors", &processors, "--costs"]).arg(file);
    let json = folder.join("simulated.json");
    // A report of the simulation before must not pass for this one's.
    let _ = std::fs::remove_file(&json);
    command.arg("--json").arg(&json).stdout(Stdio::null());
    // It fails where a frame was rejected, which is a row here.
    process::status(&mut command)?;
    serde_json::from_slice(&std::fs::read(json).context("tombolo-simulate left no report")?)
        .context("the report of tombolo-simulate")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_compared_figure_has_a_control_that_misses_where_nothing_differs() {
        let real = json!({ "chunks": 100, "bytes": 1000, "latency_ms": { "p99": 50.0 } });
        let half = json!({ "chunks": 50, "bytes": 500 });
        let free = json!({ "latency_ms": { "p99": 1.0 } });
        let missed = |rows: [Bar; 3]| rows.iter().filter(|row| row.is_missed()).count();
        assert_eq!(missed(controls(&half, &free, &real)), 0);
        assert_eq!(missed(controls(&real, &real, &real)), FIGURES.len());
    }

    #[test]
    fn costs_of_every_level_are_scaled_and_cost_nothing_in_the_control() {
        let costs = json!({ "chunk_us": [28.0, 33.0, 46.0], "view_us": 64.0 });
        assert_eq!(times(&costs["chunk_us"], 0.5), json!([14.0, 16.5, 23.0]));
        assert_eq!(free(&costs), json!({ "chunk_us": [0.0, 0.0, 0.0], "view_us": 0.0 }));
    }
}
