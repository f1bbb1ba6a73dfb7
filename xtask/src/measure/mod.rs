//! `measure`: the built programs against the project's bars. Figures depend on the machine, so
//! tests never check them; this does, and leaves a dated record.

mod code;
mod culling;
mod end_to_end;
mod heightfield;
mod pom;
mod record;
mod report;
mod runs;
mod streaming;
mod terrain;

use crate::process;
use anyhow::{Result, bail};
use bars::{Bar, Limit};
use serde_json::Value;
use std::path::Path;

/// Why a row has no figure on a software driver.
const NEEDS_GPU: &str = "needs a GPU";

/// A measurement by name.
type Measurement = (&'static str, fn() -> Result<()>);

const MEASUREMENTS: [Measurement; 7] = [
    ("code", code::run),
    ("end-to-end", end_to_end::run),
    ("heightfield", heightfield::run),
    ("terrain", terrain::run),
    ("pom", pom::run),
    ("culling", culling::run),
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
    match MEASUREMENTS.into_iter().find(|(known, _)| *known == name) {
        Some((_, measurement)) => measurement(),
        None => {
            let known = MEASUREMENTS.map(|(known, _)| known).join(", ");
            bail!("measure: `{name}` is not known; give one of: {known}")
        }
    }
}

/// The rows that a GPU is needed for, from reports of `tombolo-lab`.
pub fn gpu_rows(digest: &Value, lod: &Value, pom: &Value, culling: &Value) -> Vec<Bar> {
    let twins = heightfield::differing_twins(digest);
    let mut rows = vec![Bar::new("GPU twins with another digest", twins, "", Limit::AtMost(0.0))];
    rows.extend(terrain::rows(lod).into_iter().filter(|row| row.name == terrain::GPU_TIME));
    rows.extend(pom::rows(pom));
    rows.extend(culling::rows(culling).into_iter().filter(|row| culling::needs_gpu(&row.name)));
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
