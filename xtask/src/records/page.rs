//! `docs/measurements/README.md`, made from the records and the sections in
//! `docs/measurements/notes`, so that no figure of it is typed.

use super::record::{self, FOLDER, Record, Row};
use std::collections::BTreeMap;
use std::fmt::Write;

/// The page.
pub const PATH: &str = "docs/measurements/README.md";

/// Order of the sections; a measurement without notes has no section.
const SECTIONS: [&str; 18] = [
    "heightfield",
    "land",
    "end-to-end",
    "terrain",
    "pom",
    "culling",
    "visual",
    "streaming",
    "cluster",
    "soak",
    "resilience",
    "websocket",
    "fuzz",
    "mutants",
    "demo-build",
    "code",
    "gpu",
    "audit",
];

/// Beginning and end of the page.
const INTRODUCTION: &str = "introduction";
const LIMITS: &str = "limits";

const COLUMNS: usize = 100;

/// The page of some files, by path: records and notes.
pub fn text(files: &BTreeMap<String, String>) -> String {
    let (records, _) = record::newest(record::all(files));
    let notes = |name: &str| files.get(&format!("{FOLDER}notes/{name}.md")).map(String::as_str);
    let mut page = String::from(
        "<!-- Written by `cargo xtask records --write` from the records and docs/measurements/notes. -->\n\n",
    );
    page.push_str(notes(INTRODUCTION).unwrap_or("# Measurements\n"));
    let others = records.iter().map(|record| record.name.as_str());
    let mut others: Vec<_> = others.filter(|name| !SECTIONS.contains(name)).collect();
    others.dedup();
    for name in SECTIONS.into_iter().chain(others) {
        let own: Vec<_> = records.iter().filter(|record| record.name == name).collect();
        let notes = notes(name);
        if own.is_empty() && notes.is_none() {
            continue;
        }
        section(&mut page, name, notes.unwrap_or_default(), &own, files);
    }
    if let Some(limits) = notes(LIMITS) {
        let _ = write!(page, "\n{limits}");
    }
    page
}

/// A heading, the records' tables, and the notes: first what the records say of their rows, then
/// what people wrote.
fn section(
    page: &mut String,
    name: &str,
    notes: &str,
    records: &[&Record],
    files: &BTreeMap<String, String>,
) {
    let (title, body) = match notes.strip_prefix("# ").and_then(|rest| rest.split_once('\n')) {
        Some((title, body)) => (title, body.trim()),
        None => (name, notes.trim()),
    };
    // Writing to a string cannot fail.
    let command = if name == "gpu" { "gpu-bundle".into() } else { format!("measure {name}") };
    let _ = writeln!(page, "\n## {title}\n\nCommand: `cargo xtask {command}`.");
    if records.is_empty() {
        page.push_str("\nNo record is committed yet.\n");
    }
    for record in records {
        let _ = write!(page, "\n{}", table(record, files));
    }
    if !body.is_empty() {
        let _ = writeln!(page, "\n{body}");
    }
}

fn table(record: &Record, files: &BTreeMap<String, String>) -> String {
    let link = |path: &str| path.trim_start_matches(FOLDER).to_owned();
    let folder = record.path.trim_end_matches(".md");
    // The curves of the codec belong to the record of the streaming.
    let curves = [folder.to_owned(), format!("{}/codec", folder.rsplit_once('/').map_or("", |(at, _)| at))];
    let wanted = if record.name == "streaming" { &curves[..] } else { &curves[..1] };
    let curves = wanted
        .iter()
        .map(|folder| format!("{folder}/README.md"))
        .find(|path| files.contains_key(path))
        .map_or(String::new(), |path| format!(", [curves]({})", link(&path)));
    let dirty = if record.is_dirty() { " with uncommitted changes" } else { "" };
    let runs = record.runs();
    let facts = format!(
        "[Record]({}){curves} of {}, commit {}{dirty}, {} {}; {}; GPU: {}.",
        link(&record.path),
        record.fact("Date"),
        record.commit(),
        runs,
        if runs == 1 { "run" } else { "runs" },
        record.fact("CPU"),
        record.fact("GPU"),
    );
    let mut table = wrapped(&facts, "");
    table.push_str("\n| what | figure | bar | kept |\n| --- | ---: | --- | --- |\n");
    for row in &record.rows {
        let Row { what, figure, bar, .. } = row;
        let _ = writeln!(table, "| {what} | {figure} | {bar} | {} |", kept(row));
    }
    let of_rows = |note: &&String| {
        record
            .rows
            .iter()
            .any(|row| note.strip_prefix(row.what.as_str()).is_some_and(|rest| rest.starts_with(": ")))
    };
    let mut defined: Vec<_> = record.notes.iter().filter(of_rows).collect();
    defined.dedup();
    if !defined.is_empty() {
        table.push('\n');
        for note in defined {
            table.push_str(&wrapped(&format!("- {note}"), "  "));
        }
    }
    table
}

/// How often a row kept its bar.
fn kept(row: &Row) -> String {
    match (row.kept.as_str(), row.verdict.as_str()) {
        (_, verdict) if row.bar == "reported" && verdict != "MISSED" => "reported".into(),
        ("", verdict) => verdict.into(),
        (kept, "MISSED") => format!("MISSED, {kept}"),
        (kept, _) => kept.into(),
    }
}

