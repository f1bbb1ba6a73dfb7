//! The steps of `ci`, in the order in which failures are cheapest.

use super::digest;
use super::host::{Host, Tool, WASM};
use super::outcome::Outcome;
use crate::{advisories, cluster, demo, dependency_rules, fast_simd, land_version_3, process, records};
use anyhow::{Result, bail};
use std::collections::BTreeSet;
use std::process::Command;

/// Schedules of each test of the step `schedules`: a tenth of what the tests run by themselves.
const SCHEDULES: &str = "200";

/// The same, and seeds of the simulation, of `cargo ci --long`.
const LONG_SCHEDULES: &str = "2000";
const LONG_SEEDS: &str = "1000";

/// A step: what it is called and what it does.
#[derive(Clone, Copy)]
pub struct Step {
    /// For `--only` and `--allow-skips`.
    pub name: &'static str,
    /// Subject of the step.
    pub about: &'static str,
    /// How to repeat it by hand.
    pub again: &'static str,
    /// Looks; an error is a failure.
    pub action: fn(&dyn Host) -> Result<Shown>,
}

/// Outcomes of a step: one for each part with a tool of its own.
#[derive(Clone, Debug)]
pub struct Shown {
    /// Of the step.
    pub outcome: Outcome,
    /// Of its parts, by name.
    pub parts: Vec<(String, Outcome)>,
}

/// Every step.
pub const ALL: [Step; 18] = [
    Step {
        name: "format",
        about: "Rust is formatted",
        again: "cargo fmt --all --check",
        action: |host| ran(host, process::cargo("fmt --all --check")),
    },
    Step {
        name: "source",
        about: "columns, words, names in documents, import circles, quoted figures",
        again: "cargo xtask source",
        action: |host| checked(host, crate::source::run),
    },
    Step {
        name: "records",
        about: "the README quotes no record that is out of date or of one run",
        again: "cargo xtask ci --only records",
        action: ages_of_records,
    },
    Step {
        name: "architecture",
        about: "dependencies that a crate must not have",
        again: "cargo tree --package PACKAGE",
        action: |host| checked(host, dependency_rules::check),
    },
    Step {
        name: "deploy",
        about: "nginx and Prometheus accept the files under `deploy`",
        again: "cargo xtask ci --only deploy",
        action: deploy,
    },
    Step {
        name: "licences",
        about: "licences, bans and sources of dependencies",
        again: "cargo deny check bans licenses sources",
        action: |host| ran(host, process::cargo("deny check bans licenses sources")),
    },
    Step {
        name: "advisories",
        about: "known vulnerabilities of dependencies, in a dated snapshot",
        again: "cargo xtask advisories",
        action: |host| checked(host, advisories::check),
    },
    Step {
        name: "clippy",
        about: "lints",
        again: "cargo clippy --workspace --all-targets -- -D warnings",
        action: |host| ran(host, process::cargo("clippy --workspace --all-targets -- -D warnings")),
    },
    Step {
        name: "build",
        about: "every target builds, and the programs of the demo also without a window",
        again: "cargo build --workspace --all-targets && cargo check --profile dev \
                --no-default-features --bin tombolo-server --bin tombolo-view",
        action: build,
    },
    Step {
        name: "tests",
        about: "every test",
        again: "TOMBOLO_REQUIRE_GPU=1 TOMBOLO_REQUIRE_DISPLAY=1 TOMBOLO_REQUIRE_BROWSER=1 \
                cargo nextest run --workspace",
        action: tests,
    },
    Step {
        name: "doc-tests",
        about: "examples in the documentation",
        again: "cargo test --workspace --doc",
        action: |host| ran(host, process::cargo("test --workspace --doc")),
    },
    Step {
        name: "schedules",
        about: "the request coalescing in some schedules of its threads",
        again: "TOMBOLO_SCHEDULES=200 RUSTFLAGS='--cfg shuttle' cargo test --package tombolo-server --lib \
                schedules --target-dir target/shuttle",
        action: schedules,
    },
    Step {
        name: "shaders",
        about: "shaders compile with naga and with Tint",
        again: "cargo nextest run --workspace -E 'package(tombolo-shaders)'",
        action: shaders,
    },
    Step {
        name: "digest",
        about: "every backend computes the same integers",
        again: "cargo run --bin tombolo-lab -- digest",
        action: digest_of_backends,
    },
    Step {
        name: "wasm",
        about: "the crates of a browser build; the kernels run in Node",
        again: "cargo check --target wasm32-unknown-unknown --package tombolo-terrain",
        action: webassembly,
    },
    Step {
        name: "docs",
        about: "documentation builds without warnings",
        again: "RUSTDOCFLAGS='-D warnings' cargo doc --workspace --no-deps --lib --bins --examples",
        action: docs,
    },
    Step {
        name: "benches",
        about: "the comparisons under `benches` are formatted, lint-free and build",
        again: "cd benches/PACKAGE && cargo clippy --release --all-targets -- -D warnings",
        action: benches,
    },
    Step {
        name: "fuzz",
        about: "the fuzz targets are formatted and lint-free",
        again: "cd fuzz && cargo clippy --locked --all-targets -- -D warnings",
        action: fuzz,
    },
];

