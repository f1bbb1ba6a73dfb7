//! Result files.

use anyhow::{Context, Result};
use cli::UsageError;
use serde::Serialize;
use std::fs::File;
use std::io::{BufWriter, Write};
use std::path::{Path, PathBuf};

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
    fn an_unwritable_output_is_an_error_that_names_its_option() {
        let missing = Outputs { json: Some("/no/such/folder/a.json".into()), out: None };
        let error = missing.prepare().unwrap_err().to_string();
        assert!(error.starts_with("--json: ") && error.lines().count() == 1, "{error}");
    }
}
