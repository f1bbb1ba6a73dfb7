//! `advisories`: known vulnerabilities of the dependencies, by a dated snapshot of RustSec's
//! database.
//!
//! The snapshot holds the advisories of the crates in `Cargo.lock` and the names of those crates,
//! so that a crate that came later is an error and not a pass. `cargo deny` judges: the snapshot is
//! unpacked as its database. RustSec's data is CC0-1.0; an advisory that states another licence
//! keeps that statement and its source.

use crate::{machine, process};
use anyhow::{Context, Result, bail};
use std::collections::{BTreeMap, BTreeSet};
use std::fmt::Write;
use std::path::Path;

/// The snapshot, from the root of the repository.
const SNAPSHOT: &str = ".ci/advisories.txt";

/// The folder in which `cargo deny` looks for RustSec's database: its name and a hash of its
/// address.
const FOLDER: &str = "advisory-db-3157b0e258782691";

/// Prefix of the path of an advisory in the snapshot.
const ENTRY: &str = "=== ";

/// Age in days over which a snapshot lacks too many advisories to pass.
const MOST_DAYS: i64 = 180;

/// How to replace a snapshot.
const REGENERATE: &str = "regenerate it: cargo xtask advisories --update PATH, with PATH a clone of \
                      https://github.com/rustsec/advisory-db";

/// Columns of the list of names.
const COLUMNS: usize = 100;

/// An advisory that no version of a crate of this workspace escapes: the control.
const PLANTED: (&str, &str) = (
    "crates/anyhow/RUSTSEC-2000-0001.md",
    "```toml\n[advisory]\nid = \"RUSTSEC-2000-0001\"\npackage = \"anyhow\"\ndate = \"2000-01-01\"\nurl = \
     \"https://example.org\"\n\n[versions]\npatched = [\">= 999.0.0\"]\n```\n\n# Planted by the check\n",
);

/// The advisories of some crates at one commit of the database.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
struct Snapshot {
    /// Of the database.
    commit: String,
    /// Of that commit, `YYYY-MM-DD`.
    date: String,
    /// Crates whose advisories were looked for.
    crates: BTreeSet<String>,
    /// By path, as in the database; without the description.
    advisories: BTreeMap<String, String>,
}

impl Snapshot {
    fn parse(text: &str) -> Result<Self> {
        let (head, rest) = text.split_once(&format!("\n{ENTRY}")).unwrap_or((text, ""));
        let mut snapshot = Self::default();
        for line in head.lines().filter(|line| !line.starts_with('#')) {
            match line.split_once(": ") {
                Some(("commit", commit)) => snapshot.commit = commit.into(),
                Some(("date", date)) => snapshot.date = date.into(),
                _ => snapshot.crates.extend(line.split_whitespace().map(str::to_owned)),
            }
        }
        for entry in rest.split(&format!("\n{ENTRY}")).filter(|entry| !entry.is_empty()) {
            let (path, text) = entry.split_once('\n').context("an advisory of the snapshot is empty")?;
            snapshot.advisories.insert(path.into(), text.into());
        }
        if snapshot.commit.is_empty() || snapshot.date.is_empty() || snapshot.crates.is_empty() {
            bail!("{SNAPSHOT} states no commit, date or crates; regenerate it with --update");
        }
        Ok(snapshot)
    }

    fn text(&self) -> String {
        let mut text = String::from(
            "# RustSec's advisories of the crates in Cargo.lock, without their descriptions, and the names \
             of\n# those crates. Source: https://github.com/rustsec/advisory-db, CC0-1.0; an advisory with \
             a field\n# `license` has that licence. Written by: cargo xtask advisories --update PATH\n",
        );
        // Writing to a string cannot fail.
        let _ = write!(text, "commit: {}\ndate: {}", self.commit, self.date);
        let mut column = COLUMNS;
        for name in &self.crates {
            let gap = if column + 1 + name.len() > COLUMNS { '\n' } else { ' ' };
            column = if gap == '\n' { name.len() } else { column + 1 + name.len() };
            let _ = write!(text, "{gap}{name}");
        }
        for (path, advisory) in &self.advisories {
            let _ = write!(text, "\n{ENTRY}{path}\n{}", advisory.trim_end());
        }
        text.push('\n');
        text
    }
}

/// Crates of a lock file.
fn locked(lock: &str) -> BTreeSet<String> {
    let names = lock.lines().filter_map(|line| line.strip_prefix("name = "));
    names.map(|name| name.trim_matches('"').to_owned()).collect()
}

/// Crates of the lock file that the snapshot does not know.
fn unknown<'a>(snapshot: &'a Snapshot, locked: &'a BTreeSet<String>) -> Vec<&'a str> {
    locked.difference(&snapshot.crates).map(String::as_str).collect()
}

