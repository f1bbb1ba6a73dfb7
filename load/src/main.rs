//! `tombolo-load`: reads the options, runs the load, shows progress, prints the report, and exits
//! with its verdict.

mod progress;

use anyhow::{Context, Result, anyhow};
use load::{Args, LoadConfig, Report, RunStats, plot};
use progress::ProgressReporter;
use std::fs::File;
use std::io::{BufWriter, Write};
use std::path::Path;
use std::process::ExitCode;
use std::sync::Arc;
use std::time::Duration;
use tokio_util::sync::CancellationToken;

const NAME: &str = "tombolo-load";

/// Exit code after an interrupt.
const INTERRUPTED: u8 = 130;

/// A run that was interrupted, in one line.
#[derive(Debug, thiserror::Error)]
#[error("{0}")]
struct Interrupted(String);

fn main() -> ExitCode {
    let args: Args = match cli::parse() {
        Ok(args) => args,
        Err(code) => return code,
    };
    for line in args.without_effect() {
        eprintln!("{line}");
    }
    let (json, picture, quiet) = (args.json.clone(), args.plot.clone(), args.quiet);
    let config = match args.resolve() {
        Ok(config) => config,
        Err(error) => return cli::fail(NAME, error, cli::USAGE),
    };
    if let Err(error) = cli::are_apart(("--json", json.as_deref()), ("--plot", picture.as_deref())) {
        return cli::fail(NAME, error, cli::USAGE);
    }
    match drive(config, json.as_deref(), picture.as_deref(), quiet) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            let code = if error.is::<Interrupted>() { INTERRUPTED } else { cli::FAILED };
            cli::fail(NAME, format!("{error:#}"), code)
        }
    }
}

fn drive(config: LoadConfig, json: Option<&Path>, picture: Option<&Path>, quiet: bool) -> Result<()> {
    let outputs = [("--json", json), ("--plot", picture)];
    // An unwritable file must not cost a run.
    for (option, path) in outputs {
        check_writable(option, path)?;
    }
    let runtime = tokio::runtime::Builder::new_multi_thread()
        .enable_all()
        // The default polls timers after 61 tasks, here up to 0.1 s: too coarse for latencies.
        .event_interval(4)
        .build()
        .context("cannot start the runtime")?;
    let outcome = runtime.block_on(run_with_progress(config, quiet));
    // A look-up of a name may take long: its thread must not keep the program.
    runtime.shutdown_background();
    let report = outcome?;
    // A closed pipe is no reason to fail; the exit code has the verdict.
    let _ = write!(std::io::stdout(), "{report}");
    let written = write_json(json, &report).and_then(|()| write_plot(picture, &report));
    let problem = match (report.verdict(), written) {
        (Ok(()), written) => return written,
        (Err(problem), Ok(())) => problem,
        (Err(problem), Err(unwritten)) => format!("{problem}; {unwritten:#}"),
    };
    Err(if report.interrupted { Interrupted(problem).into() } else { anyhow!(problem) })
}

/// Writes the report by the file's path, not by a file opened before the run: a folder that was
/// removed or closed meanwhile is an error, where a write to the removed file would succeed.
fn write_json(path: Option<&Path>, report: &Report) -> Result<()> {
    let Some(path) = path else { return Ok(()) };
    let write = |mut file: File| {
        serde_json::to_writer_pretty(&mut file, report).map_err(std::io::Error::from)?;
        writeln!(file)
    };
    cli::replace_file(path, write).with_context(|| unwritable("--json", path))
}

fn write_plot(path: Option<&Path>, report: &Report) -> Result<()> {
    let Some(path) = path else { return Ok(()) };
    let write = |file| plot::write(BufWriter::new(file), report);
    cli::replace_file(path, write).with_context(|| unwritable("--plot", path))
}

/// Whether a file for results can be written. Creates it; the content of an old one is kept until
/// the run has its results.
fn check_writable(option: &str, path: Option<&Path>) -> Result<()> {
    let Some(path) = path else { return Ok(()) };
    std::fs::OpenOptions::new()
        .create(true)
        .append(true)
        .open(path)
        .with_context(|| unwritable(option, path))?;
    Ok(())
}

fn unwritable(option: &str, path: &Path) -> String {
    format!("{option}: cannot write `{}`", path.display())
}

/// Runs with progress, until the end or the first Ctrl-C.
///
/// # Errors
/// A second Ctrl-C, or no handler for the first.
async fn run_with_progress(config: LoadConfig, quiet: bool) -> Result<Report> {
    let stats = Arc::new(RunStats::new(&config));
    let mut reporter = ProgressReporter::new(quiet, stats.duration());
    let interrupt = CancellationToken::new();
    let run = load::run_counting(config, Arc::clone(&stats), interrupt.clone());
    let ctrl_c = tokio::signal::ctrl_c();
    tokio::pin!(run, ctrl_c);
    let mut tick = tokio::time::interval(Duration::from_secs(1));
    loop {
        tokio::select! {
            // In this order: the handler exists before the first client connects.
            biased;
            handled = &mut ctrl_c => {
                handled.context("cannot listen for Ctrl-C")?;
                reporter.finish();
                if interrupt.is_cancelled() {
                    return Err(Interrupted("interrupted twice; no report was written".into()).into());
                }
                interrupt.cancel();
                ctrl_c.set(tokio::signal::ctrl_c());
            }
            report = &mut run => {
                reporter.finish();
                return Ok(report);
            }
            _ = tick.tick(), if !interrupt.is_cancelled() => reporter.update(&stats.progress()),
        }
    }
}
