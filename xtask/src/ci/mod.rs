//! `ci`: everything that a change must pass. A run is green only if every step looked: what could
//! not look is skipped, and a skip that is not allowed by name fails the run.

mod digest;
mod host;
mod outcome;
pub mod rehearsal;
mod steps;

use crate::process;
use crate::setup::{self, Extent};
use anyhow::{Result, bail};
use host::{Here, Host, Tool};
use outcome::{Line, Outcome, Report};
use std::time::Instant;
use steps::Step;

/// Versions installed where the tools are missing; any that is there already is used.
const NEXTEST: &str = "0.9.143";
const DENY: &str = "0.20.2";

/// Options of `ci`.
#[derive(Clone, Debug, Default, clap::Args)]
pub struct Options {
    /// Steps or tools without which the run may be green, by the names of the list
    #[arg(long, value_delimiter = ',', value_name = "NAME")]
    pub allow_skips: Vec<String>,
    /// Run these steps alone; nothing is installed or downloaded
    #[arg(long, value_delimiter = ',', value_name = "STEP")]
    pub only: Vec<String>,
    /// Run the long searches, too: 1,000 seeds of the simulation, and more schedules
    #[arg(long, conflicts_with = "only")]
    pub long: bool,
    /// Print the steps and the tools that they look with
    #[arg(long)]
    pub list: bool,
}

/// Runs the steps up to the first that fails and prints the list of all outcomes.
///
/// # Errors
/// A name that is not known, a step that failed, or a skip that is not allowed.
pub fn run(options: &Options) -> Result<()> {
    let chosen = choose(options)?;
    if options.list {
        list(&Here::new());
        return Ok(());
    }
    let is_whole = options.only.is_empty();
    let host = if is_whole { equipped()? } else { Here::new() };
    let began = Instant::now();
    let report = Report { allowed: options.allow_skips.clone(), ..Report::default() };
    let report = run_steps(&host, &chosen, report);
    println!("\n{report}");
    let seconds = began.elapsed().as_secs_f64();
    let faults: Vec<_> = report.faults().collect();
    if !report.is_green() {
        let again = faults.iter().filter(|line| matches!(line.outcome, Outcome::Failed(_)));
        for step in again.filter_map(|line| chosen.iter().find(|step| step.name == line.step)) {
            println!("repeat {} with: {}", step.name, step.again);
        }
        bail!("ci: {} failed or were skipped, in {seconds:.0} s", faults.len());
    }
    let what = if is_whole { "all steps" } else { "the chosen steps, not the whole," };
    println!("ci: {what} passed in {seconds:.0} s");
    Ok(())
}

/// This machine with what can be installed and downloaded.
fn equipped() -> Result<Here> {
    setup::run(Extent::Checks)?;
    setup::cargo_tool("nextest --version", "cargo-nextest", NEXTEST)?;
    setup::cargo_tool("deny --version", "cargo-deny", DENY)?;
    Ok(Here::with_downloads())
}

/// The steps to run.
fn choose(options: &Options) -> Result<Vec<Step>> {
    let all = || steps::ALL.into_iter().chain(steps::LONG);
    let is_step = |name: &String| all().any(|step| step.name == name);
    let is_tool = |name: &String| Tool::ALL.iter().any(|tool| tool.name() == name);
    if let Some(unknown) = options.only.iter().find(|name| !is_step(name)) {
        bail!("ci: there is no step `{unknown}`; see: cargo ci --list");
    }
    if let Some(unknown) = options.allow_skips.iter().find(|name| !is_step(name) && !is_tool(name)) {
        bail!("ci: there is no step and no tool `{unknown}`; see: cargo ci --list");
    }
    if options.only.is_empty() {
        return Ok(if options.long { all().collect() } else { steps::ALL.into() });
    }
    Ok(all().filter(|step| options.only.iter().any(|name| name == step.name)).collect())
}

fn list(host: &dyn Host) {
    for step in steps::ALL {
        println!("step  {:<15}  {}", step.name, step.about);
    }
    for step in steps::LONG {
        println!("long  {:<15}  {}", step.name, step.about);
    }
    for tool in Tool::ALL {
        println!("tool  {:<15}  {}", tool.name(), host.lacks(tool).unwrap_or_else(|| "found".into()));
    }
}

/// Runs steps; those after a failure are skipped, since they would fail for its sake.
fn run_steps(host: &dyn Host, steps: &[Step], mut report: Report) -> Report {
    let mut failed: Option<&str> = None;
    for step in steps {
        let line = |part: String, outcome, took| Line { step: step.name, part, outcome, took };
        if let Some(earlier) = failed {
            let reason = format!("not run after the failure of {earlier}");
            let outcome = Outcome::Skipped { lacks: "an earlier step", reason };
            report.lines.push(line(String::new(), outcome, None));
            continue;
        }
        host.begin(step.name, step.about);
        let began = Instant::now();
        let shown = (step.action)(host);
        let took = Some(began.elapsed());
        match shown {
            Ok(shown) => {
                report.lines.push(line(String::new(), shown.outcome, took));
                for (part, outcome) in shown.parts {
                    report.lines.push(line(part, outcome, None));
                }
            }
            Err(why) => report.lines.push(line(String::new(), Outcome::Failed(format!("{why:#}")), took)),
        }
        let own = report.lines.iter().filter(|line| line.step == step.name);
        if own.clone().any(|line| matches!(line.outcome, Outcome::Failed(_))) {
            failed = Some(step.name);
        }
        if process::interrupted() {
            failed = Some(step.name);
        }
    }
    report
}

#[cfg(test)]
mod tests {
    use super::*;

    fn options(only: &[&str], allow_skips: &[&str]) -> Options {
        let owned = |names: &[&str]| names.iter().map(|name| (*name).to_owned()).collect();
        Options { only: owned(only), allow_skips: owned(allow_skips), ..Options::default() }
    }

    #[test]
    fn names_of_steps_and_tools_are_known_and_others_are_errors() {
        assert_eq!(choose(&options(&[], &[])).unwrap().len(), steps::ALL.len());
        let long = Options { long: true, ..Options::default() };
        assert_eq!(choose(&long).unwrap().len(), steps::ALL.len() + steps::LONG.len());
        assert_eq!(choose(&options(&["long-simulation"], &[])).unwrap().len(), 1);
        let chosen = choose(&options(&["docs", "format"], &["tint", "benches"])).unwrap();
        assert_eq!(chosen.iter().map(|step| step.name).collect::<Vec<_>>(), ["format", "docs"]);
        assert!(choose(&options(&["form"], &[])).is_err());
        assert!(choose(&options(&[], &["tin"])).is_err());
        assert!(choose(&options(&["tint"], &[])).is_err(), "a tool is no step");
    }
}