/// Checks every dependency against the snapshot.
///
/// # Errors
/// A vulnerable, unmaintained or yanked version that `deny.toml` does not excuse; a crate that the
/// snapshot does not know; a snapshot that is too old; a control that does not fail.
pub fn check() -> Result<()> {
    let read = |path: &str| {
        std::fs::read_to_string(process::root().join(path)).with_context(|| format!("cannot read {path}"))
    };
    let snapshot = Snapshot::parse(&read(SNAPSHOT)?)?;
    let locked = locked(&read("Cargo.lock")?);
    let unknown = unknown(&snapshot, &locked);
    if !unknown.is_empty() {
        bail!("{SNAPSHOT} does not know {}; {REGENERATE}", unknown.join(", "));
    }
    reject_old(&snapshot, &machine::today()?)?;
    println!(
        "advisories: {} of {} crates, by RustSec's database of {} ({})",
        snapshot.advisories.len(),
        snapshot.crates.len(),
        snapshot.date,
        snapshot.commit
    );
    let folder = process::target().join("advisories");
    let config = folder.join("deny.toml");
    let database = folder.join(FOLDER);
    std::fs::create_dir_all(&folder).with_context(|| format!("cannot create {}", folder.display()))?;
    let own = read("deny.toml")?;
    if own.matches("[advisories]\n").count() != 1 {
        bail!("deny.toml has not one table [advisories]");
    }
    let path = format!("[advisories]\ndb-path = {:?}\n", folder.to_string_lossy());
    std::fs::write(&config, own.replace("[advisories]\n", &path)).context("advisories")?;

    let mut corrupted = snapshot.clone();
    corrupted.advisories.insert(PLANTED.0.into(), PLANTED.1.into());
    unpack(&corrupted, &database)?;
    let mut control = deny(&config);
    control.stdout(std::process::Stdio::null()).stderr(std::process::Stdio::null());
    if process::status(&mut control)?.success() {
        bail!("advisories: a planted vulnerability of a dependency is not found; nothing is checked");
    }
    unpack(&snapshot, &database)?;
    process::run(deny(&config))
}

fn deny(config: &Path) -> std::process::Command {
    let mut deny = process::cargo("deny --offline --config");
    deny.arg(config).args(["check", "advisories"]);
    deny
}

/// Writes a snapshot as a database.
fn unpack(snapshot: &Snapshot, database: &Path) -> Result<()> {
    // An older one may hold other advisories.
    let _ = std::fs::remove_dir_all(database);
    for (path, advisory) in &snapshot.advisories {
        let path = database.join(path);
        let parent = path.parent().unwrap_or(database);
        std::fs::create_dir_all(parent).with_context(|| format!("cannot create {}", parent.display()))?;
        std::fs::write(&path, advisory).with_context(|| format!("cannot write {}", path.display()))?;
    }
    // `cargo deny` asks this file for the time of its last download and reads no other file of git.
    std::fs::create_dir_all(database.join(".git")).context("advisories")?;
    std::fs::write(database.join(".git/FETCH_HEAD"), "").context("advisories")
}

/// Regenerates the snapshot from a clone of the database, bare or not.
///
/// # Errors
/// The clone cannot be read, has no advisories of our crates, or is older than the snapshot.
pub fn update(clone: &Path) -> Result<()> {
    let git = |args: &[&str]| {
        let mut git = process::command("git");
        git.arg("-C").arg(clone).args(args);
        process::output(git).context("advisories: PATH is no clone of the database")
    };
    let lock =
        std::fs::read_to_string(process::root().join("Cargo.lock")).context("cannot read Cargo.lock")?;
    let crates = locked(&lock);
    let all = git(&["ls-tree", "-r", "--name-only", "HEAD", "crates/"])?;
    let of_ours = |path: &&str| path.split('/').nth(1).is_some_and(|name| crates.contains(name));
    let mut advisories = BTreeMap::new();
    for path in all.lines().filter(of_ours) {
        let text = git(&["show", &format!("HEAD:{path}")])?;
        advisories.insert(path.to_owned(), without_description(&text));
    }
    if advisories.is_empty() {
        bail!("advisories: {} has none of the crates in Cargo.lock", clone.display());
    }
    let snapshot = Snapshot {
        commit: git(&["rev-parse", "HEAD"])?.trim().into(),
        date: git(&["log", "-1", "--format=%cs"])?.trim().into(),
        crates,
        advisories,
    };
    let path = process::root().join(SNAPSHOT);
    let present = std::fs::read_to_string(&path).ok().and_then(|text| Snapshot::parse(&text).ok());
    if let Some(present) = present {
        reject_older(&snapshot, &present)?;
    }
    std::fs::write(&path, snapshot.text()).with_context(|| format!("cannot write {}", path.display()))?;
    println!("advisories: {} written, {} advisories", path.display(), snapshot.advisories.len());
    Ok(())
}

/// A snapshot that was not regenerated for long passes whatever was found since.
fn reject_old(snapshot: &Snapshot, today: &str) -> Result<()> {
    let day = |date: &str| day_number(date).with_context(|| format!("`{date}` is no date YYYY-MM-DD"));
    let age = day(today)? - day(&snapshot.date)?;
    if age > MOST_DAYS {
        bail!("{SNAPSHOT} is of {}, {age} days old, at most {MOST_DAYS}; {REGENERATE}", snapshot.date);
    }
    Ok(())
}

