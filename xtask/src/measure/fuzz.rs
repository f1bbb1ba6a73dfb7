//! `fuzz`: every decoder under libFuzzer, a search by coverage.
//!
//! The targets are those of the package `fuzz`, built by cargo-fuzz. They start from the valid
//! inputs of `entry-points` and from what earlier runs left in `target/fuzz/corpus`: what one run
//! found, the next need not find again. Many hours; `TOMBOLO_FUZZ_TARGETS` selects targets by their
//! names, with commas between them, and `TOMBOLO_FUZZ_SECONDS` limits each one's time. A run adds
//! its executions to those that `runs.csv` has of the same code, so that several short runs make a
//! whole one. What falls short of the executions misses its bar.

mod earlier;

use super::run::Run;
use crate::process;
use anyhow::{Context, Result, bail};
use bars::Bar;
use earlier::Earlier;
use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};
use std::sync::Mutex;

/// Executions of a target that reads one message, connection, file or view.
const EXECUTIONS: u64 = 100_000_000;

/// Executions of a target that passes a whole session: hundreds of times the work of one message,
/// whose decoders have targets of their own.
const SESSIONS: u64 = 1_000_000;

/// Executions of a target whose input is a file on the disk.
const FILES: u64 = 10_000_000;

/// An entry point.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Target {
    name: &'static str,
    /// Executions that its bar requires.
    executions: u64,
    /// The code that it calls beside [`COMMON`], and what of that it does not: pathspecs of git.
    code: &'static [&'static str],
}

/// The code that all targets call. Versions of dependencies do not count, as in all measurements.
const COMMON: [&str; 6] =
    ["terrain", "protocol", "entry-points", "fuzz", ":(exclude)fuzz/Cargo.lock", "rust-toolchain.toml"];

/// The server's side of a session, which targets of one message or of a client do not call.
const NO_SERVER: &[&str] = &[":(exclude)protocol/src/server", ":(exclude)protocol/src/server.rs"];

const SERVER: &[&str] = &["server"];

/// Files of the server that import no others of it.
const WEBSOCKET: &[&str] = &[
    "server/src/websocket/close.rs",
    "server/src/websocket/frame.rs",
    "server/src/websocket/inbox.rs",
    "server/src/websocket/utf8.rs",
];
const PROXY: &[&str] = &["server/src/proxy", "server/src/traces/parent.rs"];
const ADDRESS: &[&str] = &["server/src/store/address.rs", "server/src/store/folder.rs"];
const PACK: &[&str] = &["server/src/chunk_id.rs", "server/src/store/pack.rs", "server/src/store/tile.rs"];
const TOKENS: &[&str] = &["server/src/access/tokens.rs"];

const CLIENT: &[&str] = &["client", "shaders", NO_SERVER[0], NO_SERVER[1]];

/// The targets. The slowest ones come first, so that no core waits for them at the end.
const TARGETS: [Target; 12] = [
    Target { name: "configuration", executions: EXECUTIONS, code: SERVER },
    Target { name: "client_session", executions: SESSIONS, code: NO_SERVER },
    Target { name: "chunk", executions: EXECUTIONS, code: NO_SERVER },
    Target { name: "http", executions: EXECUTIONS, code: SERVER },
    Target { name: "tokens", executions: FILES, code: TOKENS },
    Target { name: "uniforms", executions: EXECUTIONS, code: CLIENT },
    Target { name: "websocket", executions: EXECUTIONS, code: WEBSOCKET },
    Target { name: "server_session", executions: SESSIONS, code: &[] },
    Target { name: "control", executions: EXECUTIONS, code: NO_SERVER },
    Target { name: "proxy", executions: EXECUTIONS, code: PROXY },
    Target { name: "address", executions: EXECUTIONS, code: ADDRESS },
    Target { name: "pack", executions: EXECUTIONS, code: PACK },
];

/// Row of the faults that a run found.
const FAULTS: &str = "targets with a fault";

/// The target with a fault that must be found.
const PLANTED: &str = "planted";

/// Executions in which the planted fault must be found; some 20,000 are enough.
const PLANTED_EXECUTIONS: u64 = 50_000_000;

