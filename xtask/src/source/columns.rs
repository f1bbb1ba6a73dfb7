//! Lines that do not fit a screen.

use super::{Files, Finding};

/// Longest line of Markdown and of comments, characters.
pub const LIMIT: usize = 100;

/// Longest line of code: what cannot be broken may take a little more.
pub const LIMIT_CODE: usize = 110;

/// Lines over [`LIMIT`] or [`LIMIT_CODE`] in Rust, WESL and Markdown. Table rows, links that are a
/// line of their own and records of measurements are exempt: a table and a link cannot be wrapped,
/// and programs write the records, from the notes beside them among others. A program writes the
/// WGSL too.
pub fn check(files: &Files) -> Vec<Finding> {
    let mut found = Vec::new();
    for (path, text) in files.with_extension(&["rs", "wesl", "md"]) {
        let is_markdown = path.ends_with(".md");
        let is_record = path.starts_with("docs/measurements/") && !path.contains("/notes/");
        if is_markdown && is_record {
            continue;
        }
        for (index, line) in text.lines().enumerate() {
            let columns = line.chars().count();
            let is_comment = !is_markdown && line.trim_start().starts_with("//");
            let limit = if is_markdown || is_comment { LIMIT } else { LIMIT_CODE };
            let content = line.trim_start().trim_start_matches(['/', '!']).trim_start();
            let is_table = content.starts_with('|');
            let is_link = content.trim_start_matches("- ").starts_with('[');
            let is_exempt = (is_markdown || is_comment) && (is_table || is_link);
            if columns > limit && !is_exempt {
                let what = format!("{columns} columns, at most {limit}");
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
        let long = "x".repeat(LIMIT_CODE + 1);
        let files = Files::of(&[
            ("a.rs", &format!("fine\n{long}\n")),
            ("b.md", &format!("| {long} |\n{long}\n[a]: {long}\n")),
            ("c.json", &long),
            ("docs/measurements/x/r.md", &long),
        ]);
        let found: Vec<_> = check(&files).into_iter().map(|found| (found.path, found.line)).collect();
        assert_eq!(found, [("a.rs".into(), 2), ("b.md".into(), 2)]);
        let comment = format!("    /// {}\n", "x".repeat(LIMIT - 8));
        let row = format!("//! | {} |\n", "x".repeat(LIMIT));
        let files = Files::of(&[
            ("a.rs", &format!("{comment}{row} {comment}")),
            ("docs/measurements/notes/a.md", &long),
        ]);
        let found: Vec<_> = check(&files).into_iter().map(|found| (found.path, found.line)).collect();
        assert_eq!(found, [("a.rs".into(), 3), ("docs/measurements/notes/a.md".into(), 1)]);
        let wide = "é".repeat(LIMIT_CODE);
        assert!(check(&Files::of(&[("a.rs", &wide)])).is_empty());
        assert_eq!(check(&Files::of(&[("a.md", &wide), ("a.wesl", &wide)])).len(), 1);
    }
}
