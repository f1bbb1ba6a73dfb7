//! `code`: what can be counted in the source text.

use super::run::Run;
use crate::dependency_rules;
use crate::source::{Files, circles, columns, lines, names, repeats, words};
use anyhow::Result;
use bars::Bar;

/// Repeats that the same count found at commit 667da50, before they were looked for.
const REPEATS_BEFORE: f64 = 30.0;

/// Most lines that measure; there were 16,645 at that commit.
const MEASURING_LIMIT: f64 = 12_000.0;

/// Counts; there is no program to run.
///
/// # Errors
/// Git cannot list the files.
pub fn rows(run: &mut Run) -> Result<Vec<Bar>> {
    let files = Files::tracked()?;
    run.notes.push(format!(
        "Repeats are maximal runs of six or more equal lines of code in two places, outside tests and \
         examples; the bar is a quarter of the {REPEATS_BEFORE:.0} at commit 667da50. Measuring code is \
         lab, server-bench, bars, chart, benches and xtask/src/measure without tests."
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
        Bar::at_most("repeats of six lines", count(repeats.len()), "", (REPEATS_BEFORE / 4.0).floor()),
    ])
}
