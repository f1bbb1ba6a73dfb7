//! `tombolo-view`: options in, exit code out.

use client::native::{args::Args, run};
use std::process::ExitCode;

fn main() -> ExitCode {
    match cli::parse::<Args>() {
        Ok(args) => match run(&args) {
            Ok(()) => ExitCode::SUCCESS,
            Err(error) => {
                let code = if error.is::<cli::UsageError>() { cli::USAGE } else { cli::FAILED };
                cli::fail("tombolo-view", format_args!("{error:#}"), code)
            }
        },
        Err(code) => code,
    }
}
