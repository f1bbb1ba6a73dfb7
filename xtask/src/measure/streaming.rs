//! `streaming`: bytes and time of a chunk, and the server's throughput, fairness and behaviour
//! under overload.
//!
//! The server's figures and their bars come from `tombolo-server-bench`; those of the codecs from
//! `tombolo-lab codec` and, for LERC, from `benches/lerc`, which needs a C++ compiler and libclang.
//! The comparison with nginx needs `nginx` and `wrk`.

use super::record::{self, Heading};
use super::report::{self, number};
use crate::process;
use crate::setup::{self, Extent};
use anyhow::{Context, Result};
use bars::{Bar, Limit, worst};
use serde_json::{Value, json};
use std::path::Path;
use std::process::{Command, Stdio};

/// The benchmarks of `tombolo-server-bench`, in the order in which they run.
const BENCHES: [&str; 7] = ["cached", "cold", "stampede", "idle", "fair", "overload", "flood"];

/// Rounds of each; figures are medians over them.
const ROUNDS: &str = "5";

/// Length of each timed part, seconds.
const SECONDS: &str = "3";

/// Bytes of a chunk's heights as `u16`, which decoding rates refer to.
const HEIGHT_BYTES: f64 = 65.0 * 65.0 * 2.0;

/// Shown where LERC could not be built.
const LERC_NOT_BUILT: &str = "LERC was not built: it needs a C++ compiler and libclang; run: \
    apt-get install --no-install-recommends g++ libclang-dev";

/// Builds, measures, prints, records.
///
/// # Errors
/// The build or the record failed, or a bar was missed.
pub fn run() -> Result<()> {
    setup::run(Extent::Headless)?;
    let programs = ["tombolo-lab", "tombolo-server", "tombolo-server-bench"];
    process::run(process::build(&programs)).context("measure: the build failed")?;
    let folder = process::target().join("measure/streaming");
    std::fs::create_dir_all(&folder)
        .with_context(|| format!("measure: cannot create {}", folder.display()))?;
    let mut notes = Vec::new();
    let json = folder.join("codec.json");
    let mut lab = process::command(process::program("tombolo-lab"));
    lab.args(["codec", "--json"]).arg(&json);
    let mut codecs = json!({ "codec": report::of(lab, &json, &mut notes)? });
    codecs["lerc"] = lerc(&folder, &mut notes)?;
    let mut rows = codec_rows(&codecs);
    notes.splice(0..0, codec_notes(&codecs));
    let server_cores = separate_cores();
    notes.insert(0, how(server_cores));
    for bench in BENCHES {
        let json = folder.join(format!("{bench}.json"));
        let report = report::of(server_bench(bench, server_cores, &json), &json, &mut notes)?;
        rows.extend(server_rows(bench, &report));
        notes.extend(server_notes(&report));
    }
    let path = record::write(&Heading { name: "streaming", adapter: None, notes: &notes }, &rows)?;
    super::judge(&rows, &path)
}

/// LERC, whose library is C++ and bound with libclang, in a package of its own. If it cannot be
/// built, its row misses and a note says why.
fn lerc(folder: &Path, notes: &mut Vec<String>) -> Result<Value> {
    let target = process::target().join("lerc");
    let mut build = process::cargo("build --release --locked --target-dir");
    build.arg(&target).current_dir(process::root().join("benches/lerc"));
    if !process::status(&mut build)?.success() {
        notes.push(LERC_NOT_BUILT.into());
        return Ok(Value::Null);
    }
    let json = folder.join("lerc.json");
    let mut bench = process::command(target.join("release/lerc-bench"));
    bench.arg(&json);
    report::of(bench, &json, notes)
}

/// The last core, if there are several and `taskset` is installed: then the server has the first
/// core for itself.
fn separate_cores() -> Option<usize> {
    let last = std::thread::available_parallelism().ok()?.get().checked_sub(1).filter(|last| *last > 0)?;
    let taskset = Command::new("taskset").arg("-V").stdout(Stdio::null()).stderr(Stdio::null()).status();
    taskset.is_ok_and(|status| status.success()).then_some(last)
}

/// A benchmark, with the server on the first core and the client on the others up to `last`, if
/// given.
fn server_bench(bench: &str, last: Option<usize>, json: &Path) -> Command {
    let program = process::program("tombolo-server-bench");
    let mut command = match last {
        Some(last) => {
            let mut taskset = process::command("taskset");
            taskset.args(["-c", &format!("1-{last}")]).arg(program).args(["--server-cpus", "0"]);
            taskset
        }
        None => process::command(program),
    };
    command.args([bench, "--rounds", ROUNDS, "--seconds", SECONDS, "--json"]).arg(json);
    command
}

/// The bars of a benchmark's report, judged again. A report without bars is one row that misses.
fn server_rows(bench: &str, report: &Value) -> Vec<Bar> {
    let bars: Option<Vec<Bar>> =
        report.get("bars").and_then(|bars| serde_json::from_value(bars.clone()).ok());
    let bars = bars.unwrap_or_default();
    if bars.is_empty() {
        return vec![Bar::new(format!("{bench}: no bars were reported"), None, "", Limit::Reported)];
    }
    bars
}

