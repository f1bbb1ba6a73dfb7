//! `measure`: the built programs against the project's bars. Figures depend on the machine, so
//! tests never check them; this does, and leaves a dated record.

mod code;
mod end_to_end;
mod heightfield;
mod lab;
mod record;
mod report;
mod runs;
mod streaming;

use crate::process;
use anyhow::{Result, bail};
use bars::{Bar, Limit};
use serde_json::Value;
use std::path::Path;

/// A measurement by name.
type Measurement = (&'static str, fn() -> Result<()>);

const MEASUREMENTS: [Measurement; 4] = [
    ("code", code::run),
    ("end-to-end", end_to_end::run),
    ("heightfield", heightfield::run),
    ("streaming", streaming::run),
];

/// Runs one measurement.
///
/// # Errors
/// An unknown name (with those that are known), a measurement that could not run, or a bar that was
/// missed.
pub fn run(name: &str) -> Result<()> {
    process::use_dist_profile();
    // The name of this measurement in older records and scripts.
    let name = if name == "first-voyage" { "end-to-end" } else { name };
    if let Some((_, measurement)) = MEASUREMENTS.into_iter().find(|(known, _)| *known == name) {
        return measurement();
    }
    if let Some(measurement) = lab::ALL.into_iter().find(|known| known.name == name) {
        return lab::run(measurement);
    }
    let known = MEASUREMENTS.map(|(known, _)| known).into_iter().chain(lab::ALL.map(|known| known.name));
    bail!("measure: `{name}` is not known; give one of: {}", known.collect::<Vec<_>>().join(", "))
}

/// The rows of a GPU bundle: those of every report that judge what a GPU computes, by their names.
pub fn gpu_rows(digest: &Value, lod: &Value, pom: &Value, culling: &Value) -> Vec<Bar> {
    let twins = heightfield::differing_twins(digest);
    let mut rows = vec![Bar::new("GPU twins with another digest", twins, "", Limit::AtMost(0.0))];
    for (name, report) in [("lod", lod), ("pom", pom), ("culling", culling)] {
        let all = lab::rows(name, report);
        let is_whole = all.len() > 1;
        rows.extend(all.into_iter().filter(|row| !is_whole || name == "pom" || row.name.contains("GPU")));
    }
    rows
}

/// Prints the rows and where they were recorded.
///
/// # Errors
/// A bar was missed.
pub fn judge(rows: &[Bar], recorded: &Path) -> Result<()> {
    println!();
    print!("{}", bars::text(rows));
    println!("\nmeasure: recorded in {}", recorded.display());
    let missed = rows.iter().filter(|row| row.is_missed()).count();
    if missed > 0 {
        bail!("measure: {missed} of {} bars missed", rows.len());
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    #[test]
    fn an_unknown_name_is_answered_with_the_known_ones() {
        let error = super::run("end-to-start").unwrap_err().to_string();
        assert!(error.contains("end-to-start") && error.contains("end-to-end"), "{error}");
    }
}
