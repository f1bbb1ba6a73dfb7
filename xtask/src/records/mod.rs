//! `records`: the committed records of measurements, which of them are out of date, and the page
//! that is made from them.

mod caveats;
pub mod link;
pub mod page;
pub mod record;
mod stale;

use crate::process;
use anyhow::{Context, Result, bail};
use record::Record;
use std::collections::BTreeMap;
use std::fmt::Write;

pub use stale::lacks_history;

/// Options of `records`.
#[derive(Clone, Debug, Default, clap::Args)]
pub struct Options {
    /// Fail if the README quotes a record that is out of date, of a changed working tree, or of one
    /// run
    #[arg(long)]
    pub check: bool,
    /// Write docs/measurements/README.md from the records, and beside the figures of the README which
    /// records are out of date or of one run
    #[arg(long)]
    pub write: bool,
}

/// Least runs of a record that the README quotes.
const LEAST_RUNS: u32 = 2;

/// A record with what is wrong with it.
#[derive(Clone, Debug)]
struct Judged {
    record: Record,
    /// Why it is out of date; none if it is not.
    stale: Option<String>,
    is_quoted: bool,
}

impl Judged {
    fn is_fit_to_quote(&self) -> bool {
        self.stale.is_none() && !self.record.is_dirty() && self.record.runs() >= LEAST_RUNS
    }

    /// What readers of a quoted figure must know; none if nothing.
    fn caveat(&self) -> Option<String> {
        let is_single = self.record.runs() < LEAST_RUNS;
        let older = self.stale.as_ref().map(|_| caveats::OLDER_CODE);
        let parts = [older, is_single.then_some(caveats::ONE_RUN)];
        let parts: Vec<_> = parts.into_iter().flatten().collect();
        (!parts.is_empty()).then(|| parts.join(caveats::SEPARATOR))
    }
}

/// Lists the records; writes the page; judges what the README quotes.
///
/// # Errors
/// Files cannot be read or written, or `--check` found a record that must not be quoted.
pub fn run(options: &Options) -> Result<()> {
    if options.write {
        write_page()?;
        write_caveats()?;
    }
    show()?;
    let unfit = unfit_quotes()?;
    if options.check && unfit > 0 {
        bail!("records: the README quotes {unfit} records that are out of date, changed, or of one run");
    }
    Ok(())
}

/// Prints the list.
///
/// # Errors
/// Files cannot be read.
pub fn show() -> Result<()> {
    print!("{}", table(&judged()?));
    Ok(())
}

/// How many records the README quotes that are out of date, of a changed working tree, or of fewer
/// than two runs.
///
/// # Errors
/// Files cannot be read.
pub fn unfit_quotes() -> Result<usize> {
    Ok(judged()?.iter().filter(|judged| judged.is_quoted && !judged.is_fit_to_quote()).count())
}

/// Shows the records. The README may quote one that is out of date or of one run only if it says so
/// in the same row: a measurement takes up to an hour on a quiet machine, which not every change has.
///
/// # Errors
/// Rows of the README do not say it, the history lacks the commits of the records, or files cannot be
/// read.
pub fn judge() -> Result<()> {
    if let Some(why) = lacks_history() {
        bail!("records: {why}");
    }
    show()?;
    let unfit = unfit_quotes()?;
    println!("records that the README quotes and that are out of date, changed, or of one run: {unfit}");
    let wrong = wrong_caveats()?;
    if wrong > 0 {
        bail!(
            "{wrong} rows of the README do not say whether their record is out of date or of one run; run: \
             cargo xtask records --write"
        );
    }
    Ok(())
}

/// How many rows of the README do not say rightly whether their record is out of date or of one run.
fn wrong_caveats() -> Result<usize> {
    let files = files()?;
    Ok(caveats::wrong_rows(readme(&files)?, &caveats()?))
}

/// The newest records of a measurement, one for each machine.
///
/// # Errors
/// Files cannot be read.
pub fn of(name: &str) -> Result<Vec<Record>> {
    let (records, _) = record::newest(record::all(&files()?));
    Ok(records.into_iter().filter(|record| record.name == name).collect())
}

/// Whether a measurement has a list of what it measures.
#[cfg(test)]
pub fn is_known(name: &str) -> bool {
    stale::measured(name).is_some()
}

/// Writes the page of all records.
///
/// # Errors
/// Files cannot be read or written.
pub fn write_page() -> Result<()> {
    let path = process::root().join(page::PATH);
    std::fs::write(&path, page::text(&files()?))
        .with_context(|| format!("cannot write {}", path.display()))?;
    println!("records: {} written", path.display());
    Ok(())
}

