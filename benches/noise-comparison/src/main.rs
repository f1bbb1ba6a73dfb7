//! Times the land's noise against other noise libraries, in one process and interleaved: see
//! README.md beside this package.

mod comparisons;
mod disturbance;
mod land;
mod libraries;
mod report;
mod rounds;
mod threads;

use anyhow::{Context, Result};
use clap::Parser;
use std::hint::black_box;
use std::path::PathBuf;
use std::process::ExitCode;

#[derive(Debug, Parser)]
#[command(about = "Times the land's noise against other noise libraries")]
struct Args {
    /// Rounds of the small comparisons; the large ones take a quarter of them
    #[arg(long, default_value_t = 201, value_parser = clap::value_parser!(u16).range(9..))]
    rounds: u16,
    /// Shift everything on the heap by this many times 16 bytes: the position of buffers
    /// changes times by some percent, and starts with other shifts show by how many
    #[arg(long, default_value_t = 0)]
    shift: u8,
    /// Also write the figures to this file
    #[arg(long, value_name = "FILE")]
    json: Option<PathBuf>,
}

fn main() -> ExitCode {
    match run(&Args::parse()) {
        Ok(true) => ExitCode::SUCCESS,
        Ok(false) => {
            eprintln!(
                "noise-comparison: a control failed, so the figures are invalid; run it \
                 again on an idle machine"
            );
            ExitCode::FAILURE
        }
        Err(error) => {
            eprintln!("noise-comparison: {error:#}");
            ExitCode::FAILURE
        }
    }
}

fn run(args: &Args) -> Result<bool> {
    // Large enough to come from the end of the heap, like the buffers after it. Never freed.
    std::mem::forget(black_box(vec![1u8; 4096 + 16 * usize::from(args.shift)]));
    let report = comparisons::run(args.rounds.into())?;
    print!("{report}");
    if let Some(path) = &args.json {
        std::fs::write(path, format!("{:#}\n", report.json()))
            .with_context(|| format!("cannot write {}", path.display()))?;
    }
    Ok(report.is_valid())
}