/// An input that takes longer is a fault. The largest view that a server accepts is selected whole
/// here, which takes over ten seconds with assertions and coverage.
const TIMEOUT: &str = "-timeout=120";

/// Result of one target in this run.
#[derive(Clone, Debug)]
struct Searched {
    target: &'static str,
    executions: Option<f64>,
    /// Whether it ended with a fault: a panic, too much memory, or no end.
    has_fault: bool,
}

/// Builds and runs all targets, as many at once as there are cores.
///
/// # Errors
/// cargo-fuzz is not installed, a target is not known, a build failed, or the run was interrupted.
pub fn rows(run: &mut Run) -> Result<Vec<Bar>> {
    // Before the build: an unknown name costs no time.
    let selected = selected()?;
    let earlier = earlier::read().context("the earlier runs cannot be read")?;
    let folder = process::target().join("fuzz");
    build(&folder)?;
    let mut seeds = process::cargo("run --quiet --example seeds --");
    seeds.arg(folder.join("corpus"));
    process::run(seeds).context("the valid inputs were not written")?;
    clear(&folder, PLANTED)?;
    let planted = search(run, &folder, PLANTED, PLANTED_EXECUTIONS)?;
    let cores = std::thread::available_parallelism().map_or(1, usize::from);
    let left = left(&selected, &earlier.executions);
    let waiting = Mutex::new(left.iter());
    let found = Mutex::new(Vec::new());
    let next = || waiting.lock().ok()?.next().copied();
    let run_here = &*run;
    std::thread::scope(|scope| {
        let work = || -> Result<()> {
            while let Some((target, executions)) = next() {
                let searched = search(run_here, &folder, target, executions)?;
                found.lock().map_err(|_| anyhow::anyhow!("a search panicked"))?.push(searched);
            }
            Ok(())
        };
        let searches: Vec<_> = (0..cores).map(|_| scope.spawn(work)).collect();
        searches.into_iter().try_for_each(|search| match search.join() {
            Ok(ended) => ended,
            Err(_) => bail!("a search panicked"),
        })
    })?;
    let found = found.into_inner().unwrap_or_default();
    run.notes.push(
        "libFuzzer through cargo-fuzz without a sanitizer, release build with debug assertions; each \
         target starts from the valid inputs of its entry point and from the inputs that earlier runs on \
         this machine found; the one with the planted fault starts from nothing."
            .into(),
    );
    for searched in &found {
        let executions = searched.executions.unwrap_or(0.0);
        run.notes.push(format!("{}: {executions:.0} executions of the last run.", searched.target));
    }
    Ok(bars_of(&planted, &found, &earlier))
}

/// The targets to run: all, or those of `TOMBOLO_FUZZ_TARGETS`.
fn selected() -> Result<Vec<Target>> {
    std::env::var("TOMBOLO_FUZZ_TARGETS").map_or_else(|_| Ok(TARGETS.into()), |names| named(&names))
}

/// The targets of a list of names.
fn named(names: &str) -> Result<Vec<Target>> {
    let of = |name: &str| {
        let found = TARGETS.into_iter().find(|target| target.name == name);
        found.with_context(|| format!("TOMBOLO_FUZZ_TARGETS: there is no target `{name}`"))
    };
    names.split(',').map(of).collect()
}

/// Targets and the executions that they still lack; without those that lack none.
fn left(selected: &[Target], earlier: &BTreeMap<&str, f64>) -> Vec<(&'static str, u64)> {
    let lacks = |target: &Target| {
        let executed = earlier.get(target.name).map_or(0, |executions| *executions as u64);
        (target.name, target.executions.saturating_sub(executed))
    };
    selected.iter().map(lacks).filter(|(_, executions)| *executions > 0).collect()
}

/// The name of the row of a target.
fn row(target: &str) -> String {
    format!("{target}: executions")
}

