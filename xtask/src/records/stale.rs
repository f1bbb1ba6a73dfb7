//! Whether the code that a record measured has changed since.
//!
//! Code is files of this repository, and the compiler, which `rust-toolchain.toml` names. Versions
//! of dependencies in `Cargo.lock` do not count: one file holds those of every program, so an
//! update of a crate that only the viewer has would make the records of all others out of date.
//! After an update that may change a figure, its measurement is to be run again.

use crate::process;
use crate::test_modules::have_equal_code;
use anyhow::{Result, bail};

/// What decides the figures of every measurement: the bars and figures of reports, and the median
/// of the runs. `xtask/src/measure/mod.rs` is left out, though it has the sample sizes of the
/// measurements by the lab: every new measurement changes it.
const COMMON: [&str; 2] = ["bars", "xtask/src/measure/runs.rs"];

/// What each measurement measures beside [`COMMON`]: paths from the root. Tests and documents in
/// them do not count.
const MEASURED: [(&str, &[&str]); 18] = [
    ("code", &["*.rs", "*.wesl", "*.md", "*.toml"]),
    (
        "heightfield",
        &[
            "terrain",
            "lab/src/digest",
            "lab/src/timings.rs",
            "lab/src/stats.rs",
            "lab/src/adapters.rs",
            "lab/src/probe_pass.rs",
            "lab/src/gpu_probes/fill.rs",
            "client/src/gpu/bind.rs",
            "client/src/gpu/buffer.rs",
            "client/src/gpu/device.rs",
            "client/src/gpu/pipeline.rs",
            "client/src/gpu/readback.rs",
            "lab/src/codec/samples.rs",
            "benches/noise-comparison",
            "xtask/src/measure/heightfield.rs",
            // Sources rather than what the linker writes: a test holds that to them, and `cargo ci`
            // compares the digests of all drivers each time.
            "shaders/wgsl/probe_heights.wesl",
            "shaders/wgsl/probe_heights_float.wesl",
            "shaders/wgsl/shared/base.wesl",
            "shaders/wgsl/shared/coast.wesl",
            "shaders/wgsl/shared/curves.wesl",
            "shaders/wgsl/shared/gradients.wesl",
            "shaders/wgsl/shared/hash.wesl",
            "shaders/wgsl/shared/island.wesl",
            "shaders/wgsl/shared/land.wesl",
            "shaders/wgsl/shared/lattice.wesl",
            "shaders/wgsl/shared/noise.wesl",
            "shaders/wgsl/shared/octaves.wesl",
            "shaders/wgsl/shared/ring.wesl",
            "shaders/wgsl/shared/spline.wesl",
            "shaders/wgsl/shared/weights.wesl",
        ],
    ),
    (
        "land",
        &[
            "terrain",
            // The rule of woods, which `lab/src/land/wood.rs` repeats.
            "shaders/wgsl/shared/splat.wesl",
            "shaders/wgsl/shared/pattern.wesl",
            "lab/src/land",
            "lab/src/land.rs",
            "lab/src/stability",
            "lab/src/stability.rs",
            "lab/src/floats.rs",
            "lab/src/reference_f64",
            "lab/src/reference_f64.rs",
            "lab/src/sample.rs",
            "lab/src/stats.rs",
            "benches/land-comparison",
            "benches/noise-comparison/src/rounds.rs",
            "xtask/src/measure/land.rs",
        ],
    ),
    // Programs make a build longer with every line: what is compared are profiles, features and
    // dependencies.
    (
        "demo-build",
        &[
            "Cargo.toml",
            ".cargo/config.toml",
            "client/Cargo.toml",
            "protocol/Cargo.toml",
            "server/Cargo.toml",
            "shaders/Cargo.toml",
            "terrain/Cargo.toml",
            "xtask/Cargo.toml",
            "xtask/src/demo.rs",
            "xtask/src/measure/demo_build.rs",
            "xtask/src/process.rs",
            "xtask/src/setup.rs",
        ],
    ),
    (
        "end-to-end",
        &[
            "terrain",
            "protocol",
            "shaders",
            "server",
            "client",
            "load",
            "tls-client",
            "cli",
            "xtask/src/measure/end_to_end.rs",
            "xtask/src/server.rs",
        ],
    ),
    (
        "streaming",
        &[
            "terrain",
            "protocol",
            "server",
            "load",
            // The others are of other measurements.
            "server-bench/Cargo.toml",
            "server-bench/src/cached.rs",
            "server-bench/src/clients.rs",
            "server-bench/src/cold.rs",
            "server-bench/src/connection.rs",
            "server-bench/src/fair.rs",
            "server-bench/src/flood.rs",
            "server-bench/src/http.rs",
            "server-bench/src/idle.rs",
            "server-bench/src/keys.rs",
            "server-bench/src/main.rs",
            "server-bench/src/mechanism.rs",
            "server-bench/src/mechanisms.rs",
            "server-bench/src/nginx.rs",
            "server-bench/src/overload.rs",
            "server-bench/src/polite.rs",
            "server-bench/src/rounds.rs",
            "server-bench/src/server_process.rs",
            "server-bench/src/stampede.rs",
            "server-bench/src/wrk.rs",
            "tls-client",
            "cli",
            "test-support",
            "lab/src/codec",
            "lab/src/codec.rs",
            "lab/src/stats.rs",
            "benches/lerc",
            "xtask/src/measure/streaming.rs",
        ],
    ),
    (
        "fuzz",
        &[
            "terrain",
            "protocol",
            "server",
            "client",
            "shaders",
            "entry-points",
            "fuzz",
            "xtask/src/measure/fuzz.rs",
            "xtask/src/measure/fuzz",
        ],
    ),
    (
        "websocket",
        &[
            "server/src/websocket",
            "server/examples/echo.rs",
            "server/tests/websocket/echo.rs",
            "server/tests/websocket/echo_server.rs",
            "xtask/src/measure/websocket.rs",
        ],
    ),
    (
        "mutants",
        &[
            "terrain",
            "protocol",
            "server/src/limits",
            "server/src/session",
            "server/src/cache",
            "xtask/src/measure/mutants.rs",
        ],
    ),
    (
        "resilience",
        &[
            "terrain",
            "protocol",
            "server",
            "server-bench",
            "tls-client",
            "cli",
            "test-support",
            "client",
            "shaders",
            "xtask/src/measure/resilience.rs",
            // The cores and the command of a benchmark.
            "xtask/src/measure/streaming.rs",
        ],
    ),
    (
        "cluster",
        &[
            "terrain",
            "protocol",
            "server",
            "load",
            "tls-client",
            "simulation",
            "cli",
            "xtask/src/cluster",
            "xtask/src/server.rs",
            "xtask/src/measure/cluster.rs",
            "deploy/nginx",
            "deploy/prometheus",
        ],
    ),
    (
        "soak",
        &[
            "terrain",
            "protocol",
            "server",
            "load",
            "tls-client",
            "cli",
            "xtask/src/cluster",
            "xtask/src/server.rs",
            "xtask/src/measure/cluster.rs",
            "deploy/nginx",
        ],
    ),
    (
        "terrain",
        &[
            "terrain",
            "shaders",
            "client",
            "lab/src/lod",
            "lab/src/lod.rs",
            "lab/src/cracks.rs",
            "lab/src/headless_renderer.rs",
            "lab/src/places.rs",
            "lab/src/sample.rs",
            "lab/src/stats.rs",
            "lab/src/world_builder.rs",
        ],
    ),
    (
        "visual",
        &[
            "terrain",
            "shaders",
            "client",
            "lab/src/visual",
            "lab/src/visual.rs",
            "lab/src/cracks.rs",
            "lab/src/flip.rs",
            "lab/src/headless_renderer.rs",
            "lab/src/lod/screen.rs",
            "lab/src/pom/renderer.rs",
            "lab/src/probe_pass.rs",
            "lab/src/sample.rs",
            "lab/src/stats.rs",
            "lab/src/supersampled.rs",
            "lab/src/tree_shadow.rs",
            "lab/src/world_builder.rs",
        ],
    ),
    (
        "pom",
        &[
            "shaders",
            "client",
            "lab/src/headless_renderer.rs",
            "lab/src/pom",
            "lab/src/pom.rs",
            "lab/src/probe_pass.rs",
            "lab/src/sample.rs",
            "lab/src/stats.rs",
        ],
    ),
    (
        "culling",
        &[
            "terrain",
            "shaders",
            "client",
            "lab/src/culling",
            "lab/src/culling.rs",
            "lab/src/gpu_probes/cpu_cull.rs",
            "lab/src/headless_renderer.rs",
            "lab/src/lod/drawn.rs",
            "lab/src/stats.rs",
        ],
    ),
    ("gpu", &["terrain", "shaders", "client", "lab", "server", "protocol", "xtask/src/gpu_bundle/run.sh"]),
    // Records and documents that it reads are judged as they are.
    // Near misses of the drawn trees are among its rows.
    ("audit", &["xtask", "client", "shaders"]),
];