/// Lines of at most [`COLUMNS`], the second and later ones behind an indent.
fn wrapped(text: &str, indent: &str) -> String {
    let (mut lines, mut column) = (String::new(), 0);
    for word in text.split_whitespace() {
        let length = word.chars().count();
        if column > 0 && column + 1 + length > COLUMNS {
            lines.push('\n');
            lines.push_str(indent);
            column = indent.len();
        } else if column > 0 {
            lines.push(' ');
            column += 1;
        }
        lines.push_str(word);
        column += length;
    }
    lines.push('\n');
    lines
}

/// Errors of the committed page and of the records beside it, with the path.
pub fn faults(files: &BTreeMap<String, String>) -> Vec<(String, String)> {
    let (_, older) = record::newest(record::all(files));
    let mut faults: Vec<_> = older
        .into_iter()
        .map(|record| (record.path, "a newer record of this machine replaces it; remove it".to_owned()))
        .collect();
    if files.get(PATH).map(String::as_str) != Some(text(files).as_str()) {
        let cure = "differs from what the records and notes give; run: cargo xtask records --write";
        faults.push((PATH.into(), cure.into()));
    }
    faults
}

#[cfg(test)]
mod tests {
    use super::*;

    fn files() -> BTreeMap<String, String> {
        let record = "| Date | 2026-01-02 |\n| Commit | abc |\n| CPU | X, 2 cores |\n| GPU | none |\n| Runs \
                      of this commit | 3 |\n\n| what | median | bar | | range | kept |\n| time | 2.5 s | \
                      under 3 s | ok | 1 to 9 | 2 of 3 |\n\n- time: from request to socket.\n- Load 5.\n";
        let mut files = BTreeMap::from(
            [
                ("docs/measurements/2026-01-02-x/streaming.md", record),
                ("docs/measurements/2026-01-02-x/codec/README.md", "curves"),
                ("docs/measurements/notes/streaming.md", "# Streaming\n\nOne core serves.\n"),
                ("docs/measurements/notes/introduction.md", "# Measurements\n\nRead this.\n"),
                ("docs/measurements/notes/limits.md", "## Limits\n"),
                ("docs/measurements/notes/gpu.md", "# On a GPU\n\nNone yet.\n"),
            ]
            .map(|(path, text)| (path.to_owned(), text.to_owned())),
        );
        files.insert(PATH.into(), text(&files));
        files
    }

    #[test]
    fn a_missing_figure_without_a_bar_is_a_miss() {
        let of = |verdict: &str| {
            let [what, figure, range] = ["time", "missing", ""].map(str::to_owned);
            let (bar, verdict, kept) = ("reported".into(), verdict.into(), "0 of 1".into());
            super::kept(&Row { what, figure, bar, verdict, range, kept })
        };
        assert_eq!([of("ok"), of("MISSED")], ["reported", "MISSED, 0 of 1"]);
    }

    #[test]
    fn the_page_has_rows_notes_of_rows_and_sections_without_records() {
        let page = text(&files());
        for part in [
            "# Measurements\n\nRead this.\n",
            "## Streaming\n",
            "| time | 2.5 s | under 3 s | 2 of 3 |",
            "- time: from request to socket.\n",
            "One core serves.",
            "[curves](2026-01-02-x/codec/README.md)",
            "## On a GPU\n",
            "No record is committed yet.",
        ] {
            assert!(page.contains(part), "{part} is not in:\n{page}");
        }
        assert!(page.ends_with("\n## Limits\n") && !page.contains("Load 5"), "{page}");
    }

    #[test]
    fn the_generated_page_passes_and_a_changed_figure_or_record_fails() {
        let whole = files();
        assert_eq!(faults(&whole), []);
        let corrupt = |path: &str, from: &str, to: &str| {
            let mut files = whole.clone();
            let text = files[path].replace(from, to);
            assert_ne!(text, files[path]);
            files.insert(path.into(), text);
            faults(&files).len()
        };
        assert_eq!(corrupt(PATH, "2.5 s", "2.4 s"), 1);
        assert_eq!(corrupt("docs/measurements/2026-01-02-x/streaming.md", "2.5 s", "2.4 s"), 1);
        assert_eq!(corrupt("docs/measurements/notes/streaming.md", "One", "Two"), 1);
        let mut without = whole.clone();
        without.remove(PATH);
        assert_eq!(faults(&without).len(), 1);
    }

    #[test]
    fn an_older_record_of_the_same_machine_is_to_be_removed() {
        let mut files = files();
        let record = files["docs/measurements/2026-01-02-x/streaming.md"].clone();
        files.insert("docs/measurements/2026-01-01-x/streaming.md".into(), record);
        files.insert(PATH.into(), text(&files));
        let faults = faults(&files);
        assert!(matches!(faults.as_slice(), [(path, _)] if path.contains("2026-01-01")), "{faults:?}");
    }

    #[test]
    fn lines_are_wrapped_at_the_limit() {
        let lines = wrapped(&"word ".repeat(60), "  ");
        assert!(lines.lines().all(|line| line.len() <= COLUMNS) && lines.lines().count() == 4, "{lines}");
    }
}
