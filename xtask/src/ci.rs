//! `ci`: everything that a change must pass, in the order in which failures are cheapest.

use crate::absence;
use crate::process;
use crate::setup::{self, Extent};
use anyhow::{Context, Result};
use std::process::Command;
use std::time::Instant;

/// Versions installed where the tools are missing; any that is there already is used.
const NEXTEST: &str = "0.9.143";
const DENY: &str = "0.20.2";

/// One step: what it is called and what it does. `Err` stops the run.
struct Step {
    name: &'static str,
    /// How to repeat it alone.
    again: String,
    action: Box<dyn FnOnce() -> Result<()>>,
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
    for step in steps() {
        println!("\n== {}", step.name);
        let step_began = Instant::now();
        (step.action)()
            .with_context(|| format!("ci: {} failed; repeat it with: {}", step.name, step.again))?;
        println!("== {}: ok, {:.1} s", step.name, step_began.elapsed().as_secs_f64());
    }
    println!("\nci: all passed in {:.0} s", began.elapsed().as_secs_f64());
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
        own_step("architecture", "cargo tree", absence::check),
        cargo("licences, bans and sources", "deny check bans licenses sources"),
        own_step("advisories", "cargo deny check advisories", advisories),
        cargo("clippy", "clippy --workspace --all-targets -- -D warnings"),
        cargo("build", "build --workspace --all-targets"),
        command_step("tests", tests),
        cargo("doc tests", "test --workspace --doc"),
        own_step("shaders", "cargo nextest run --package shaders", shaders),
        Step {
            again: "RUSTDOCFLAGS='-D warnings' cargo doc --workspace --no-deps".into(),
            ..command_step("documentation", docs)
        },
    ]
}

fn command_step(name: &'static str, command: Command) -> Step {
    Step { name, again: process::shown(&command), action: Box::new(|| process::run(command)) }
}

fn own_step(name: &'static str, again: &str, action: fn() -> Result<()>) -> Step {
    Step { name, again: again.into(), action: Box::new(action) }
}

/// Known vulnerabilities, where the database of them can be had.
fn advisories() -> Result<()> {
    if let Err(why) = process::output(process::cargo("deny fetch db")) {
        println!("SKIPPED: the advisory database cannot be fetched: {why:#}");
        return Ok(());
    }
    process::run(process::cargo("deny check --disable-fetch advisories"))
}

/// The shaders' own tests again with their output shown: naga always, Tint where it is installed. The line that says which
/// must not be hidden among passing tests.
fn shaders() -> Result<()> {
    let mut tint = process::command("tint");
    tint.arg("--version");
    if process::output(tint).is_ok() {
        println!("tint is on PATH: shaders are checked by naga and by Tint");
    } else {
        println!("SKIPPED: `tint` is not on PATH; shaders are checked by naga only");
    }
    // Chosen among the workspace: one package alone would be built anew with other features.
    process::run(process::cargo("nextest run --workspace -E package(shaders)"))
}
