//! Results of a sweep: as a table, as JSON, as a verdict.

use super::check::Check;
use super::errors::ErrorRow;
use super::floats::FloatRow;
use serde::Serialize;
use std::fmt;

/// The result of `stability`. Field names are a contract with scripts.
#[derive(Clone, Debug, Serialize)]
pub struct Report {
    pub worlds: u32,
    /// Properties of the land: all must hold.
    pub checks: Vec<Check>,
    /// The same sweeps over broken fields: none may hold.
    pub controls: Vec<Check>,
    /// Stated and observed errors of coarse chunks.
    pub errors: Vec<ErrorRow>,
    /// Float noise at the same distances.
    pub floats: Vec<FloatRow>,
}

impl Report {
    /// Whether all properties hold and all controls fail.
    ///
    /// # Errors
    /// One line with the first that did not.
    pub fn verdict(&self) -> Result<(), String> {
        if let Some(check) = self.checks.iter().find(|check| !check.holds()) {
            let first = check.first.as_deref().unwrap_or("it was never tested");
            return Err(format!("`{}` is violated {} times; first: {first}", check.name, check.violations));
        }
        if let Some(control) = self.controls.iter().find(|control| control.violations == 0) {
            return Err(format!("the control `{}` found nothing: the sweep detects nothing", control.name));
        }
        Ok(())
    }
}

impl fmt::Display for Report {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(
            f,
            "{:<66} {:>10} {:>8} {:>8}",
            format!("property ({} worlds)", self.worlds),
            "cases",
            "violated",
            "worst"
        )?;
        for check in &self.checks {
            write_row(f, check)?;
        }
        writeln!(
            f,
            "\n{:<66} {:>10} {:>8} {:>8}",
            "control, must be violated", "cases", "violated", "worst"
        )?;
        for control in &self.controls {
            write_row(f, control)?;
        }
        writeln!(f, "worst: largest share of what is allowed; where nothing is allowed, units\n")?;
        writeln!(
            f,
            "{:<24} {:>8} {:>10} {:>9} {:>8} {:>7} {:>17}",
            "error of a chunk, level",
            "chunks",
            "vertices",
            "stated, m",
            "seen, m",
            "ratio",
            "median of chunks"
        )?;
        for row in &self.errors {
            let median = row.median_ratio.map_or_else(|| "-".into(), |ratio| format!("{ratio:.2}"));
            writeln!(
                f,
                "{:<24} {:>8} {:>10} {:>9.2} {:>8.2} {:>7.2} {:>17}",
                row.level,
                row.chunks,
                row.vertices,
                row.stated_m,
                row.seen_m,
                row.stated_m / row.seen_m,
                median,
            )?;
        }
        writeln!(f, "stated, seen: the largest of all chunks\n")?;
        writeln!(
            f,
            "{:<40} {:>10} {:>9} {:>6} {:>10} {:>10} {:>6} {:>8}",
            "64 samples, 1/256 m apart",
            "at, m",
            "distinct",
            "least",
            "jump, mm",
            "x bound",
            "stuck",
            "repeats"
        )?;
        for row in &self.floats {
            writeln!(
                f,
                "{:<40} {:>10} {:>9.1} {:>6} {:>10.2} {:>10.2} {:>5.0}% {:>8}",
                row.field,
                row.distance_m,
                row.distinct_mean,
                row.distinct_least,
                row.largest_jump_m * 1000.0,
                row.jump_over_bound,
                row.stuck * 100.0,
                if row.repeats { "yes" } else { "no" },
            )?;
        }
        Ok(())
    }
}

fn write_row(f: &mut fmt::Formatter<'_>, check: &Check) -> fmt::Result {
    writeln!(f, "{:<66} {:>10} {:>8} {:>8.2}", check.name, check.cases, check.violations, check.worst)?;
    match &check.first {
        Some(first) => writeln!(f, "    first: {first}; worst at {}", check.worst_at),
        None => Ok(()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn check(violations: u64) -> Check {
        Check { cases: 5, violations, ..Check::new("property") }
    }

    fn report(checks: Vec<Check>, controls: Vec<Check>) -> Report {
        Report { worlds: 1, checks, controls, errors: Vec::new(), floats: Vec::new() }
    }

    #[test]
    fn a_violation_an_untested_property_and_a_passing_control_fail() {
        assert_eq!(report(vec![check(0)], vec![check(2)]).verdict(), Ok(()));
        assert!(report(vec![check(1)], vec![check(2)]).verdict().unwrap_err().contains("violated 1 times"));
        assert!(report(vec![Check::new("p")], vec![]).verdict().unwrap_err().contains("never tested"));
        assert!(report(vec![check(0)], vec![check(0)]).verdict().unwrap_err().contains("detects nothing"));
    }
}
