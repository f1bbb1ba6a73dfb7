//! `tombolo-load`: reads the options, runs the load and says how it goes, prints the report, exits
//! by its verdict.

mod progress;

use anyhow::{Context, Result, anyhow};
use load::bench::{Bench, Plan};
use load::{Args, LoadConfig, Report, Tally, plot};
use progress::Live;
use std::io::{BufWriter, Write};
use std::path::Path;
use std::process::ExitCode;
use std::sync::Arc;
use std::time::Duration;

const NAME: &str = "tombolo-load";

fn main() -> ExitCode {
    let args: Args = match cli::parse() {
        Ok(args) => args,
        Err(code) => return code,
    };
    if let Some(bench) = args.bench {
        return match measure(bench, args) {
            Ok(()) => ExitCode::SUCCESS,
            Err(error) => cli::fail(NAME, format!("{error:#}"), cli::FAILED),
        };
    }
    let (json, picture, quiet) = (args.json.clone(), args.plot.clone(), args.quiet);
    let config = match args.resolve() {
        Ok(config) => config,
        Err(error) => return cli::fail(NAME, error, cli::USAGE),
    };
    match drive(config, json.as_deref(), picture.as_deref(), quiet) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => cli::fail(NAME, format!("{error:#}"), cli::FAILED),
    }
}

fn drive(config: LoadConfig, json: Option<&Path>, picture: Option<&Path>, quiet: bool) -> Result<()> {
    let mut file = create("--json", json)?;
    let picture = create("--plot", picture)?;
    let runtime = tokio::runtime::Builder::new_multi_thread()
        .enable_all()
        // The default looks at the clock after 61 turns of work, here up to 0.1 s: too coarse for
        // latencies.
        .event_interval(4)
        .build()
        .context("cannot start the runtime")?;
    let report = runtime.block_on(watched(config, quiet))?;
    if let Some(file) = &mut file {
        serde_json::to_writer_pretty(&mut *file, &report).context("--json: cannot write the report")?;
        writeln!(file).context("--json: cannot write the report")?;
    }
    if let Some(picture) = picture {
        plot::write(BufWriter::new(picture), &report)?;
    }
    // Nobody reading the table is no reason to fail; the exit code says what matters.
    let _ = write!(std::io::stdout(), "{report}");
    report.verdict().map_err(|problem| anyhow!(problem))
}

/// Runs a benchmark. One thread drives all of its connections, so that a core is left for the
/// server.
fn measure(bench: Bench, args: Args) -> Result<()> {
    let mut file = create("--json", args.json.as_deref())?;
    let plan = Plan::new(bench, args.server, args.server_cpus, args.rounds, args.seconds)?;
    let runtime = tokio::runtime::Builder::new_current_thread()
        .enable_all()
        .build()
        .context("cannot start the runtime")?;
    let figures = serde_json::to_string_pretty(&runtime.block_on(load::bench::run(&plan))?)?;
    if let Some(file) = &mut file {
        writeln!(file, "{figures}").context("--json: cannot write the figures")?;
    }
    // Nobody reading them is no reason to fail.
    let _ = writeln!(std::io::stdout(), "{figures}");
    Ok(())
}

/// A file for results, created before the run: one that cannot be written should not cost the run.
fn create(option: &str, path: Option<&Path>) -> Result<Option<std::fs::File>> {
    path.map(|path| {
        std::fs::File::create(path).with_context(|| format!("{option}: cannot write `{}`", path.display()))
    })
    .transpose()
}

/// Runs, and says how it goes.
async fn watched(config: LoadConfig, quiet: bool) -> Result<Report> {
    let tally = Arc::new(Tally::new(&config));
    let mut live = Live::new(quiet, tally.lasts());
    let run = load::run_counting(config, Arc::clone(&tally));
    tokio::pin!(run);
    let mut tick = tokio::time::interval(Duration::from_secs(1));
    loop {
        tokio::select! {
            report = &mut run => {
                live.finish();
                return Ok(report);
            }
            _ = tick.tick() => live.say(&tally.progress()),
            _ = tokio::signal::ctrl_c() => {
                live.finish();
                return Err(anyhow!("interrupted before the end of the run; nothing is reported"));
            }
        }
    }
}
