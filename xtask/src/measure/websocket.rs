//! `websocket`: the cases of Autobahn|Testsuite against an echo of the server's WebSocket layer.
//!
//! The suite is a program of Python 2.7; docs/measuring.md says how to install it. Its sections 12
//! and 13 need compression, which the layer does not have. As a control the suite runs against an
//! echo with a planted fault.

use super::run::Run;
use crate::process;
use crate::server::free_address;
use anyhow::{Context, Result, bail};
use bars::Bar;
use serde_json::{Value, json};
use std::fs;
use std::net::{SocketAddr, TcpStream};
use std::process::{Child, Command, Stdio};
use std::thread::sleep;
use std::time::{Duration, Instant};

/// The program of the suite, unless this variable names another path.
const SUITE: &str = "wstest";
const SUITE_VARIABLE: &str = "TOMBOLO_WSTEST";

/// The sections that apply, and the number of their cases in version 0.8.2 of the suite.
const SECTIONS: [&str; 9] = ["1.*", "2.*", "3.*", "4.*", "5.*", "6.*", "7.*", "9.*", "10.*"];
const CASES: f64 = 301.0;

/// The sections of the control: its fault concerns pings, which are in both.
const CONTROL_SECTIONS: [&str; 2] = ["2.*", "5.*"];

/// Cases that may pass without being strict: a fault that is found later than it could be.
const MAX_NOT_STRICT: f64 = 8.0;

/// The name of the echo in the report.
const AGENT: &str = "echo";

/// Time until the echo accepts connections.
const READY_WITHIN: Duration = Duration::from_secs(10);

/// Results of the suite's cases.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
struct Verdicts {
    passed: usize,
    not_strict: usize,
    /// Cases for information, which no behaviour fails.
    not_judged: usize,
    /// Names of the others.
    failed: Vec<String>,
}

/// Builds the echo and runs the suite.
///
/// # Errors
/// The suite is not installed, the echo was not built or did not start, or the suite left no
/// report.
pub fn rows(run: &mut Run) -> Result<Vec<Bar>> {
    let version = process::output(suite(&["--autobahnversion"]))
        .context("the suite cannot be run; docs/measuring.md says how to install it")?;
    process::run(process::build_example("echo")).context("the echo was not built")?;
    let tested = tested(run, "cases", &SECTIONS, &[])?;
    let control = self::tested(run, "control", &CONTROL_SECTIONS, &["--planted-fault"])?;
    let version = version.split_whitespace().collect::<Vec<_>>().join(" ");
    run.notes.push(format!("{version}; sections {}.", SECTIONS.join(", ")));
    let names = |failed: &[String]| if failed.is_empty() { "none".into() } else { failed.join(", ") };
    run.notes.push(format!("Failed: {}; of the control: {}.", names(&tested.failed), names(&control.failed)));
    Ok(bars_of(&tested, &control))
}

/// The rows. Without failed cases in the control nothing counts.
fn bars_of(tested: &Verdicts, control: &Verdicts) -> Vec<Bar> {
    let (passed, not_strict) = (tested.passed as f64, tested.not_strict as f64);
    let (not_judged, failed) = (tested.not_judged as f64, tested.failed.len() as f64);
    let can_fail = !control.failed.is_empty();
    let cases = passed + not_strict + not_judged + failed;
    vec![
        Bar::at_least("cases run", Some(cases), "", CASES),
        Bar::none("cases failed", (can_fail && cases > 0.0).then_some(failed)),
        Bar::reported("cases passed", Some(passed), ""),
        Bar::at_most("cases passed, but not strictly", Some(not_strict), "", MAX_NOT_STRICT),
        Bar::reported("cases that are not judged", Some(not_judged), ""),
        Bar::some(
            "failed cases of an echo with a planted fault (control)",
            Some(control.failed.len() as f64),
        ),
    ]
}

/// Runs the cases of some sections against an echo with these options.
fn tested(run: &Run, name: &str, sections: &[&str], options: &[&str]) -> Result<Verdicts> {
    let address = free_address()?;
    let _echo = Echo::start(address, options)?;
    let folder = run.file(name);
    // A report of an earlier run must not pass for one of this.
    let _ = fs::remove_dir_all(&folder);
    fs::create_dir_all(&folder).with_context(|| format!("cannot create {}", folder.display()))?;
    let spec = folder.join("spec.json");
    let text = json!({
        "outdir": folder,
        "servers": [{ "agent": AGENT, "url": format!("ws://{address}"), "options": { "version": 13 } }],
        "cases": sections,
        "exclude-cases": [],
        "exclude-agent-cases": {},
    });
    fs::write(&spec, text.to_string()).with_context(|| format!("cannot write {}", spec.display()))?;
    let mut suite = suite(&["--mode", "fuzzingclient", "--spec"]);
    let said = fs::File::create(folder.join("suite.log")).context("cannot write the suite's log")?;
    suite.arg(&spec).stdout(said.try_clone()?).stderr(said);
    println!("measure: {name}");
    process::run(suite)?;
    let report = folder.join("index.json");
    let text = fs::read_to_string(&report).with_context(|| format!("cannot read {}", report.display()))?;
    verdicts(&serde_json::from_str(&text).with_context(|| report.display().to_string())?)
}

