//! `ci`: everything that a change must pass, in the order in which failures are cheapest.

use crate::dependency_rules;
use crate::process;
use crate::setup::{self, Extent};
use anyhow::{Context, Result, bail};
use std::collections::BTreeSet;
use std::process::{Command, Stdio};
use std::time::Instant;

/// Versions installed where the tools are missing; any that is there already is used.
const NEXTEST: &str = "0.9.143";
const DENY: &str = "0.20.2";

/// What a step that did not fail has shown.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Outcome {
    Passed,
    /// It could not look, has said why, and proves nothing.
    Skipped,
}

/// One step: what it is called and what it does. `Err` stops the run.
struct Step {
    name: &'static str,
    /// How to repeat it alone.
    again: String,
    action: Box<dyn FnOnce() -> Result<Outcome>>,
}

/// Runs every step, stops at the first that fails.
///
/// # Errors
/// The step that failed and how to repeat it alone.
pub fn run() -> Result<()> {
    setup::run(Extent::Headless)?;
    setup::cargo_tool("nextest --version", "cargo-nextest", NEXTEST)?;
    setup::cargo_tool("deny --version", "cargo-deny", DENY)?;
    let began = Instant::now();
    let mut skipped = Vec::new();
    for step in steps() {
        println!("\n== {}", step.name);
        let step_began = Instant::now();
        let outcome = (step.action)()
            .with_context(|| format!("ci: {} failed; repeat it with: {}", step.name, step.again))?;
        let word = match outcome {
            Outcome::Passed => "ok",
            Outcome::Skipped => {
                skipped.push(step.name);
                "SKIPPED"
            }
        };
        println!("== {}: {word}, {:.1} s", step.name, step_began.elapsed().as_secs_f64());
    }
    let without =
        if skipped.is_empty() { String::new() } else { format!(" (skipped: {})", skipped.join(", ")) };
    println!("\nci: all passed in {:.0} s{without}", began.elapsed().as_secs_f64());
    Ok(())
}

fn steps() -> Vec<Step> {
    let cargo = |name, line: &str| command_step(name, process::cargo(line));
    let mut docs = process::cargo("doc --workspace --no-deps");
    docs.env("RUSTDOCFLAGS", "-D warnings");
    let mut tests = process::cargo("nextest run --workspace");
    // Setup has installed a software driver, so pictures that are not drawn are a failure.
    tests.env("TOMBOLO_REQUIRE_GPU", "1");
    vec![
        cargo("format", "fmt --all --check"),
        own_step("source text", "cargo xtask source", source),
        own_step("architecture", "cargo tree --package PACKAGE", architecture),
        cargo("licences, bans and sources", "deny check bans licenses sources"),
        own_step("advisories", "cargo deny check advisories", advisories),
        cargo("clippy", "clippy --workspace --all-targets -- -D warnings"),
        cargo("build", "build --workspace --all-targets"),
        command_step("tests", tests),
        cargo("doc tests", "test --workspace --doc"),
        own_step("shaders", "cargo nextest run --package shaders", shaders),
        own_step("digest of every backend", "cargo run --bin tombolo-lab -- digest", digest),
        own_step("WebAssembly", "cargo check --target wasm32-unknown-unknown --package terrain", webassembly),
        Step {
            again: "RUSTDOCFLAGS='-D warnings' cargo doc --workspace --no-deps".into(),
            ..command_step("documentation", docs)
        },
    ]
}

fn command_step(name: &'static str, mut command: Command) -> Step {
    let again = process::shown(&command);
    let action = move || {
        let status = process::status(&mut command)?;
        if status.success() { Ok(Outcome::Passed) } else { bail!("{status}") }
    };
    Step { name, again, action: Box::new(action) }
}

fn own_step(name: &'static str, again: &str, action: fn() -> Result<Outcome>) -> Step {
    Step { name, again: again.into(), action: Box::new(action) }
}

fn source() -> Result<Outcome> {
    crate::source::run().map(|()| Outcome::Passed)
}