/// Further steps of `cargo ci --long`: the searches that `ALL` runs a short part of.
pub const LONG: [Step; 2] = [
    Step {
        name: "long-simulation",
        about: "the session machines, and the server's sessions, in 1,000 seeds of clients, links and faults",
        again: "TOMBOLO_SIMULATION_SEEDS=1000 cargo nextest run --workspace -E \
                'kind(test) & binary(simulation)'",
        action: long_simulation,
    },
    Step {
        name: "long-schedules",
        about: "the request coalescing in ten times the schedules",
        again: "TOMBOLO_SCHEDULES=2000 RUSTFLAGS='--cfg shuttle' cargo test --package tombolo-server --lib \
                schedules --target-dir target/shuttle",
        action: |host| schedules_of(host, LONG_SCHEDULES),
    },
];

fn long_simulation(host: &dyn Host) -> Result<Shown> {
    // Chosen among the workspace: one package alone would be built with other features.
    let mut tests = process::cargo("nextest run --workspace -E");
    tests.arg("kind(test) & binary(simulation)").env("TOMBOLO_SIMULATION_SEEDS", LONG_SEEDS);
    ran(host, tests)
}

fn passed() -> Shown {
    Shown { outcome: Outcome::Passed, parts: Vec::new() }
}

fn skipped(tool: Tool, reason: String) -> Outcome {
    Outcome::Skipped { lacks: tool.name(), reason }
}

fn ran(host: &dyn Host, command: Command) -> Result<Shown> {
    host.run(command).map(|()| passed())
}

fn checked(host: &dyn Host, check: fn() -> Result<()>) -> Result<Shown> {
    host.own(check).map(|()| passed())
}

/// The ages are those of commits, which a shallow clone lacks.
fn ages_of_records(host: &dyn Host) -> Result<Shown> {
    if let Some(why) = host.lacks(Tool::History) {
        return Ok(Shown { outcome: skipped(Tool::History, why), parts: Vec::new() });
    }
    checked(host, records::judge)
}

/// With the features of `--all-targets` the viewer has a window; `cargo demo -- --headless` builds
/// it without.
fn build(host: &dyn Host) -> Result<Shown> {
    host.run(process::cargo("build --workspace --all-targets"))?;
    ran(host, process::check_without_window(&demo::PROGRAMS))
}

fn schedules(host: &dyn Host) -> Result<Shown> {
    schedules_of(host, SCHEDULES)
}

/// One package alone and a folder of its own: these flags build every dependency again.
fn schedules_of(host: &dyn Host, count: &str) -> Result<Shown> {
    let tests = || {
        let mut tests = process::cargo("test --package tombolo-server --lib schedules --target-dir");
        tests.arg(process::target().join("shuttle")).env("TOMBOLO_SCHEDULES", count);
        // The second variable would replace the first.
        tests.env("RUSTFLAGS", "--cfg shuttle").env_remove("CARGO_ENCODED_RUSTFLAGS");
        // Schedules are few, and optimised dependencies take minutes to build.
        tests.args(["--config", "profile.dev.opt-level=0"]);
        tests
    };
    host.run(tests())?;
    let mut list = tests();
    list.args(["--", "--list"]);
    require_tests(&host.output(list)?)?;
    Ok(passed())
}

/// For cargo a run without a test has passed.
fn require_tests(list: &str) -> Result<()> {
    if !list.lines().any(|line| line.ends_with(": test")) {
        bail!("there is no test of schedules; were they built with `--cfg shuttle`?");
    }
    Ok(())
}

/// Programs without which some tests cannot look. Compose file and manifests are read by tests.
fn deploy(host: &dyn Host) -> Result<Shown> {
    let mut parts = Vec::new();
    for (name, tool) in [("nginx", Tool::Nginx), ("alerts", Tool::Promtool)] {
        let check = if tool == Tool::Nginx { cluster::nginx::check } else { cluster::prometheus::check };
        let outcome = match host.lacks(tool) {
            Some(why) => skipped(tool, why),
            None => {
                host.own(check)?;
                Outcome::Passed
            }
        };
        parts.push((name.into(), outcome));
    }
    Ok(Shown { outcome: Outcome::Passed, parts })
}

