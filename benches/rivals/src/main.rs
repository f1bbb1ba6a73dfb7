//! Times the land's noise against other noise libraries, in one process and interleaved: see
//! README.md beside this package.

mod comparisons;
mod ours;
mod quiet;
mod report;
mod rivals;
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
    /// Shift everything on the heap by this many times 16 bytes: where buffers lie decides some
    /// percent, and a program that is started again with another shift shows how many
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
                "rivals: a control failed, so the figures prove nothing; is the machine busy? run it again"
            );
            ExitCode::FAILURE
        }
        Err(error) => {
            eprintln!("rivals: {error:#}");
            ExitCode::FAILURE
        }
    }
}

fn run(args: &Args) -> Result<bool> {
    // Large enough to be cut from the heap's end, where the buffers that follow come from too.
    // Never freed.
    std::mem::forget(black_box(vec![1u8; 4096 + 16 * usize::from(args.shift)]));
    let report = comparisons::run(args.rounds.into())?;
    print!("{report}");
    if let Some(path) = &args.json {
        std::fs::write(path, format!("{:#}\n", report.json()))
            .with_context(|| format!("cannot write {}", path.display()))?;
    }
    Ok(report.is_believable())
}
