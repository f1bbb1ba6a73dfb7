//! `heightfield`: the land's noise against other libraries, what comes on top of it, and the GPU's
//! twin of it.
//!
//! Ratios come from `benches/noise-comparison`, a package outside the workspace: it needs a C++ compiler,
//! which nothing else here does.

use super::record::{self, Heading};
use super::report::{self, number};
use crate::process;
use anyhow::{Context, Result, bail};
use bars::{Bar, Limit};
use serde_json::Value;
use std::path::Path;

/// Times that the comparisons are started. Where a program's code and buffers happen to lie is
/// decided once per start and moves single figures by half, ours and of other libraries; the median start
/// counts.
const STARTS: usize = 7;

/// Rounds per start; all starts take half a minute on an idle machine, minutes on a busy one.
const ROUNDS: &str = "101";

/// How the names of backends that run on the CPU begin; all others are twins.
const CPU_BACKEND: &str = "rust";

/// Builds, measures, prints, records.
///
/// # Errors
/// The comparison cannot be built, the record cannot be written, or a bar was missed.
pub fn run() -> Result<()> {
    let folder = process::target().join("measure/heightfield");
    std::fs::create_dir_all(&folder)
        .with_context(|| format!("measure: cannot create {}", folder.display()))?;
    let mut notes = Vec::new();
    let rivals = rivals(&folder, &mut notes)?;
    let (digest, timings) = lab(&folder, &mut notes)?;

    let rows = rows(&rivals, &digest, &timings);
    notes.splice(0..0, how(&rivals, &digest, &timings));
    let adapter = timings.pointer("/gpu/adapter").and_then(Value::as_str);
    let path = record::write(&Heading { name: "heightfield", adapter, notes: &notes }, &rows)?;
    super::judge(&rows, &path)
}

/// Builds and runs the comparisons; one report per start.
fn rivals(folder: &Path, notes: &mut Vec<String>) -> Result<Vec<Value>> {
    let compiler = Clang::find()?;
    // In its own folder, so that its `.cargo/config.toml` is read too.
    let package = process::root().join("benches/noise-comparison");
    let target = process::target().join("noise-comparison");
    println!("measure: building the noise comparison with {}", compiler.cpp);
    let mut build = process::cargo("build --release --locked --target-dir");
    build.arg(&target).current_dir(&package).env("CC", &compiler.c).env("CXX", &compiler.cpp);
    process::run(build).context(
        "measure: the noise comparison was not built; CMake fetches a part of FastNoise2, so the \
         first build needs the network",
    )?;
    let compare = |shift: usize| {
        println!("measure: comparing, start {} of {STARTS}", shift + 1);
        let json = folder.join(format!("noise-{shift}.json"));
        let mut rivals = process::command(target.join("release/noise-comparison"));
        rivals.args(["--rounds", ROUNDS, "--shift", &shift.to_string(), "--json"]).arg(&json);
        report::of(rivals, &json, notes)
    };
    (0..STARTS).map(compare).collect()
}

/// Digests and timings of the land on CPU and GPU.
fn lab(folder: &Path, notes: &mut Vec<String>) -> Result<(Value, Value)> {
    println!("measure: CPU and GPU");
    process::run(process::build(&["tombolo-lab"])).context("measure: the build failed")?;
    let mut ask = |question: &str| {
        let json = folder.join(question).with_extension("json");
        let mut lab = process::command(process::program("tombolo-lab"));
        lab.args([question, "--json"]).arg(&json);
        process::quiet_drivers(&mut lab);
        report::of(lab, &json, notes)
    };
    Ok((ask("digest")?, ask("timings")?))
}

