//! `tombolo-server-bench`: micro-benchmarks of a server. Each starts the real program in a process
//! of its own, measures one property, and compares the figures with its bars.
//!
//! Reading order: [`server_process`] (the server, and what `/proc` and its metrics say about it),
//! [`connection`] (a client that costs little), [`clients`] (many of them), [`rounds`], [`keys`]
//! (the chunks that are requested), then one file per benchmark.

#![forbid(unsafe_code)]

mod cached;
mod cgroup;
mod clients;
mod cold;
mod connection;
mod downloads;
mod fair;
mod flood;
mod garbage;
mod half_open;
mod hang_ups;
mod http;
mod idle;
mod keys;
mod mechanism;
mod mechanisms;
mod memory_cap;
mod nginx;
mod overload;
mod polite;
mod resealer;
mod rounds;
mod server_process;
mod stampede;
mod tls;
mod unread;
mod wrk;

use anyhow::{Context, Result, bail};
use bars::{Bar, Summary};
use clap::{Parser, ValueEnum};
use mechanism::Mechanism;
use serde_json::{Value, json};
use server_process::Launch;
use std::fs::File;
use std::io::Write;
use std::path::PathBuf;
use std::process::ExitCode;

const NAME: &str = "tombolo-server-bench";

/// Measures one property of a Tombolo server, which it starts in a process of its own. Linux only.
///
/// Prints the figures and their bars. Exits with 0 if everything could be measured; with --check
/// also only if no bar is missed.
#[derive(Clone, Debug, Parser)]
#[command(name = NAME, version)]
struct Args {
    /// What to measure
    #[arg(value_name = "BENCH", value_enum)]
    bench: Bench,
    #[command(flatten)]
    plan: Plan,
    /// File for figures and bars as JSON
    #[arg(long, value_name = "FILE")]
    json: Option<PathBuf>,
    /// Exit with 1 if a bar is missed
    #[arg(long)]
    check: bool,
}

/// The benchmark to run.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum Bench {
    /// Cached chunks over 64 connections, 16 outstanding each, beside nginx where it and wrk are
    /// installed
    Cached,
    /// The same chunks over HTTP, ours and nginx's, by wrk; needs both
    Http,
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
    /// One address with 64 HTTP requests at once for costly chunks, beside a session
    Downloads,
    /// 1,000 clients that never read, beside healthy ones
    Unread,
    /// 200,000 clients that connect, ask and hang up
    HangUps,
    /// 5,000 sockets that send nothing or a byte a second, beside new good clients
    HalfOpen,
    /// 200 clients and a hard limit of memory, 60 times as long as --seconds; needs root
    MemoryCap,
    /// Viewers whose server sends garbage, for --seconds; needs tombolo-view beside this program
    Garbage,
    /// Cached chunks over TLS and over plain TCP; needs openssl
    Tls,
    /// Requests at up to five times the server's capacity, and the time until it recovers
    Overload,
    /// Each mechanism against overload alone: a load that needs it, with it and without it in turn
    Mechanisms,
}

/// How a benchmark is run.
#[derive(Clone, Debug, clap::Args)]
struct Plan {
    /// Rounds, 1 to 100; figures are medians over them unless their note says otherwise
    #[arg(long, value_name = "N", default_value_t = 3,
          value_parser = clap::value_parser!(u32).range(1..=100))]
    rounds: u32,
    /// Length of each timed part in seconds, 1 to 3600
    #[arg(long, value_name = "S", default_value_t = 10,
          value_parser = clap::value_parser!(u64).range(1..=3600))]
    seconds: u64,
    #[command(flatten)]
    launch: Launch,
}

fn main() -> ExitCode {
    let args: Args = match cli::parse() {
        Ok(args) => args,
        Err(code) => return code,
    };
    match run(&args) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => cli::fail(NAME, format!("{error:#}"), cli::FAILED),
    }
}

