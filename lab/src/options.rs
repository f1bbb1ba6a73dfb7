//! The command line, and where results go.

use anyhow::{Context, Result};
use clap::{Parser, Subcommand};
use cli::UsageError;
use serde::Serialize;
use std::fs::File;
use std::io::{BufWriter, Write};
use std::path::{Path, PathBuf};

use crate::{accuracy, codec, culling, digest, lod, pom, stability, timings};

/// Measures the terrain: digests of all backends, accuracy curves, stability sweeps, GPU timings.
///
/// Exits with 0 only if every bar is met.
#[derive(Clone, Debug, Parser)]
#[command(name = "tombolo-lab", version)]
pub struct Args {
    /// What to measure.
    #[command(subcommand)]
    pub command: Command,
    /// Where results go.
    #[command(flatten)]
    pub outputs: Outputs,
}

/// One measurement.
#[derive(Clone, Debug, Subcommand)]
pub enum Command {
    /// Compare the integers of every backend of this machine: CPU kernels, GPU drivers, a browser
    Digest(digest::Options),
    /// Measure error against cost of every approximation
    Accuracy(accuracy::Options),
    /// Measure the drawn levels of detail: screen error, triangles, gaps, popping, draw calls,
    /// memory, time
    Lod(lod::Options),
    /// Measure parallax occlusion mapping: every march against the reference
    Pom(pom::Options),
    /// Measure culling: every test against visibility in f64
    Culling(culling::Options),
    /// Sweep the borders of the world and of every cell
    Stability(stability::Options),
    /// Time chunk generation on GPU and CPU
    Timings(timings::Options),
    /// Measure chunks on the wire against other codecs, in bytes and in time
    Codec(codec::Options),
}

/// Result files.
#[derive(Clone, Debug, Default, clap::Args)]
pub struct Outputs {
    /// File for the results as JSON
    #[arg(long, value_name = "FILE", global = true)]
    pub json: Option<PathBuf>,
    /// Folder for tables and pictures, created where it is missing
    #[arg(long, value_name = "DIR", global = true)]
    pub out: Option<PathBuf>,
}

impl Outputs {
    /// Creates file and folder, before a measurement that may take minutes.
    ///
    /// # Errors
    /// One of them cannot be written; the line names it.
    pub fn prepare(&self) -> Result<(), UsageError> {
        let refuse = |option: &str, path: &Path, error: std::io::Error| {
            UsageError::new(format!("{option}: cannot write `{}`: {error}", path.display()))
        };
        if let Some(folder) = &self.out {
            std::fs::create_dir_all(folder).map_err(|error| refuse("--out", folder, error))?;
        }
        if let Some(file) = &self.json {
            File::create(file).map_err(|error| refuse("--json", file, error))?;
        }
        Ok(())
    }

    /// Writes the JSON file, if requested.
    ///
    /// # Errors
    /// It cannot be written.
    pub fn write_json(&self, report: &impl Serialize) -> Result<()> {
        let Some(path) = &self.json else { return Ok(()) };
        let write = || -> Result<()> {
            let mut file = BufWriter::new(File::create(path)?);
            serde_json::to_writer_pretty(&mut file, report)?;
            writeln!(file)?;
            Ok(file.flush()?)
        };
        write().with_context(|| format!("--json: cannot write `{}`", path.display()))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn outputs_come_before_or_after_the_command() {
        for line in ["--json a.json digest --out b", "digest --json a.json --out b"] {
            let args = Args::try_parse_from(std::iter::once("tombolo-lab").chain(line.split(' '))).unwrap();
            assert_eq!(args.outputs.json.as_deref(), Some(Path::new("a.json")));
            assert_eq!(args.outputs.out.as_deref(), Some(Path::new("b")));
        }
    }

    #[test]
    fn an_unwritable_output_is_an_error_that_names_its_option() {
        let missing = Outputs { json: Some("/no/such/folder/a.json".into()), out: None };
        let error = missing.prepare().unwrap_err().to_string();
        assert!(error.starts_with("--json: ") && error.lines().count() == 1, "{error}");
    }
}
