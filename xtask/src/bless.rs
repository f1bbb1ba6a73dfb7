//! `bless`: rewrites what tests compare with from what the code does now. The diff is for a person
//! to judge.

use crate::process;
use anyhow::{Context, Result};

/// The test binaries that compare with frozen files and know `TOMBOLO_BLESS`.
const FILTER: &str = "binary(/fixtures|pictures/)";

/// Reruns the comparing tests so that they write instead.
///
/// # Errors
/// A test that fails although it was allowed to write.
pub fn run() -> Result<()> {
    let mut tests = process::cargo("nextest run --workspace --no-fail-fast -E");
    tests.arg(FILTER).env("TOMBOLO_BLESS", "1");
    process::run(tests).context("bless: a test fails although it may write; fix it first")?;
    let mut changes = process::command("git");
    changes.args(["status", "--short"]);
    let changes = process::output(changes).context("bless: cannot ask git what changed")?;
    println!("bless: changed files in the working tree (look at the diff before committing):\n{changes}");
    Ok(())
}
