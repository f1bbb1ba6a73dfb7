//! Reports as JSON, with the bars of their figures.

use bars::Bar;
use serde_json::{Value, json};

/// Why a row has no figure on a software driver.
pub const NEEDS_GPU: &str = "needs a GPU";

/// A number of a report. Absent, null or of another type is missing.
#[must_use]
pub fn number(report: &Value, field: &str) -> Option<f64> {
    report.get(field)?.as_f64()
}

/// A list of a report; empty if it is absent.
#[must_use]
pub fn list<'a>(report: &'a Value, path: &str) -> &'a [Value] {
    report.pointer(path).and_then(Value::as_array).map_or(&[], Vec::as_slice)
}

/// The report with its bars, the notes of its record and the adapter that it ran on, which stands at
/// the path `adapter` of the report.
#[must_use]
pub fn with_bars(mut report: Value, bars: &[Bar], notes: &[String], adapter: &str) -> Value {
    let adapter = report.pointer(adapter).cloned();
    report["bars"] = json!(bars);
    report["notes"] = json!(notes);
    report["record_adapter"] = json!(adapter);
    report
}
