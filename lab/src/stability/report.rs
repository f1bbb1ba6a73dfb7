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
        write_rows(f, &format!("property ({} worlds)", self.worlds), &self.checks)?;
        writeln!(f)?;
        write_rows(f, "control, must be violated", &self.controls)?;
        writeln!(f, "worst: largest share of what is allowed; where nothing is allowed, units\n")?;
        write!(f, "{:<24} {:>8} {:>10} ", "error of a chunk, level", "chunks", "vertices")?;
        writeln!(f, "{:>9} {:>8} {:>7} {:>17}", "stated, m", "seen, m", "ratio", "median of chunks")?;
        for row in &self.errors {
            let ErrorRow { level, chunks, vertices, stated_m, seen_m, .. } = row;
            let median = row.median_ratio.map_or_else(|| "-".into(), |ratio| format!("{ratio:.2}"));
            let ratio = stated_m / seen_m;
            write!(f, "{level:<24} {chunks:>8} {vertices:>10} {stated_m:>9.2} {seen_m:>8.2} ")?;
            writeln!(f, "{ratio:>7.2} {median:>17}")?;
        }
        writeln!(f, "stated, seen: the largest of all chunks\n")?;
        write!(f, "{:<40} {:>10} {:>9} {:>6} ", "64 samples, 1/256 m apart", "at, m", "distinct", "least")?;
        writeln!(f, "{:>10} {:>10} {:>6} {:>8}", "jump, mm", "x bound", "stuck", "repeats")?;
        for row in &self.floats {
            let FloatRow { field, distance_m, distinct_mean, distinct_least, .. } = row;
            let (jump_mm, stuck) = (row.largest_jump_m * 1000.0, row.stuck * 100.0);
            let repeats = if row.repeats { "yes" } else { "no" };
            write!(f, "{field:<40} {distance_m:>10} {distinct_mean:>9.1} {distinct_least:>6} ")?;
            writeln!(f, "{jump_mm:>10.2} {:>10.2} {stuck:>5.0}% {repeats:>8}", row.jump_over_bound)?;
        }
        Ok(())
    }
}

fn write_rows(f: &mut fmt::Formatter<'_>, what: &str, checks: &[Check]) -> fmt::Result {
    writeln!(f, "{what:<66} {:>10} {:>8} {:>8}", "cases", "violated", "worst")?;
    for Check { name, cases, violations, worst, worst_at, first } in checks {
        writeln!(f, "{name:<66} {cases:>10} {violations:>8} {worst:>8.2}")?;
        first.iter().try_for_each(|first| writeln!(f, "    first: {first}; worst at {worst_at}"))?;
    }
    Ok(())
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
