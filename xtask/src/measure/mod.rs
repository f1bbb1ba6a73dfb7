//! `measure`: the built programs against the project's bars. Figures depend on the machine, so
//! tests never check them; this does, and leaves a dated record.

mod audit;
mod cluster;
mod code;
mod demo_build;
mod end_to_end;
mod fuzz;
pub mod heightfield;
mod land;
mod mutants;
pub mod record;
mod record_runs;
mod resilience;
mod run;
mod runs;
mod streaming;
mod websocket;

use crate::machine;
use crate::process;
use crate::setup::{self, Extent};
use anyhow::{Context, Result, bail};
use bars::Bar;
use record::Heading;
use run::Run;
pub use run::rows as rows_of;
use std::path::Path;

/// A measurement: its name, the programs that it builds, and the rows that it makes with them.
type Measurement = (&'static str, &'static [&'static str], fn(&mut Run) -> Result<Vec<Bar>>);

/// A measurement by `tombolo-lab`, with the sample sizes that the bars require.
macro_rules! by_lab {
    ($name:literal, $arguments:expr) => {
        ($name, &["tombolo-lab"], |run| {
            let report = run.lab($name, &$arguments)?;
            Ok(run.rows_of($name, &report))
        })
    };
}

const MEASUREMENTS: [Measurement; 17] = [
    ("audit", &[], audit::rows),
    ("code", &[], code::rows),
    ("end-to-end", &["tombolo-server", "tombolo-view", "tombolo-load"], end_to_end::rows),
    ("demo-build", &["tombolo-server", "tombolo-server-bench", "tombolo-view"], demo_build::rows),
    ("heightfield", &["tombolo-lab"], heightfield::rows),
    ("streaming", &["tombolo-lab", "tombolo-server", "tombolo-server-bench"], streaming::rows),
    ("resilience", &["tombolo-server", "tombolo-server-bench", "tombolo-view"], resilience::rows),
    ("fuzz", &[], fuzz::rows),
    ("websocket", &[], websocket::rows),
    ("mutants", &[], mutants::rows),
    ("land", &["tombolo-lab"], land::rows),
    ("cluster", &["tombolo-server", "tombolo-load", "tombolo-simulate"], cluster::rows),
    ("soak", &["tombolo-server", "tombolo-load"], cluster::soak),
    by_lab!("terrain", ["lod", "--poses", "50", "--views", "200"]),
    by_lab!("pom", ["pom", "--rays", "2000000"]),
    by_lab!("culling", ["culling", "--poses", "300"]),
    by_lab!("visual", ["visual", "--poses", "60"]),
];

/// Builds, measures, prints and records one measurement.
///
/// # Errors
/// An unknown name (with those that are known), a build or a record that failed, or a bar that was
/// missed.
pub fn run(name: &str) -> Result<()> {
    process::use_dist_profile();
    // The name of this measurement in older records and scripts.
    let name = if name == "first-voyage" { "end-to-end" } else { name };
    let Some((_, programs, rows)) = MEASUREMENTS.into_iter().find(|known| known.0 == name) else {
        let known = MEASUREMENTS.map(|known| known.0).join(", ");
        bail!("measure: `{name}` is not known; give one of: {known}")
    };
    let begun = machine::commit();
    if !programs.is_empty() {
        setup::run(Extent::Headless)?;
        process::run(process::build(programs)).context("measure: the build failed")?;
    }
    let mut run = Run::new(name).context("measure")?;
    let rows = match rows(&mut run) {
        Ok(rows) => rows,
        Err(error) => {
            // A run that a person ended says nothing of what it measures.
            if !process::interrupted() {
                record::write_failed(name, &begun).context("measure")?;
            }
            return Err(error.context("measure"));
        }
    };
    run.notes.append(&mut run.faults);
    let heading = Heading { name, adapter: run.adapter.as_deref(), notes: &run.notes };
    let path = record::write(&heading, &rows, &begun).context("measure")?;
    judge(&rows, &path)
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
    fn every_measurement_says_what_makes_its_record_stale() {
        for measurement in super::MEASUREMENTS {
            assert!(crate::records::is_known(measurement.0), "{}", measurement.0);
        }
    }

    #[test]
    fn an_unknown_name_is_answered_with_the_known_ones() {
        let error = super::run("end-to-start").unwrap_err().to_string();
        assert!(error.contains("end-to-start") && error.contains("end-to-end"), "{error}");
    }
}
