//! Figures in documents that refer to a row of a record.
//!
//! A definition of a link of Markdown whose title is a row of a record,
//! `[turns]: ../measurements/2026-01-02-x/streaming.md "row"`, makes every use of it a quote:
//! `[3.28][turns]` is the figure of that row, at its own precision. A document so keeps the figures
//! of the record that it names; it says of which date the record is.

use super::record::{FOLDER, Record};
use std::ops::Range;

/// A figure of a document that differs from its record, or has none.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Fault {
    /// Line of the document, from 1.
    pub line: usize,
    /// The error.
    pub what: String,
    /// The bytes of the number and what the record states in their place; none without a record's
    /// figure.
    right: Option<(Range<usize>, String)>,
}

/// A link to a row of a record.
struct Definition<'a> {
    name: &'a str,
    /// Of the record, from the root of the repository.
    path: String,
    row: &'a str,
    line: usize,
}

/// Errors of the figures of a document at `path`.
pub fn faults(path: &str, text: &str, records: &[Record]) -> Vec<Fault> {
    let mut faults = Vec::new();
    for definition in definitions(path, text) {
        let Definition { name, path, row, line } = definition;
        let stated = records
            .iter()
            .find(|record| record.path == path)
            .and_then(|record| record.rows.iter().find(|known| known.what == row))
            .and_then(|row| number(&row.figure));
        let Some(stated) = stated else {
            faults.push(Fault { line, what: format!("{path} has no figure `{row}`"), right: None });
            continue;
        };
        let uses: Vec<_> = uses(text, name).collect();
        if uses.is_empty() {
            faults.push(Fault { line, what: format!("no figure refers to [{name}]"), right: None });
        }
        for place in uses {
            let line = text[..place.start].matches('\n').count() + 1;
            let quoted = &text[place.clone()];
            let right = written(stated, quoted);
            if number(quoted).is_none() {
                let what = format!("the text of a link to [{name}] begins with the figure, not `{quoted}`");
                faults.push(Fault { line, what, right: None });
            } else if quoted != right {
                let what = format!("quotes {quoted}; `{row}` of {path} states {right}");
                faults.push(Fault { line, what, right: Some((place, right)) });
            }
        }
    }
    faults
}

/// The document with the figures of its records.
pub fn corrected(path: &str, text: &str, records: &[Record]) -> String {
    let mut right: Vec<_> = faults(path, text, records).into_iter().filter_map(|fault| fault.right).collect();
    right.sort_by_key(|(place, _)| std::cmp::Reverse(place.start));
    let mut text = text.to_owned();
    right.into_iter().for_each(|(place, figure)| text.replace_range(place, &figure));
    text
}

/// The definitions of links to rows of records.
fn definitions<'a>(path: &str, text: &'a str) -> impl Iterator<Item = Definition<'a>> {
    let folder = path.rsplit_once('/').map_or("", |(folder, _)| folder).to_owned();
    text.lines().enumerate().filter_map(move |(index, line)| {
        let (name, target) = line.strip_prefix('[')?.split_once("]: ")?;
        let (target, title) = target.split_once(" \"")?;
        let path = resolved(&folder, target);
        let row = title.strip_suffix('"')?;
        path.starts_with(FOLDER).then_some(Definition { name, path, row, line: index + 1 })
    })
}

/// A path from the root of a target in a document of a folder.
fn resolved(folder: &str, target: &str) -> String {
    let mut parts: Vec<_> = folder.split('/').filter(|part| !part.is_empty()).collect();
    for part in target.split('/') {
        if part == ".." {
            parts.pop();
        } else {
            parts.push(part);
        }
    }
    parts.join("/")
}

/// The bytes of the first words of the links that refer to a definition.
fn uses<'a>(text: &'a str, name: &str) -> impl Iterator<Item = Range<usize>> + 'a {
    let reference = format!("][{name}]");
    let found: Vec<_> = text.match_indices(&reference).map(|(end, _)| end).collect();
    found.into_iter().filter_map(move |end| {
        let start = text[..end].rfind('[')? + 1;
        let word = text[start..end].split_whitespace().next()?;
        Some(start..start + word.len())
    })
}

