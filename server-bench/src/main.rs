//! `tombolo-server-bench`: reads the options, runs one benchmark, prints its figures as JSON and
//! its bars as a table.

use anyhow::{Context, Result, bail};
use bars::Summary;
use clap::Parser;
use server_bench::{Bench, Plan};
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
    /// Rounds, 1 to 100; figures are medians over them unless their note says otherwise
    #[arg(long, value_name = "N", default_value_t = 3,
          value_parser = clap::value_parser!(u32).range(1..=100))]
    rounds: u32,
    /// Length of each timed part in seconds, 1 to 3600
    #[arg(long, value_name = "S", default_value_t = 10,
          value_parser = clap::value_parser!(u64).range(1..=3600))]
    seconds: u64,
    /// Server program to measure [default: tombolo-server beside this program]
    #[arg(long, value_name = "FILE")]
    server: Option<PathBuf>,
    /// Processors for the server, and for nginx in `cached`, as `taskset -c` takes them, such as 0
    /// or 0-3 [default: all]
    #[arg(long, value_name = "LIST")]
    server_cpus: Option<String>,
    /// File for figures and bars as JSON
    #[arg(long, value_name = "FILE")]
    json: Option<PathBuf>,
    /// Exit with 1 if a bar is missed
    #[arg(long)]
    check: bool,
}

fn main() -> ExitCode {
    let args: Args = match cli::parse() {
        Ok(args) => args,
        Err(code) => return code,
    };
    match run(args) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => cli::fail(NAME, format!("{error:#}"), cli::FAILED),
    }
}

fn run(args: Args) -> Result<()> {
    // Created before the run: a file that cannot be written should not cost the run.
    let json = args
        .json
        .as_deref()
        .map(|path| File::create(path).with_context(|| format!("--json: cannot write `{}`", path.display())));
    let json = json.transpose()?;
    let plan = Plan::new(args.bench, args.server, args.server_cpus, args.rounds, args.seconds)?;
    // One thread drives all connections, so that a core is left for the server.
    let runtime = tokio::runtime::Builder::new_current_thread()
        .enable_all()
        .build()
        .context("cannot start the runtime")?;
    let report = runtime.block_on(server_bench::run(&plan))?;
    let text = serde_json::to_string_pretty(&report.to_json(&plan)?)?;
    if let Some(mut file) = json {
        writeln!(file, "{text}").context("--json: cannot write the figures")?;
    }
    let summary = Summary::of(&report.bars);
    // A closed pipe is no reason to fail.
    let _ = write!(std::io::stdout(), "{text}\n\n{}\n{summary}\n", bars::text(&report.bars));
    if args.check && summary.missed > 0 {
        bail!("{} of {} bars missed", summary.missed, report.bars.len());
    }
    Ok(())
}
