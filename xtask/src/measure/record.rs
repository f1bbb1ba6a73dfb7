//! The dated record of a measurement: what it ran on, the command, the figures.

use super::runs::{self, Runs};
use crate::records::record::FOLDER;
use crate::{machine, process};
use anyhow::{Context, Result};
use bars::{Bar, Figure};
use std::collections::BTreeMap;
use std::fmt::Write;
use std::path::{Path, PathBuf};

/// What a record holds apart from the rows.
#[derive(Clone, Debug)]
pub struct Heading<'a> {
    /// Name of the measurement, also the file's.
    pub name: &'a str,
    /// Name of the GPU and its backend, as the viewer reports them.
    pub adapter: Option<&'a str>,
    /// Sentences on how the figures were measured.
    pub notes: &'a [String],
}

/// Writes the record and returns its path.
///
/// From a clean commit the run is appended to `docs/measurements/<date>-<machine>/runs.csv`, and
/// the record `<name>.md` beside it shows the median of the runs of that commit on this machine, on
/// any day, and beside it how often runs of all commits kept the bar. From a working tree that was
/// changed, at the start of the run (`begun`) or since, a draft is written under `target/measure`,
/// which no document may quote.
///
/// # Errors
/// The date is not known or a file cannot be written.
pub fn write(heading: &Heading<'_>, rows: &[Bar], begun: &machine::Commit) -> Result<PathBuf> {
    let rows = &distinct(rows);
    let machine = machine::Machine::here();
    let date = machine::today()?;
    let commit = begun.until(machine::commit());
    let days = process::root().join(FOLDER);
    let folder = if commit.is_clean {
        days.join(format!("{date}-{}", machine.slug()))
    } else {
        process::target().join("measure/drafts")
    };
    std::fs::create_dir_all(&folder).with_context(|| format!("cannot create {}", folder.display()))?;
    let runs = if commit.is_clean {
        let path = folder.join(runs::FILE);
        runs::append(&path, heading.name, &commit.hash, rows)
            .with_context(|| format!("cannot append to {}", path.display()))?;
        let of = |commit| Runs::of_machine(&days, &machine.slug(), heading.name, commit);
        of(Some(&commit.hash))
            .and_then(|runs| Ok((runs, of(None)?)))
            .with_context(|| format!("cannot read the runs in {}", days.display()))?
    } else {
        println!(
            "measure: the working tree differs from its commit, or did so in the run; this record is a draft"
        );
        Default::default()
    };
    let path = folder.join(heading.name).with_extension("md");
    let command = format!("cargo xtask measure {}", heading.name);
    let text =
        page(heading, rows, (&runs.0, &runs.1), &Origin { machine, date, commit: commit.clone(), command });
    std::fs::write(&path, text).with_context(|| format!("cannot write {}", path.display()))?;
    if commit.is_clean {
        crate::records::write_page()?;
    }
    Ok(path)
}

/// Appends a run that ended without figures to the `runs.csv` of the day. Nothing is written for a
/// changed working tree.
///
/// # Errors
/// A file cannot be written.
pub fn write_failed(name: &str, begun: &machine::Commit) -> Result<()> {
    let commit = begun.until(machine::commit());
    if !commit.is_clean {
        return Ok(());
    }
    let day = format!("{}-{}", machine::today()?, machine::Machine::here().slug());
    let folder = process::root().join(FOLDER).join(day);
    std::fs::create_dir_all(&folder).with_context(|| format!("cannot create {}", folder.display()))?;
    let path = folder.join(runs::FILE);
    runs::append_failed(&path, name, &commit.hash)
        .with_context(|| format!("cannot append to {}", path.display()))
}

/// Where, when and of what the figures are.
#[derive(Clone, Debug)]
pub struct Origin {
    /// The machine that measured.
    pub machine: machine::Machine,
    /// `YYYY-MM-DD`.
    pub date: String,
    /// The commit of the programs.
    pub commit: machine::Commit,
    /// What a reader runs to repeat it.
    pub command: String,
}

