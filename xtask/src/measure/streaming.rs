//! `streaming`: what a chunk costs in bytes and time, to make and to send, and what a server does
//! when too many ask at once.
//!
//! Needs `nginx` and `wrk` for the rival server, and for LERC what `benches/lerc` says: a C++
//! compiler and libclang.

use super::bars::{Bar, Row, worst};
use super::record::{self, Heading};
use super::report::{self, number};
use crate::process;
use crate::setup::{self, Extent};
use anyhow::{Context, Result};
use serde_json::{Value, json};
use std::path::Path;
use std::process::{Command, Stdio};

/// The benchmarks of `tombolo-load`, in the order in which they run.
const BENCHES: [&str; 6] = ["cached", "cold", "stampede", "idle", "fair", "overload"];

/// Rounds of each; figures are medians over them.
const ROUNDS: &str = "5";

/// Length of each timed part, seconds.
const SECONDS: &str = "3";

/// Answers of the stampede, if none is lost.
const ANSWERS: f64 = 10_000.0;

/// Clients that do nothing, besides those that warm the server up.
const IDLE: f64 = 1_000.0;

/// Builds, measures, prints, records.
///
/// # Errors
/// The build or the record failed, or a bar was missed.
pub fn run() -> Result<()> {
    setup::run(Extent::Headless)?;
    process::run(process::cargo("build --release --bin tombolo-lab --bin tombolo-server --bin tombolo-load"))
        .context("measure: the build failed")?;
    let folder = process::target().join("measure/streaming");
    std::fs::create_dir_all(&folder)
        .with_context(|| format!("measure: cannot create {}", folder.display()))?;
    let mut notes = Vec::new();
    let json = folder.join("codec.json");
    let mut lab = process::command(process::program("tombolo-lab"));
    lab.args(["codec", "--json"]).arg(&json);
    let mut measured = json!({ "codec": report::of(lab, &json, &mut notes)? });
    measured["lerc"] = lerc(&folder, &mut notes)?;
    let apart = cores_apart();
    for bench in BENCHES {
        let json = folder.join(format!("{bench}.json"));
        let report = report::of(load(bench, apart, &json), &json, &mut notes)?;
        measured[bench] = report.get("figures").cloned().unwrap_or_default();
    }

    let rows = rows(&measured);
    notes.splice(0..0, how(&measured, apart));
    let path = record::write(&Heading { name: "streaming", adapter: None, notes: &notes }, &rows)?;
    super::judge(&rows, &path)
}

/// The rival whose library is C++ and bound with libclang: in a package of its own. Where it cannot
/// be built its row misses and a note says why.
fn lerc(folder: &Path, notes: &mut Vec<String>) -> Result<Value> {
    let target = process::target().join("lerc");
    let mut build = process::cargo("build --release --locked --target-dir");
    build.arg(&target).current_dir(process::root().join("benches/lerc"));
    if !process::status(&mut build)?.success() {
        notes.push("LERC was not built: it needs a C++ compiler and libclang; run: apt-get install --no-install-recommends g++ libclang-dev".into());
        return Ok(Value::Null);
    }
    let json = folder.join("lerc.json");
    let mut bench = process::command(target.join("release/lerc-bench"));
    bench.arg(&json);
    report::of(bench, &json, notes)
}

/// The last core, if there are several and a way to keep to some: then the first is the server's
/// alone.
fn cores_apart() -> Option<usize> {
    let last = std::thread::available_parallelism().ok()?.get().checked_sub(1).filter(|last| *last > 0)?;
    let taskset = Command::new("taskset").arg("-V").stdout(Stdio::null()).stderr(Stdio::null()).status();
    taskset.is_ok_and(|status| status.success()).then_some(last)
}

/// A benchmark, with the server on the first core and the client on the others where `apart` says
/// so.
fn load(bench: &str, apart: Option<usize>, json: &Path) -> Command {
    let program = process::program("tombolo-load");
    let mut load = match apart {
        Some(last) => {
            let mut taskset = process::command("taskset");
            taskset.args(["-c", &format!("1-{last}")]).arg(program).args(["--server-cpus", "0"]);
            taskset
        }
        None => process::command(program),
    };
    load.args(["--bench", bench, "--rounds", ROUNDS, "--seconds", SECONDS, "--json"]).arg(json);
    load
}