fn run(args: &Args) -> Result<()> {
    // Created before the run: a file that cannot be written should not cost the run.
    let create = |path: &PathBuf| {
        File::create(path).with_context(|| format!("--json: cannot write `{}`", path.display()))
    };
    let json = args.json.as_ref().map(create).transpose()?;
    // One thread drives all connections, so that a core is left for the server.
    let runtime = tokio::runtime::Builder::new_current_thread()
        .enable_all()
        .build()
        .context("cannot start the runtime")?;
    let (figures, bars, notes) = runtime.block_on(measure(args.bench, &args.plan))?;
    let report = json!({
        "bench": args.bench.to_possible_value().map(|bench| bench.get_name().to_owned()),
        "server_cpus": args.plan.launch.cpus,
        "without": args.plan.launch.without.map(Mechanism::name),
        "rounds": args.plan.rounds,
        "seconds": args.plan.seconds,
        "figures": figures,
        "bars": bars,
        "notes": notes,
    });
    let text = serde_json::to_string_pretty(&report)?;
    if let Some(mut file) = json {
        writeln!(file, "{text}").context("--json: cannot write the figures")?;
    }
    let summary = Summary::of(&bars);
    // A closed pipe is no reason to fail.
    let _ = write!(std::io::stdout(), "{text}\n\n{}\n{summary}\n", bars::text(&bars));
    if args.check && summary.missed > 0 {
        bail!("{} of {} bars missed", summary.missed, bars.len());
    }
    Ok(())
}

/// Everything that a benchmark measures, the figures that have a bar, and further figures in
/// sentences.
async fn measure(bench: Bench, plan: &Plan) -> Result<(Value, Vec<Bar>, Vec<String>)> {
    type Judge = (fn(&Value) -> Vec<Bar>, fn(&Value) -> Vec<String>);
    let (figures, (bars, notes)): (Value, Judge) = match bench {
        Bench::Cached => (cached::run(plan).await?, (cached::bars, cached::notes)),
        Bench::Http => (http::run(plan).await?, (http::bars, http::notes)),
        Bench::Cold => (cold::run(plan).await?, (cold::bars, cold::notes)),
        Bench::Stampede => (stampede::run(plan).await?, (stampede::bars, stampede::notes)),
        Bench::Idle => (idle::run(plan).await?, (idle::bars, |_| Vec::new())),
        Bench::Fair => (fair::run(plan).await?, (fair::bars, fair::notes)),
        Bench::Flood => (flood::run(plan).await?, (flood::bars, |_| Vec::new())),
        Bench::Downloads => (downloads::run(plan).await?, (downloads::bars, downloads::notes)),
        Bench::Unread => (unread::run(plan).await?, (unread::bars, unread::notes)),
        Bench::HangUps => (hang_ups::run(plan).await?, (hang_ups::bars, hang_ups::notes)),
        Bench::HalfOpen => (half_open::run(plan).await?, (half_open::bars, half_open::notes)),
        Bench::MemoryCap => (memory_cap::run(plan).await?, (memory_cap::bars, memory_cap::notes)),
        Bench::Garbage => (garbage::run(plan).await?, (garbage::bars, garbage::notes)),
        Bench::Tls => (tls::run(plan).await?, (tls::bars, tls::notes)),
        Bench::Overload => (overload::run(plan).await?, (overload::bars, overload::notes)),
        Bench::Mechanisms => (mechanisms::run(plan).await?, (mechanisms::bars, mechanisms::notes)),
    };
    let judged = (bars(&figures), notes(&figures));
    Ok((figures, judged.0, judged.1))
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

    /// Checks that a run without the peers that it is about shows nothing: with this value every
    /// row misses, except those of controls.
    pub fn check_without_peers(bars: fn(&Value) -> Vec<Bar>, good: &Value, path: &str, value: Value) {
        let mut figures = good.clone();
        *figures.pointer_mut(path).expect(path) = value;
        for bar in bars(&figures) {
            assert_eq!(bar.is_met(), bar.name.ends_with("(control)"), "{path}: {}", bar.name);
        }
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