/// Appends a run that another machine took to `runs.csv` in a folder, writes the record of that run
/// beside it, and returns its path.
///
/// # Errors
/// A file cannot be written.
pub fn write_foreign(folder: &Path, heading: &Heading<'_>, rows: &[Bar], origin: &Origin) -> Result<PathBuf> {
    let rows = &distinct(rows);
    let csv = folder.join(runs::FILE);
    runs::append(&csv, heading.name, &origin.commit.hash, rows)
        .with_context(|| format!("cannot append to {}", csv.display()))?;
    let path = folder.join(heading.name).with_extension("md");
    // One run has neither a range nor a median.
    let none = Runs::default();
    std::fs::write(&path, page(heading, rows, (&none, &none), origin))
        .with_context(|| format!("cannot write {}", path.display()))?;
    Ok(path)
}

/// The rows with a number behind a name that an earlier row has: figures of a name are taken for
/// runs of one row.
fn distinct(rows: &[Bar]) -> Vec<Bar> {
    let mut seen = BTreeMap::<&str, usize>::new();
    let mut numbered = rows.to_vec();
    for (row, new) in rows.iter().zip(&mut numbered) {
        let count = seen.entry(&row.name).or_default();
        *count += 1;
        if *count > 1 {
            println!("measure: {count} rows are named `{}`", row.name);
            new.name = format!("{} ({count})", row.name);
        }
    }
    numbered
}

/// The record of the runs of a commit, beside those of all commits.
fn page(heading: &Heading<'_>, rows: &[Bar], (runs, all): (&Runs, &Runs), origin: &Origin) -> String {
    let Origin { machine, date, commit, command } = origin;
    let memory = machine.memory_mib.map_or("unknown".into(), |mib| format!("{mib} MiB"));
    let draft = if commit.is_clean { "" } else { " with uncommitted changes: a draft" };
    let facts = [
        ("Date", date.clone()),
        ("Commit", format!("{}{draft}", commit.hash)),
        ("CPU", format!("{}, {} cores", machine.cpu, machine.cores)),
        ("Memory", memory),
        ("System", machine.os.clone()),
        ("GPU", heading.adapter.unwrap_or("none").into()),
        ("Command", format!("`{command}`")),
        ("Runs of this commit", runs.count().max(1).to_string()),
    ];
    let failed = (runs.failed() > 0).then(|| ("Runs without figures", runs.failed().to_string()));
    let mut page = format!("# {}\n\n| | |\n| --- | --- |\n", heading.name);
    // Writing to a string cannot fail.
    for (name, value) in facts.into_iter().chain(failed) {
        let _ = writeln!(page, "| {name} | {} |", cell(&value));
    }
    page.push_str("\n| what | median | bar | | range | kept |\n| --- | ---: | --- | --- | --- | --- |\n");
    for row in rows {
        let spread = runs.of(&row.name);
        let (figure, range, kept) = match (&row.figure, spread.figures.as_slice()) {
            (Figure::NotMeasured { .. }, figures) if figures.iter().all(|figure| figure.is_nan()) => {
                (row.figure.clone(), String::new(), String::new())
            }
            // A run that failed before this row: it cannot be outvoted by the others.
            (_, figures) if figures.len() < runs.count() && runs.count() > 1 => {
                (Figure::Missing, spread.range(), format!("{} of {}", spread.kept, runs.count()))
            }
            (figure, [] | [_]) => {
                (figure.clone(), String::new(), format!("{} of 1", u32::from(row.is_met())))
            }
            // A run without a figure leaves none: it cannot be outvoted.
            (_, figures) => (
                spread.median(row.limit).into(),
                spread.range(),
                format!("{} of {}", spread.kept, figures.len()),
            ),
        };
        let of_all = all.of(&row.name);
        let is_not_measured = kept.is_empty() && of_all.figures.iter().all(|figure| figure.is_nan());
        let in_all = (of_all.figures.len() > spread.figures.len().max(1) && !is_not_measured)
            .then(|| format!("all commits: {} of {}", of_all.kept, of_all.figures.len()));
        let kept = [Some(kept).filter(|kept| !kept.is_empty()), in_all];
        let kept = kept.into_iter().flatten().collect::<Vec<_>>().join("; ");
        let median = Bar { figure, ..row.clone() };
        let _ = writeln!(page, "| {} | {} | {range} | {kept} |", cell(&row.name), median.cells().join(" | "));
    }
    // Some measurements have their rows' definitions among their notes already.
    let has_note = |row: &Bar| heading.notes.iter().any(|note| note.starts_with(&format!("{}: ", row.name)));
    let defined = rows.iter().filter(|row| !has_note(row));
    let defined = defined.filter_map(|row| Some(format!("{}: {}", row.name, row.note.as_ref()?)));
    let notes: Vec<_> = defined.chain(heading.notes.iter().cloned()).collect();
    if !notes.is_empty() {
        page.push('\n');
        for note in notes {
            let _ = writeln!(page, "- {}", note.replace('\n', " "));
        }
    }
    page
}