/// Every figure beside its bar.
fn rows(rivals: &[Value], digest: &Value, timings: &Value) -> Vec<Bar> {
    let side = |name: &str| timings.get(name).and_then(|side| number(side, "chunks_per_second"));
    let (gpu, cpu) = (side("gpu"), side("cpu"));
    let row = |what: &str, figure, bar| Bar::new(what, figure, "x", bar);
    let ratio = |what, key, bar| row(what, middle(&medians(rivals, key)), bar);
    vec![
        ratio("65 x 65, AVX2: time of FastNoise2's", "chunk_avx2", Limit::AtMost(0.30)),
        ratio("1024 x 1024, AVX2: time of FastNoise2's", "large_avx2", Limit::AtMost(0.33)),
        ratio("65 x 65: speed of `noise` Fbm<Perlin>'s", "noise_crate", Limit::AtLeast(40.0)),
        ratio("shaping and pyramids: time of the noise's", "shaping_and_pyramids", Limit::AtMost(0.5)),
        ratio("one pyramid: time of a copy's of the heights", "pyramid", Limit::AtMost(2.0)),
        ratio("2 threads: chunks per second of one's", "two_threads", Limit::AtLeast(1.8)),
        ratio("65 x 65, 128 bits: time of FastNoise2's AVX2", "chunk_sse4.1", Limit::AtMost(0.45)),
        Bar::new("starts in which a control failed", failed_controls(rivals), "", Limit::AtMost(0.0)),
        Bar::new("GPU twins with another digest", differing_twins(digest), "", Limit::AtMost(0.0)),
        Bar::new("GPU twin: chunks per second", gpu, "", Limit::Reported),
        row(
            "GPU twin: chunks per second of the CPU's",
            gpu.zip(cpu).map(|(gpu, cpu)| gpu / cpu),
            Limit::Reported,
        ),
    ]
}

/// A figure of every start.
fn medians(rivals: &[Value], key: &str) -> Vec<Option<f64>> {
    let median = |report: &Value| number(report.get("figures")?.get(key)?.get("ratio")?, "median");
    rivals.iter().map(median).collect()
}

/// The median start; none if one of them has no figure, so that a lost start cannot improve it.
fn middle(figures: &[Option<f64>]) -> Option<f64> {
    let mut figures: Vec<f64> = figures.iter().copied().collect::<Option<_>>()?;
    figures.sort_by(f64::total_cmp);
    figures.get(figures.len() / 2).copied()
}

/// Starts in which a known ratio was measured wrong; missing if one start looked at
/// none.
fn failed_controls(rivals: &[Value]) -> Option<f64> {
    let kept = |report: &Value| {
        let controls = report.get("controls")?.as_array()?;
        let kept = controls.iter().all(|control| control.get("kept") == Some(&Value::Bool(true)));
        (!controls.is_empty()).then_some(kept)
    };
    let kept: Vec<bool> = rivals.iter().map(kept).collect::<Option<_>>()?;
    (!kept.is_empty()).then(|| kept.iter().filter(|kept| !**kept).count() as f64)
}

/// Backends of the GPU's language whose digest is not the CPU's; missing if none ran, if the CPU's
/// backends disagree, or if the control, which must differ, did not differ.
pub fn differing_twins(digest: &Value) -> Option<f64> {
    let is_cpu = |backend: &&Value| {
        let name = backend.get("name").and_then(Value::as_str).unwrap_or_default();
        name.to_lowercase().starts_with(CPU_BACKEND)
    };
    let state = |backend: &Value| backend.get("state").and_then(Value::as_str).map(str::to_owned);
    let (cpu, twins): (Vec<&Value>, Vec<_>) = digest.get("backends")?.as_array()?.iter().partition(is_cpu);
    let agree = cpu.iter().all(|backend| state(backend).is_some_and(|state| state != "different"));
    let ran: Vec<_> =
        twins.iter().filter(|twin| state(twin).is_some_and(|state| state != "skipped")).collect();
    let control = digest.get("control")?.get("differs")?.as_bool()?;
    let differing = ran.iter().filter(|twin| state(twin).as_deref() != Some("equal")).count();
    (agree && !ran.is_empty() && control).then_some(differing as f64)
}

