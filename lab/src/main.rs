//! `tombolo-lab`: reads the options, runs one measurement, exits by its verdict.

use cli::UsageError;
use lab::Args;
use std::process::ExitCode;

const NAME: &str = "tombolo-lab";

fn main() -> ExitCode {
    let args: Args = match cli::parse() {
        Ok(args) => args,
        Err(code) => return code,
    };
    match lab::run(&args) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) if error.is::<UsageError>() => cli::fail(NAME, error, cli::USAGE),
        Err(error) => cli::fail(NAME, format!("{error:#}"), cli::FAILED),
    }
}
