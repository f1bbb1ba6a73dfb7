//! `heightfield`: the land's noise against other libraries, what comes on top of it, and the GPU's
//! twin of it.
//!
//! Ratios come from `benches/noise-comparison`, a package outside the workspace: it needs a C++
//! compiler, which nothing else here does.

use super::run::Run;
use crate::{fast_simd, process};
use anyhow::{Context, Result, bail};
use bars::figures::{at, each, fill, list, median, ratio, text};
use bars::{Bar, Limit};
use serde_json::{Value, json};

/// Times that the comparisons are started. Where a program's code and buffers happen to lie is
/// decided once per start and moves single figures by half, ours and of other libraries; the median
/// start counts.
const STARTS: usize = 7;

/// Rounds per start; all starts take half a minute on an idle machine, minutes on a busy one.
const ROUNDS: &str = "101";

/// How the names of backends that run on the CPU begin; all others are twins.
const CPU_BACKEND: &str = "rust";

/// The bars of ratios, by their key in the reports of the comparisons.
const RATIOS: [(&str, &str, Limit); 7] = [
    ("65 x 65, AVX2: time of FastNoise2's", "chunk_avx2", Limit::AtMost(0.30)),
    ("1024 x 1024, AVX2: time of FastNoise2's", "large_avx2", Limit::AtMost(0.33)),
    ("65 x 65: speed of `noise` Fbm<Perlin>'s", "noise_crate", Limit::AtLeast(40.0)),
    ("shaping and pyramids: time of the noise's", "shaping_and_pyramids", Limit::AtMost(0.5)),
    ("one pyramid: time of a copy's of the heights", "pyramid", Limit::AtMost(2.0)),
    ("2 threads: chunks per second of one's", "two_threads", Limit::AtLeast(1.8)),
    ("65 x 65, 128 bits: time of FastNoise2's AVX2", "chunk_sse4.1", Limit::AtMost(0.45)),
];

/// Builds the comparisons, runs all, and takes the digests and timings of the land on CPU and GPU.
///
/// # Errors
/// The comparison cannot be built, or a program was interrupted.
pub fn rows(run: &mut Run) -> Result<Vec<Bar>> {
    let compiler = Clang::find()?;
    // In its own folder, so that its `.cargo/config.toml` is read too.
    let package = process::root().join("benches/noise-comparison");
    let target = process::target().join("noise-comparison");
    println!("measure: building the noise comparison with {}", compiler.cpp);
    let mut build = process::cargo("build --release --locked --target-dir");
    build.arg(&target).current_dir(&package).env("CC", &compiler.c).env("CXX", &compiler.cpp);
    fast_simd::fetch().context("the noise comparison needs FastSIMD, a part of FastNoise2")?;
    fast_simd::use_clone(&mut build);
    process::run(build).context("the noise comparison was not built")?;
    let mut starts = Vec::new();
    for shift in 0..STARTS {
        let mut comparison = process::command(target.join("release/noise-comparison"));
        comparison.args(["--rounds", ROUNDS, "--shift", &shift.to_string()]);
        starts.push(run.report(&format!("noise-{shift}"), comparison, "--json")?);
    }
    let (digest, timings) = (run.lab("digest", &["digest"])?, run.lab("timings", &["timings"])?);
    run.notes.extend(how(&starts, &digest, &timings));
    run.adapter = text(&timings, "gpu/adapter").map(str::to_owned);
    Ok(bars_of(&starts, &digest, &timings))
}

/// Every figure beside its bar.
fn bars_of(starts: &[Value], digest: &Value, timings: &Value) -> Vec<Bar> {
    let ratios = RATIOS.map(|(what, key, limit)| Bar::new(what, median(medians(starts, key)), "x", limit));
    let mut rows = Vec::from(ratios);
    rows.extend([Bar::none("starts in which a control failed", failed_controls(starts)), twins(digest)]);
    rows.extend(rates(timings));
    rows
}

/// The rows of chunks a second.
pub fn rates(timings: &Value) -> [Bar; 2] {
    let (gpu, cpu) = (at(timings, "gpu/chunks_per_second"), at(timings, "cpu/chunks_per_second"));
    [
        Bar::reported("GPU twin: chunks per second", gpu, ""),
        Bar::reported("GPU twin: chunks per second of the CPU's", ratio(gpu, cpu), "x"),
    ]
}

