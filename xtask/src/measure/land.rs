//! `land`: the shape of the land, the errors that its chunks state, and the time of a chunk beside
//! version 3's and beside floats.
//!
//! Shape comes from `tombolo-lab land`, stated errors from `tombolo-lab stability`, times from
//! `benches/land-comparison`, a package outside the workspace: it compiles the sources of version 3
//! from the history.

use super::run::{self, Run};
use crate::{land_version_3, process};
use anyhow::{Context, Result};
use bars::figures::{list, median};
use bars::{Bar, Figure};
use serde_json::Value;
use std::path::{Path, PathBuf};

/// Times that the comparison is started. Where code and buffers happen to lie is decided once per
/// start and moves single figures; the median start counts.
const STARTS: usize = 5;

/// Rounds per start.
const ROUNDS: &str = "101";

/// Measures shape and times.
///
/// # Errors
/// The history lacks version 3, the comparison cannot be built, or a program was interrupted.
pub fn rows(run: &mut Run) -> Result<Vec<Bar>> {
    // First, because the shape takes minutes.
    let comparison = cfg!(target_arch = "x86_64").then(build).transpose()?;
    let shape = run.lab("land", &["land"])?;
    let mut rows = run.rows_of("land", &shape);
    let stability = run.lab("stability", &["stability"])?;
    rows.extend(run.rows_of("stability", &stability));
    match comparison {
        Some(program) => rows.extend(times(run, &program)?),
        None => run.notes.push("Times: not measured, the bars are for AVX2.".into()),
    }
    Ok(rows)
}

/// Builds the comparison and returns the program.
fn build() -> Result<PathBuf> {
    land_version_3::export()?;
    let target = process::target().join("land-comparison");
    let mut build = process::cargo("build --release --locked --target-dir");
    build.arg(&target).current_dir(process::root().join("benches/land-comparison"));
    process::run(build).context("the land comparison was not built")?;
    Ok(target.join("release/land-comparison"))
}

/// Starts the comparison several times.
fn times(run: &mut Run, program: &Path) -> Result<Vec<Bar>> {
    let mut starts = Vec::new();
    for shift in 0..STARTS {
        let mut comparison = process::command(program);
        comparison.args(["--rounds", ROUNDS, "--shift", &shift.to_string()]);
        starts.push(run.report(&format!("land-comparison-{shift}"), comparison, "--json")?);
    }
    run.notes.extend(notes(&starts));
    Ok(middle(&starts))
}

/// The rows of the first start with the median of all starts; missing if one start lacks the row.
/// A count and a difference of heights are the largest of all starts.
fn middle(starts: &[Value]) -> Vec<Bar> {
    let tables: Vec<_> = starts.iter().map(|report| run::rows("land comparison", report)).collect();
    let figure = |table: &Vec<Bar>, name: &str| {
        let row = table.iter().find(|row| row.name == name)?;
        if let Figure::Measured(figure) = row.figure { Some(figure) } else { None }
    };
    let first = tables.first().cloned().unwrap_or_else(|| run::rows("land comparison", &Value::Null));
    let merge = |row: Bar| {
        let figures = tables.iter().map(|table| figure(table, &row.name));
        let is_ratio = row.unit == "x";
        let figure = if is_ratio { median(figures) } else { bars::figures::worst(figures) };
        Bar { figure: figure.into(), note: None, ..row }
    };
    first.into_iter().map(merge).collect()
}

/// Figures of the starts, and how far they differ.
fn notes(starts: &[Value]) -> Vec<String> {
    let mut notes = vec![format!(
        "Times: ratios are the median of {} starts of `land-comparison --rounds {ROUNDS}`, each the median \
         of its rounds; counts and differences are the largest.",
        starts.len()
    )];
    for row in middle(starts).iter().filter(|row| row.unit == "x") {
        let of_starts = starts.iter().flat_map(|report| run::rows("land comparison", report));
        let figures = of_starts.filter(|other| other.name == row.name).filter_map(|row| match row.figure {
            Figure::Measured(figure) => Some(figure),
            _ => None,
        });
        let (low, high) =
            figures.fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), v: f64| (low.min(v), high.max(v)));
        notes.push(format!("{}: {low:.3} to {high:.3} over the starts.", row.name));
    }
    let first = starts.first().unwrap_or(&Value::Null);
    let defined = |row: Bar| Some(format!("First start, {}: {}.", row.name, row.note?));
    notes.extend(run::rows("land comparison", first).into_iter().filter_map(defined));
    let remarks = list(first, "notes").iter().filter_map(Value::as_str);
    notes.extend(remarks.map(|remark| format!("First start, {remark}")));
    notes
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    fn start(ratio: Option<f64>, failed: f64) -> Value {
        let bars = [
            Bar::at_most("time", ratio, "x", 2.5).with_note("n"),
            Bar::none("controls that failed", Some(failed)),
        ];
        json!({ "bars": bars, "notes": ["41 rounds."] })
    }

    fn missed(starts: &[Value]) -> usize {
        let rows = middle(starts);
        assert_eq!(rows.len(), 2);
        rows.iter().filter(|row| row.is_missed()).count()
    }

    #[test]
    fn the_median_start_counts_for_ratios_and_the_worst_for_counts() {
        let good = || start(Some(1.3), 0.0);
        assert_eq!(missed(&[good(), good(), good()]), 0);
        assert_eq!(missed(&[start(Some(9.0), 0.0), good(), good()]), 0);
        assert_eq!(missed(&[start(Some(9.0), 0.0), good(), start(Some(2.6), 0.0)]), 1);
        assert_eq!(missed(&[good(), good(), start(Some(1.3), 1.0)]), 1);
    }

    #[test]
    fn a_start_without_a_figure_or_a_report_loses_the_rows() {
        let good = || start(Some(1.3), 0.0);
        assert_eq!(missed(&[good(), good(), start(None, 0.0)]), 1);
        assert_eq!(missed(&[good(), Value::Null, good()]), 2);
        for none in [&[][..], &[Value::Null, good()]] {
            let rows = middle(none);
            assert!(rows.len() == 1 && rows[0].is_missed());
        }
    }

    #[test]
    fn notes_say_how_far_starts_differ() {
        let notes = notes(&[start(Some(1.3), 0.0), start(Some(1.5), 0.0)]).join("\n");
        for part in ["2 starts", "time: 1.300 to 1.500", "First start, time: n.", "First start, 41 rounds."] {
            assert!(notes.contains(part), "{part} is not in:\n{notes}");
        }
    }
}
