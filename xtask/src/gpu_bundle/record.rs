//! The record of a bundle: what the programs reported on the other machine, beside the bars.

use crate::machine::{self, Commit, Machine};
use crate::measure;
use crate::measure::record::{self, Heading, Origin};
use anyhow::{Context, Result, ensure};
use bars::Bar;
use bars::figures::{at, each, fill, list, text};
use serde_json::{Value, json};
use std::path::Path;

/// Name of the record.
const NAME: &str = "gpu";

/// Name of the file with the facts of the machine.
const MACHINE: &str = "machine";

/// Reports of the lab whose rows stand in the record.
const REPORTS: [&str; 4] = ["lod", "pom", "visual", "culling"];

/// Reports of the viewer, by the names of their files.
const VIEWS: [(&str, &str); 4] = [
    ("grass", "scene `grass`"),
    ("island_low", "scene `island`, low"),
    ("island_medium", "scene `island`, medium"),
    ("island_high", "scene `island`, high"),
];

/// The reports of a folder that `run.sh` filled. Those of programs that failed are null.
struct Reports<'a>(&'a Path);

impl Reports<'_> {
    fn json(&self, name: &str) -> Value {
        serde_json::from_str(&self.text(&format!("{name}.json"))).unwrap_or(Value::Null)
    }

    fn text(&self, file: &str) -> String {
        std::fs::read_to_string(self.0.join(file)).unwrap_or_default().trim().to_owned()
    }
}

/// Writes `gpu.md` and `runs.csv` into a folder that `run.sh` filled, in the format of every
/// record.
///
/// The first call notes the machine in `machine.json`; a later one, on another machine, reads it.
/// With `only`, a report of [`REPORTS`], the record has its name and no other rows: of a run that
/// had no time for the other steps.
///
/// # Errors
/// The folder cannot be read or written, `only` is no report, or a bar was missed.
pub fn write(folder: &Path, only: Option<&str>) -> Result<()> {
    let reports = Reports(folder);
    let origin = origin(&reports).context("gpu-record")?;
    let (name, rows, notes, adapter) = match only {
        None => {
            let adapter = text(&reports.json("timings"), "gpu/adapter").map(str::to_owned);
            (NAME, rows(&reports), notes(&reports), adapter)
        }
        Some(name) => {
            ensure!(REPORTS.contains(&name), "gpu-record: `{name}` is none of {}", REPORTS.join(", "));
            let report = reports.json(name);
            let adapter = text(&report, "record_adapter").map(str::to_owned);
            (name, measure::rows_of(name, &report), notes_of(&report), adapter)
        }
    };
    let heading = Heading { name, adapter: adapter.as_deref(), notes: &notes };
    // A second call replaces the run that the first one noted.
    let _ = std::fs::remove_file(folder.join("runs.csv"));
    let path = record::write_foreign(folder, &heading, &rows, &origin).context("gpu-record")?;
    measure::judge(&rows, &path)
}

/// The machine and the commit of the programs.
fn origin(reports: &Reports<'_>) -> Result<Origin> {
    if reports.json(MACHINE).is_null() {
        let machine = Machine::here();
        let commit = std::env::current_exe()
            .ok()
            .and_then(|program| std::fs::read_to_string(program.parent()?.parent()?.join("commit")).ok());
        let facts = json!({
            "cpu": machine.cpu,
            "cores": machine.cores,
            "memory_mib": machine.memory_mib,
            "os": machine.os,
            "date": machine::today()?,
            "commit": commit.as_deref().map_or("unknown", str::trim),
        });
        std::fs::write(reports.0.join(format!("{MACHINE}.json")), facts.to_string())?;
    }
    let facts = reports.json(MACHINE);
    let fact = |name| text(&facts, name).unwrap_or("unknown").to_owned();
    let commit = fact("commit");
    let hash = commit.split_whitespace().next().unwrap_or_default();
    Ok(Origin {
        machine: Machine {
            cpu: fact("cpu"),
            cores: at(&facts, "cores").map_or(0, |cores| cores as usize),
            memory_mib: at(&facts, "memory_mib").map(|mib| mib as u64),
            os: fact("os"),
        },
        date: fact("date"),
        commit: Commit { hash: hash.to_owned(), is_clean: hash == commit },
        command: "cargo xtask gpu-bundle".into(),
    })
}

