//! Micro-benchmarks of a server. Each starts the real program in a process of its own, measures one
//! property, and compares the figures with its bars.
//!
//! Reading order: [`server_process`] (the server, and what `/proc` and its metrics say about it),
//! [`connection`] (a client that costs little), [`keys`] (the chunks that are requested),
//! [`stats`], then one file per benchmark.

#![forbid(unsafe_code)]

pub mod cached;
pub mod cold;
pub mod connection;
pub mod fair;
pub mod flood;
pub mod idle;
pub mod keys;
pub mod nginx;
pub mod overload;
pub mod server_process;
pub mod stampede;
pub mod stats;

use anyhow::{Context, Result};
use bars::Bar;
use serde_json::{Value, json};
use server_process::Launch;
use std::path::PathBuf;
use tokio::task::JoinHandle;

/// Name and version, sent to the server in the Hello message.
pub const SOFTWARE: &str = concat!("tombolo-server-bench ", env!("CARGO_PKG_VERSION"));

/// What is measured.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub enum Bench {
    /// Cached chunks over 64 connections, 16 outstanding each, beside nginx where it and wrk are
    /// installed
    Cached,
    /// Chunks that must be generated, of levels 0, 2 and 4, and the time of each stage
    Cold,
    /// One chunk requested 10,000 times over 1,000 connections while it is generated
    Stampede,
    /// Memory of 1,000 idle connections
    Idle,
    /// One client with 1,000 requests outstanding beside 50 with 4 each
    Fair,
    /// Sessions that send views without pause, beside a polite client and a liveness probe
    Flood,
    /// Requests at up to five times the server's capacity, and the time until it recovers
    Overload,
}

impl Bench {
    /// As on the command line.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Cached => "cached",
            Self::Cold => "cold",
            Self::Stampede => "stampede",
            Self::Idle => "idle",
            Self::Fair => "fair",
            Self::Flood => "flood",
            Self::Overload => "overload",
        }
    }
}

/// How a benchmark is run.
#[derive(Clone, Debug)]
pub struct Plan {
    /// What is measured.
    pub bench: Bench,
    /// The program under measurement.
    pub launch: Launch,
    /// Rounds; figures are medians over them.
    pub rounds: u32,
    /// Length of each timed part, seconds.
    pub seconds: u64,
}

impl Plan {
    /// A plan with the server beside this program, unless another is given.
    ///
    /// # Errors
    /// The path of this program is unknown.
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
                .context("the path of this program is unknown; give the server with --server")?
                .with_file_name(format!("tombolo-server{}", std::env::consts::EXE_SUFFIX)),
        };
        Ok(Self { bench, launch: Launch { server, cpus }, rounds, seconds })
    }
}

/// The result of a benchmark.
#[derive(Clone, Debug)]
pub struct Report {
    /// Everything that was measured.
    pub figures: Value,
    /// The figures that have a bar.
    pub bars: Vec<Bar>,
    /// Further figures in sentences, for a record.
    pub notes: Vec<String>,
}

impl Report {
    /// The bars of a benchmark's figures.
    #[must_use]
    pub fn new(bench: Bench, figures: Value) -> Self {
        let (bars, notes) = match bench {
            Bench::Cached => (cached::bars(&figures), cached::notes(&figures)),
            Bench::Cold => (cold::bars(&figures), cold::notes(&figures)),
            Bench::Stampede => (stampede::bars(&figures), Vec::new()),
            Bench::Idle => (idle::bars(&figures), Vec::new()),
            Bench::Fair => (fair::bars(&figures), fair::notes(&figures)),
            Bench::Flood => (flood::bars(&figures), Vec::new()),
            Bench::Overload => (overload::bars(&figures), overload::notes(&figures)),
        };
        Self { figures, bars, notes }
    }

    /// Figures and bars with the conditions of the run.
    ///
    /// # Errors
    /// Never with bars of this crate: their fields have JSON forms.
    pub fn to_json(&self, plan: &Plan) -> Result<Value> {
        Ok(json!({
            "bench": plan.bench.name(),
            "server_cpus": plan.launch.cpus,
            "rounds": plan.rounds,
            "seconds": plan.seconds,
            "figures": self.figures,
            "bars": serde_json::to_value(&self.bars)?,
            "notes": self.notes,
        }))
    }
}

/// Runs one benchmark.
///
/// # Errors
/// It could not be measured: the server does not start, fails, or sends something wrong.
pub async fn run(plan: &Plan) -> Result<Report> {
    let figures = match plan.bench {
        Bench::Cached => cached::run(plan).await?,
        Bench::Cold => cold::run(plan).await?,
        Bench::Stampede => stampede::run(plan).await?,
        Bench::Idle => idle::run(plan).await?,
        Bench::Fair => fair::run(plan).await?,
        Bench::Flood => flood::run(plan).await?,
        Bench::Overload => overload::run(plan).await?,
    };
    Ok(Report::new(plan.bench, figures))
}

/// A number among the figures; none if it is absent, null or of another type.
fn at(figures: &Value, path: &str) -> Option<f64> {
    figures.pointer(path).and_then(Value::as_f64)
}

/// As [`at`], for texts: NaN if there is none.
fn shown(figures: &Value, path: &str) -> f64 {
    at(figures, path).unwrap_or(f64::NAN)
}

/// The numbers of a list, as text.
fn listed(figures: &Value, path: &str, digits: usize) -> String {
    let numbers = figures.pointer(path).and_then(Value::as_array).into_iter().flatten();
    let numbers = numbers.filter_map(Value::as_f64).map(|number| format!("{number:.digits$}"));
    numbers.collect::<Vec<_>>().join(", ")
}

/// Waits for all clients. The first that fails fails the benchmark.
async fn join_all<T>(clients: Vec<JoinHandle<Result<T>>>) -> Result<Vec<T>> {
    let mut results = Vec::with_capacity(clients.len());
    for client in clients {
        results.push(client.await.context("a client failed")??);
    }
    Ok(results)
}

/// Helpers for the tests of each benchmark's bars.
#[cfg(test)]
mod test_bars {
    use bars::Bar;
    use serde_json::Value;

    /// How many bars these figures miss.
    pub fn missed(bars: fn(&Value) -> Vec<Bar>, figures: &Value) -> usize {
        bars(figures).iter().filter(|bar| !bar.is_met()).count()
    }

    /// Checks that good figures meet every bar, that each of these values misses exactly one, and
    /// that every row misses if there are no figures.
    pub fn check(bars: fn(&Value) -> Vec<Bar>, good: &Value, bad: &[(&str, Value)]) {
        assert_eq!(missed(bars, good), 0, "{:#?}", bars(good));
        for (path, value) in bad {
            let mut figures = good.clone();
            *figures.pointer_mut(path).expect(path) = value.clone();
            assert_eq!(missed(bars, &figures), 1, "{path} {value}");
        }
        assert_eq!(missed(bars, &Value::Null), bars(good).len(), "no figures");
    }

    /// Checks how many bars miss if a field is absent, null or a text.
    pub fn check_absent(bars: fn(&Value) -> Vec<Bar>, good: &Value, absent: &[(&str, &str, usize)]) {
        for (path, field, expected) in absent {
            for value in [None, Some(Value::Null), Some(Value::from("much"))] {
                let mut figures = good.clone();
                let fields = figures.pointer_mut(path).and_then(Value::as_object_mut).expect(path);
                fields.remove(*field).expect(field);
                fields.extend(value.map(|value| ((*field).to_owned(), value)));
                assert_eq!(missed(bars, &figures), *expected, "{path} {field}");
            }
        }
    }
}