/// Writes the caveats of the quoted records into the README.
fn write_caveats() -> Result<()> {
    let path = process::root().join("README.md");
    let readme = std::fs::read_to_string(&path).context("cannot read README.md")?;
    std::fs::write(&path, caveats::annotated(&readme, &caveats()?)).context("cannot write README.md")
}

fn caveats() -> Result<caveats::Caveats> {
    let caveat = |judged: Judged| Some((judged.record.path.clone(), judged.caveat()?));
    Ok(judged()?.into_iter().filter_map(caveat).collect())
}

/// Records, notes and README as they are in the working tree, new files included.
fn files() -> Result<BTreeMap<String, String>> {
    let mut list = process::command("git");
    list.args([
        "ls-files",
        "-z",
        "--cached",
        "--others",
        "--exclude-standard",
        "--",
        "README.md",
        record::FOLDER,
    ]);
    let list = process::output(list).context("cannot list the records")?;
    let root = process::root();
    let read = |path: &str| Some((path.to_owned(), std::fs::read_to_string(root.join(path)).ok()?));
    Ok(list.split('\0').filter(|path| !path.is_empty()).filter_map(read).collect())
}

fn readme(files: &BTreeMap<String, String>) -> Result<&str> {
    files.get("README.md").map(String::as_str).context("git tracks no README.md here; run it in a clone")
}

fn judged() -> Result<Vec<Judged>> {
    let files = files()?;
    let quoted = quoted(readme(&files)?);
    Ok(record::all(&files)
        .into_iter()
        .map(|record| Judged {
            stale: stale::reason(&record.name, record.commit()),
            is_quoted: quoted.contains(&record.path.as_str()),
            record,
        })
        .collect())
}

/// Paths of the records that links of a text lead to.
fn quoted(text: &str) -> Vec<&str> {
    let targets = text.split("](").skip(1).filter_map(|rest| rest.split([')', ' ']).next());
    targets.filter(|target| target.starts_with(&format!("{}2", record::FOLDER))).collect()
}

fn table(all: &[Judged]) -> String {
    let mut table = String::from("records:\n");
    for Judged { record, stale, is_quoted } in all {
        let mut words = vec![format!("runs: {}", record.runs())];
        words.extend(record.is_dirty().then(|| "UNCOMMITTED CHANGES".into()));
        words.extend(stale.as_ref().map(|why| format!("STALE: {why}")));
        words.extend(is_quoted.then(|| "quoted in the README".into()));
        // Writing to a string cannot fail.
        let _ = writeln!(
            table,
            "  {:<12} {} {:<12} {}: {}",
            record.name,
            record.fact("Date"),
            record.commit(),
            record.fact("CPU"),
            words.join("; ")
        );
    }
    table
}

#[cfg(test)]
mod tests {
    use super::*;

    fn judged(runs: &str, commit: &str, stale: Option<&str>) -> Judged {
        let facts = [("Runs of this commit", runs), ("Commit", commit)];
        let facts = facts.map(|(name, value)| (name.to_owned(), value.to_owned())).into();
        Judged {
            record: Record { facts, ..Record::default() },
            stale: stale.map(str::to_owned),
            is_quoted: true,
        }
    }

    #[test]
    fn only_a_new_clean_and_repeated_record_is_fit_to_quote() {
        assert!(judged("3", "abc", None).is_fit_to_quote());
        for (runs, commit, stale) in
            [("1", "abc", None), ("3", "abc with uncommitted changes", None), ("3", "abc", Some("old"))]
        {
            let judged = judged(runs, commit, stale);
            assert!(!judged.is_fit_to_quote(), "{judged:?}");
        }
        assert_eq!(judged("3", "abc", None).caveat(), None);
        assert_eq!(judged("1", "abc", Some("old")).caveat().as_deref(), Some("older code, one run"));
    }

    #[test]
    fn links_to_records_are_quotes_and_other_links_are_not() {
        let text =
            "| a | 1 | [x](docs/measurements/2026-x/a.md \"row\") |\n[all](docs/measurements/README.md)";
        assert_eq!(quoted(text), ["docs/measurements/2026-x/a.md"]);
    }

    #[test]
    fn the_list_says_what_is_wrong_with_a_record() {
        let text = table(&[judged("1", "abc with uncommitted changes", Some("old"))]);
        assert!(text.contains("runs: 1; UNCOMMITTED CHANGES; STALE: old; quoted"), "{text}");
    }
}