fn tests(host: &dyn Host) -> Result<Shown> {
    let mut tests = process::cargo("nextest run --workspace");
    // Setup has installed a software driver, so pictures that are not drawn are a failure.
    tests.env("TOMBOLO_REQUIRE_GPU", "1");
    // By the step `build`; tests of programs need not look.
    tests.env("TOMBOLO_PROGRAMS_BUILT", "1");
    let mut parts = Vec::new();
    for (part, tool, variable) in [
        ("window on a display", Tool::Xvfb, "TOMBOLO_REQUIRE_DISPLAY"),
        ("page in a browser", Tool::Chromium, "TOMBOLO_REQUIRE_BROWSER"),
    ] {
        let lacks = host.lacks(tool);
        if lacks.is_none() {
            tests.env(variable, "1");
        }
        parts.push((part.into(), lacks.map_or(Outcome::Passed, |why| skipped(tool, why))));
    }
    host.run(tests)?;
    Ok(Shown { outcome: Outcome::Passed, parts })
}

/// The shaders' own tests once more by themselves: naga always, Tint where it is installed. Which
/// of them looked must be said here, because the output of passing tests is not shown.
fn shaders(host: &dyn Host) -> Result<Shown> {
    // Chosen among the workspace: one package alone would be built with other features.
    host.run(process::cargo("nextest run --workspace -E package(tombolo-shaders)"))?;
    let tint = host.lacks(Tool::Tint).map_or(Outcome::Passed, |why| skipped(Tool::Tint, why));
    Ok(Shown {
        outcome: Outcome::Passed,
        parts: vec![("naga".into(), Outcome::Passed), ("tint".into(), tint)],
    })
}

fn digest_of_backends(host: &dyn Host) -> Result<Shown> {
    let json = process::target().join("ci-digest.json");
    // As the step `build` does it: `cargo run` would build it with other features.
    host.run(process::cargo("build --workspace --all-targets"))?;
    let mut lab = process::command(process::tested_program("tombolo-lab"));
    lab.args(["digest", "--json"]).arg(&json).env("TOMBOLO_REQUIRE_GPU", "1");
    process::quiet_drivers(&mut lab);
    let report = host.report(lab, &json)?;
    Ok(Shown { outcome: Outcome::Passed, parts: digest::parts(&report)? })
}

/// The crates that a browser will run, with and without its vectors; the land's kernels are run too
/// where Node is installed.
fn webassembly(host: &dyn Host) -> Result<Shown> {
    if let Some(why) = host.lacks(Tool::WasmTarget) {
        return Ok(Shown { outcome: skipped(Tool::WasmTarget, why), parts: Vec::new() });
    }
    let check = format!(
        "check --target {WASM} --package tombolo-terrain --package tombolo-protocol --package tombolo-shaders"
    );
    host.run(process::cargo(&check))?;
    let build = format!("build --release --target {WASM} --package tombolo-terrain --example kernels_wasm");
    let mut build = process::cargo(&build);
    build.arg("--target-dir").arg(process::target());
    build.env("CARGO_TARGET_WASM32_UNKNOWN_UNKNOWN_RUSTFLAGS", "-C target-feature=+simd128");
    host.run(build)?;
    let part = |outcome| vec![("kernels in Node".into(), outcome)];
    if let Some(why) = host.lacks(Tool::Node) {
        return Ok(Shown { outcome: Outcome::Passed, parts: part(skipped(Tool::Node, why)) });
    }
    let mut node = process::command("node");
    node.args(["-e", RUN_KERNELS])
        .arg(process::target().join(WASM).join("release/examples/kernels_wasm.wasm"));
    let here = host.output(process::cargo("run --quiet --example kernels"))?;
    let there = host.output(node)?;
    println!("native:\n{here}WebAssembly:\n{there}");
    let digests: BTreeSet<_> =
        here.lines().chain(there.lines()).filter_map(|line| line.rsplit(' ').next()).collect();
    if digests.len() != 1 || there.trim().is_empty() {
        bail!("the kernels' digests differ: {digests:?}");
    }
    Ok(Shown { outcome: Outcome::Passed, parts: part(Outcome::Passed) })
}

/// Runs the kernels of a WebAssembly module.
const RUN_KERNELS: &str =
    "const module = new WebAssembly.Module(require('fs').readFileSync(process.argv[1]));
const { scalar, best } = new WebAssembly.Instance(module).exports;
for (const [name, call] of [['scalar', scalar], ['simd128', best]])
    console.log(name, BigInt.asUintN(64, call()).toString(16).padStart(16, '0'));";

