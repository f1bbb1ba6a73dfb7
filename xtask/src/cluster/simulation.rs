//! The simulation beside real clients: the same paths, with the costs that this machine has. Those of
//! generation, views and encoding are measured by the simulation itself; those of sockets and of
//! clients follow from the processor time of a smaller load, so that what is compared is a prediction.

use super::capacity::{ended_processor_s, processor_s};
use crate::process;
use crate::server::Server;
use anyhow::{Context, Result, ensure};
use bars::Bar;
use bars::figures::{at, ratio};
use serde_json::{Value, json};
use std::path::Path;
use std::process::Stdio;

/// Real and simulated clients, those of the load that the costs follow from, and how long they fly.
const CLIENTS: &str = "1000";
const FEW_CLIENTS: &str = "100";
const SECONDS: &str = "20";

/// Costs of sockets, and of clients, which the smaller load gives.
const SOCKETS: [&str; 3] = ["receive_us", "write_us", "kib_us"];
const CLIENT: &str = "client_chunk_us";

/// How far a figure may be off, percent.
const WITHIN: f64 = 10.0;

/// What is compared: names in both reports.
const FIGURES: [(&str, &str); 3] =
    [("chunks", "chunks"), ("bytes", "bytes"), ("p99 of requested chunks", "latency_ms/p99")];

/// The rows.
///
/// # Errors
/// A program does not run or leaves no report.
pub fn rows() -> Result<Vec<Bar>> {
    let folder = super::folder("simulation")?;
    let costs = process::output(simulate(&["--measure-costs"]))?;
    let costs: Value = serde_json::from_str(&costs).context("the costs are not JSON")?;
    let costs = calibrated(&folder, costs)?;
    let Load { report: real, .. } = load(&folder.join("load.json"), CLIENTS)?;
    let simulated = simulation(&folder, &costs, CLIENTS)?;
    let free = simulation(&folder, &free(&costs), CLIENTS)?;
    let off = |report: &Value, path: &str| {
        ratio(at(report, path), at(&real, path)).map(|ratio| 100.0 * (ratio - 1.0).abs())
    };
    let mut rows =
        vec![Bar::none("simulation: frames that a state machine rejected", at(&simulated, "wrong"))];
    for cost in SOCKETS.into_iter().chain([CLIENT]) {
        rows.push(Bar::reported(format!("simulation: {cost}, by 100 real clients"), at(&costs, cost), "us"));
    }
    for (name, path) in FIGURES {
        rows.extend([
            Bar::reported(format!("1,000 real clients, 20 s: {name}"), at(&real, path), ""),
            Bar::reported(format!("1,000 simulated clients, 20 s: {name}"), at(&simulated, path), ""),
            Bar::at_most(format!("simulation: {name}, off by"), off(&simulated, path), "%", WITHIN),
        ]);
    }
    rows.push(Bar::at_least(
        "control: p99 of a simulation whose work costs nothing, off by",
        off(&free, FIGURES[2].1),
        "%",
        WITHIN,
    ));
    // Results of a build may stay: a failed removal is harmless.
    let _ = std::fs::remove_dir_all(&folder);
    Ok(rows)
}

/// The control: the same costs, all of them nothing.
fn free(costs: &Value) -> Value {
    match costs {
        Value::Number(_) => json!(0.0),
        Value::Array(list) => list.iter().map(free).collect(),
        Value::Object(fields) => fields.iter().map(|(name, cost)| (name.clone(), free(cost))).collect(),
        other => other.clone(),
    }
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

/// The costs with those of sockets and clients scaled, so that the simulation of few clients takes the
/// processor time of real ones.
fn calibrated(folder: &Path, mut costs: Value) -> Result<Value> {
    let real = load(&folder.join("few.json"), FEW_CLIENTS)?;
    let simulated = simulation(folder, &costs, FEW_CLIENTS)?;
    let mut without = costs.clone();
    SOCKETS.iter().for_each(|cost| without[*cost] = json!(0.0));
    let without = simulation(folder, &without, FEW_CLIENTS)?;
    let seconds = |report: &Value, field: &str| at(report, field).with_context(|| format!("no {field}"));
    let made_s = seconds(&without, "processor_s")?;
    let sockets = (real.server_s - made_s) / (seconds(&simulated, "processor_s")? - made_s);
    let clients = real.clients_s / seconds(&simulated, "client_processor_s")?;
    ensure!(sockets > 0.0 && clients > 0.0, "real clients took less time than the chunks of simulated ones");
    for (cost, times) in SOCKETS.into_iter().map(|cost| (cost, sockets)).chain([(CLIENT, clients)]) {
        costs[cost] = json!(seconds(&costs, cost)? * times);
    }
    Ok(costs)
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
    fn in_the_control_every_level_and_every_other_work_costs_nothing() {
        let costs = json!({ "chunk_us": [28.0, 33.0, 46.0], "view_us": 64.0 });
        assert_eq!(free(&costs), json!({ "chunk_us": [0.0, 0.0, 0.0], "view_us": 0.0 }));
    }
}
