//! Exit codes and one-line errors, shared by the command-line programs.
//!
//! Exit code 0: success. 1: failure. 2: an invalid option, variable or file.

#![forbid(unsafe_code)]

mod output;
mod usage;

pub use output::{are_apart, replace_file};
pub use usage::{UsageError, read_token};

use clap::{Arg, Command, Parser};
use std::fmt::Display;
use std::process::ExitCode;

/// The program failed.
pub const FAILED: u8 = 1;

/// An option, variable or file cannot be used.
pub const USAGE: u8 = 2;

/// Parses the command line. `--help` and `--version` print and exit with 0; an invalid option
/// prints one line with its name, its value and the allowed values.
///
/// # Errors
/// The exit code for `main`; the message is already printed.
pub fn parse<A: Parser>() -> Result<A, ExitCode> {
    let matches = without_empty_variables(A::command()).try_get_matches();
    matches.and_then(|mut matches| A::from_arg_matches_mut(&mut matches)).map_err(|error| {
        if error.use_stderr() {
            let name = A::command().get_name().to_owned();
            return fail(&name, one_line(&error.to_string()), USAGE);
        }
        // Help or version. A closed pipe is not an error.
        let _ = error.print();
        ExitCode::SUCCESS
    })
}

/// Options that protect a server: an empty variable of theirs is an error, since a forgotten value
/// must not turn the protection off.
const PROTECTING: [&str; 8] = [
    "config",
    "token_file",
    "tls_cert",
    "tls_key",
    "protect",
    "rate_limit_ms",
    "cost_per_second",
    "max_sessions_per_address",
];

/// The command without those of its variables that are set and empty: deployments pass on variables
/// that may be empty, which is the same as absent.
fn without_empty_variables(command: Command) -> Command {
    let of_argument = |argument: Arg| {
        let is_empty = argument.get_env().and_then(std::env::var_os).is_some_and(|value| value.is_empty());
        let is_absent = is_empty && !PROTECTING.contains(&argument.get_id().as_str());
        if is_absent { argument.env(None) } else { argument }
    };
    command.mut_args(of_argument).mut_subcommands(move |command| command.mut_args(of_argument))
}

/// Prints `program: message` on standard error and returns the exit code.
pub fn fail(program: &str, message: impl Display, code: u8) -> ExitCode {
    eprintln!("{program}: {message}");
    ExitCode::from(code)
}

/// The message of a clap error without its usage block, as one line.
fn one_line(rendered: &str) -> String {
    let message = rendered.split("\nUsage:").next().unwrap_or(rendered);
    let message = message.split("\nFor more information").next().unwrap_or(message);
    let parts: Vec<_> = message.lines().map(str::trim).filter(|line| !line.is_empty()).collect();
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
    fn invalid_options_yield_one_line_with_name_value_and_range() {
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