/// A value that cannot break the table.
fn cell(text: &str) -> String {
    text.replace('|', "/").replace('\n', " ")
}

#[cfg(test)]
mod tests {
    use super::*;
    use bars::Limit;

    #[test]
    fn the_figure_is_the_median_of_all_runs_and_missing_if_one_run_has_none() {
        let machine = machine::Machine { cpu: "CPU".into(), cores: 2, memory_mib: None, os: "OS".into() };
        let commit = machine::Commit { hash: "abc".into(), is_clean: true };
        let origin =
            Origin { machine, date: "2026-01-02".into(), commit, command: "cargo xtask measure x".into() };
        let heading = Heading { name: "x", adapter: None, notes: &[] };
        let rows = [
            Bar::new("time", Some(1.0), "s", Limit::Under(3.0)),
            Bar::under("on a GPU", None, "ms", 2.0).not_measured_if(true, "needs a GPU"),
        ];
        let days = std::env::temp_dir().join(format!("tombolo-record-{}", std::process::id()));
        let _ = std::fs::remove_dir_all(&days);
        std::fs::create_dir_all(days.join("2026-01-02-cpu")).unwrap();
        let mut pages = Vec::new();
        let all =
            |figure: Option<f64>| vec![Bar { figure: figure.into(), ..rows[0].clone() }, rows[1].clone()];
        let failed = vec![rows[1].clone()];
        runs::append_failed(&days.join("2026-01-02-cpu").join(runs::FILE), "x", "abc").unwrap();
        for run in [all(Some(1.0)), all(Some(2.5)), all(Some(9.0)), all(None), failed] {
            runs::append(&days.join("2026-01-02-cpu").join(runs::FILE), "x", "abc", &run).unwrap();
            let runs = Runs::of_machine(&days, "cpu", "x", Some("abc")).unwrap();
            pages.push(page(&heading, &rows, (&runs, &runs), &origin));
        }
        std::fs::remove_dir_all(&days).unwrap();
        assert!(pages[2].contains("| Runs of this commit | 3 |"), "{}", pages[2]);
        assert!(pages[2].contains("| Runs without figures | 1 |"), "{}", pages[2]);
        assert!(
            pages[2].contains("| time | 2.500 s | under 3 s | ok | 1.000 to 9.000 | 2 of 3 |"),
            "{}",
            pages[2]
        );
        assert!(
            pages[3].contains("| time | missing | under 3 s | MISSED | 1.000 to 9.000 | 2 of 4 |"),
            "{}",
            pages[3]
        );
        assert!(
            pages[4].contains("| time | missing | under 3 s | MISSED | 1.000 to 9.000 | 2 of 5 |"),
            "{}",
            pages[4]
        );
        assert!(
            pages[3].contains("| on a GPU | not measured | under 2 ms | needs a GPU |  |  |"),
            "{}",
            pages[3]
        );
    }