/// How the figures came about, for the record.
fn how(rivals: &[Value], digest: &Value, timings: &Value) -> Vec<String> {
    let first = rivals.first().unwrap_or(&Value::Null);
    let versions: Vec<_> = list(first, "rivals").iter().filter_map(Value::as_str).collect();
    let mut notes = vec![format!(
        "Ratios are the median of {} starts, each the median of {} interleaved rounds in one \
         process. Rivals: {}.",
        rivals.len(),
        number(first, "rounds").unwrap_or(0.0),
        versions.join(", ")
    )];
    for (key, figure) in first.get("figures").and_then(Value::as_object).into_iter().flatten() {
        let starts: Vec<f64> = medians(rivals, key).into_iter().flatten().collect();
        let low = starts.iter().copied().fold(f64::INFINITY, f64::min);
        let high = starts.iter().copied().fold(f64::NEG_INFINITY, f64::max);
        notes.push(format!("{}: {low:.3} to {high:.3} over the starts.", text(figure, "what")));
    }
    for timed in list(first, "times") {
        let figure = |field| number(timed, field).unwrap_or(f64::NAN);
        let (group, name) = (text(timed, "group"), text(timed, "name"));
        let (us, ns) = (figure("microseconds"), figure("ns_per_sample"));
        notes.push(format!("First start, {group}, {name}: {us:.2} us, {ns:.2} ns per sample."));
    }
    notes.extend(
        list(first, "notes").iter().filter_map(Value::as_str).map(|note| format!("First start, {note}.")),
    );
    for backend in list(digest, "backends") {
        let (name, state, detail) = (text(backend, "name"), text(backend, "state"), text(backend, "detail"));
        notes.push(format!("Digest on {name}: {state} ({detail})."));
    }
    if let (Some(gpu), Some(cpu)) = (timings.get("gpu"), timings.get("cpu")) {
        let rate = |side| number(side, "chunks_per_second").unwrap_or(f64::NAN);
        notes.push(format!(
            "Chunks per second: {:.0} on {}; {:.0} on the CPU ({}, {} thread).",
            rate(gpu),
            text(gpu, "adapter"),
            rate(cpu),
            text(cpu, "kernel"),
            number(cpu, "threads").unwrap_or(f64::NAN),
        ));
    }
    notes
}

fn text<'a>(value: &'a Value, field: &str) -> &'a str {
    value.get(field).and_then(Value::as_str).unwrap_or("unknown")
}

fn list<'a>(value: &'a Value, field: &str) -> &'a [Value] {
    value.get(field).and_then(Value::as_array).map_or(&[], Vec::as_slice)
}

/// The compiler that FastNoise2 is fastest with; code of gcc takes twice as long, and beating that
/// would prove nothing.
struct Clang {
    c: String,
    cpp: String,
}

