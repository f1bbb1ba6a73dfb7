//! The result: a text table, and JSON for `cargo xtask measure heightfield`.

use crate::rounds::Spread;
use serde_json::{Value, json};
use std::fmt;
use std::ops::RangeInclusive;

/// Versions come from the lock file.
const LOCK: &str = include_str!("../Cargo.lock");

/// The result of a run.
pub struct Report {
    rounds: usize,
    compiler: String,
    /// Ratios of times within rounds.
    figures: Vec<Figure>,
    /// Ratios whose value is known.
    controls: Vec<Control>,
    /// Absolute times, for orientation; they depend on the machine's load.
    pub times: Vec<Timed>,
    /// Chunks per second of one thread: noise, shaping and both pyramids.
    pub chunks_per_second: f64,
    /// Remarks on the run.
    pub notes: Vec<String>,
}

/// A ratio that `cargo xtask measure heightfield` compares with a bar.
struct Figure {
    /// Name in the JSON.
    key: String,
    what: String,
    spread: Spread,
}

/// A ratio whose median must lie within bounds, otherwise the run is invalid.
struct Control {
    what: String,
    spread: Spread,
    bounds: RangeInclusive<f64>,
}

impl Control {
    fn is_kept(&self) -> bool {
        self.bounds.contains(&self.spread.median)
    }
}

/// A median time.
pub struct Timed {
    /// What was computed.
    pub group: &'static str,
    /// Name of the contender.
    pub name: String,
    /// Median time.
    pub microseconds: f64,
    /// Number of samples.
    pub samples: f64,
}

impl Report {
    /// An empty report.
    pub fn new(rounds: usize, compiler: String) -> Self {
        let (figures, controls, times, notes) = Default::default();
        Self { rounds, compiler, figures, controls, times, notes, chunks_per_second: f64::NAN }
    }

    /// Adds a figure.
    pub fn figure(&mut self, key: impl Into<String>, what: impl Into<String>, spread: Spread) {
        self.figures.push(Figure { key: key.into(), what: what.into(), spread });
    }

    /// Adds a control, whose median must lie within bounds.
    pub fn control(&mut self, what: impl Into<String>, spread: Spread, bounds: RangeInclusive<f64>) {
        self.controls.push(Control { what: what.into(), spread, bounds });
    }

    /// Whether all controls are within their bounds.
    pub fn is_valid(&self) -> bool {
        self.controls.iter().all(Control::is_kept)
    }

    /// Libraries with their versions.
    fn libraries(&self) -> Vec<String> {
        let crates = ["fastnoise2", "fastnoise2-sys", "noise", "fastnoise-lite"];
        let mut libraries: Vec<_> = crates
            .iter()
            .map(|name| format!("{name} {}", version(name).unwrap_or("of unknown version")))
            .collect();
        libraries[1] += &format!(" (C++ built by {})", self.compiler);
        libraries
    }

    /// The report as JSON.
    pub fn json(&self) -> Value {
        let spread = |s: &Spread| json!({ "median": s.median, "min": s.min, "max": s.max });
        let figures = self.figures.iter().map(|figure| {
            let value = json!({ "what": figure.what, "ratio": spread(&figure.spread) });
            (figure.key.clone(), value)
        });
        let controls = self.controls.iter().map(|control| {
            json!({ "what": control.what, "ratio": spread(&control.spread), "low": control.bounds.start(),
                    "high": control.bounds.end(), "kept": control.is_kept() })
        });
        let times = self.times.iter().map(|timed| {
            json!({ "group": timed.group, "name": timed.name, "microseconds": timed.microseconds,
                    "ns_per_sample": timed.microseconds * 1e3 / timed.samples })
        });
        json!({
            "rounds": self.rounds,
            "rivals": self.libraries(),
            "figures": figures.collect::<serde_json::Map<_, _>>(),
            "controls": controls.collect::<Vec<_>>(),
            "times": times.collect::<Vec<_>>(),
            "chunks_per_second": self.chunks_per_second,
            "notes": self.notes,
        })
    }
}

impl fmt::Display for Report {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let mut group = "";
        for timed in &self.times {
            if timed.group != group {
                group = timed.group;
                writeln!(f, "\n{group:<58} {:>12} {:>12}", "us", "ns/sample")?;
            }
            let per_sample = timed.microseconds * 1e3 / timed.samples;
            writeln!(f, "  {:<56} {:>12.2} {per_sample:>12.3}", timed.name, timed.microseconds)?;
        }
        writeln!(f, "\n{:<72} {:>8}  of all rounds", "ratios", "median")?;
        let line = |f: &mut fmt::Formatter<'_>, what: &str, Spread { median, min, max }: Spread, verdict| {
            writeln!(f, "  {what:<70} {median:>8.3}  {min:.3} to {max:.3}{verdict}")
        };
        for figure in &self.figures {
            line(f, &figure.what, figure.spread, String::new())?;
        }
        writeln!(f, "\n{:<72}", "controls")?;
        for control in &self.controls {
            let word = if control.is_kept() { "ok" } else { "FAILED" };
            let verdict =
                format!("   must be {:.3} to {:.3}: {word}", control.bounds.start(), control.bounds.end());
            line(f, &control.what, control.spread, verdict)?;
        }
        writeln!(f, "\n{:.0} chunks per second on one thread", self.chunks_per_second)?;
        self.notes.iter().try_for_each(|note| writeln!(f, "{note}"))?;
        writeln!(f, "{} rounds; {}", self.rounds, self.libraries().join(", "))
    }
}

/// The version of a package in the lock file.
fn version(package: &str) -> Option<&'static str> {
    let entry = LOCK.split("[[package]]").find(|entry| entry.contains(&format!("name = \"{package}\"\n")))?;
    entry.lines().find_map(|line| line.strip_prefix("version = \"")?.strip_suffix('"'))
}