/// The number of a day, counted from any fixed one, of a date `YYYY-MM-DD`. The formula is
/// `days_from_civil` of Howard Hinnant, "chrono-Compatible Low-Level Date Algorithms" (2013).
fn day_number(date: &str) -> Option<i64> {
    let numbers = date.split('-').map(|part| part.parse().ok()).collect::<Option<Vec<i64>>>()?;
    let [year, month @ 1..=12, day @ 1..=31] = numbers[..] else { return None };
    // A year that begins in March has the day of leap years at its end.
    let (year, month) = if month > 2 { (year, month - 3) } else { (year - 1, month + 9) };
    Some(365 * year + year / 4 - year / 100 + year / 400 + (153 * month + 2) / 5 + day)
}

/// An older database lacks advisories that the present snapshot has.
fn reject_older(new: &Snapshot, present: &Snapshot) -> Result<()> {
    // Dates are `YYYY-MM-DD`: their order is that of the text.
    if new.date < present.date {
        bail!(
            "advisories: the clone is of {}, {SNAPSHOT} of {}; pull the clone, or remove the snapshot to \
             go back",
            new.date,
            present.date
        );
    }
    Ok(())
}

/// The fields and the title of an advisory.
fn without_description(advisory: &str) -> String {
    let mut is_closed = false;
    let mut kept = String::new();
    for line in advisory.lines() {
        kept.push_str(line);
        kept.push('\n');
        is_closed |= line == "```";
        if is_closed && line.starts_with("# ") {
            break;
        }
    }
    kept
}

#[cfg(test)]
mod tests {
    use super::*;

    fn snapshot() -> Snapshot {
        let advisory = "```toml\n# a comment\nid = 1\n```\n\n# Title";
        Snapshot {
            commit: "abc".into(),
            date: "2026-01-02".into(),
            crates: (0..50).map(|number| format!("crate-{number}")).collect(),
            advisories: [("crates/a/R-1.md", advisory), ("crates/b/R-2.md", advisory)]
                .map(|(path, text)| (path.into(), text.into()))
                .into(),
        }
    }

    #[test]
    fn a_snapshot_is_read_as_it_was_written() {
        let text = snapshot().text();
        let mut read = Snapshot::parse(&text).unwrap();
        read.advisories.values_mut().for_each(|text| *text = text.trim_end().into());
        assert_eq!(read, snapshot());
        assert!(text.lines().all(|line| line.len() <= COLUMNS), "{text}");
        assert!(Snapshot::parse("").is_err() && Snapshot::parse("commit: a\ndate: b\n").is_err());
    }

    #[test]
    fn an_older_database_replaces_no_snapshot() {
        let of = |date: &str| Snapshot { date: date.into(), ..snapshot() };
        assert!(reject_older(&of("2026-01-01"), &of("2026-01-02")).is_err());
        assert!(reject_older(&of("2025-12-31"), &of("2026-01-02")).is_err());
        assert!(reject_older(&of("2026-01-02"), &of("2026-01-02")).is_ok());
        assert!(reject_older(&of("2026-02-01"), &of("2026-01-02")).is_ok());
    }

    #[test]
    fn a_snapshot_passes_for_180_days_and_then_no_more() {
        for (today, is_accepted) in [
            ("2026-01-02", true),
            ("2026-07-01", true),
            ("2026-07-02", false),
            ("2027-01-02", false),
            // A clock that is slow.
            ("2025-12-31", true),
            ("soon", false),
        ] {
            assert_eq!(reject_old(&snapshot(), today).is_ok(), is_accepted, "{today}");
        }
        let undated = Snapshot { date: "2026-13-01".into(), ..snapshot() };
        assert!(reject_old(&undated, "2026-01-02").is_err());
    }

    #[test]
    fn days_are_counted_over_months_and_leap_years() {
        let between = |one, other| day_number(other).unwrap() - day_number(one).unwrap();
        assert_eq!(between("2026-08-21", "2027-02-17"), 180);
        assert_eq!(between("2027-12-31", "2028-03-01"), 61);
        assert_eq!(between("2026-12-31", "2027-03-01"), 60);
        assert_eq!(between("2000-01-01", "2400-01-01"), 146_097);
        for wrong in ["", "2026", "2026-00-01", "2026-01-32", "2026-1-1-1", "2026-x-1"] {
            assert_eq!(day_number(wrong), None, "{wrong}");
        }
    }

    #[test]
    fn a_crate_that_came_after_the_snapshot_is_unknown() {
        let lock = "[[package]]\nname = \"crate-3\"\nversion = \"1\"\n\n[[package]]\nname = \"new\"\n";
        assert_eq!(unknown(&snapshot(), &locked(lock)), ["new"]);
    }

    #[test]
    fn a_title_ends_what_is_kept_and_a_comment_in_the_fields_does_not() {
        let advisory = "```toml\n# a comment\nid = 1\n```\n\n# Title\n\nLong text\n";
        assert_eq!(without_description(advisory), "```toml\n# a comment\nid = 1\n```\n\n# Title\n");
    }
}
