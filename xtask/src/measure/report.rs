//! JSON that a measured program leaves. What is absent stays absent: its rows miss.

use crate::process;
use anyhow::Result;
use serde_json::Value;
use std::path::Path;
use std::process::Command;

/// Runs a program and reads the JSON that it leaves. Only an interrupt is an error; everything else
/// is a note.
///
/// # Errors
/// The program cannot be started or was interrupted.
pub fn of(mut command: Command, json: &Path, notes: &mut Vec<String>) -> Result<Value> {
    // A report of an earlier run must not pass for one of this.
    let _ = std::fs::remove_file(json);
    let shown = process::shown(&command);
    let ended = process::status(&mut command)?;
    if !ended.success() {
        notes.push(format!("`{shown}` failed ({ended})."));
    }
    let parsed = std::fs::read_to_string(json)
        .map_err(|error| error.to_string())
        .and_then(|text| serde_json::from_str(&text).map_err(|error| error.to_string()));
    Ok(parsed.unwrap_or_else(|error: String| {
        notes.push(format!("`{shown}` left no report: {error}."));
        Value::Null
    }))
}

/// A number of a report. Absent, null or of another type is missing.
pub fn number(report: &Value, field: &str) -> Option<f64> {
    report.get(field)?.as_f64()
}