/// The rows. Without the planted fault nothing counts.
fn bars_of(planted: &Searched, found: &[Searched], earlier: &Earlier) -> Vec<Bar> {
    let can_find = planted.has_fault;
    let mut rows: Vec<_> = TARGETS
        .iter()
        .map(|target| {
            let before = earlier.executions.get(target.name).copied();
            let now = found.iter().find(|one| one.target == target.name).and_then(|one| one.executions);
            let executions = now.map(|now| now + before.unwrap_or(0.0)).or(before).filter(|_| can_find);
            Bar::at_least(row(target.name), executions, "", target.executions as f64)
        })
        .collect();
    let faults = found.iter().filter(|one| one.has_fault).count() as f64;
    rows.push(
        Bar::none(FAULTS, can_find.then_some(faults.max(earlier.faults)))
            .with_note("of those that have executions above"),
    );
    rows.push(Bar::some("planted fault: found (control)", Some(f64::from(u8::from(can_find)))));
    rows
}

/// Builds all targets. Coverage needs options of the compiler that are not stable;
/// `RUSTC_BOOTSTRAP` allows them to the compiler of the project, so that no second one is needed.
fn build(folder: &Path) -> Result<()> {
    let mut fuzz = process::cargo("fuzz build --release --sanitizer none --target-dir");
    fuzz.arg(folder).env("RUSTC_BOOTSTRAP", "1");
    process::run(fuzz).context("the targets were not built; run: cargo install cargo-fuzz --locked")
}

/// Removes what earlier runs of a target left. The planted fault is easier to find from an input
/// that has some of its bytes.
fn clear(folder: &Path, target: &str) -> Result<()> {
    for left in ["corpus", "faults"].map(|kind| folder.join(kind).join(target)) {
        match fs::remove_dir_all(&left) {
            Err(error) if error.kind() != std::io::ErrorKind::NotFound => {
                return Err(error).with_context(|| format!("cannot remove {}", left.display()));
            }
            _ => {}
        }
    }
    Ok(())
}

/// Runs one target.
fn search(run: &Run, folder: &Path, target: &'static str, executions: u64) -> Result<Searched> {
    println!("measure: {target}");
    let program = programs(folder)?.join(target);
    let corpus = folder.join("corpus").join(target);
    let artifacts = folder.join("faults").join(target);
    for folder in [&corpus, &artifacts] {
        fs::create_dir_all(folder).with_context(|| format!("cannot create {}", folder.display()))?;
    }
    let log = run.file(&format!("{target}.log"));
    let output = fs::File::create(&log).with_context(|| format!("cannot write {}", log.display()))?;
    let mut search = process::command(program);
    search
        .arg(&corpus)
        .arg(format!("-runs={executions}"))
        .arg(format!("-artifact_prefix={}/", artifacts.display()))
        .args(["-print_final_stats=1", TIMEOUT, "-rss_limit_mb=2048", "-verbosity=0"])
        .stdout(std::process::Stdio::null())
        .stderr(output);
    if let Ok(seconds) = std::env::var("TOMBOLO_FUZZ_SECONDS") {
        search.arg(format!("-max_total_time={seconds}"));
    }
    let ended = process::status(&mut search)?;
    let said = fs::read_to_string(&log).unwrap_or_default();
    Ok(Searched { target, executions: executed(&said), has_fault: !ended.success() })
}

/// Where cargo-fuzz leaves the programs: `TRIPLE/release`.
fn programs(folder: &Path) -> Result<PathBuf> {
    let triples = fs::read_dir(folder).with_context(|| format!("cannot read {}", folder.display()))?;
    let candidates = triples.filter_map(|entry| Some(entry.ok()?.path().join("release")));
    candidates
        .into_iter()
        .find(|folder| folder.join(PLANTED).is_file())
        .context("cargo-fuzz left no programs")
}

