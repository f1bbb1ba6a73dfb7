//! `code`: what can be counted in the source text.

use super::record::{self, Heading};
use crate::source::{Files, circles, columns, lines, names, repeats, words};
use anyhow::{Context, Result};
use bars::{Bar, Limit};

/// Repeats that the same count found at commit 667da50, before they were looked for.
const REPEATS_BEFORE: f64 = 30.0;

/// Most lines that measure; there were 16,645 at that commit.
const MEASURING_LIMIT: f64 = 12_000.0;

/// Counts, prints, records.
///
/// # Errors
/// Git cannot list the files, the record cannot be written, or a bar was missed.
pub fn run() -> Result<()> {
    let files = Files::tracked()?;
    let rows = rows(&files);
    let note = format!(
        "Repeats are maximal runs of six or more equal lines of code in two places, outside tests and \
         examples; the bar is a quarter of the {REPEATS_BEFORE:.0} at commit 667da50. Measuring code is \
         lab, server-bench, bars, benches and xtask/src/measure without tests."
    );
    for repeat in repeats::find(&files) {
        println!("repeat: {}:{}: {}", repeat.path, repeat.line, repeat.what);
    }
    let heading = Heading { name: "code", adapter: None, notes: &[note] };
    let path = record::write(&heading, &rows).context("measure")?;
    super::judge(&rows, &path)
}

fn rows(files: &Files) -> Vec<Bar> {
    let none = |what: &str, count: usize| Bar::new(what, Some(count as f64), "", Limit::AtMost(0.0));
    vec![
        none("import circles between modules of a crate", circles::check(files).len()),
        none("lines over 110 columns in Rust, WESL, Markdown", columns::check(files).len()),
        none("retired words in identifiers, messages, documents", words::check(files).len()),
        none("names in documents that do not exist", names::check(files).len()),
        Bar::new(
            "README",
            Some(lines::readme(files) as f64),
            "lines",
            Limit::AtMost(lines::README_LIMIT as f64),
        ),
        Bar::new(
            "measuring code without tests",
            Some(lines::measuring(files) as f64),
            "lines",
            Limit::AtMost(MEASURING_LIMIT),
        ),
        Bar::new(
            "repeats of six lines",
            Some(repeats::find(files).len() as f64),
            "",
            Limit::AtMost((REPEATS_BEFORE / 4.0).floor()),
        ),
    ]
}
