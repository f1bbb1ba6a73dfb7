//! `tombolo-view`: options in, exit code out.

use client::native::{args::Args, run};
use std::process::ExitCode;

fn main() -> ExitCode {
    match cli::parse::<Args>() {
        Ok(args) => match run(&args) {
            Ok(()) => ExitCode::SUCCESS,
            Err(error) => cli::fail("tombolo-view", format_args!("{error:#}"), cli::FAILED),
        },
        Err(code) => code,
    }
}