    #[test]
    fn a_row_without_figures_has_no_range_and_one_that_is_not_measured_no_count() {
        let machine = machine::Machine { cpu: "CPU".into(), cores: 2, memory_mib: None, os: "OS".into() };
        let commit = machine::Commit { hash: "abc".into(), is_clean: true };
        let origin =
            Origin { machine, date: "2026-01-02".into(), commit, command: "cargo xtask measure x".into() };
        let heading = Heading { name: "x", adapter: None, notes: &[] };
        let rows = [
            Bar::new("time", Some(1.0), "s", Limit::Under(3.0)),
            Bar::new("size", None, "MiB", Limit::Under(3.0)),
            Bar::under("on a GPU", None, "ms", 2.0).not_measured_if(true, "needs a GPU"),
        ];
        let days = std::env::temp_dir().join(format!("tombolo-record-none-{}", std::process::id()));
        let _ = std::fs::remove_dir_all(&days);
        std::fs::create_dir_all(days.join("2026-01-02-cpu")).unwrap();
        for commit in ["earlier", "abc", "abc"] {
            runs::append(&days.join("2026-01-02-cpu").join(runs::FILE), "x", commit, &rows).unwrap();
        }
        let of = |commit| Runs::of_machine(&days, "cpu", "x", commit).unwrap();
        let page = page(&heading, &rows, (&of(Some("abc")), &of(None)), &origin);
        std::fs::remove_dir_all(&days).unwrap();
        for line in [
            "| time | 1 s | under 3 s | ok | 1.000 to 1.000 | 2 of 2; all commits: 3 of 3 |",
            "| size | missing | under 3 MiB | MISSED |  | 0 of 2; all commits: 0 of 3 |",
            "| on a GPU | not measured | under 2 ms | needs a GPU |  |  |",
        ] {
            assert!(page.contains(line), "{page}");
        }
    }

    #[test]
    fn rows_with_one_name_are_kept_apart() {
        let row = |name: &str| Bar::reported(name, Some(1.0), "");
        let names: Vec<_> = distinct(&[row("a"), row("b"), row("a"), row("a")]);
        let names: Vec<_> = names.into_iter().map(|row| row.name).collect();
        assert_eq!(names, ["a", "b", "a (2)", "a (3)"]);
    }

    #[test]
    fn a_page_names_machine_commit_command_and_every_row() {
        let machine =
            machine::Machine { cpu: "Some | CPU".into(), cores: 2, memory_mib: Some(4096), os: "OS".into() };
        let rows = [
            Bar::new("cold", Some(1.5), "s", Limit::Under(3.0)).with_note("until all chunks are there"),
            Bar::new("lost", None, "", Limit::AtMost(0.0)),
        ];
        let notes = ["worst of three".into()];
        let heading = Heading { name: "end-to-end", adapter: Some("soft"), notes: &notes };
        let commit = machine::Commit { hash: "abc".into(), is_clean: true };
        let origin = Origin {
            machine,
            date: "2026-01-02".into(),
            commit,
            command: "cargo xtask measure end-to-end".into(),
        };
        let page = page(&heading, &rows, (&Runs::default(), &Runs::default()), &origin);
        assert!(!page.contains("draft"));
        for part in [
            "Some / CPU, 2 cores",
            "4096 MiB",
            "soft",
            "abc",
            "`cargo xtask measure end-to-end`",
            "| cold | 1.500 s | under 3 s | ok |  | 1 of 1 |",
            "| lost | missing | at most 0 | MISSED |  | 0 of 1 |",
            "- worst of three",
            "- cold: until all chunks are there",
        ] {
            assert!(page.contains(part), "{part} is not in:\n{page}");
        }
    }
}