fn docs(host: &dyn Host) -> Result<Shown> {
    let mut docs = process::cargo("doc --workspace --no-deps --lib --bins --examples");
    docs.env("RUSTDOCFLAGS", "-D warnings");
    ran(host, docs)
}

/// A package under `benches/`, with what its build needs.
struct Bench {
    name: &'static str,
    needs: &'static [Tool],
    /// Makes what the build reads beside the checkout.
    prepare: Option<fn() -> Result<()>>,
    /// Whether it has vectors of x86-64 and of nothing else.
    is_x86: bool,
}

const BENCHES: [Bench; 3] = [
    Bench {
        name: "noise-comparison",
        needs: &[Tool::Clang, Tool::Cmake, Tool::FastSimd],
        prepare: None,
        is_x86: false,
    },
    Bench { name: "lerc", needs: &[Tool::Libclang], prepare: None, is_x86: false },
    Bench {
        name: "land-comparison",
        needs: &[Tool::History],
        prepare: Some(land_version_3::export),
        is_x86: true,
    },
];

/// Workspaces of their own, so the other steps do not see them.
fn benches(host: &dyn Host) -> Result<Shown> {
    let mut parts = Vec::new();
    for bench in BENCHES {
        let folder = process::root().join("benches").join(bench.name);
        let cargo = |line: &str| {
            let mut cargo = process::cargo(line);
            // As the measurements build them, whose results are then used again.
            cargo.current_dir(&folder).env("CARGO_TARGET_DIR", process::target().join(bench.name));
            if let (Tool::Clang, Some((c, cpp))) = (bench.needs[0], super::host::clang()) {
                cargo.env("CC", c).env("CXX", cpp);
            }
            if bench.needs.contains(&Tool::FastSimd) {
                fast_simd::use_clone(&mut cargo);
            }
            cargo
        };
        host.run(cargo("fmt --check"))?;
        parts.push((format!("{}, format", bench.name), Outcome::Passed));
        let lacks = bench.needs.iter().find_map(|tool| Some(skipped(*tool, host.lacks(*tool)?)));
        let outcome = match lacks {
            _ if bench.is_x86 && !cfg!(target_arch = "x86_64") => {
                Outcome::NotHere("its vectors are those of x86-64".into())
            }
            Some(skip) => skip,
            None => {
                bench.prepare.map_or(Ok(()), |prepare| host.own(prepare))?;
                host.run(cargo("clippy --release --locked --all-targets -- -D warnings"))?;
                host.run(cargo("build --release --locked"))?;
                Outcome::Passed
            }
        };
        parts.push((format!("{}, clippy and build", bench.name), outcome));
    }
    Ok(Shown { outcome: Outcome::Passed, parts })
}

/// A workspace of its own, whose library is in C++. Its entry points are searched by the step
/// `tests`; what a coverage-guided search needs is a nightly compiler and time.
fn fuzz(host: &dyn Host) -> Result<Shown> {
    let folder = process::root().join("fuzz");
    for line in ["fmt --check", "clippy --locked --all-targets -- -D warnings"] {
        let mut cargo = process::cargo(line);
        cargo.current_dir(&folder).env("CARGO_TARGET_DIR", process::target().join("fuzz"));
        host.run(cargo)?;
    }
    Ok(passed())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_list_without_tests_is_an_error() {
        assert!(require_tests("generation::schedules::x: test\n\n1 test, 0 benchmarks\n").is_ok());
        assert!(require_tests("\n0 tests, 0 benchmarks\n").is_err());
        assert!(require_tests("").is_err());
    }

    #[test]
    fn the_numbers_of_searches_are_those_of_the_command_to_repeat() {
        for (name, variable) in [
            ("schedules", format!("TOMBOLO_SCHEDULES={SCHEDULES} ")),
            ("long-schedules", format!("TOMBOLO_SCHEDULES={LONG_SCHEDULES} ")),
            ("long-simulation", format!("TOMBOLO_SIMULATION_SEEDS={LONG_SEEDS} ")),
        ] {
            let step = ALL.into_iter().chain(LONG).find(|step| step.name == name).unwrap();
            assert!(step.again.starts_with(&variable), "{name}");
        }
    }

    #[test]
    fn the_check_without_a_window_is_that_of_the_command_to_repeat() {
        let step = ALL.into_iter().find(|step| step.name == "build").unwrap();
        let check = process::check_without_window(&demo::PROGRAMS);
        let again: Vec<_> = step.again.split_whitespace().collect();
        for word in ["check", "--profile", "--no-default-features", "tombolo-server", "tombolo-view"] {
            let is_run = check.get_args().any(|argument| argument == word);
            assert!(is_run && again.contains(&word), "{word}");
        }
    }
}