/// A figure of every start.
fn medians(starts: &[Value], key: &str) -> impl Iterator<Item = Option<f64>> {
    let path = format!("figures/{key}/ratio/median");
    starts.iter().map(move |report| at(report, &path))
}

/// Starts in which a known ratio was measured wrong; missing if one start looked at none.
fn failed_controls(starts: &[Value]) -> Option<f64> {
    let kept = |report: &Value| {
        let controls = list(report, "controls");
        let is_kept = |control: &Value| control.get("kept") == Some(&Value::Bool(true));
        (!controls.is_empty()).then_some(controls.iter().all(is_kept))
    };
    let kept: Vec<bool> = starts.iter().map(kept).collect::<Option<_>>()?;
    (!kept.is_empty()).then(|| kept.iter().filter(|kept| !**kept).count() as f64)
}

/// The row of the GPU's twins.
pub fn twins(digest: &Value) -> Bar {
    Bar::none("GPU twins with another digest", differing_twins(digest))
}

/// Backends of the GPU's language whose digest is not the CPU's; missing if none ran, if the CPU's
/// backends disagree, or if the control, which must differ, did not differ.
fn differing_twins(digest: &Value) -> Option<f64> {
    let is_cpu = |backend: &&Value| {
        text(backend, "name").is_some_and(|name| name.to_lowercase().starts_with(CPU_BACKEND))
    };
    let state = |backend: &Value| text(backend, "state").map(str::to_owned);
    let (cpu, twins): (Vec<&Value>, Vec<_>) = list(digest, "backends").iter().partition(is_cpu);
    let agree = cpu.iter().all(|backend| state(backend).is_some_and(|state| state != "different"));
    let ran: Vec<_> =
        twins.iter().filter(|twin| state(twin).is_some_and(|state| state != "skipped")).collect();
    let control = digest.get("control")?.get("differs")?.as_bool()?;
    let differing = ran.iter().filter(|twin| state(twin).as_deref() != Some("equal")).count();
    (agree && !ran.is_empty() && control).then_some(differing as f64)
}

/// How the figures came about, for the record.
fn how(starts: &[Value], digest: &Value, timings: &Value) -> Vec<String> {
    let first = starts.first().unwrap_or(&Value::Null);
    let texts = |path| list(first, path).iter().filter_map(Value::as_str);
    let mut notes = vec![format!(
        "Ratios are the median of {} starts, each the median of {} interleaved rounds in one process. \
         Rivals: {}.",
        starts.len(),
        at(first, "rounds").unwrap_or(0.0),
        texts("rivals").collect::<Vec<_>>().join(", ")
    )];
    for (key, figure) in first.get("figures").and_then(Value::as_object).into_iter().flatten() {
        let (low, high) = medians(starts, key)
            .flatten()
            .fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), v| (low.min(v), high.max(v)));
        let spread = json!({ "what": figure.get("what"), "low": low, "high": high });
        notes.push(fill("{what}: {low:.3} to {high:.3} over the starts.", &spread));
    }
    let time = "First start, {group}, {name}: {microseconds:.2} us, {ns_per_sample:.2} ns per sample.";
    notes.extend(each(first, "times", time));
    notes.extend(texts("notes").map(|note| format!("First start, {note}.")));
    notes.extend(each(digest, "backends", "Digest on {name}: {state} ({detail})."));
    if timings.is_object() {
        notes.push(fill(
            "Chunks per second: {gpu/chunks_per_second:.0} on {gpu/adapter}; {cpu/chunks_per_second:.0} on \
             the CPU ({cpu/kernel}, {cpu/threads} thread).",
            timings,
        ));
    }
    notes
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
                "FastNoise2 is built with clang, cmake and make; run: apt-get install \
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
        let rows = bars_of(rivals, digest, timings);
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
            let corrupt = |report: &mut Value, value| report["figures"][key]["ratio"]["median"] = value;
            corrupt(&mut reports.0[1], json!(bad));
            assert_eq!(missed(&reports), 0, "{key}");
            corrupt(&mut reports.0[0], json!(bad));
            assert_eq!(missed(&reports), 1, "{key}");
            for lost in [Value::Null, json!("fast")] {
                let mut reports = good();
                corrupt(&mut reports.0[2], lost);
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