/// The rows of every report.
fn rows(reports: &Reports<'_>) -> Vec<Bar> {
    let mut rows = vec![measure::heightfield::twins(&reports.json("digest"))];
    let timings = reports.json("timings");
    rows.extend(measure::heightfield::rates(&timings));
    // A renderer needs none.
    let without_readback = at(&timings, "gpu/chunks_per_second_without_readback");
    rows.push(Bar::reported("GPU twin: chunks per second without readback", without_readback, ""));
    for (name, what) in VIEWS {
        let view = reports.json(name);
        for (quantile, key) in [("p50", "frame_ms_p50"), ("p99", "frame_ms_p99")] {
            let row = format!("{what}, 1920 x 1080: time of a frame, {quantile}");
            rows.push(Bar::reported(row, at(&view, key), "ms"));
        }
    }
    rows.extend(REPORTS.iter().flat_map(|name| measure::rows_of(name, &reports.json(name))));
    rows
}

/// How the figures came about.
fn notes(reports: &Reports<'_>) -> Vec<String> {
    let mut notes = vec![reports.text("samples.txt")];
    for line in reports.text("steps.tsv").lines() {
        if let [name, code, seconds] = line.split('\t').collect::<Vec<_>>()[..] {
            notes.push(format!("Step {name}: exit code {code} after {seconds} s."));
        }
    }
    notes.extend(each(&reports.json("digest"), "backends", "Digest on {name}: {state} ({detail})."));
    let frames = "{frames} frames, each awaited before the next one; {triangles} triangles, {plants_drawn} \
                  plants.";
    notes.extend(VIEWS.map(|(name, what)| format!("Of the {what}: {}", fill(frames, &reports.json(name)))));
    notes.extend(REPORTS.iter().flat_map(|name| notes_of(&reports.json(name))));
    notes
}

/// The notes of a report of the lab.
fn notes_of(report: &Value) -> Vec<String> {
    list(report, "notes").iter().filter_map(Value::as_str).map(str::to_owned).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn in_folder(name: &str, files: &[(&str, &str)]) -> (String, String) {
        let folder = std::env::temp_dir().join(format!("tombolo-gpu-record-{name}-{}", std::process::id()));
        std::fs::create_dir_all(&folder).unwrap();
        for (file, text) in files {
            std::fs::write(folder.join(file), text).unwrap();
        }
        let error = write(&folder, None).unwrap_err().to_string();
        let page = std::fs::read_to_string(folder.join("gpu.md")).unwrap();
        std::fs::remove_dir_all(&folder).unwrap();
        (error, page)
    }

    #[test]
    fn a_folder_without_reports_misses_every_bar_and_says_so() {
        let (error, page) = in_folder("empty", &[("steps.tsv", "digest\t1\t3\n")]);
        assert!(error.contains("missed"), "{error}");
        assert!(page.contains("Step digest: exit code 1 after 3 s.") && page.contains("MISSED"), "{page}");
    }

    #[test]
    fn the_machine_that_ran_the_script_stands_in_the_record() {
        let machine = json!({ "cpu": "X", "cores": 16, "os": "Y", "date": "2026-01-02", "commit": "abc" });
        let (_, page) = in_folder("machine", &[("machine.json", &machine.to_string())]);
        for line in ["| CPU | X, 16 cores |", "| Date | 2026-01-02 |", "| Commit | abc |"] {
            assert!(page.contains(line), "{line}: {page}");
        }
    }

    #[test]
    fn the_record_of_one_measurement_has_its_name_and_no_other_rows() {
        let folder = std::env::temp_dir().join(format!("tombolo-gpu-record-only-{}", std::process::id()));
        std::fs::create_dir_all(&folder).unwrap();
        let row = json!({ "name": "a row", "figure": 1.0, "direction": "at_most", "bar": 2.0 });
        std::fs::write(folder.join("visual.json"), json!({ "bars": [row] }).to_string()).unwrap();
        write(&folder, Some("visual")).unwrap();
        assert!(write(&folder, Some("gpu")).is_err());
        let page = std::fs::read_to_string(folder.join("visual.md")).unwrap();
        std::fs::remove_dir_all(&folder).unwrap();
        assert!(page.starts_with("# visual") && page.contains("| a row | 1 |"), "{page}");
        assert!(!page.contains("GPU twin"), "{page}");
    }

    #[test]
    fn every_row_of_a_report_and_every_backend_is_in_the_record() {
        let row = |name: &str| json!({ "name": name, "figure": 1.0, "direction": "at_most", "bar": 2.0 });
        let culling = json!({ "bars": [row("on the GPU"), row("the same (control)")] }).to_string();
        let backend = json!({ "name": "naga -> x", "state": "equal", "detail": "a driver" });
        let digest = json!({ "backends": [backend], "control": { "differs": true } }).to_string();
        let (_, page) = in_folder("rows", &[("culling.json", &culling), ("digest.json", &digest)]);
        for line in
            ["| on the GPU | 1 |", "| the same (control) | 1 |", "- Digest on naga -> x: equal (a driver)."]
        {
            assert!(page.contains(line), "{line}: {page}");
        }
    }
}