/// The version of the compiler, on which times and sizes depend as on the code.
const COMPILER: &str = "rust-toolchain.toml";

/// Measurements that count text and records, whatever the compiler.
const WITHOUT_COMPILER: [&str; 2] = ["code", "audit"];

/// Paths that a measurement measures; none if it is not known.
pub fn measured(name: &str) -> Option<Vec<&'static str>> {
    let (_, paths) = MEASURED.into_iter().find(|(known, _)| *known == name)?;
    let compiler = (!WITHOUT_COMPILER.contains(&name)).then_some(COMPILER);
    Some(paths.iter().copied().chain(COMMON).chain(compiler).collect())
}

/// Files among the measured paths that decide no figure, as pathspecs of git.
const NO_FIGURES: [&str; 2] = [":(exclude,glob)**/README.md", ":(exclude)docs/measurements"];

/// Files that decide the figures of [`OF_TESTS`] alone.
const TESTS: [&str; 3] =
    [":(exclude,glob)**/tests/**", ":(exclude,glob)**/tests.rs", ":(exclude,glob)**/examples/**"];

/// Measurements of tests, or of an example.
const OF_TESTS: [&str; 2] = ["mutants", "websocket"];

/// Why the age of no record is known: a shallow clone lacks their commits. None in a full clone.
pub fn lacks_history() -> Option<String> {
    let mut git = process::command("git");
    git.args(["rev-parse", "--is-shallow-repository"]);
    why_shallow(process::output(git))
}

