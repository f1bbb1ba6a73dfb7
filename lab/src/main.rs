//! `tombolo-lab`: reads the options, runs one measurement, exits by its verdict.

use anyhow::Result;
use cli::UsageError;
use lab::{Args, Command, accuracy, codec, culling, digest, lod, pom, stability, timings};
use std::process::ExitCode;

const NAME: &str = "tombolo-lab";

fn main() -> ExitCode {
    let args: Args = match cli::parse() {
        Ok(args) => args,
        Err(code) => return code,
    };
    match measure(&args) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) if error.is::<UsageError>() => cli::fail(NAME, error, cli::USAGE),
        Err(error) => cli::fail(NAME, format!("{error:#}"), cli::FAILED),
    }
}

fn measure(args: &Args) -> Result<()> {
    args.outputs.prepare()?;
    match &args.command {
        Command::Digest(options) => digest::run(options, &args.outputs),
        Command::Accuracy(options) => accuracy::run(options, &args.outputs),
        Command::Lod(options) => lod::run(options, &args.outputs),
        Command::Pom(options) => pom::run(options, &args.outputs),
        Command::Culling(options) => culling::run(options, &args.outputs),
        Command::Stability(options) => stability::run(options, &args.outputs),
        Command::Timings(options) => timings::run(options, &args.outputs),
        Command::Codec(options) => codec::run(options, &args.outputs),
    }
}
