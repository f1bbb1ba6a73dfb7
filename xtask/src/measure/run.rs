//! A measurement at work: the reports that measured programs leave as JSON, and what the record
//! says about them. What is absent from a report stays absent: its rows miss.

use crate::process;
use anyhow::{Context, Result};
use bars::figures::{list, text};
use bars::{Bar, Limit};
use serde_json::Value;
use std::path::PathBuf;
use std::process::Command;

/// The folder of the reports, and what the record says.
#[derive(Debug)]
pub struct Run {
    folder: PathBuf,
    /// Sentences on how the figures were measured.
    pub notes: Vec<String>,
    /// What went wrong.
    pub faults: Vec<String>,
    /// Name of the GPU and its backend, if one was measured.
    pub adapter: Option<String>,
}

impl Run {
    /// A run of the measurement of a name.
    ///
    /// # Errors
    /// The folder cannot be created.
    pub fn new(name: &str) -> Result<Self> {
        let folder = process::target().join("measure").join(name);
        std::fs::create_dir_all(&folder).with_context(|| format!("cannot create {}", folder.display()))?;
        Ok(Self { folder, notes: Vec::new(), faults: Vec::new(), adapter: None })
    }

    /// Where a program leaves a file.
    pub fn file(&self, name: &str) -> PathBuf {
        self.folder.join(name)
    }

    /// Runs a program and reads the report `NAME.json` that it writes where `option` says. Only an
    /// interrupt is an error; everything else is a fault, and the report null.
    ///
    /// # Errors
    /// The program cannot be started or was interrupted.
    pub fn report(&mut self, name: &str, mut command: Command, option: &str) -> Result<Value> {
        let json = self.file(&format!("{name}.json"));
        command.args((!option.is_empty()).then_some(option)).arg(json);
        self.report_of(name, command)
    }

    /// As [`Run::report`], of a command whose options already name `self.file("NAME.json")`.
    ///
    /// # Errors
    /// As [`Run::report`].
    pub fn report_of(&mut self, name: &str, mut command: Command) -> Result<Value> {
        println!("measure: {name}");
        let json = self.file(&format!("{name}.json"));
        // A report of an earlier run must not pass for one of this.
        let _ = std::fs::remove_file(&json);
        let shown = without_folder(&process::shown(&command), &process::target().display().to_string());
        let ended = process::status(&mut command)?;
        if !ended.success() {
            self.faults.push(format!("`{shown}` failed ({ended})."));
        }
        let parsed = std::fs::read_to_string(&json)
            .map_err(|error| error.to_string())
            .and_then(|text| serde_json::from_str(&text).map_err(|error| error.to_string()));
        Ok(parsed.unwrap_or_else(|error: String| {
            self.faults.push(format!("`{shown}` left no report: {error}."));
            Value::Null
        }))
    }

    /// The report of `tombolo-lab`.
    ///
    /// # Errors
    /// As [`Run::report`].
    pub fn lab(&mut self, name: &str, arguments: &[&str]) -> Result<Value> {
        let mut lab = process::command(process::program("tombolo-lab"));
        lab.args(arguments);
        process::quiet_drivers(&mut lab);
        self.report(name, lab, "--json")
    }

    /// The rows of a report whose program owns its bars; notes and adapter go to the record.
    pub fn rows_of(&mut self, name: &str, report: &Value) -> Vec<Bar> {
        let rows = rows(name, report);
        let defined = |row: &Bar| Some(format!("{}: {}.", row.name, row.note.as_deref()?));
        self.notes.extend(rows.iter().filter_map(defined));
        self.notes.extend(list(report, "notes").iter().filter_map(Value::as_str).map(str::to_owned));
        self.adapter = text(report, "record_adapter").map(str::to_owned).or(self.adapter.take());
        rows
    }
}

/// The text of a command in which the build folder of this machine is `target`. Records are
/// committed, and its path means nothing elsewhere.
fn without_folder(command: &str, target: &str) -> String {
    command.replace(&format!("{target}/"), "target/")
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
    fn commands_in_records_have_no_path_of_the_machine() {
        let command = "tombolo-lab codec --json /home/anyone/build/measure/codec.json --seeds 3";
        let expected = "tombolo-lab codec --json target/measure/codec.json --seeds 3";
        assert_eq!(without_folder(command, "/home/anyone/build"), expected);
        assert_eq!(without_folder(expected, "/home/anyone/build"), expected);
    }

    #[test]
    fn bars_are_judged_again_and_notes_and_adapter_taken_over() {
        let lie = json!({
            "bars": [
                { "name": "a", "figure": 2.0, "direction": "at_most", "bar": 1.0, "met": true },
                { "name": "b", "figure": 1.0, "unit": "ms", "direction": "at_most", "bar": 1.0, "met": false,
                  "note": "n" },
                { "name": "c", "figure": null, "direction": "reported", "bar": null, "met": true },
            ],
            "notes": ["further"],
            "record_adapter": "soft",
        });
        let mut run = Run { folder: PathBuf::new(), notes: Vec::new(), faults: Vec::new(), adapter: None };
        let missed: Vec<_> = run.rows_of("x", &lie).iter().map(Bar::is_missed).collect();
        assert_eq!(missed, [true, false, true]);
        assert_eq!(run.notes, ["b: n.", "further"]);
        run.rows_of("y", &json!({}));
        assert_eq!(run.adapter.as_deref(), Some("soft"));
    }

    #[test]
    fn a_report_without_bars_is_a_miss() {
        for report in [
            Value::Null,
            json!({}),
            json!({ "bars": [] }),
            json!({ "bars": 3 }),
            json!({ "bars": [{ "name": "a" }] }),
        ] {
            let rows = rows("x", &report);
            assert!(rows.len() == 1 && rows[0].is_missed() && rows[0].name.contains('x'), "{report}");
        }
    }

    #[test]
    fn a_program_without_a_report_is_a_fault() {
        let folder = std::env::temp_dir().join(format!("measure-run-{}", std::process::id()));
        std::fs::create_dir_all(&folder).unwrap();
        let mut run = Run { folder: folder.clone(), notes: Vec::new(), faults: Vec::new(), adapter: None };
        std::fs::write(run.file("x.json"), "{}").unwrap();
        assert_eq!(
            run.report("x", Command::new("false"), "").unwrap(),
            Value::Null,
            "not that of an earlier run"
        );
        assert_eq!(run.faults.len(), 2);
        assert!(run.report("x", Command::new("no-such-program"), "--json").is_err());
        std::fs::remove_dir_all(folder).unwrap();
    }
}