impl Clang {
    /// The newest that is installed.
    ///
    /// # Errors
    /// There is none, or another tool is missing that the library is built with.
    fn find() -> Result<Self> {
        let runs = |program: &str| {
            process::succeeds({
                let mut command = process::command(program);
                command.arg("--version");
                command
            })
        };
        // Debian names them by version; 14 is the oldest that has been tried.
        let suffixes = (14..40).rev().map(|version| format!("-{version}")).chain([String::new()]);
        let found = suffixes
            .map(|suffix| Self { c: format!("clang{suffix}"), cpp: format!("clang++{suffix}") })
            .find(|clang| runs(&clang.c) && runs(&clang.cpp));
        match found {
            Some(clang) if ["cmake", "make"].into_iter().all(runs) => Ok(clang),
            _ => bail!(
                "measure: FastNoise2 is built with clang, cmake and make; run: apt-get install \
                 --no-install-recommends clang-19 cmake make"
            ),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    /// Three starts, digest and timings.
    type Reports = (Vec<Value>, Value, Value);

    fn good() -> Reports {
        let figure =
            |median: f64| json!({ "what": "x", "ratio": { "median": median, "min": 0.1, "max": 99.0 } });
        let rivals = json!({
            "rounds": 9,
            "figures": {
                "chunk_avx2": figure(0.2), "large_avx2": figure(0.2), "noise_crate": figure(50.0),
                "shaping_and_pyramids": figure(0.4), "pyramid": figure(1.5), "two_threads": figure(1.9),
                "chunk_sse4.1": figure(0.3),
            },
            "controls": [{ "what": "x", "ratio": { "median": 1.0 }, "kept": true }],
        });
        let backend = |name: &str, state: &str| json!({ "name": name, "state": state, "digest": "00" });
        let digest = json!({
            "backends": [backend("Rust scalar", "equal"), backend("naga on \
             llvmpipe", "equal"), backend("tint", "skipped")],
            "control": { "differs": true },
        });
        let timings = json!({
            "gpu": { "adapter": "soft", "chunks_per_second": 100.0 },
            "cpu": { "kernel": "avx2", "threads": 1, "chunks_per_second": 50_000.0 },
        });
        (vec![rivals.clone(), rivals.clone(), rivals], digest, timings)
    }

    fn missed((rivals, digest, timings): &Reports) -> usize {
        let rows = rows(rivals, digest, timings);
        assert_eq!(rows.len(), 11);
        rows.iter().filter(|row| row.is_missed()).count()
    }

    #[test]
    fn good_reports_meet_every_bar_and_absent_ones_none() {
        assert_eq!(missed(&good()), 0);
        assert_eq!(missed(&(Vec::new(), Value::Null, Value::Null)), 11);
        assert_eq!(missed(&(vec![Value::Null], Value::Null, Value::Null)), 11);
    }

    #[test]
    fn the_median_start_counts_and_a_start_without_a_figure_loses_it() {
        for (key, bad) in [
            ("chunk_avx2", 0.301),
            ("large_avx2", 0.331),
            ("noise_crate", 39.9),
            ("shaping_and_pyramids", 0.501),
            ("pyramid", 2.01),
            ("two_threads", 1.79),
            ("chunk_sse4.1", 0.451),
        ] {
            let mut reports = good();
            let spoil = |report: &mut Value, value| report["figures"][key]["ratio"]["median"] = value;
            spoil(&mut reports.0[1], json!(bad));
            assert_eq!(missed(&reports), 0, "{key}");
            spoil(&mut reports.0[0], json!(bad));
            assert_eq!(missed(&reports), 1, "{key}");
            for lost in [Value::Null, json!("fast")] {
                let mut reports = good();
                spoil(&mut reports.0[2], lost);
                assert_eq!(missed(&reports), 1, "{key}");
            }
        }
    }

    #[test]
    fn a_control_that_failed_or_was_not_looked_at_in_any_start_is_a_miss() {
        for controls in [json!([{ "kept": false }]), json!([{}]), json!([]), Value::Null] {
            let mut reports = good();
            reports.0[1]["controls"] = controls;
            assert_eq!(missed(&reports), 1);
        }
    }

    #[test]
    fn twins_count_only_if_one_ran_the_cpu_agrees_and_the_control_differs() {
        for (pointer, value) in [
            ("/backends/1/state", json!("different")),
            ("/backends/1/state", json!("skipped")),
            ("/backends/1/state", json!("confused")),
            ("/backends/0/state", json!("different")),
            ("/control/differs", json!(false)),
        ] {
            let mut reports = good();
            *reports.1.pointer_mut(pointer).unwrap() = value.clone();
            assert_eq!(missed(&reports), 1, "{pointer} {value}");
        }
    }

    #[test]
    fn the_record_says_who_was_compared_and_how_far_starts_differed() {
        let (mut rivals, digest, timings) = good();
        rivals[2]["figures"]["chunk_avx2"]["ratio"]["median"] = json!(0.25);
        let notes = how(&rivals, &digest, &timings).join("\n");
        for part in [
            "3 starts",
            "9 interleaved rounds",
            "x: 0.200 to 0.250",
            "naga on llvmpipe: equal",
            "100 on soft",
        ] {
            assert!(notes.contains(part), "{part} is not in:\n{notes}");
        }
        how(&[], &Value::Null, &Value::Null);
    }
}