/// The definitions of a report's figures, and its further figures.
fn server_notes(report: &Value) -> Vec<String> {
    let list = |field: &str| report.get(field).and_then(Value::as_array).into_iter().flatten();
    let text = |value: &Value, field: &str| value.get(field).and_then(Value::as_str).map(str::to_owned);
    let definitions =
        list("bars").filter_map(|bar| Some(format!("{}: {}.", text(bar, "name")?, text(bar, "note")?)));
    definitions.chain(list("notes").filter_map(Value::as_str).map(str::to_owned)).collect()
}

/// The codecs' figures with their bars.
fn codec_rows(measured: &Value) -> Vec<Bar> {
    let at = |path: &str| measured.pointer(path).and_then(Value::as_f64);
    let codec = |name: &str, field: &str| {
        let is_optimised = measured.pointer("/codec/optimised") == Some(&Value::Bool(true));
        let of_name = |row: &&Value| row.get("codec").and_then(Value::as_str) == Some(name);
        codecs(measured).iter().find(of_name).filter(|_| is_optimised).and_then(|row| number(row, field))
    };
    let lossy = |is_control: bool| {
        let of_sort = |row: &&Value| is_control == (row.get("codec").and_then(Value::as_str) == Some(LOSSY));
        let is_lossy = |row: &Value| Some(f64::from(!row.get("lossless")?.as_bool()?));
        worst(&codecs(measured).iter().filter(of_sort).map(is_lossy).collect::<Vec<_>>())
    };
    let whole_frame = |name: &str| codec(name, "decode_frame_ns").map(|ns| HEIGHT_BYTES / ns);
    vec![
        Bar::new(
            "bytes of lossless heights over their entropy",
            codec(COMPACT, "of_entropy"),
            "x",
            Limit::AtMost(1.08),
        ),
        Bar::new(
            "scan deltas and gzip, as in quantized-mesh: the same (control)",
            codec(SCAN_DELTA, "of_entropy"),
            "x",
            Limit::AtLeast(1.08),
        ),
        Bar::new(
            "LERC: the same (control)",
            at("/lerc/bytes_per_sample")
                .zip(at("/codec/entropy_bytes_per_sample"))
                .map(|(bytes, entropy)| bytes / entropy),
            "x",
            Limit::AtLeast(1.08),
        ),
        Bar::new("lossless codecs that lose something", lossy(false), "", Limit::AtMost(0.0)),
        Bar::new("a lossy one (control)", lossy(true), "", Limit::AtLeast(1.0)),
        Bar::new(
            "decoding heights alone, cached level",
            codec(COMPACT, "decode_gb_per_s"),
            "GB/s",
            Limit::AtLeast(1.2),
        ),
        Bar::new(
            "decoding heights alone, hot level",
            codec(FAST, "decode_gb_per_s"),
            "GB/s",
            Limit::AtLeast(3.0),
        ),
        Bar::new(
            "whole frame to verified chunk, cached level",
            whole_frame(COMPACT),
            "GB/s",
            Limit::Reported,
        ),
        Bar::new("whole frame to verified chunk, hot level", whole_frame(FAST), "GB/s", Limit::Reported),
        Bar::new(
            "PNG, 16 bits: the same (control)",
            codec(PNG, "decode_gb_per_s"),
            "GB/s",
            Limit::Under(1.2),
        ),
    ]
}

/// Names that `tombolo-lab codec` gives.
const COMPACT: &str = "exact, compact";
const FAST: &str = "exact, fast";
const SCAN_DELTA: &str = "scan deltas, zigzag, gzip 6 (quantized-mesh)";
const PNG: &str = "PNG, 16 bits, adaptive filters";
const LOSSY: &str = "control: quantised to 1/256 m";

fn codecs(measured: &Value) -> &[Value] {
    measured.pointer("/codec/rows").and_then(Value::as_array).map_or(&[], Vec::as_slice)
}

/// The conditions of the run.
fn how(server_cores: Option<usize>) -> String {
    let cores = if server_cores.is_some() {
        "the server on the first core, the client on the others"
    } else {
        "server and client on the same cores"
    };
    format!(
        "`tombolo-server-bench NAME --rounds {ROUNDS} --seconds {SECONDS}`, {cores}; figures are medians \
         of the rounds, except counts and memory, which are measured once. `tombolo-lab codec` for the \
         codecs: level-0 chunks with land, the shortest of 25 interleaved turns of each chunk. Rates of \
         decoding are bytes of u16 heights; heights alone are decoded into existing memory, without \
         digest, grass and pyramids, which a whole frame includes."
    )
}

