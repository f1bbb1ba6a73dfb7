//! Benchmarks of a server: each starts the real program in a process of its own, measures one
//! promise and says the figures as JSON.
//!
//! Reading order: [`host`] (the server and what is read from `/proc`), [`wire`] (a connection that
//! costs the client little), [`land_keys`] (what is asked for), then one file a benchmark. They
//! measure; whether a figure is good enough is judged by whoever reads the JSON, beside the machine
//! that it was measured on.

pub mod cached;
pub mod cold;
pub mod fair;
pub mod flood;
pub mod host;
pub mod idle;
pub mod land_keys;
pub mod overload;
pub mod rival;
pub mod stampede;
pub mod stats;
pub mod wire;

use anyhow::{Context, Result};
use host::Launch;
use serde_json::{Value, json};
use std::path::PathBuf;
use tokio::task::JoinHandle;

/// What is measured.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub enum Bench {
    /// Cached chunks over 64 connections, 16 outstanding each, beside nginx where it and wrk are
    /// installed
    Cached,
    /// Chunks that must be made, stage by stage
    Cold,
    /// One cold chunk asked for by 10,000 requests over 1,000 connections
    Stampede,
    /// Memory of 1,000 connected clients that do nothing
    Idle,
    /// One client with 1,000 requests outstanding beside 50 with 4 each
    Fair,
    /// Sessions that send views without pause, beside a polite client and a probe
    Flood,
    /// Arrivals at up to five times what the server can do, and afterwards
    Overload,
}

/// How a benchmark is run.
#[derive(Clone, Debug)]
pub struct Plan {
    /// What is measured.
    pub bench: Bench,
    /// The program under measurement.
    pub launch: Launch,
    /// Rounds; the figures are medians over them.
    pub rounds: u32,
    /// Length of each timed part, seconds.
    pub seconds: u64,
}

impl Plan {
    /// A plan with the server beside this program, unless another is named.
    ///
    /// # Errors
    /// This program's own place is unknown.
    pub fn new(
        bench: Bench,
        server: Option<PathBuf>,
        cpus: Option<String>,
        rounds: u32,
        seconds: u64,
    ) -> Result<Self> {
        let server = match server {
            Some(server) => server,
            None => std::env::current_exe()
                .context("cannot tell where this program lies; name the server with --server")?
                .with_file_name(format!("tombolo-server{}", std::env::consts::EXE_SUFFIX)),
        };
        Ok(Self { bench, launch: Launch { server, cpus }, rounds, seconds })
    }
}

/// Runs one benchmark.
///
/// # Errors
/// What it measures could not be measured: the server does not start, fails, or sends something
/// wrong.
pub async fn run(plan: &Plan) -> Result<Value> {
    let (name, figures) = match plan.bench {
        Bench::Cached => ("cached", cached::run(plan).await?),
        Bench::Cold => ("cold", cold::run(plan).await?),
        Bench::Stampede => ("stampede", stampede::run(plan).await?),
        Bench::Idle => ("idle", idle::run(plan).await?),
        Bench::Fair => ("fair", fair::run(plan).await?),
        Bench::Flood => ("flood", flood::run(plan).await?),
        Bench::Overload => ("overload", overload::run(plan).await?),
    };
    Ok(json!({ "bench": name, "server_cpus": plan.launch.cpus, "seconds": plan.seconds, "figures": figures }))
}

/// Waits for all clients; the first that fails fails the benchmark.
async fn to_end<T>(clients: Vec<JoinHandle<Result<T>>>) -> Result<Vec<T>> {
    let mut results = Vec::with_capacity(clients.len());
    for client in clients {
        results.push(client.await.context("a client failed")??);
    }
    Ok(results)
}
