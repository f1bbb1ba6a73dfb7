//! `demo-build`: how long `cargo demo -- --headless` builds in a fresh clone, beside the same at
//! commit 667da50, and what the profile that builds faster costs in speed.

use super::end_to_end;
use super::run::Run;
use super::streaming::{separate_cores, server_bench};
use crate::process;
use crate::server::Server;
use anyhow::{Context, Result, bail};
use bars::Bar;
use bars::figures::{at, median};
use std::io::{BufRead, BufReader};
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::time::Instant;

/// The commit that the bar refers to.
const BEFORE: &str = "667da50";

/// The demo prints such a line when its programs are built and its server runs.
const BUILT: &str = "demo: a server streams";

/// How the time is taken.
const HOW: &str = "`cargo demo -- --headless` in two fresh clones, one after the other: the time until \
    the server runs, with the build of `xtask`. Packages of the system are installed and libraries \
    downloaded before.";

/// Interleaved runs of each profile.
const ROUNDS: usize = 3;

/// Length of each timed part of a run, seconds.
const SECONDS: &str = "3";

/// Most of the time at the commit before, percent.
const MOST: f64 = 50.0;

/// Clones, builds and compares.
///
/// # Errors
/// The history lacks the commit, a clone or a demo failed, or it was interrupted.
pub fn rows(run: &mut Run) -> Result<Vec<Bar>> {
    let clones = [("before", BEFORE), ("now", "HEAD")].map(|(name, commit)| clone(run, name, commit));
    let [before, now] = clones;
    let (before, now) = (before?, now?);
    run.notes.push(HOW.into());
    let minutes = [demo_minutes(&before)?, demo_minutes(&now)?];
    let slower = slower(run, &now)?;
    // Two builds with debug information are gigabytes.
    for folder in [&before, &now] {
        std::fs::remove_dir_all(folder).with_context(|| format!("cannot remove {}", folder.display()))?;
    }
    Ok(bars_of(minutes, slower))
}

fn bars_of([before, now]: [f64; 2], [server, viewer]: [Option<f64>; 2]) -> Vec<Bar> {
    vec![
        Bar::at_most(
            format!("fresh build of the demo, of the time at commit {BEFORE}"),
            (before > 0.0).then_some(100.0 * now / before),
            "%",
            MOST,
        ),
        Bar::reported("fresh build of the demo", Some(now), "min"),
        Bar::reported(format!("the same at commit {BEFORE}"), Some(before), "min"),
        Bar::reported("time of a new chunk by the demo's server, over the dist profile's", server, "x"),
        Bar::reported("time to a complete view by the demo's viewer, over the dist profile's", viewer, "x"),
    ]
}

/// A clone of this repository at a commit, with its libraries downloaded.
fn clone(run: &Run, name: &str, commit: &str) -> Result<PathBuf> {
    let folder = run.file(name);
    // Of an earlier run.
    let _ = std::fs::remove_dir_all(&folder);
    let mut clone = process::command("git");
    clone.args(["clone", "--quiet", "--no-checkout", "."]).arg(&folder);
    process::run(clone).context("cannot clone the repository")?;
    let mut hash = process::command("git");
    hash.args(["rev-parse", "--verify", commit]);
    let hash = process::output(hash).with_context(|| format!("the history lacks commit {commit}"))?;
    let mut checkout = command_in(&folder, "git");
    process::run({
        checkout.args(["checkout", "--quiet", "--detach", hash.trim()]);
        checkout
    })?;
    let mut fetch = command_in(&folder, "cargo");
    fetch.args(["fetch", "--quiet", "--locked"]);
    process::run(fetch).context("cannot download the libraries")?;
    Ok(folder)
}

/// A command as in a shell in a folder: without what this cargo has set.
fn command_in(folder: &Path, program: &str) -> Command {
    let mut command = Command::new(program);
    command.current_dir(folder).env_remove("RUSTUP_TOOLCHAIN");
    for (name, _) in std::env::vars_os() {
        let is_cargos = name.to_str().is_some_and(|name| name == "CARGO" || name.starts_with("CARGO_"));
        if is_cargos && name != "CARGO_HOME" {
            command.env_remove(name);
        }
    }
    command
}

/// Runs the demo to its end. Returns the minutes until its server runs.
fn demo_minutes(folder: &Path) -> Result<f64> {
    println!("measure: cargo demo -- --headless in {}", folder.display());
    let mut demo = command_in(folder, "cargo");
    process::quiet_drivers(&mut demo);
    let started = Instant::now();
    let mut child = demo
        .args(["demo", "--", "--headless"])
        .stdin(Stdio::null())
        .stdout(Stdio::piped())
        .spawn()
        .context("cannot start the demo")?;
    let mut built = None;
    for line in BufReader::new(child.stdout.take().context("no output")?).lines().map_while(Result::ok) {
        println!("{line}");
        if line.starts_with(BUILT) {
            built = Some(started.elapsed().as_secs_f64() / 60.0);
        }
    }
    let status = child.wait().context("cannot wait for the demo")?;
    if process::interrupted() {
        bail!("interrupted");
    }
    built.filter(|_| status.success()).with_context(|| format!("the demo failed ({status})"))
}

/// How much slower the programs of the demo are than those of the `dist` profile: the server at new
/// chunks of level 0, and the viewer at a view from the cache of one server. Medians of interleaved
/// runs.
fn slower(run: &mut Run, clone: &Path) -> Result<[Option<f64>; 2]> {
    let of_demo = |name: &str| clone.join("target/release").join(name);
    let mut chunk = [Vec::new(), Vec::new()];
    for round in 0..ROUNDS {
        for (times, program) in chunk.iter_mut().zip([Some(of_demo("tombolo-server")), None]) {
            let mut bench = server_bench("cold", separate_cores(), "1", SECONDS);
            bench.args(program.iter().flat_map(|program| ["--server".as_ref(), program.as_os_str()]));
            let name = if program.is_some() { "demo" } else { "dist" };
            let report = run.report(&format!("cold-{name}-{round}"), bench, "--json")?;
            times.push(at(&report, "figures/levels/0/total_us"));
        }
    }
    let server = Server::start(end_to_end::WORLD_SEED)?;
    let mut view = [Vec::new(), Vec::new()];
    // The first fills the cache of the server.
    end_to_end::view(run, process::viewer(), &server, "fill", &[])?;
    for round in 0..ROUNDS {
        let of_demo = process::command(of_demo("tombolo-view"));
        for (times, (name, viewer)) in view.iter_mut().zip([("demo", of_demo), ("dist", process::viewer())]) {
            let stats = end_to_end::view(run, viewer, &server, &format!("view-{name}-{round}"), &[])?;
            times.push(at(&stats, "seconds_to_complete_view"));
        }
    }
    Ok([chunk, view].map(|times| {
        let [demo, dist] = times.map(median);
        bars::figures::ratio(demo, dist)
    }))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn more_than_half_of_the_time_is_missed() {
        let missed =
            |now| bars_of([11.0, now], [Some(1.1), Some(1.2)]).iter().filter(|bar| bar.is_missed()).count();
        assert_eq!((missed(5.5), missed(5.6)), (0, 1));
    }

    #[test]
    fn commands_in_a_clone_do_not_have_the_folders_of_this_build() {
        let command = command_in(Path::new("."), "cargo");
        let is_removed =
            |name: &str| command.get_envs().any(|(other, value)| other == name && value.is_none());
        assert!(is_removed("CARGO_MANIFEST_DIR") && is_removed("RUSTUP_TOOLCHAIN"));
    }
}