/// Figures of the codecs that have no bar.
fn codec_notes(measured: &Value) -> Vec<String> {
    let at = |path: &str| measured.pointer(path).and_then(Value::as_f64).unwrap_or(f64::NAN);
    let mut notes = vec![format!(
        "Entropy: order 0, of each chunk's plane residuals, {:.3} bytes a sample.",
        at("/codec/entropy_bytes_per_sample")
    )];
    for row in codecs(measured).iter().chain(measured.get("lerc").filter(|row| row.is_object())) {
        let of = |field: &str| number(row, field).unwrap_or(f64::NAN);
        notes.push(format!(
            "{}: {:.3} bytes a sample, {:.3} of the entropy; encoded in {:.1} us, decoded in {:.1} us \
             ({:.2} GB/s).",
            row.get("codec").and_then(Value::as_str).unwrap_or("unknown"),
            of("bytes_per_sample"),
            of("bytes_per_sample") / at("/codec/entropy_bytes_per_sample"),
            of("encode_ns") / 1e3,
            of("decode_ns") / 1e3,
            of("decode_gb_per_s")
        ));
    }
    notes
}

#[cfg(test)]
mod tests {
    use super::*;

    fn measured() -> Value {
        let codec = |name, of_entropy, rate, lossless| {
            json!({
                "codec": name, "of_entropy": of_entropy, "decode_gb_per_s": rate, "lossless": lossless,
                "decode_frame_ns": 10_000.0,
            })
        };
        json!({
            "codec": {
                "optimised": true,
                "entropy_bytes_per_sample": 0.8,
                "rows": [
                    codec(COMPACT, 1.03, 1.6, true),
                    codec(FAST, 1.3, 4.0, true),
                    codec(SCAN_DELTA, 1.7, 0.2, true),
                    codec(PNG, 1.8, 0.2, true),
                    codec(LOSSY, 0.9, 1.6, false),
                ],
            },
            "lerc": { "bytes_per_sample": 1.4 },
        })
    }

    fn missed(measured: &Value) -> usize {
        let rows = codec_rows(measured);
        assert_eq!(rows.len(), 10);
        rows.iter().filter(|row| row.is_missed()).count()
    }

    #[test]
    fn a_good_report_meets_every_bar() {
        assert_eq!(missed(&measured()), 0);
    }

    #[test]
    fn every_missing_field_is_a_miss() {
        for (path, field, expected) in [
            ("", "codec", 10),
            ("", "lerc", 1),
            ("/codec", "entropy_bytes_per_sample", 1),
            ("/codec", "optimised", 7),
            ("/codec", "rows", 9),
            ("/codec/rows/0", "of_entropy", 1),
            ("/codec/rows/1", "decode_gb_per_s", 1),
            ("/codec/rows/1", "decode_frame_ns", 1),
            ("/codec/rows/3", "lossless", 1),
        ] {
            for lost in [None, Some(Value::Null), Some(json!("much"))] {
                let mut measured = measured();
                let fields = measured.pointer_mut(path).unwrap().as_object_mut().unwrap();
                fields.remove(field);
                fields.extend(lost.map(|lost| (field.to_string(), lost)));
                assert_eq!(missed(&measured), expected, "{path} {field}");
            }
        }
        assert_eq!(missed(&Value::Null), 10);
    }

    #[test]
    fn each_bar_can_be_missed() {
        for (path, value) in [
            ("/codec/rows/0/of_entropy", json!(1.09)),
            ("/codec/rows/2/of_entropy", json!(1.0)),
            ("/lerc/bytes_per_sample", json!(0.8)),
            ("/codec/rows/1/lossless", json!(false)),
            ("/codec/rows/4/lossless", json!(true)),
            ("/codec/rows/0/decode_gb_per_s", json!(1.19)),
            ("/codec/rows/1/decode_gb_per_s", json!(2.9)),
            ("/codec/rows/3/decode_gb_per_s", json!(1.2)),
        ] {
            let mut measured = measured();
            *measured.pointer_mut(path).unwrap() = value;
            assert_eq!(missed(&measured), 1, "{path}");
        }
    }

    #[test]
    fn bars_of_a_benchmark_are_judged_again() {
        let report = json!({
            "bars": [
                { "name": "a", "figure": 1.0, "unit": "ms", "direction": "at_most", "bar": 2.0, "note": "n" },
                { "name": "b", "figure": 3.0, "unit": "", "direction": "at_most", "bar": 2.0, "met": true },
                { "name": "c", "figure": null, "direction": "reported", "bar": null, "met": true },
            ],
            "notes": ["further"],
        });
        let met: Vec<_> = server_rows("idle", &report).iter().map(Bar::is_met).collect();
        assert_eq!(met, [true, false, false]);
        assert_eq!(server_notes(&report), ["a: n.", "further"]);
    }

    #[test]
    fn a_report_without_bars_is_a_miss() {
        for report in [Value::Null, json!({}), json!({ "bars": [] }), json!({ "bars": [{ "name": "a" }] })] {
            let rows = server_rows("idle", &report);
            assert_eq!(rows.len(), 1);
            assert!(!rows[0].is_met() && rows[0].name.contains("idle"));
        }
    }
}
