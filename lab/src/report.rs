//! Reports as JSON, with the bars of their figures.

use crate::Outputs;
use anyhow::Result;
use bars::Bar;
use serde::Serialize;
use serde_json::{Value, json};

/// Why a row has no figure on a software driver.
pub const NEEDS_GPU: &str = "needs a GPU";

/// Prints the notes and bars of a report and writes all of them as JSON, with the adapter that it
/// ran on, which stands at the path `adapter` of the report.
pub fn publish(
    report: &impl Serialize,
    rows: fn(&Value) -> Vec<Bar>,
    notes: fn(&Value) -> Vec<String>,
    adapter: &str,
    outputs: &Outputs,
) -> Result<()> {
    let mut json = serde_json::to_value(report)?;
    let (rows, notes) = (rows(&json), notes(&json));
    print!("{}\n\n{}", notes.join("\n"), bars::text(&rows));
    json["record_adapter"] = json!(json.pointer(adapter));
    json["bars"] = json!(rows);
    json["notes"] = json!(notes);
    outputs.write_json(&json)
}
