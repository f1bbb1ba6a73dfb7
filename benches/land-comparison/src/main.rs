//! Times the land against its version 3 and against the same land in floats, in one process and
//! interleaved: see README.md beside this package.

mod agreement;
mod comparisons;
mod contenders;
#[path = "../../noise-comparison/src/disturbance.rs"]
mod disturbance;
mod floats;
#[path = "../../noise-comparison/src/rounds.rs"]
#[expect(dead_code, reason = "the other comparison uses more of it")]
mod rounds;

use anyhow::{Context, Result};
use clap::Parser;
use std::hint::black_box;
use std::path::PathBuf;
use std::process::ExitCode;

#[derive(Debug, Parser)]
#[command(about = "Times the land against its version 3 and against the same land in floats")]
struct Args {
    /// Rounds
    #[arg(long, default_value_t = 201, value_parser = clap::value_parser!(u16).range(9..))]
    rounds: u16,
    /// Shift everything on the heap by this many times 16 bytes: the position of buffers
    /// changes times by some percent, and starts with other shifts show by how many
    #[arg(long, default_value_t = 0)]
    shift: u8,
    /// Also write figures and bars to this file
    #[arg(long, value_name = "FILE")]
    json: Option<PathBuf>,
}

fn main() -> ExitCode {
    match run(&Args::parse()) {
        Ok(true) => ExitCode::SUCCESS,
        Ok(false) => {
            eprintln!("land-comparison: a bar was missed");
            ExitCode::FAILURE
        }
        Err(error) => {
            eprintln!("land-comparison: {error:#}");
            ExitCode::FAILURE
        }
    }
}

/// Whether every bar is kept.
fn run(args: &Args) -> Result<bool> {
    // Large enough to come from the end of the heap, like the buffers after it. Never freed.
    std::mem::forget(black_box(vec![1u8; 4096 + 16 * usize::from(args.shift)]));
    let agreement = agreement::compare()?;
    let report = comparisons::run(args.rounds.into(), &agreement)?;
    print!("{}", bars::text(&report.bars));
    report.notes.iter().for_each(|note| println!("{note}"));
    if let Some(path) = &args.json {
        let json = serde_json::json!({ "bars": report.bars, "notes": report.notes });
        std::fs::write(path, format!("{json:#}\n"))
            .with_context(|| format!("cannot write {}", path.display()))?;
    }
    Ok(!report.bars.iter().any(bars::Bar::is_missed))
}
