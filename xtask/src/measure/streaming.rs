//! `streaming`: bytes and time of a chunk, and the server's throughput, fairness and behaviour
//! under overload.
//!
//! The server's figures and their bars come from `tombolo-server-bench`, those of the codecs from
//! `tombolo-lab codec`; LERC's figures from `benches/lerc`, which needs a C++ compiler and
//! libclang. The comparison with nginx needs `nginx` and `wrk`.

use super::run::Run;
use crate::process;
use anyhow::Result;
use bars::Bar;
use std::process::Command;

/// The benchmarks of `tombolo-server-bench`, in the order in which they run.
const BENCHES: [&str; 8] = ["cached", "http", "cold", "stampede", "idle", "fair", "overload", "mechanisms"];

/// Rounds of each; figures are medians over them.
const ROUNDS: &str = "5";

/// Length of each timed part, seconds.
const SECONDS: &str = "3";

/// Shown where LERC could not be built.
const LERC_NOT_BUILT: &str = "LERC was not built: it needs a C++ compiler and libclang; run: \
    apt-get install --no-install-recommends g++ libclang-dev";

/// Runs the benchmarks of codecs and server.
///
/// # Errors
/// A program cannot be started or was interrupted.
pub fn rows(run: &mut Run) -> Result<Vec<Bar>> {
    let last_core = separate_cores();
    run.notes.push(how(last_core.is_some()));
    lerc(run)?;
    let lerc = run.file("lerc.json");
    let codec = run.lab("codec", &["codec", "--lerc", &lerc.to_string_lossy()])?;
    let mut rows = run.rows_of("codec", &codec);
    for bench in BENCHES {
        let report = run.report(bench, server_bench(bench, last_core, ROUNDS, SECONDS), "--json")?;
        rows.extend(run.rows_of(bench, &report));
    }
    let report = run.report("framing", framing(), "--json")?;
    rows.extend(run.rows_of("framing", &report));
    Ok(rows)
}

/// LERC, whose library is C++ and bound with libclang, in a package of its own. If it cannot be
/// built, its row has no figure, and the record says why.
fn lerc(run: &mut Run) -> Result<()> {
    let target = process::target().join("lerc");
    let mut build = process::cargo("build --release --locked --target-dir");
    build.arg(&target).current_dir(process::root().join("benches/lerc"));
    // Figures of an earlier run must not pass for those of this.
    let _ = std::fs::remove_file(run.file("lerc.json"));
    if process::status(&mut build)?.success() {
        run.report("lerc", process::command(target.join("release/lerc-bench")), "")?;
    } else {
        run.faults.push(LERC_NOT_BUILT.into());
    }
    Ok(())
}

/// The last core, if there are several and `taskset` is installed: then the server has the first
/// core for itself.
pub fn separate_cores() -> Option<usize> {
    let last = std::thread::available_parallelism().ok()?.get().checked_sub(1).filter(|last| *last > 0)?;
    let mut taskset = Command::new("taskset");
    taskset.arg("-V");
    process::succeeds(taskset).then_some(last)
}

/// A benchmark, with the server on the first core and the client on the others up to `last`, if
/// given.
pub fn server_bench(bench: &str, last: Option<usize>, rounds: &str, seconds: &str) -> Command {
    let program = process::program("tombolo-server-bench");
    let mut command = match last {
        Some(last) => {
            let mut taskset = process::command("taskset");
            taskset.args(["-c", &format!("1-{last}")]).arg(program).args(["--server-cpus", "0"]);
            taskset
        }
        None => process::command(program),
    };
    command.args([bench, "--rounds", rounds, "--seconds", seconds]);
    command
}

/// The comparison of WebSocket framing, which links the server and so is no part of
/// `tombolo-server-bench`.
fn framing() -> Command {
    let mut command = process::cargo("bench --profile dist --package tombolo-server --bench framing --");
    command.args(["--rounds", ROUNDS, "--seconds", "1"]);
    command
}

/// Which cores server and clients have.
pub const fn cores(are_separate: bool) -> &'static str {
    if are_separate {
        "the server on the first core, the client on the others"
    } else {
        "server and client on the same cores"
    }
}

/// The conditions of the run.
fn how(has_separate_cores: bool) -> String {
    let cores = cores(has_separate_cores);
    format!(
        "`tombolo-server-bench NAME --rounds {ROUNDS} --seconds {SECONDS}`, {cores}; figures are medians \
         of the rounds, except counts and memory, which are measured once. `tombolo-lab codec` for the \
         codecs: level-0 chunks with land, the median of 25 interleaved turns of each chunk. Rates of \
         decoding are bytes of u16 heights; ours decode heights alone into existing memory, without digest, \
         grass and pyramids, which a whole frame includes; other codecs return memory of their own."
    )
}
