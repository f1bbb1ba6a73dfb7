//! `tombolo-load`: reads the options, runs the load with a progress bar, prints the report, exits by its verdict.

use anyhow::{Context, Result, anyhow};
use indicatif::{ProgressBar, ProgressStyle};
use load::bench::{Bench, Plan};
use load::{Args, LoadConfig, Report, Tally};
use std::io::{IsTerminal, Write};
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
    let json = args.json.clone();
    let config = match args.resolve() {
        Ok(config) => config,
        Err(error) => return cli::fail(NAME, error, cli::USAGE),
    };
    match drive(config, json.as_deref()) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => cli::fail(NAME, format!("{error:#}"), cli::FAILED),
    }
}

fn drive(config: LoadConfig, json: Option<&Path>) -> Result<()> {
    let mut file = create(json)?;
    let runtime = tokio::runtime::Builder::new_multi_thread()
        .enable_all()
        // The default looks at the clock after 61 turns of work, here up to 0.1 s: too coarse for latencies.
        .event_interval(4)
        .build()
        .context("cannot start the runtime")?;
    let report = runtime.block_on(watched(config))?;
    if let Some(file) = &mut file {
        serde_json::to_writer_pretty(&mut *file, &report).context("--json: cannot write the report")?;
        writeln!(file).context("--json: cannot write the report")?;
    }
    // Nobody reading the table is no reason to fail; the exit code says what matters.
    let _ = write!(std::io::stdout(), "{report}");
    report.verdict().map_err(|problem| anyhow!(problem))
}

/// Runs a benchmark. One thread drives all of its connections, so that a core is left for the server.
fn measure(bench: Bench, args: Args) -> Result<()> {
    let mut file = create(args.json.as_deref())?;
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

/// The file for the results, created before the run: one that cannot be written should not cost the run.
fn create(json: Option<&Path>) -> Result<Option<std::fs::File>> {
    json.map(|path| {
        std::fs::File::create(path).with_context(|| format!("--json: cannot write `{}`", path.display()))
    })
    .transpose()
}

/// Runs with a progress bar where a person is watching.
async fn watched(config: LoadConfig) -> Result<Report> {
    let tally = Arc::new(Tally::default());
    let bar = if std::io::stderr().is_terminal() {
        let style = ProgressStyle::with_template("{bar:30} {pos}/{len} s  {msg}").context("progress bar")?;
        ProgressBar::new(config.seconds).with_style(style)
    } else {
        ProgressBar::hidden()
    };
    let run = load::run_counting(config, Arc::clone(&tally));
    tokio::pin!(run);
    let started = tokio::time::Instant::now();
    let mut tick = tokio::time::interval(Duration::from_millis(250));
    loop {
        tokio::select! {
            report = &mut run => {
                bar.finish_and_clear();
                return Ok(report);
            }
            _ = tick.tick() => {
                let (chunks, bytes, faults) = tally.progress();
                bar.set_position(started.elapsed().as_secs());
                bar.set_message(format!("{chunks} chunks, {:.1} MB, {faults} faults", bytes as f64 / 1e6));
            }
            _ = tokio::signal::ctrl_c() => {
                bar.finish_and_clear();
                return Err(anyhow!("interrupted before the end of the run; nothing is reported"));
            }
        }
    }
}
