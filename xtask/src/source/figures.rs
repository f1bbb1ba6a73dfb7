//! Figures of the README against their records.
//!
//! A row of a table whose link leads to a record quotes one figure of it. The title of the link
//! names the row of the record:
//! `[streaming](docs/measurements/x/streaming.md "memory of a client")`.

use super::{Files, Finding};
use crate::records::link::{self, Link};
use crate::records::quotes::WITHDRAWN;

/// Figures that the record does not state, rows that it does not have, and records of changed
/// working trees.
pub fn check(files: &Files) -> Vec<Finding> {
    let readme = files.0.get("README.md").map_or("", String::as_str);
    let rows = readme.lines().enumerate().filter(|(_, line)| line.contains("](docs/measurements/2"));
    rows.filter_map(|(index, line)| {
        let what = fault(files, line)?;
        Some(Finding { path: "README.md".into(), line: index + 1, what })
    })
    .collect()
}

/// Error of one row; none if its figure is the record's.
fn fault(files: &Files, line: &str) -> Option<String> {
    let cells: Vec<_> = line.trim().trim_matches('|').split('|').map(str::trim).collect();
    let [_, quoted, source] = cells.as_slice() else {
        return Some("a quoted figure needs the cells: what, figure, record".into());
    };
    if *quoted == WITHDRAWN {
        return None;
    }
    let Some(Link { path, title: Some(title), .. }) = link::first(source) else {
        return Some("the link to the record needs the title of the record's row".into());
    };
    let Some(record) = files.0.get(path) else { return Some(format!("there is no record {path}")) };
    if record.contains("uncommitted changes") {
        return Some(format!("{path} is of a changed working tree"));
    }
    let stated = record.lines().find_map(|row| {
        let mut cells = row.trim().trim_matches('|').split('|').map(str::trim);
        (cells.next() == Some(title)).then(|| cells.next().and_then(number)).flatten()
    });
    let Some(stated) = stated else { return Some(format!("{path} has no figure `{title}`")) };
    let decimals = quoted
        .split_whitespace()
        .next()
        .and_then(|word| word.split_once('.'))
        .map_or(0, |(_, part)| part.len());
    let rounded = format!("{stated:.decimals$}");
    let agrees = number(quoted).is_some_and(|number| format!("{number:.decimals$}") == rounded);
    (!agrees).then(|| format!("quotes {quoted}; {path} states {stated}"))
}

/// The number at the beginning of a cell.
fn number(cell: &str) -> Option<f64> {
    cell.split_whitespace().next()?.replace(',', "").parse().ok()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn found(row: &str, record: &str) -> Vec<String> {
        let files = Files::of(&[("README.md", row), ("docs/measurements/2026-x/a.md", record)]);
        check(&files).into_iter().map(|found| found.what).collect()
    }

    const RECORD: &str = "| what | figure | bar | |\n| time of a chunk | 0.207 x | at most 0.3 x | ok |\n";

    #[test]
    fn a_figure_of_the_record_passes_at_its_precision() {
        for quoted in ["0.21", "0.207", "0.2 x"] {
            let row = format!("| time | {quoted} | [a](docs/measurements/2026-x/a.md \"time of a chunk\") |");
            assert_eq!(found(&row, RECORD), [""; 0], "{quoted}");
        }
    }

    #[test]
    fn a_title_with_parentheses_is_read_to_its_end() {
        let record = format!("{RECORD}| time (of 2), all | 0.5 | | |\n");
        let row =
            |title: &str| format!("| time | 0.5 | [a](docs/measurements/2026-x/a.md \"{title}\") (x) |");
        assert_eq!(found(&row("time (of 2), all"), &record), [""; 0]);
        assert_eq!(found(&row("time (of 2)"), &record).len(), 1);
    }

    #[test]
    fn another_figure_row_or_record_is_found() {
        let row = |quoted: &str, link: &str| format!("| time | {quoted} | [a]({link}) |");
        let good = "docs/measurements/2026-x/a.md \"time of a chunk\"";
        for (row, record) in [
            (row("0.20", good), RECORD),
            (row("0.21", "docs/measurements/2026-x/a.md \"time of all\""), RECORD),
            (row("0.21", "docs/measurements/2026-x/a.md"), RECORD),
            (row("0.21", "docs/measurements/2026-x/b.md \"time of a chunk\""), RECORD),
            (row("fast", good), RECORD),
            (row("0.21", good), &format!("{RECORD}| Commit | abc with uncommitted changes |\n")),
        ] {
            assert_eq!(found(&row, record).len(), 1, "{row}");
        }
    }
}
