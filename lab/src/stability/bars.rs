//! The bars of the errors that chunks state, for records.

use super::errors::{self, ErrorRow, TIGHT};
use super::report::Report;
use ::bars::Bar;

/// Chunks of every level that the bars ask for; fewer find less than the largest error.
const CHUNKS: u32 = 10_000;

/// Every level's figure beside its bar, controls last. Levels of too few chunks have no figure.
pub fn rows(report: &Report) -> Vec<Bar> {
    let is_enough = report.errors.iter().all(|row| row.chunks >= CHUNKS) && !report.errors.is_empty();
    let counted = |count: u64| is_enough.then_some(count as f64);
    let of_levels = report.checks.iter().filter(|check| check.name.starts_with(errors::OF_LEVEL));
    let beyond = of_levels.map(|check| check.violations).sum();
    let violated = report.checks.iter().filter(|check| !check.holds()).count() as u64;
    let blind = report.controls.iter().filter(|control| control.violations == 0).count() as u64;
    let ratio = |row: &ErrorRow| {
        let figure = (is_enough && row.seen_m > 0.0).then(|| row.stated_m / row.seen_m);
        Bar::at_most(
            format!("level {}: largest stated error over largest seen", row.level),
            figure,
            "x",
            TIGHT,
        )
    };
    let mut rows = vec![Bar::none("chunks of all levels beyond the error that they state", counted(beyond))];
    rows.extend(report.errors.iter().map(ratio));
    rows.extend([
        Bar::none("properties of the land that are violated", Some(violated as f64)),
        Bar::none("controls of these properties that find nothing (control)", Some(blind as f64)),
    ]);
    rows
}

/// How the figures were measured.
pub fn notes(report: &Report) -> Vec<String> {
    let of_level = |row: &ErrorRow| {
        format!(
            "level {} states {:.0} and has {:.0} m, {} whole",
            row.level, row.stated_m, row.seen_m, row.whole
        )
    };
    let levels: Vec<_> = report.errors.iter().map(of_level).collect();
    vec![format!(
        "Stated errors: {} chunks a level on islands of many worlds, {:.1e} vertices of level 0; \"whole\" \
         chunks, which state the largest errors, at every vertex: {}.",
        report.errors.iter().map(|row| row.chunks).min().unwrap_or(0),
        report.errors.iter().map(|row| row.vertices).sum::<u64>() as f64,
        levels.join("; ")
    )]
}

#[cfg(test)]
mod tests {
    use super::super::check::Check;
    use super::*;

    fn report() -> Report {
        let row = |level| ErrorRow {
            level,
            chunks: CHUNKS,
            whole: 16,
            vertices: 1,
            stated_m: 40.0,
            seen_m: 20.0,
            median_ratio: None,
        };
        let check = |name: &str, violations| Check { cases: 5, violations, ..Check::new(name) };
        Report {
            worlds: 1,
            checks: vec![check("level 1: chunks", 0), check("other", 0)],
            controls: vec![check("a quarter", 3)],
            errors: vec![row(1), row(2)],
            floats: Vec::new(),
        }
    }

    fn missed(change: impl Fn(&mut Report)) -> Vec<String> {
        let mut report = report();
        change(&mut report);
        rows(&report).into_iter().filter(Bar::is_missed).map(|row| row.name).collect()
    }

    #[test]
    fn each_bar_can_be_missed() {
        assert_eq!(missed(|_| ()), [""; 0]);
        assert_eq!(missed(|report| report.errors[1].stated_m = 80.1).len(), 1);
        assert_eq!(missed(|report| report.errors[1].seen_m = 0.0).len(), 1);
        assert_eq!(missed(|report| report.checks[0].violations = 1).len(), 2, "a property, too");
        assert_eq!(missed(|report| report.checks[1].violations = 1).len(), 1);
        assert_eq!(missed(|report| report.controls[0].violations = 0).len(), 1);
    }

    #[test]
    fn a_shorter_run_measures_no_level() {
        assert_eq!(missed(|report| report.errors[0].chunks = CHUNKS - 1).len(), 3);
        assert_eq!(missed(|report| report.errors.clear()).len(), 1);
    }
}
