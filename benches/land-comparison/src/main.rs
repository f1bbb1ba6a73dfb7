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
#[path = "../../noise-comparison/src/start.rs"]
mod start;

use anyhow::Result;
use clap::Parser;
use std::process::ExitCode;

#[derive(Debug, Parser)]
#[command(about = "Times the land against its version 3 and against the same land in floats")]
struct Args {
    #[command(flatten)]
    start: start::Options,
}

fn main() -> ExitCode {
    start::exit_code("land-comparison", run(&Args::parse().start), "a bar was missed")
}

/// Whether every bar is kept.
fn run(options: &start::Options) -> Result<bool> {
    options.shift_heap();
    let agreement = agreement::compare()?;
    let report = comparisons::run(options.rounds.into(), &agreement)?;
    print!("{}", bars::text(&report.bars));
    report.notes.iter().for_each(|note| println!("{note}"));
    options.write_json(&serde_json::json!({ "bars": report.bars, "notes": report.notes }))?;
    Ok(!report.bars.iter().any(bars::Bar::is_missed))
}
