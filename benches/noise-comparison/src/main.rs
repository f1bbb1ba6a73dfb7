//! Times the land's noise against other noise libraries, in one process and interleaved: see
//! README.md beside this package.

mod comparisons;
mod disturbance;
mod land;
mod libraries;
mod report;
mod rounds;
mod start;
mod threads;

use anyhow::Result;
use clap::Parser;
use std::process::ExitCode;

#[derive(Debug, Parser)]
#[command(about = "Times the land's noise against other noise libraries")]
struct Args {
    #[command(flatten)]
    start: start::Options,
}

fn main() -> ExitCode {
    let invalid = "a control failed, so the figures are invalid; run it again on an idle machine";
    start::exit_code("noise-comparison", run(&Args::parse().start), invalid)
}

/// Whether the figures are valid.
fn run(options: &start::Options) -> Result<bool> {
    options.shift_heap();
    let report = comparisons::run(options.rounds.into())?;
    print!("{report}");
    options.write_json(&report.json())?;
    Ok(report.is_valid())
}
