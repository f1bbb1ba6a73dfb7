//! A committed record, read back from its page.

use std::collections::BTreeMap;

/// The folder of all records.
pub const FOLDER: &str = "docs/measurements/";

/// Length of the date in the name of a record's folder, and of the hyphen behind it.
pub const DATE: usize = "2026-01-02-".len();

/// A record of one measurement on one machine.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Record {
    /// Path from the root of the repository.
    pub path: String,
    /// Name of the measurement today.
    pub name: String,
    /// The table of facts: date, commit, CPU and so on.
    pub facts: BTreeMap<String, String>,
    /// The rows, in their order.
    pub rows: Vec<Row>,
    /// The sentences below the table.
    pub notes: Vec<String>,
}

/// One figure of a record, as it is printed.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Row {
    /// The measurement.
    pub what: String,
    /// The figure with its unit.
    pub figure: String,
    /// The bar.
    pub bar: String,
    /// `ok`, `MISSED`, or why it was not measured.
    pub verdict: String,
    /// Least and largest figure; empty for one run.
    pub range: String,
    /// Runs that kept the bar, `2 of 3`; empty in records that did not count them.
    pub kept: String,
}

impl Record {
    /// Reads a page. Absent parts stay empty.
    pub fn parse(path: &str, page: &str) -> Self {
        let stem = path.rsplit('/').next().unwrap_or(path).trim_end_matches(".md");
        let mut record = Self { path: path.into(), name: today(stem).into(), ..Self::default() };
        for line in page.lines() {
            if let Some(note) = line.strip_prefix("- ") {
                record.notes.push(note.into());
                continue;
            }
            let Some(cells) = cells(line) else { continue };
            match cells.as_slice() {
                ["", ""] | ["---", ..] | ["what", ..] => {}
                [name, value] => _ = record.facts.insert((*name).into(), (*value).into()),
                [what, figure, bar, verdict, rest @ ..] => {
                    let rest = |index: usize| rest.get(index).map_or(String::new(), ToString::to_string);
                    record.rows.push(Row {
                        what: (*what).into(),
                        figure: (*figure).into(),
                        bar: (*bar).into(),
                        verdict: (*verdict).into(),
                        range: rest(0),
                        kept: rest(1),
                    });
                }
                _ => {}
            }
        }
        record
    }

    /// The machine in the name of its folder; empty for a path of no record.
    pub fn machine(&self) -> &str {
        let folder = self.path.strip_prefix(FOLDER).and_then(|rest| rest.split('/').next());
        folder.and_then(|folder| folder.get(DATE..)).unwrap_or_default()
    }

    /// A fact; empty if the record does not state it.
    pub fn fact(&self, name: &str) -> &str {
        self.facts.get(name).map_or("", String::as_str)
    }

    /// The commit that was measured, without remarks.
    pub fn commit(&self) -> &str {
        self.fact("Commit").split_whitespace().next().unwrap_or_default()
    }

    /// Whether the working tree differed from the commit.
    pub fn is_dirty(&self) -> bool {
        self.fact("Commit").contains("uncommitted")
    }

    /// Number of runs that the figures are medians of. Records that do not count them are of one.
    pub fn runs(&self) -> u32 {
        self.fact("Runs of this commit").parse().unwrap_or(1)
    }
}

/// The cells of a line of a table.
fn cells(line: &str) -> Option<Vec<&str>> {
    let inner = line.trim().strip_prefix('|')?.strip_suffix('|')?;
    Some(inner.split('|').map(|cell| cell.trim().trim_end_matches(':')).collect())
}

/// Today's name of a measurement.
pub fn today(name: &str) -> &str {
    if name == "first-voyage" { "end-to-end" } else { name }
}

/// Every record among some files, by path: `docs/measurements/DATE-MACHINE/NAME.md`.
pub fn all(files: &BTreeMap<String, String>) -> Vec<Record> {
    let is_record = |path: &str| {
        let Some(rest) = path.strip_prefix(FOLDER) else { return false };
        rest.starts_with("20") && rest.ends_with(".md") && rest.matches('/').count() == 1
    };
    files.iter().filter(|(path, _)| is_record(path)).map(|(path, page)| Record::parse(path, page)).collect()
}

/// Splits records into the newest of each measurement and machine, and those that they replace.
pub fn newest(records: Vec<Record>) -> (Vec<Record>, Vec<Record>) {
    let mut by_key: BTreeMap<(String, String), Record> = BTreeMap::new();
    let mut older = Vec::new();
    for record in records {
        let key = (record.name.clone(), record.fact("CPU").to_owned());
        match by_key.get_mut(&key) {
            // Paths begin with the date.
            Some(known) if known.path < record.path => older.push(std::mem::replace(known, record)),
            Some(_) => older.push(record),
            None => _ = by_key.insert(key, record),
        }
    }
    (by_key.into_values().collect(), older)
}

#[cfg(test)]
mod tests {
    use super::*;

    const PAGE: &str = "# streaming\n\n| | |\n| --- | --- |\n| Date | 2026-01-02 |\n| Commit | abc with \
        uncommitted changes: a draft |\n| CPU | X, 2 cores |\n| Runs of this commit | 3 |\n\n| what | \
        median | bar | | range | kept |\n| --- | ---: | --- | --- | --- | --- |\n| time | 2.500 s | under \
        3 s | ok | 1.000 to 9.000 | 2 of 3 |\n| on a GPU | not measured | under 2 ms | needs a GPU |  |  \
        |\n\n- time: from request to socket.\n";

    #[test]
    fn a_page_is_read_with_facts_rows_and_notes() {
        let record = Record::parse("docs/measurements/2026-01-02-x/streaming.md", PAGE);
        assert_eq!((record.commit(), record.is_dirty(), record.runs()), ("abc", true, 3));
        assert_eq!(record.rows.len(), 2);
        assert_eq!(
            (record.rows[0].range.as_str(), record.rows[0].kept.as_str()),
            ("1.000 to 9.000", "2 of 3")
        );
        assert_eq!(record.notes, ["time: from request to socket."]);
    }

    #[test]
    fn a_page_of_before_runs_were_counted_is_of_one_run() {
        let record = Record::parse("x/first-voyage.md", "| Commit | abc |\n| a | 1 | at most 2 | ok |\n");
        assert_eq!((record.name.as_str(), record.runs(), record.is_dirty()), ("end-to-end", 1, false));
        assert_eq!((record.rows.len(), record.rows[0].kept.as_str()), (1, ""));
    }

    #[test]
    fn the_newest_of_a_machine_replaces_older_ones_and_other_machines_stay() {
        let record = |path: &str, cpu: &str| Record {
            path: path.into(),
            name: "x".into(),
            facts: [("CPU".into(), cpu.into())].into(),
            ..Record::default()
        };
        let all = vec![record("2026-02-a", "A"), record("2026-01-a", "A"), record("2026-01-b", "B")];
        let paths = |records: &[Record]| records.iter().map(|r| r.path.clone()).collect::<Vec<_>>();
        let (new, old) = newest(all);
        assert_eq!(
            (paths(&new), paths(&old)),
            (vec!["2026-02-a".to_owned(), "2026-01-b".to_owned()], vec!["2026-01-a".to_owned()],)
        );
    }
}
