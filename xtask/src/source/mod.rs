//! Checks of the source text: columns, words, names in documents, import circles, repeats.
//!
//! `cargo ci` runs every check that must find nothing; `cargo xtask measure code` also counts.
//! Each check is a pure function over [`Files`], so that its tests can plant what it must find.

pub mod circles;
pub mod code_map;
pub mod columns;
pub mod figures;
pub mod lines;
pub mod names;
pub mod repeats;
pub mod words;

use crate::process;
use crate::records;
use anyhow::{Context, Result, bail};
use std::collections::BTreeMap;

/// Text files of the repository by their path from its root.
#[derive(Clone, Debug, Default)]
pub struct Files(pub BTreeMap<String, String>);

impl Files {
    /// The files that git tracks, as they are in the working tree. Files that are not UTF-8 are
    /// left out.
    ///
    /// # Errors
    /// Git cannot list them.
    pub fn tracked() -> Result<Self> {
        let mut list = process::command("git");
        list.args(["ls-files", "-z"]);
        let list = process::output(list).context("cannot list the tracked files")?;
        let root = process::root();
        let read = |path: &str| std::fs::read_to_string(root.join(path)).ok();
        let paths = list.split('\0').filter(|path| !path.is_empty());
        let files = Self(paths.filter_map(|path| Some((path.to_owned(), read(path)?))).collect());
        // A copy of the files in another repository has none: no check would look at anything.
        if files.with_extension(&["rs"]).count() == 0 || !files.0.contains_key("README.md") {
            bail!("git tracks no source file in {}; run it in a clone", root.display());
        }
        Ok(files)
    }

    /// Files with one of these extensions.
    pub fn with_extension<'a>(&'a self, extensions: &'a [&str]) -> impl Iterator<Item = (&'a str, &'a str)> {
        self.0.iter().map(|(path, text)| (path.as_str(), text.as_str())).filter(|(path, _)| {
            extensions.iter().any(|extension| path.rsplit_once('.').is_some_and(|(_, ext)| ext == *extension))
        })
    }

    #[cfg(test)]
    pub fn of(files: &[(&str, &str)]) -> Self {
        Self(files.iter().map(|(path, text)| ((*path).to_owned(), (*text).to_owned())).collect())
    }
}

/// Something that a check found.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Finding {
    /// Path from the root of the repository.
    pub path: String,
    /// Line, from 1.
    pub line: usize,
    /// The error.
    pub what: String,
}

/// A check that must find nothing.
type Check = fn(&Files) -> Vec<Finding>;

/// Checks that must find nothing, with their names.
pub const CHECKS: [(&str, Check); 9] = [
    ("lines over the limit", columns::check),
    ("retired words", words::check),
    ("names in documents that do not exist", names::check),
    ("import circles between files", circles::check),
    ("modules that the code map lacks", code_map::check),
    ("length of the README", lines::check_readme),
    ("figures of the README that differ from their records", figures::check),
    ("figures of documents that differ from their records", documents),
    ("page of the measurements that differs from the records", measurements),
];

/// Figures of documents that refer to rows of records.
fn documents(files: &Files) -> Vec<Finding> {
    let records = records::record::all(&files.0);
    let of = |(path, text): (&str, &str)| {
        let faults = records::references::faults(path, text, &records).into_iter();
        faults
            .map(|fault| Finding { path: path.into(), line: fault.line, what: fault.what })
            .collect::<Vec<_>>()
    };
    files.with_extension(&["md"]).flat_map(of).collect()
}

/// The page of all records against the records.
fn measurements(files: &Files) -> Vec<Finding> {
    let faults = records::page::faults(&files.0);
    faults.into_iter().map(|(path, what)| Finding { path, line: 1, what }).collect()
}

/// Runs every check.
///
/// # Errors
/// The findings, at most 30 a check.
pub fn run() -> Result<()> {
    let files = Files::tracked()?;
    let mut total = 0;
    for (name, check) in CHECKS {
        let found = check(&files);
        println!("{name}: {}", found.len());
        for finding in found.iter().take(30) {
            println!("  {}:{}: {}", finding.path, finding.line, finding.what);
        }
        total += found.len();
    }
    if total > 0 {
        bail!("{total} findings in the source text");
    }
    Ok(())
}
