//! The executions of earlier runs, which count while the code that they called is the same.

use super::{COMMON, FAULTS, SERVER, TARGETS, row};
use crate::measure::runs::{FILE, Runs};
use crate::process;
use crate::records;
use crate::records::record::{DATE, FOLDER};
use anyhow::{Context, Result};
use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::Path;

/// Name of the measurement in `runs.csv`.
const NAME: &str = "fuzz";

/// What earlier runs on any machine have found.
#[derive(Clone, Debug, Default)]
pub struct Earlier {
    /// Executions by their targets.
    pub executions: BTreeMap<&'static str, f64>,
    /// Targets with a fault that no change of the code can have removed.
    pub faults: f64,
}

/// Reads the earlier runs.
///
/// # Errors
/// A file of runs cannot be read.
pub fn read() -> Result<Earlier> {
    let runs = by_commit(&process::root().join(FOLDER))?;
    let mut executions = BTreeMap::new();
    for target in TARGETS {
        let code: Vec<_> = COMMON.iter().chain(target.code).copied().collect();
        let is_same = |commit: &str| records::has_code_of(&code, commit);
        if let Some(executed) = executed(target.name, &runs, is_same) {
            executions.insert(target.name, executed);
        }
    }
    let all: Vec<_> = COMMON.iter().chain(SERVER).chain(&["client", "shaders"]).copied().collect();
    let faults = faults(&runs, |commit| records::has_code_of(&all, commit));
    Ok(Earlier { executions, faults })
}

/// The most targets with a fault in a run of the same code.
fn faults(runs: &[(String, Runs)], is_same: impl Fn(&str) -> bool) -> f64 {
    let same = runs.iter().filter(|(commit, _)| is_same(commit));
    same.flat_map(|(_, runs)| runs.of(FAULTS).figures).fold(0.0, f64::max)
}

/// The executions of a target in the run with most of those of the same code: each run has those
/// of the runs before it. A commit with a fault, or without the planted one, counts for nothing.
fn executed(target: &str, runs: &[(String, Runs)], is_same: impl Fn(&str) -> bool) -> Option<f64> {
    let is_faulty = |runs: &Runs| runs.of(FAULTS).figures.iter().any(|faults| *faults != 0.0);
    let faulty: BTreeSet<_> =
        runs.iter().filter(|(_, runs)| is_faulty(runs)).map(|(commit, _)| commit).collect();
    let counts = |commit: &String| !faulty.contains(commit) && is_same(commit);
    let counted = runs.iter().filter(|(commit, _)| counts(commit));
    let executed = counted.flat_map(|(_, runs)| runs.of(&row(target)).figures);
    executed.filter(|executions| executions.is_finite()).max_by(f64::total_cmp)
}

/// The runs on all days, by their commits and machines.
fn by_commit(days: &Path) -> Result<Vec<(String, Runs)>> {
    let mut of = BTreeSet::new();
    for day in fs::read_dir(days).with_context(|| format!("cannot read {}", days.display()))? {
        let day = day?;
        let (name, file) = (day.file_name(), day.path().join(FILE));
        let Some(machine) = name.to_str().and_then(|name| name.get(DATE..)) else { continue };
        if !file.exists() {
            continue;
        }
        let text = fs::read_to_string(&file).with_context(|| format!("cannot read {}", file.display()))?;
        let commits =
            text.lines().filter_map(|line| line.strip_prefix(NAME)?.strip_prefix(',')?.split(',').next());
        of.extend(commits.map(|commit| (machine.to_owned(), commit.to_owned())));
    }
    let mut runs = Vec::new();
    for (machine, commit) in of {
        runs.push((commit.clone(), Runs::of_machine(days, &machine, NAME, Some(&commit))?));
    }
    Ok(runs)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::measure::runs;
    use crate::source::Files;
    use crate::source::circles::imported;
    use bars::Bar;

    #[test]
    fn executions_of_earlier_runs_of_the_same_code_count_unless_a_fault_was_found() {
        let folder = std::env::temp_dir().join(format!("tombolo-fuzz-runs-{}", std::process::id()));
        let add = |machine: &str, commit: &str, executions, faults| {
            let day = folder.join("2026-01-02-".to_owned() + machine);
            fs::create_dir_all(&day).unwrap();
            let rows = [Bar::at_least(row("chunk"), executions, "", 100.0), Bar::none(FAULTS, faults)];
            runs::append(&day.join(FILE), NAME, commit, &rows).unwrap();
        };
        add("x", "a", Some(30.0), Some(0.0));
        add("x", "a", Some(50.0), Some(0.0));
        add("x", "b", None, Some(0.0));
        add("y", "a", Some(55.0), Some(0.0));
        add("x", "other", Some(90.0), Some(0.0));
        let before = |is_same: fn(&str) -> bool| executed("chunk", &by_commit(&folder).unwrap(), is_same);
        assert_eq!(before(|commit| commit != "other"), Some(55.0));
        assert_eq!(before(|_| true), Some(90.0));
        assert_eq!(before(|_| false), None);
        add("x", "a", Some(60.0), Some(1.0));
        assert_eq!(before(|commit| commit != "other"), None, "a fault, whatever the machine");
        let runs = by_commit(&folder).unwrap();
        assert_eq!(
            [faults(&runs, |commit| commit == "a"), faults(&runs, |commit| commit == "b")],
            [1.0, 0.0]
        );
        add("x", "other", Some(95.0), None);
        assert_eq!(before(|_| true), None, "the planted fault was not found");
        fs::remove_dir_all(folder).unwrap();
    }

    #[test]
    fn the_code_of_every_target_exists_and_makes_its_record_stale() {
        for target in TARGETS {
            for path in COMMON.iter().chain(target.code) {
                let excluded = path.strip_prefix(":(exclude)");
                assert!(process::root().join(excluded.unwrap_or(path)).exists(), "{path}");
                assert!(excluded.is_some() || records::measures("fuzz", path), "{path}");
            }
        }
    }

    #[test]
    fn the_code_of_a_target_imports_no_other_file_of_the_server() {
        let files = Files::tracked().unwrap();
        let outside = |code: &[&str]| {
            let is_listed = |file: &str| code.iter().any(|path| file.starts_with(path));
            imported(&files, |file| file.starts_with("server/") && is_listed(file))
                .into_iter()
                .filter(|file| !is_listed(file))
                .count()
        };
        for target in TARGETS {
            assert_eq!(outside(target.code), 0, "{}", target.name);
        }
        assert_ne!(outside(&["server/src/websocket/socket.rs"]), 0, "the control");
    }
}
