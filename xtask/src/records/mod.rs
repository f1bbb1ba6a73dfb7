//! `records`: the committed records of measurements, which of them are out of date, and the page
//! that is made from them.

pub mod link;
pub mod page;
pub mod quotes;
pub mod record;
pub mod references;
mod stale;

use crate::process;
use anyhow::{Context, Result, bail};
use record::Record;
use std::collections::BTreeMap;
use std::fmt::Write;

pub use stale::{has_code_of, lacks_history};

/// Options of `records`.
#[derive(Clone, Debug, Default, clap::Args)]
pub struct Options {
    /// Fail if the README quotes a record that is out of date, of a changed working tree, or of one
    /// run
    #[arg(long)]
    pub check: bool,
    /// Write docs/measurements/README.md from the records; withdraw the figures of the README whose
    /// record is out of date, of a changed working tree or of one run, and state those of new
    /// records; state figures of documents as the records do that they refer to
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
}

/// Lists the records; writes the page; judges what the README quotes.
///
/// # Errors
/// Files cannot be read or written, or `--check` found a record that must not be quoted.
pub fn run(options: &Options) -> Result<()> {
    if options.write {
        write_page()?;
        correct_quotes()?;
        correct_references()?;
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

/// How many figures of the README are withdrawn until they are measured again.
///
/// # Errors
/// Files cannot be read.
pub fn withdrawn() -> Result<usize> {
    Ok(readme(&files()?)?.lines().filter(|line| quotes::is_withdrawn(line)).count())
}

/// Shows the records. The README may quote none that is out of date, of a changed working tree or
/// of one run: a change of measured code withdraws its figures until they are measured again.
///
/// # Errors
/// A figure of the README is to be withdrawn or stated, the history lacks the commits of the
/// records, or files cannot be read.
pub fn judge() -> Result<()> {
    if let Some(why) = lacks_history() {
        bail!("records: {why}");
    }
    show()?;
    let unfit = unfit_quotes()?;
    println!("records that the README quotes and that are out of date, changed, or of one run: {unfit}");
    println!("figures of the README that are withdrawn until they are measured again: {}", withdrawn()?);
    let files = files()?;
    let judged = judged()?;
    let wrong = quotes::wrong_rows(readme(&files)?, &fit(&judged));
    if wrong > 0 || unfit > 0 {
        bail!(
            "{unfit} records that the README quotes are out of date, changed or of one run, and {wrong} rows \
             of it are to be withdrawn or stated; measure again, or run: cargo xtask records --write"
        );
    }
    Ok(())
}

/// Every record.
///
/// # Errors
/// Files cannot be read.
pub fn all() -> Result<Vec<Record>> {
    Ok(record::all(&files()?))
}

/// The newest record of each measurement on each machine.
///
/// # Errors
/// Files cannot be read.
pub fn newest() -> Result<Vec<Record>> {
    Ok(record::newest(record::all(&files()?)).0)
}

/// The newest records of a measurement that are not out of date, one for each machine.
///
/// # Errors
/// Files cannot be read.
pub fn of(name: &str) -> Result<Vec<Record>> {
    let is_own = |record: &Record| record.name == name && stale::reason(name, record.commit()).is_none();
    Ok(newest()?.into_iter().filter(is_own).collect())
}

/// Whether a measurement has a list of what it measures.
#[cfg(test)]
pub fn is_known(name: &str) -> bool {
    stale::measured(name).is_some()
}

/// Whether a change of a path makes the records of a measurement out of date.
#[cfg(test)]
pub fn measures(name: &str, path: &str) -> bool {
    stale::measured(name)
        .is_some_and(|paths| paths.iter().any(|of| std::path::Path::new(path).starts_with(of)))
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

/// Withdraws and states figures of the README.
fn correct_quotes() -> Result<()> {
    let path = process::root().join("README.md");
    let readme = std::fs::read_to_string(&path).context("cannot read README.md")?;
    let judged = judged()?;
    std::fs::write(&path, quotes::corrected(&readme, &fit(&judged))).context("cannot write README.md")
}

/// States the figures of documents as the records that they name do.
fn correct_references() -> Result<()> {
    let mut list = process::command("git");
    list.args(["ls-files", "-z", "--", "*.md"]);
    let list = process::output(list).context("cannot list the documents")?;
    let records = record::all(&files()?);
    for path in list.split('\0').filter(|path| !path.is_empty()) {
        let file = process::root().join(path);
        let Ok(text) = std::fs::read_to_string(&file) else { continue };
        let corrected = references::corrected(path, &text, &records);
        if corrected != text {
            std::fs::write(&file, corrected).with_context(|| format!("cannot write {path}"))?;
        }
    }
    Ok(())
}

/// The records that the README may quote.
fn fit(judged: &[Judged]) -> Vec<&Record> {
    judged.iter().filter(|judged| judged.is_fit_to_quote()).map(|judged| &judged.record).collect()
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
    let quoted = quotes::quoted(readme(&files)?);
    Ok(record::all(&files)
        .into_iter()
        .map(|record| Judged {
            stale: stale::reason(&record.name, record.commit()),
            is_quoted: quoted.contains(&record.path.as_str()),
            record,
        })
        .collect())
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
    }

    #[test]
    fn the_list_says_what_is_wrong_with_a_record() {
        let text = table(&[judged("1", "abc with uncommitted changes", Some("old"))]);
        assert!(text.contains("runs: 1; UNCOMMITTED CHANGES; STALE: old; quoted"), "{text}");
    }
}
