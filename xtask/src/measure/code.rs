//! `code`: what can be counted in the source text.

use super::run::Run;
use crate::dependency_rules;
use crate::records::{self, record::Record};
use crate::source::{Files, circles, columns, lines, names, repeats, words};
use anyhow::Result;
use bars::Bar;
use std::collections::BTreeSet;

/// Repeats that the same count found at commit 667da50, before they were looked for.
const REPEATS_BEFORE: f64 = 30.0;

/// Most lines that measure.
const MEASURING_LIMIT: f64 = 12_000.0;

/// Figures that the records of that commit had.
const FIGURES_BEFORE: f64 = 105.0;

/// Lines that measured them.
const MEASURING_BEFORE: f64 = 16_645.0;

/// Records whose measuring code is not counted, or has no figures of its own.
const NOT_COUNTED: [&str; 3] = ["cluster", "gpu", "soak"];

/// Counts; there is no program to run.
///
/// # Errors
/// Git cannot list the files.
pub fn rows(run: &mut Run) -> Result<Vec<Bar>> {
    let files = Files::tracked()?;
    run.notes.push(format!(
        "Repeats are maximal runs of six or more equal lines of code in two places, outside tests and \
         examples; the bar is a quarter of the {REPEATS_BEFORE:.0} at commit 667da50. Measuring code is \
         lab, server-bench, bars, chart, benches and xtask/src/measure without tests; {MEASURING_BEFORE:.0} \
         lines of it measured {FIGURES_BEFORE:.0} figures of records at that commit. Figures of cluster, \
         soak and gpu are not among them."
    ));
    let repeats = repeats::find(&files);
    for repeat in &repeats {
        println!("repeat: {}:{}: {}", repeat.path, repeat.line, repeat.what);
    }
    let upward = dependency_rules::violations()?;
    run.notes.extend(upward.iter().cloned());
    let count = |count: usize| Some(count as f64);
    let readme = count(lines::readme(&files));
    let measuring = count(lines::measuring(&files));
    let figures = count(figures(&records::newest()?));
    Ok(vec![
        Bar::none("import circles between modules of a crate", count(circles::check(&files).len())),
        Bar::none("arrows up between crates", count(upward.len())),
        Bar::none(
            "lines over 110 columns in Rust and WESL, over 100 in Markdown",
            count(columns::check(&files).len()),
        ),
        Bar::none("retired words in identifiers, messages, documents", count(words::check(&files).len())),
        Bar::none("names in documents that do not exist", count(names::check(&files).len())),
        Bar::at_most("README", readme, "lines", lines::README_LIMIT as f64),
        Bar::at_most("measuring code without tests", measuring, "lines", MEASURING_LIMIT),
        Bar::reported("figures of records that it measures", figures, ""),
        Bar::reported("lines of measuring code for a figure", measuring.zip(figures).map(|(a, b)| a / b), ""),
        Bar::reported("the same at commit 667da50", Some(MEASURING_BEFORE / FIGURES_BEFORE), ""),
        Bar::at_most("repeats of six lines", count(repeats.len()), "", (REPEATS_BEFORE / 4.0).floor()),
    ])
}

/// Different figures of records: those that several machines have count once.
fn figures(records: &[Record]) -> usize {
    let counted = records.iter().filter(|record| !NOT_COUNTED.contains(&record.name.as_str()));
    let names = counted.flat_map(|record| record.rows.iter().map(|row| (&record.name, &row.what)));
    names.collect::<BTreeSet<_>>().len()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn figures_count_once_and_those_of_other_code_do_not() {
        let record =
            |path: &str| Record::parse(path, "| a | 1 | reported | ok |\n| b | 2 | reported | ok |\n");
        let records = ["x/land.md", "y/land.md", "x/pom.md", "x/soak.md"].map(record);
        assert_eq!(figures(&records), 4);
    }
}
