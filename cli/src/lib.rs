//! What the command-line programs share: the exit codes, and errors in one line.
//!
//! A script reads the exit code, a person reads the line. 0: the thing asked for happened. 1: it
//! could not be done. 2: it was asked for wrongly (option, variable or file).

#![forbid(unsafe_code)]

mod usage;

pub use usage::{UsageError, read_token};

use clap::Parser;
use std::fmt::Display;
use std::process::ExitCode;

/// The thing asked for could not be done.
pub const FAILED: u8 = 1;

/// An option, variable or file cannot be used.
pub const USAGE: u8 = 2;

/// Parses the command line. `--help` and `--version` print and end with 0; a mistake ends with one
/// line that names the option, its value and what is allowed.
///
/// # Errors
/// The exit code to return from `main`; everything has been printed.
pub fn parse<A: Parser>() -> Result<A, ExitCode> {
    A::try_parse().map_err(|error| {
        if error.use_stderr() {
            let name = A::command().get_name().to_owned();
            return fail(&name, one_line(&error.to_string()), USAGE);
        }
        // Help or version. A closed pipe is no reason to fail.
        let _ = error.print();
        ExitCode::SUCCESS
    })
}

/// Prints `program: message` on standard error and gives the exit code.
pub fn fail(program: &str, message: impl Display, code: u8) -> ExitCode {
    eprintln!("{program}: {message}");
    ExitCode::from(code)
}

/// The message of a clap error without its usage block, as one line.
fn one_line(rendered: &str) -> String {
    let told = rendered.split("\nUsage:").next().unwrap_or(rendered);
    let told = told.split("\nFor more information").next().unwrap_or(told);
    let parts: Vec<_> = told.lines().map(str::trim).filter(|line| !line.is_empty()).collect();
    let parts = parts.join("; ");
    format!("{} (see --help)", parts.strip_prefix("error: ").unwrap_or(&parts))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[derive(Debug, Parser)]
    #[command(name = "probe")]
    struct Probe {
        /// How many.
        #[arg(long, value_parser = clap::value_parser!(u8).range(1..=9))]
        count: u8,
    }

    fn message(arguments: &[&str]) -> String {
        let arguments = std::iter::once("probe").chain(arguments.iter().copied());
        one_line(&Probe::try_parse_from(arguments).unwrap_err().to_string())
    }

    #[test]
    fn mistakes_become_one_line_with_option_value_and_what_is_allowed() {
        for (arguments, words) in [
            (&["--count", "12"][..], &["--count", "12", "1..=9"][..]),
            (&["--count", "many"][..], &["--count", "many"][..]),
            (&["--cuont", "1"][..], &["--cuont", "--count"][..]),
            (&[][..], &["--count"][..]),
        ] {
            let line = message(arguments);
            assert!(!line.contains('\n'), "{line}");
            for word in words {
                assert!(line.contains(word), "`{line}` lacks `{word}`");
            }
        }
    }
}
