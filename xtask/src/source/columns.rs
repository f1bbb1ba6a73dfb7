//! Lines that do not fit a screen.

use super::{Files, Finding};

/// Longest line in characters. Comments and Markdown wrap at 100; what rustfmt cannot break may
/// take a little more.
pub const LIMIT: usize = 110;

/// Lines over [`LIMIT`] in Rust, WESL and Markdown. Table rows, definitions of links and records of
/// measurements are exempt: a table and a definition cannot be wrapped, and programs write the
/// records.
pub fn check(files: &Files) -> Vec<Finding> {
    let mut found = Vec::new();
    for (path, text) in files.with_extension(&["rs", "wesl", "wgsl", "md"]) {
        let is_markdown = path.ends_with(".md");
        if is_markdown && path.starts_with("docs/measurements/") {
            continue;
        }
        for (index, line) in text.lines().enumerate() {
            let columns = line.chars().count();
            let is_table = line.trim_start().starts_with('|');
            let is_definition = line.starts_with('[') && line.contains("]: ");
            let is_exempt = is_markdown && (is_table || is_definition);
            if columns > LIMIT && !is_exempt {
                let what = format!("{columns} columns, at most {LIMIT}");
                found.push(Finding { path: path.into(), line: index + 1, what });
            }
        }
    }
    found
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_long_line_is_found_and_a_long_table_row_is_not() {
        let long = "x".repeat(LIMIT + 1);
        let files = Files::of(&[
            ("a.rs", &format!("fine\n{long}\n")),
            ("b.md", &format!("| {long} |\n{long}\n[a]: {long}\n")),
            ("c.json", &long),
            ("docs/measurements/x/r.md", &long),
        ]);
        let found: Vec<_> = check(&files).into_iter().map(|found| (found.path, found.line)).collect();
        assert_eq!(found, [("a.rs".into(), 2), ("b.md".into(), 2)]);
        assert!(check(&Files::of(&[("a.rs", &"é".repeat(LIMIT))])).is_empty());
    }
}