fn architecture() -> Result<Outcome> {
    dependency_rules::check().map(|()| Outcome::Passed)
}

/// Known vulnerabilities, where the database of them can be had.
fn advisories() -> Result<Outcome> {
    if let Err(why) = process::output(process::cargo("deny fetch db")) {
        println!("SKIPPED: the advisory database cannot be fetched: {why:#}");
        return Ok(Outcome::Skipped);
    }
    process::run(process::cargo("deny check --disable-fetch advisories")).map(|()| Outcome::Passed)
}

/// Every backend of this machine computes the same integers; the table says which were skipped, and
/// why.
fn digest() -> Result<Outcome> {
    // Without --package: one package alone would be built with other features.
    let mut lab = process::cargo("run --quiet --bin tombolo-lab -- digest");
    lab.env("TOMBOLO_REQUIRE_GPU", "1");
    process::quiet_drivers(&mut lab);
    process::run(lab).map(|()| Outcome::Passed)
}

/// The crates that a browser will run, with and without its vectors; the land's kernels are run too
/// where Node is installed.
fn webassembly() -> Result<Outcome> {
    const TARGET: &str = "wasm32-unknown-unknown";
    let mut add = process::command("rustup");
    add.args(["target", "add", TARGET]);
    if let Err(why) = process::output(add) {
        println!("SKIPPED: the target {TARGET} is not installed and cannot be: {why:#}");
        return Ok(Outcome::Skipped);
    }
    let check = format!("check --target {TARGET} --package terrain --package protocol --package shaders");
    process::run(process::cargo(&check))?;
    let build = format!("build --release --target {TARGET} --package terrain --example kernels_wasm");
    let mut build = process::cargo(&build);
    build.env("CARGO_TARGET_WASM32_UNKNOWN_UNKNOWN_RUSTFLAGS", "-C target-feature=+simd128");
    process::run(build)?;

    let mut node = process::command("node");
    node.args(["-e", RUN_KERNELS])
        .arg(process::target().join(TARGET).join("release/examples/kernels_wasm.wasm"));
    let (Ok(_), Ok(here)) = (process::output(node_version()), process::output(process::cargo(KERNELS)))
    else {
        println!("SKIPPED: Node is not installed; the module was built and not run");
        return Ok(Outcome::Skipped);
    };
    let there = process::output(node)?;
    println!("native:\n{here}WebAssembly:\n{there}");
    let digests: BTreeSet<_> =
        here.lines().chain(there.lines()).filter_map(|line| line.rsplit(' ').next()).collect();
    if digests.len() == 1 { Ok(Outcome::Passed) } else { bail!("the kernels' digests differ: {digests:?}") }
}

/// Prints the digests of every kernel of this machine.
const KERNELS: &str = "run --quiet --example kernels";

/// Prints those of a WebAssembly module.
const RUN_KERNELS: &str =
    "const module = new WebAssembly.Module(require('fs').readFileSync(process.argv[1]));
const { scalar, best } = new WebAssembly.Instance(module).exports;
for (const [name, call] of [['scalar', scalar], ['simd128', best]])
    console.log(name, BigInt.asUintN(64, call()).toString(16).padStart(16, '0'));";

fn node_version() -> Command {
    let mut node = process::command("node");
    node.arg("--version");
    node
}

/// The shaders' own tests once more by themselves: naga always, Tint where it is installed. Which
/// of them looked must be said here, because the output of passing tests is not shown.
fn shaders() -> Result<Outcome> {
    // Whether it can be started at all; its exit code for a question about itself means nothing.
    let tint = process::command("tint").arg("--help").stdout(Stdio::null()).stderr(Stdio::null()).status();
    if tint.is_ok() {
        println!("tint is on PATH: shaders are checked by naga and by Tint");
    } else {
        println!("SKIPPED: `tint` is not on PATH; shaders are checked by naga only");
    }
    // Chosen among the workspace: one package alone would be built with other features.
    process::run(process::cargo("nextest run --workspace -E package(shaders)")).map(|()| Outcome::Passed)
}
