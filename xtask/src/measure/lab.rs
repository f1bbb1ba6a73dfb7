//! Measurements by `tombolo-lab`, which owns their bars.

use super::record::{self, Heading};
use super::report;
use crate::process;
use crate::setup::{self, Extent};
use anyhow::{Context, Result};
use bars::{Bar, Limit};
use serde_json::Value;

/// One measurement: its name, and the command of `tombolo-lab` with the sample sizes that the bars
/// require.
#[derive(Clone, Copy, Debug)]
pub struct Measurement {
    /// Name of the measurement and its record.
    pub name: &'static str,
    /// Arguments of `tombolo-lab`.
    pub arguments: &'static [&'static str],
}

/// Every measurement of this kind.
pub const ALL: [Measurement; 3] = [
    Measurement { name: "terrain", arguments: &["lod", "--poses", "50", "--views", "200"] },
    Measurement { name: "pom", arguments: &["pom", "--rays", "200000"] },
    Measurement { name: "culling", arguments: &["culling", "--poses", "300"] },
];

/// Builds, measures, prints, records.
///
/// # Errors
/// The build or the record failed, or a bar was missed.
pub fn run(measurement: Measurement) -> Result<()> {
    let name = measurement.name;
    setup::run(Extent::Headless)?;
    process::run(process::build(&["tombolo-lab"])).context("measure: the build failed")?;
    let folder = process::target().join("measure").join(name);
    std::fs::create_dir_all(&folder)
        .with_context(|| format!("measure: cannot create {}", folder.display()))?;
    let mut notes = Vec::new();
    let json = folder.join(name).with_extension("json");
    let mut lab = process::command(process::program("tombolo-lab"));
    lab.args(measurement.arguments).arg("--json").arg(&json);
    process::quiet_drivers(&mut lab);
    let report = report::of(lab, &json, &mut notes)?;

    let rows = rows(name, &report);
    let own = report.get("notes").and_then(Value::as_array).into_iter().flatten();
    notes.splice(0..0, own.filter_map(Value::as_str).map(str::to_owned));
    let adapter = report.get("record_adapter").and_then(Value::as_str);
    let path = record::write(&Heading { name, adapter, notes: &notes }, &rows)?;
    super::judge(&rows, &path)
}

/// The bars of a report, judged again. A report without bars is one row that misses.
pub fn rows(name: &str, report: &Value) -> Vec<Bar> {
    let bars: Option<Vec<Bar>> =
        report.get("bars").and_then(|bars| serde_json::from_value(bars.clone()).ok());
    match bars {
        Some(bars) if !bars.is_empty() => bars,
        _ => vec![Bar::new(format!("{name}: no bars were reported"), None, "", Limit::Reported)],
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    #[test]
    fn bars_are_judged_again_and_a_report_without_bars_misses() {
        let lie = json!({ "bars": [
            { "name": "a", "figure": 2.0, "direction": "at_most", "bar": 1.0, "met": true },
            { "name": "b", "figure": 1.0, "direction": "at_most", "bar": 1.0, "met": false },
        ] });
        let missed: Vec<_> = rows("x", &lie).iter().map(Bar::is_missed).collect();
        assert_eq!(missed, [true, false]);
        for report in [Value::Null, json!({ "bars": [] }), json!({ "bars": 3 })] {
            assert!(rows("x", &report)[0].is_missed(), "{report}");
        }
    }
}
