//! How a comparison is started: its options, the place of its buffers, its exit code.

use anyhow::{Context, Result};
use serde_json::Value;
use std::hint::black_box;
use std::path::PathBuf;
use std::process::ExitCode;

/// Options of a comparison.
#[derive(Debug, clap::Args)]
pub struct Options {
    /// Rounds; comparisons whose calls are long take a quarter of them
    #[arg(long, default_value_t = 201, value_parser = clap::value_parser!(u16).range(9..))]
    pub rounds: u16,
    /// Shift everything on the heap by this many times 16 bytes: the position of buffers
    /// changes times by some percent, and starts with other shifts show by how many
    #[arg(long, default_value_t = 0)]
    shift: u8,
    /// Also write the figures to this file
    #[arg(long, value_name = "FILE")]
    json: Option<PathBuf>,
}

impl Options {
    /// Shifts the buffers that are allocated from now on.
    pub fn shift_heap(&self) {
        // Large enough to come from the end of the heap, like the buffers after it. Never freed.
        std::mem::forget(black_box(vec![1u8; 4096 + 16 * usize::from(self.shift)]));
    }

    /// Writes the figures, if a file is given.
    ///
    /// # Errors
    /// The file cannot be written.
    pub fn write_json(&self, figures: &Value) -> Result<()> {
        let Some(path) = &self.json else { return Ok(()) };
        std::fs::write(path, format!("{figures:#}\n"))
            .with_context(|| format!("cannot write {}", path.display()))
    }
}

/// The exit code of a program, by whether its figures count; `otherwise` says what it means if not.
pub fn exit_code(program: &str, outcome: Result<bool>, otherwise: &str) -> ExitCode {
    match outcome {
        Ok(true) => return ExitCode::SUCCESS,
        Ok(false) => eprintln!("{program}: {otherwise}"),
        Err(error) => eprintln!("{program}: {error:#}"),
    }
    ExitCode::FAILURE
}