/// The verdicts of a report: of each case one on what the echo did, and one on how it closed.
fn verdicts(report: &Value) -> Result<Verdicts> {
    let cases = report.get(AGENT).and_then(Value::as_object).context("the report names no case")?;
    let mut verdicts = Verdicts::default();
    for (case, said) in cases {
        let of = |field| said.get(field).and_then(Value::as_str).unwrap_or("MISSING");
        let (behaviour, close) = (of("behavior"), of("behaviorClose"));
        match (behaviour, close) {
            ("OK", "OK" | "INFORMATIONAL") => verdicts.passed += 1,
            ("NON-STRICT", "OK" | "INFORMATIONAL") => verdicts.not_strict += 1,
            ("INFORMATIONAL", "OK" | "INFORMATIONAL") => verdicts.not_judged += 1,
            _ => verdicts.failed.push(format!("{case} ({behaviour}, close {close})")),
        }
    }
    Ok(verdicts)
}

fn suite(arguments: &[&str]) -> Command {
    let program = std::env::var_os(SUITE_VARIABLE).unwrap_or_else(|| SUITE.into());
    let mut suite = process::command(program);
    suite.args(arguments);
    suite
}

/// The running echo, ended when it goes out of scope.
struct Echo(Child);

impl Echo {
    fn start(address: SocketAddr, options: &[&str]) -> Result<Self> {
        let mut echo = process::command(process::example("echo"));
        echo.arg(address.to_string()).args(options).stdin(Stdio::null());
        let echo = Self(echo.spawn().context("cannot start the echo")?);
        let deadline = Instant::now() + READY_WITHIN;
        while TcpStream::connect(address).is_err() {
            if Instant::now() > deadline {
                bail!("the echo does not accept connections at {address}");
            }
            sleep(Duration::from_millis(20));
        }
        Ok(echo)
    }
}

impl Drop for Echo {
    fn drop(&mut self) {
        process::stop(&mut self.0, Duration::from_secs(1));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn missed(tested: &Verdicts, control: &Verdicts) -> Vec<String> {
        bars_of(tested, control).into_iter().filter(Bar::is_missed).map(|row| row.name).collect()
    }

    #[test]
    fn a_case_passes_by_what_the_echo_did_and_by_how_it_closed() {
        let case = |behaviour, close| json!({ "behavior": behaviour, "behaviorClose": close });
        let report = json!({ AGENT: {
            "1.1": case("OK", "OK"),
            "1.2": case("OK", "INFORMATIONAL"),
            "1.3": case("OK", "FAILED"),
            "1.4": case("NON-STRICT", "OK"),
            "1.5": case("INFORMATIONAL", "INFORMATIONAL"),
            "1.6": case("FAILED", "OK"),
            "1.7": {},
        }});
        let verdicts = verdicts(&report).unwrap();
        assert_eq!((verdicts.passed, verdicts.not_strict, verdicts.not_judged), (2, 1, 1));
        let failed = ["1.3 (OK, close FAILED)", "1.6 (FAILED, close OK)", "1.7 (MISSING, close MISSING)"];
        assert_eq!(verdicts.failed, failed);
        assert!(super::verdicts(&json!({})).is_err());
    }

    #[test]
    fn each_bar_can_be_missed() {
        let good = Verdicts { passed: 298, not_judged: 3, ..Verdicts::default() };
        let failed = Verdicts { failed: vec!["2.1".into()], ..good.clone() };
        assert!(missed(&good, &failed).is_empty());
        assert_eq!(missed(&failed, &failed), ["cases failed"]);
        let fewer = Verdicts { passed: 297, ..good.clone() };
        assert_eq!(missed(&fewer, &failed), ["cases run"]);
        let not_strict = Verdicts { passed: 289, not_strict: 9, ..good.clone() };
        assert_eq!(missed(&not_strict, &failed), ["cases passed, but not strictly"]);
        assert_eq!(missed(&good, &good).len(), 2, "the control must fail");
        assert_eq!(missed(&Verdicts::default(), &failed), ["cases run", "cases failed"]);
    }
}
