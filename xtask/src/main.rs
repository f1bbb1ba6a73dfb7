//! The project's development commands, one file per command.
//!
//! `cargo xtask <command>`; `cargo demo` and `cargo ci` are short for two of them. Nothing in here
//! is part of the product: a command runs the built programs and the toolchain from outside, as a
//! user would.

#![forbid(unsafe_code)]

mod advisories;
mod bless;
mod ci;
mod cluster;
mod demo;
mod dependency_rules;
mod fast_simd;
mod gallery;
mod gpu_bundle;
mod land_version_3;
mod machine;
mod measure;
mod process;
mod records;
mod server;
mod setup;
mod source;
mod test_modules;

use clap::{Parser, Subcommand};
use std::process::ExitCode;

/// Exit code of a run that Ctrl-C ended.
const INTERRUPTED: u8 = 130;

#[derive(Debug, Parser)]
#[command(name = "cargo xtask", about = "Development commands of the Tombolo workspace")]
struct Args {
    #[command(subcommand)]
    command: Command,
}

#[derive(Debug, Subcommand)]
enum Command {
    /// Install what the programs need and the system lacks (Debian, Ubuntu)
    Setup,
    /// Start a server and fly over its island; without a display, render a short flight to PNGs
    Demo(demo::Options),
    /// Everything that a change must pass
    Ci(ci::Options),
    /// Check the dependencies against a dated snapshot of known vulnerabilities
    Advisories {
        /// A clone of RustSec's database, bare or not: regenerate the snapshot from it
        #[arg(long)]
        update: Option<std::path::PathBuf>,
    },
    /// List the records of measurements: commit, machine, runs, and which are out of date
    Records(records::Options),
    /// Measure the built programs against the project's bars and write the record
    Measure {
        /// What to measure
        name: String,
    },
    /// Start replicas behind nginx, by the configuration of docker-compose.yml
    Cluster(cluster::Options),
    /// Draw the fixed poses into docs/gallery and write their page
    Gallery(gallery::Options),
    /// Pack programs and a script that run every check that needs a GPU on a bare machine
    GpuBundle,
    /// Write the record of a run of the bundle
    #[command(hide = true)]
    GpuRecord {
        /// The folder that the bundle's script filled
        folder: std::path::PathBuf,
        /// Writes the record of this measurement alone: lod, pom, visual or culling
        #[arg(long, value_name = "NAME")]
        only: Option<String>,
    },
    /// Check the source text: columns, retired words, names in documents, import circles
    Source,
    /// Show what differs from frozen fixtures, golden pictures or tables, and rewrite them
    Bless {
        /// Which of them; a fixture that exists changes only with a version
        #[arg(value_enum)]
        what: bless::What,
        /// Write; without it only what would change is shown
        #[arg(long)]
        write: bool,
    },
}

fn main() -> ExitCode {
    let args = Args::parse_from(without_separator(std::env::args()));
    let result = process::catch_interrupts().and_then(|()| match args.command {
        Command::Setup => setup::run(setup::Extent::Everything),
        Command::Demo(options) => demo::run(options),
        Command::Ci(options) => ci::run(&options),
        Command::Advisories { update: None } => advisories::check(),
        Command::Advisories { update: Some(clone) } => advisories::update(&clone),
        Command::Records(options) => records::run(&options),
        Command::Measure { name } => measure::run(&name),
        Command::Cluster(options) => cluster::run(options),
        Command::Gallery(options) => gallery::run(&options),
        Command::GpuBundle => gpu_bundle::build(),
        Command::GpuRecord { folder, only } => gpu_bundle::record(&folder, only.as_deref()),
        Command::Source => source::run(),
        Command::Bless { what, write } => bless::run(what, write),
    });
    let Err(error) = result else { return ExitCode::SUCCESS };
    if process::interrupted() {
        eprintln!("xtask: interrupted");
        return ExitCode::from(INTERRUPTED);
    }
    eprintln!("xtask: {error:#}");
    ExitCode::FAILURE
}

/// Drops the first `--`: in `cargo demo -- --headless` cargo hands it on, and the user means the
/// option.
fn without_separator(args: impl Iterator<Item = String>) -> Vec<String> {
    let mut seen = false;
    args.filter(|arg| arg != "--" || std::mem::replace(&mut seen, true)).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn options_work_with_and_without_the_separator() {
        for line in ["xtask demo --headless", "xtask demo -- --headless"] {
            let args = without_separator(line.split(' ').map(String::from));
            let parsed = Args::try_parse_from(args).unwrap();
            assert!(matches!(parsed.command, Command::Demo(demo::Options { headless: true })), "{line}");
        }
        assert!(Args::try_parse_from(["xtask", "demo", "--colour"]).is_err());
    }
}