/// Why a clone of which git says this is not a full one.
fn why_shallow(said: Result<String>) -> Option<String> {
    match said {
        Ok(said) if said.trim() == "false" => None,
        Ok(_) => Some("a shallow clone lacks the commits of the records; run: git fetch --unshallow".into()),
        Err(why) => Some(format!("{why:#}")),
    }
}

/// Why a record no longer speaks of this working tree; none if it does.
pub fn reason(name: &str, commit: &str) -> Option<String> {
    let Some(paths) = measured(name) else { return Some(format!("nothing is known of `{name}`")) };
    match changed(&paths, commit, !OF_TESTS.contains(&name)) {
        Ok(changed) => {
            let counts = |path: &&String| ages_with_text(name) || !keeps_code(commit, path);
            let count = changed.iter().filter(counts).count();
            (count > 0).then(|| format!("{count} measured files changed since"))
        }
        Err(why) => Some(format!("{why:#}")),
    }
}

/// Whether the code in some paths is that of a commit. Tests and comments do not count.
pub fn has_code_of(paths: &[&str], commit: &str) -> bool {
    changed(paths, commit, true).is_ok_and(|files| files.iter().all(|file| keeps_code(commit, file)))
}

/// Files in some paths that differ from those of a commit, with tests or without.
///
/// # Errors
/// The commit does not exist, or git fails.
fn changed(paths: &[&str], commit: &str, without_tests: bool) -> Result<Vec<String>> {
    let git = |args: &[&str]| {
        let mut git = process::command("git");
        git.args(args);
        git
    };
    let resolved = format!("{commit}^{{commit}}");
    if commit.is_empty() || !process::succeeds(git(&["rev-parse", "--verify", "--quiet", &resolved])) {
        bail!("its commit `{commit}` does not exist");
    }
    let mut diff = git(&["diff", "--name-only", commit, "--"]);
    diff.args(paths).args(NO_FIGURES).args(TESTS.iter().filter(|_| without_tests));
    Ok(process::output(diff)?.lines().map(str::to_owned).collect())
}

/// Whether tests and comments decide figures of a measurement.
fn ages_with_text(name: &str) -> bool {
    OF_TESTS.contains(&name) || WITHOUT_COMPILER.contains(&name)
}

/// Whether a Rust, WESL or TOML file of the working tree has the code that it had at a commit:
/// tests and comments decide no figure of most measurements. False for a file that is new or gone.
fn keeps_code(commit: &str, path: &str) -> bool {
    let Some(have_equal) = comparison(path) else { return false };
    let mut git = process::command("git");
    git.args(["show", &format!("{commit}:{path}")]);
    match (process::output(git), std::fs::read_to_string(process::root().join(path))) {
        (Ok(before), Ok(now)) => have_equal(&before, &now),
        _ => false,
    }
}

/// How the code of two versions of a file is compared; none for a kind of file without a
/// comparison.
fn comparison(path: &str) -> Option<fn(&str, &str) -> bool> {
    match path.rsplit_once('.')?.1 {
        "rs" => Some(have_equal_code),
        "wesl" | "wgsl" => Some(|before, now| have_equal_lines(before, now, "//")),
        "toml" if path.ends_with("Cargo.toml") => {
            Some(|before, now| have_equal_lines(&without_test_tables(before), &without_test_tables(now), "#"))
        }
        "toml" => Some(|before, now| have_equal_lines(before, now, "#")),
        _ => None,
    }
}

/// Whether two texts differ in empty lines and lines of comments alone.
fn have_equal_lines(before: &str, now: &str, comment: &str) -> bool {
    let lines = |text: &str| -> Vec<String> {
        let is_code = |line: &&str| !line.trim().is_empty() && !line.trim_start().starts_with(comment);
        text.lines().filter(is_code).map(str::to_owned).collect()
    };
    lines(before) == lines(now)
}

/// A manifest without the tables of tests and of what they alone depend on.
fn without_test_tables(manifest: &str) -> String {
    let mut is_of_tests = false;
    let mut kept = String::new();
    for line in manifest.lines() {
        if line.starts_with('[') {
            is_of_tests = line == "[[test]]" || line.trim_end().ends_with("dev-dependencies]");
        }
        if !is_of_tests {
            kept.push_str(line);
            kept.push('\n');
        }
    }
    kept
}

#[cfg(test)]
mod tests;