/// The executions that libFuzzer counted.
fn executed(log: &str) -> Option<f64> {
    let line = log.lines().rfind(|line| line.starts_with("stat::number_of_executed_units:"))?;
    line.split_whitespace().nth(1)?.parse().ok()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn searched(target: &'static str, executions: f64, has_fault: bool) -> Searched {
        Searched { target, executions: Some(executions), has_fault }
    }

    fn missed(planted: bool, found: &[Searched]) -> usize {
        let rows = bars_of(&searched(PLANTED, 1.0, planted), found, &Earlier::default());
        assert_eq!(rows.len(), TARGETS.len() + 2);
        rows.iter().filter(|row| row.is_missed()).count()
    }

    #[test]
    fn a_search_counts_only_whole_and_only_if_the_planted_fault_was_found() {
        let whole: Vec<_> =
            TARGETS.map(|target| searched(target.name, target.executions as f64, false)).into();
        assert_eq!(missed(true, &whole), 0);
        assert_eq!(missed(false, &whole), TARGETS.len() + 2);
        assert_eq!(missed(true, &whole[1..]), 1);
        assert_eq!(missed(true, &[]), TARGETS.len());
        let mut short = whole.clone();
        short[0].executions = short[0].executions.map(|wanted| wanted - 1.0);
        assert_eq!(missed(true, &short), 1);
        let mut faulty = whole;
        faulty[3].has_fault = true;
        assert_eq!(missed(true, &faulty), 1);
    }

    #[test]
    fn a_run_adds_to_the_earlier_ones_and_does_only_what_is_left() {
        let executions = BTreeMap::from([("chunk", 6e7), ("pack", 1e8)]);
        let mut earlier = Earlier { executions, faults: 0.0 };
        let selected = named("chunk,pack,tokens").unwrap();
        assert_eq!(left(&selected, &earlier.executions), [("chunk", 40_000_000), ("tokens", FILES)]);
        let found = [searched("chunk", 4e7, false), searched("tokens", 1.0, false)];
        let rows = bars_of(&searched(PLANTED, 1.0, true), &found, &earlier);
        let of = |target: &str| rows.iter().find(|found| found.name == row(target)).unwrap();
        assert!(["chunk", "pack"].into_iter().all(|target| of(target).is_met()));
        assert_eq!(of("tokens").figure, Some(1.0).into());
        assert!(of("http").is_missed());
        assert!(rows.iter().find(|row| row.name == FAULTS).unwrap().is_met());
        earlier.faults = 1.0;
        let faulty = bars_of(&searched(PLANTED, 1.0, true), &found, &earlier);
        let faults = faulty.iter().find(|row| row.name == FAULTS).unwrap();
        assert!(faults.is_missed(), "a fault that an earlier run found");
        let uncounted = bars_of(&searched(PLANTED, 1.0, false), &found, &earlier);
        assert!(uncounted.iter().all(Bar::is_missed), "without the planted fault nothing counts");
    }

    #[test]
    fn the_executions_are_those_of_the_last_count() {
        let log = "INFO: x\nstat::number_of_executed_units: 12\nstat::average_exec_per_sec: 3\n";
        assert_eq!(executed(log), Some(12.0));
        assert_eq!(executed("INFO: x\n"), None);
    }

    #[test]
    fn only_known_targets_are_selected() {
        let names: Vec<_> = named("pack,chunk").unwrap().iter().map(|target| target.name).collect();
        assert_eq!(names, ["pack", "chunk"]);
        for unknown in ["", "chunks", "pack,", "pack, chunk", PLANTED] {
            assert!(named(unknown).unwrap_err().to_string().contains("TOMBOLO_FUZZ_TARGETS"), "{unknown}");
        }
    }

    #[test]
    fn what_earlier_runs_of_a_target_left_is_removed_and_nothing_else() {
        let folder = std::env::temp_dir().join(format!("tombolo-fuzz-clear-{}", std::process::id()));
        clear(&folder, PLANTED).unwrap();
        let files =
            ["corpus/planted", "faults/planted", "corpus/chunk"].map(|name| folder.join(name).join("x"));
        for file in &files {
            fs::create_dir_all(file.parent().unwrap()).unwrap();
            fs::write(file, "TOM").unwrap();
        }
        clear(&folder, PLANTED).unwrap();
        assert_eq!(files.map(|file| file.exists()), [false, false, true]);
        // A file is no folder: what cannot be removed is an error.
        fs::write(folder.join("corpus/planted"), "").unwrap();
        assert!(clear(&folder, PLANTED).is_err());
        fs::remove_dir_all(folder).unwrap();
    }

    #[test]
    fn every_entry_point_is_a_target() {
        let listed = fs::read_to_string(process::root().join("entry-points/src/lib.rs")).unwrap();
        for target in TARGETS.map(|target| target.name) {
            assert!(listed.contains(&format!("name: \"{target}\"")), "{target}");
            assert!(process::root().join("fuzz/fuzz_targets").join(format!("{target}.rs")).is_file());
        }
        assert_eq!(listed.matches("name: \"").count(), TARGETS.len());
    }
}