/// The number at the beginning of a figure.
fn number(figure: &str) -> Option<f64> {
    figure.split_whitespace().next()?.replace(',', "").parse().ok()
}

/// A figure with as many decimals as another, and commas between thousands.
fn written(figure: f64, like: &str) -> String {
    let decimals = like.split_once('.').map_or(0, |(_, part)| part.len());
    let text = format!("{figure:.decimals$}");
    let (whole, part) = text.split_at(text.find('.').unwrap_or(text.len()));
    let (sign, digits) = whole.split_at(usize::from(whole.starts_with('-')));
    let mut grouped = String::new();
    for (index, digit) in digits.chars().enumerate() {
        if index > 0 && (digits.len() - index) % 3 == 0 {
            grouped.push(',');
        }
        grouped.push(digit);
    }
    format!("{sign}{grouped}{part}")
}

#[cfg(test)]
mod tests {
    use super::super::record::Row;
    use super::*;

    const PATH: &str = "docs/measurements/2026-x/a.md";

    fn records(figure: &str) -> Vec<Record> {
        let row = Row { what: "row (of 2)".into(), figure: figure.into(), ..Row::default() };
        vec![Record { path: PATH.into(), rows: vec![row], ..Record::default() }]
    }

    fn document(figure: &str) -> String {
        format!(
            "It takes [{figure} ms][time] of\n[{figure}\nms][time], see [x][y].\n\n[y]: b.md \"t\"\n\
             [time]: ../measurements/2026-x/a.md \"row (of 2)\"\n"
        )
    }

    fn faults_of(text: &str, figure: &str) -> Vec<String> {
        faults("docs/decisions/1.md", text, &records(figure)).into_iter().map(|fault| fault.what).collect()
    }

    #[test]
    fn a_figure_of_the_record_passes_at_its_precision() {
        for quoted in ["12,345.68", "12,345.7", "12,346"] {
            assert_eq!(faults_of(&document(quoted), "12345.678 ms"), [""; 0], "{quoted}");
        }
        assert_eq!(faults_of(&document("-0.2"), "-0.21 x"), [""; 0]);
        assert_eq!(faults_of(&document("100"), "100"), [""; 0]);
    }

    #[test]
    fn another_figure_is_found_and_corrected() {
        let (wrong, right) = (document("0.2"), document("0.3"));
        assert_eq!(faults_of(&wrong, "0.31 x").len(), 2);
        let lines: Vec<_> =
            faults("docs/decisions/1.md", &wrong, &records("0.31")).iter().map(|fault| fault.line).collect();
        assert_eq!(lines, [1, 2]);
        assert_eq!(corrected("docs/decisions/1.md", &wrong, &records("0.31 x")), right);
        assert_eq!(
            corrected("docs/decisions/1.md", &document("0.999"), &records("1000.5")),
            document("1,000.500")
        );
    }

    #[test]
    fn a_definition_without_a_row_a_record_or_a_use_and_a_text_without_a_number_are_found() {
        let good = document("0.2");
        for (from, to) in [
            ("row (of 2)", "row"),
            ("2026-x/a.md", "2026-x/b.md"),
            ("0.2 ms][time] of\n[0.2\nms][time]", "0.2 ms of"),
            ("[0.2 ms", "[about 0.2 ms"),
        ] {
            let text = good.replace(from, to);
            assert_eq!(faults_of(&text, "0.2 x").len(), 1, "{text}");
            assert_eq!(corrected("docs/decisions/1.md", &text, &records("0.2 x")), text);
        }
        assert_eq!(faults_of(&good, "0.2 x"), [""; 0]);
    }

    #[test]
    fn targets_are_resolved_from_the_folder_of_the_document() {
        for (path, target) in [
            ("docs/decisions/1.md", "../measurements/2026-x/a.md"),
            ("docs/scale.md", "measurements/2026-x/a.md"),
            ("ARCHITECTURE.md", "docs/measurements/2026-x/a.md"),
        ] {
            let text = format!("[1][a]\n\n[a]: {target} \"row (of 2)\"\n");
            assert_eq!(
                faults(path, &text, &records("2"))[0].what,
                format!("quotes 1; `row (of 2)` of {PATH} states 2")
            );
        }
    }
}