/// Every figure beside its bar.
fn rows(measured: &Value) -> Vec<Row> {
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
    let is_overload = at("/overload/loads/4/load") == Some(5.0);
    let overload = |field: &str| at(&format!("/overload/{field}")).filter(|_| is_overload);
    vec![
        Row::new(
            "bytes of lossless heights over their entropy",
            codec(COMPACT, "of_entropy"),
            Bar::AtMost(1.08),
            "x",
        ),
        Row::new(
            "quantized-mesh: the same (control)",
            codec(SCAN_DELTA, "of_entropy"),
            Bar::AtLeast(1.08),
            "x",
        ),
        Row::new(
            "LERC: the same (control)",
            at("/lerc/bytes_per_sample")
                .zip(at("/codec/entropy_bytes_per_sample"))
                .map(|(bytes, entropy)| bytes / entropy),
            Bar::AtLeast(1.08),
            "x",
        ),
        Row::new("lossless codecs that lose something", lossy(false), Bar::AtMost(0.0), ""),
        Row::new("a lossy one (control)", lossy(true), Bar::AtLeast(1.0), ""),
        Row::new("decoding, cached level", codec(COMPACT, "decode_gb_per_s"), Bar::AtLeast(1.2), "GB/s"),
        Row::new("decoding, hot level", codec(FAST, "decode_gb_per_s"), Bar::AtLeast(3.0), "GB/s"),
        Row::new("PNG, 16 bits: the same (control)", codec(PNG, "decode_gb_per_s"), Bar::Under(1.2), "GB/s"),
        Row::new("new chunks a second and core", at("/cold/chunks_per_core_s"), Bar::AtLeast(25_000.0), ""),
        Row::new("cached chunks over nginx's replies", at("/cached/ratio_to_nginx"), Bar::AtLeast(2.0), "x"),
        Row::new(
            "share of nginx's time in which it was busy (control)",
            at("/cached/nginx_busy"),
            Bar::AtLeast(0.8),
            "",
        ),
        Row::new(
            "server CPU per GB, 64 clients, pushed",
            at("/cached/push_cpu_s_per_gb"),
            Bar::AtMost(0.35),
            "s",
        ),
        Row::new(
            "the same, chunk by chunk, 16 outstanding",
            at("/cached/server_cpu_s_per_gb"),
            Bar::Reported,
            "s",
        ),
        Row::new("stampede: generations", at("/stampede/generations"), Bar::AtMost(1.0), ""),
        Row::new("stampede: right answers", at("/stampede/answers"), Bar::AtLeast(ANSWERS), ""),
        Row::new(
            "memory of an idle client",
            at("/idle/rss_kib_per_client").filter(|_| at("/idle/sessions") >= Some(IDLE)),
            Bar::AtMost(48.0),
            "KiB",
        ),
        Row::new(
            "polite p99 beside a greedy client over alone",
            at("/fair/p99_ratio"),
            Bar::AtMost(1.3),
            "x",
        ),
        Row::new("Jain's index of their shares", at("/fair/jain_index"), Bar::AtLeast(0.95), ""),
        Row::new(
            "five times the capacity: goodput over peak",
            overload("goodput_of_peak"),
            Bar::AtLeast(0.9),
            "",
        ),
        Row::new("refusals, p99", overload("refusal_p99_ms"), Bar::AtMost(10.0), "ms"),
        Row::new("back to normal after", overload("recovery_s"), Bar::AtMost(2.0), "s"),
        Row::new("refused (control)", overload("loads/4/refused"), Bar::AtLeast(1.0), ""),
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

/// What the figures were measured with, and those that have no bar.
fn how(measured: &Value, apart: Option<usize>) -> Vec<String> {
    let at = |path: &str| measured.pointer(path).and_then(Value::as_f64).unwrap_or(f64::NAN);
    let cores = if apart.is_some() {
        "the server on the first core, the client on the others"
    } else {
        "server and client on the same cores"
    };
    let mut notes = vec![
        format!(
            "`tombolo-load --bench NAME --rounds {ROUNDS} --seconds {SECONDS}`, {cores}; figures are medians of the rounds, but for the counts and the memory, which are taken once, and the loads of the overload, which are those of the last round. `tombolo-lab codec` for the codecs: level-0 chunks with land, the shortest of 25 interleaved turns of each chunk."
        ),
        format!(
            "Entropy: order 0, of each chunk's plane residuals, {:.3} bytes a sample.",
            at("/codec/entropy_bytes_per_sample")
        ),
    ];
    for row in codecs(measured).iter().chain(measured.get("lerc").filter(|row| row.is_object())) {
        let of = |field: &str| number(row, field).unwrap_or(f64::NAN);
        notes.push(format!(
            "{}: {:.3} bytes a sample, {:.3} of the entropy; encoded in {:.1} us, decoded in {:.1} us ({:.2} GB/s).",
            row.get("codec").and_then(Value::as_str).unwrap_or("unknown"),
            of("bytes_per_sample"),
            of("bytes_per_sample") / at("/codec/entropy_bytes_per_sample"),
            of("encode_ns") / 1e3,
            of("decode_ns") / 1e3,
            of("decode_gb_per_s")
        ));
    }
    notes.push(format!(
        "New chunks: {:.1} us of CPU each, of which heights {:.1}, grass {:.1}, pyramids {:.1}, coding {:.1} and all the rest (requests, queues, sockets, and what is slower in a busy server) {:.1}. {:.0} bytes each; {:.0} % coded in haste, since much was waiting.",
        at("/cold/total_us"),
        at("/cold/stages/generate_us"),
        at("/cold/stages/grass_us"),
        at("/cold/stages/pyramids_us"),
        at("/cold/stages/encode_us"),
        at("/cold/stages/serve_us"),
        at("/cold/frame_bytes"),
        100.0 * at("/cold/hasty_share")
    ));
    notes.push(format!(
        "Cached, one by one: {:.0} chunks a second of {:.0} bytes, {:.2} CPU seconds a GB; nginx {:.0} replies a second, {:.2} CPU seconds a GB. Pushed, {:.0} outstanding: {:.0} chunks a second.",
        at("/cached/chunks_per_s"),
        at("/cached/frame_bytes"),
        at("/cached/server_cpu_s_per_gb"),
        at("/cached/nginx_replies_per_s"),
        at("/cached/nginx_cpu_s_per_gb"),
        at("/cached/push_window"),
        at("/cached/push_chunks_per_s")
    ));
    notes.push(format!(
        "Polite clients: p99 {:.1} ms alone, {:.1} ms beside the greedy one, whose share is {:.2} of the mean; Jain's index of the polite ones alone {:.3}.",
        at("/fair/p99_alone_ms"),
        at("/fair/p99_beside_greedy_ms"),
        at("/fair/greedy_share_of_mean"),
        at("/fair/jain_index_polite")
    ));
    for load in measured.pointer("/overload/loads").and_then(Value::as_array).into_iter().flatten() {
        let of = |field: &str| number(load, field).unwrap_or(f64::NAN);
        let refused = match number(load, "refusal_p99_ms") {
            Some(p99) => format!("{:.0} refused, p99 {p99:.1} ms", of("refused")),
            None => "none refused".into(),
        };
        notes.push(format!(
            "Load {} (of {:.0} a second): {:.0} chunks a second, p99 {:.1} ms; {refused}.",
            of("load"),
            at("/overload/capacity_per_s"),
            of("goodput_per_s"),
            of("chunk_p99_ms")
        ));
    }
    let rounds = |path: &str, digits: usize| {
        let rounds =
            measured.pointer(path).and_then(Value::as_array).into_iter().flatten().filter_map(Value::as_f64);
        rounds.map(|figure| format!("{figure:.digits$}")).collect::<Vec<_>>().join(", ")
    };
    notes.push(format!(
        "Round by round: new chunks a second and core {}; polite p99 over alone {}; goodput over peak {}.",
        rounds("/cold/chunks_per_core_s_rounds", 0),
        rounds("/fair/p99_ratio_rounds", 2),
        rounds("/overload/goodput_of_peak_rounds", 2)
    ));
    notes
}

#[cfg(test)]
mod tests {
    use super::*;

    fn measured() -> Value {
        let codec = |name, of_entropy, rate, lossless| json!({ "codec": name, "of_entropy": of_entropy, "decode_gb_per_s": rate, "lossless": lossless });
        json!({
            "codec": {
                "optimised": true,
                "entropy_bytes_per_sample": 0.8,
                "rows": [codec(COMPACT, 1.03, 1.6, true), codec(FAST, 1.3, 4.0, true), codec(SCAN_DELTA, 1.7, 0.2, true), codec(PNG, 1.8, 0.2, true), codec(LOSSY, 0.9, 1.6, false)],
            },
            "lerc": { "bytes_per_sample": 1.4 },
            "cold": { "chunks_per_core_s": 26_000.0 },
            "cached": { "ratio_to_nginx": 2.9, "nginx_busy": 0.97, "push_cpu_s_per_gb": 0.3, "server_cpu_s_per_gb": 0.5 },
            "stampede": { "generations": 1.0, "answers": 10_000 },
            "idle": { "rss_kib_per_client": 5.0, "sessions": 1050.0 },
            "fair": { "p99_ratio": 1.1, "jain_index": 0.98 },
            "overload": { "goodput_of_peak": 0.95, "refusal_p99_ms": 3.0, "recovery_s": 0.1, "loads": [{}, {}, {}, {}, { "load": 5.0, "refused": 1000 }] },
        })
    }

    fn missed(measured: &Value) -> usize {
        let rows = rows(measured);
        assert_eq!(rows.len(), 22);
        rows.iter().filter(|row| !row.is_met()).count()
    }

    #[test]
    fn a_good_report_meets_every_bar() {
        assert_eq!(missed(&measured()), 0);
    }

    #[test]
    fn every_missing_field_is_a_miss() {
        for (path, field, expected) in [
            ("", "codec", 8),
            ("", "lerc", 1),
            ("/codec", "entropy_bytes_per_sample", 1),
            ("/codec", "optimised", 5),
            ("/codec", "rows", 7),
            ("/codec/rows/0", "of_entropy", 1),
            ("/codec/rows/1", "decode_gb_per_s", 1),
            ("/codec/rows/3", "lossless", 1),
            ("", "cold", 1),
            ("", "cached", 4),
            ("", "stampede", 2),
            ("", "idle", 1),
            ("/idle", "sessions", 1),
            ("", "fair", 2),
            ("", "overload", 4),
            ("/overload", "loads", 4),
            ("/overload/loads/4", "load", 4),
            ("/overload", "recovery_s", 1),
        ] {
            for lost in [None, Some(Value::Null), Some(json!("much"))] {
                let mut measured = measured();
                let fields = measured.pointer_mut(path).unwrap().as_object_mut().unwrap();
                fields.remove(field);
                fields.extend(lost.map(|lost| (field.to_string(), lost)));
                assert_eq!(missed(&measured), expected, "{path} {field}");
            }
        }
        assert_eq!(missed(&Value::Null), 22);
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
            ("/cold/chunks_per_core_s", json!(24_999.0)),
            ("/cached/ratio_to_nginx", json!(1.99)),
            ("/cached/nginx_busy", json!(0.18)),
            ("/cached/push_cpu_s_per_gb", json!(0.36)),
            ("/stampede/generations", json!(2)),
            ("/stampede/answers", json!(9_999)),
            ("/idle/rss_kib_per_client", json!(49)),
            ("/idle/sessions", json!(999)),
            ("/fair/p99_ratio", json!(1.31)),
            ("/fair/jain_index", json!(0.949)),
            ("/overload/goodput_of_peak", json!(0.89)),
            ("/overload/refusal_p99_ms", json!(10.1)),
            ("/overload/recovery_s", json!(2.1)),
            ("/overload/loads/4/refused", json!(0)),
        ] {
            let mut measured = measured();
            *measured.pointer_mut(path).unwrap() = value;
            assert_eq!(missed(&measured), 1, "{path}");
        }
    }
}
