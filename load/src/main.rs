//! `tombolo-load`: reads the options, runs the load, shows progress, prints the report, and exits
//! with its verdict.

mod progress;

use anyhow::{Context, Result, anyhow};
use load::{Args, LoadConfig, Report, RunStats, plot};
use progress::ProgressReporter;
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
        // The default polls timers after 61 tasks, here up to 0.1 s: too coarse for latencies.
        .event_interval(4)
        .build()
        .context("cannot start the runtime")?;
    let report = runtime.block_on(run_with_progress(config, quiet))?;
    if let Some(file) = &mut file {
        serde_json::to_writer_pretty(&mut *file, &report).context("--json: cannot write the report")?;
        writeln!(file).context("--json: cannot write the report")?;
    }
    if let Some(picture) = picture {
        plot::write(BufWriter::new(picture), &report)?;
    }
    // A closed pipe is no reason to fail; the exit code has the verdict.
    let _ = write!(std::io::stdout(), "{report}");
    report.verdict().map_err(|problem| anyhow!(problem))
}

/// A file for results, created before the run: an unwritable file must not cost a run.
fn create(option: &str, path: Option<&Path>) -> Result<Option<std::fs::File>> {
    path.map(|path| {
        std::fs::File::create(path).with_context(|| format!("{option}: cannot write `{}`", path.display()))
    })
    .transpose()
}

/// Runs with progress.
async fn run_with_progress(config: LoadConfig, quiet: bool) -> Result<Report> {
    let stats = Arc::new(RunStats::new(&config));
    let mut reporter = ProgressReporter::new(quiet, stats.duration());
    let run = load::run_counting(config, Arc::clone(&stats));
    tokio::pin!(run);
    let mut tick = tokio::time::interval(Duration::from_secs(1));
    loop {
        tokio::select! {
            report = &mut run => {
                reporter.finish();
                return Ok(report);
            }
            _ = tick.tick() => reporter.update(&stats.progress()),
            _ = tokio::signal::ctrl_c() => {
                reporter.finish();
                return Err(anyhow!("interrupted before the end of the run; no report was written"));
            }
        }
    }
}
