//! The record of a bundle: what the programs reported on the other machine, beside the bars.

use crate::machine::Machine;
use crate::measure;
use anyhow::{Context, Result};
use bars::Bar;
use bars::figures::{each, fill, text};
use serde_json::Value;
use std::fmt::Write;
use std::path::Path;

/// Reports whose rows stand in the record: name, and what they are about.
const REPORTS: [(&str, &str); 4] = [
    ("lod", "Levels of detail"),
    ("pom", "Parallax occlusion mapping"),
    ("visual", "Pictures"),
    ("culling", "Culling of vegetation"),
];

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

/// Writes `record.md` into a folder that `run.sh` filled.
///
/// # Errors
/// The folder cannot be written, or a bar was missed.
pub fn write(folder: &Path) -> Result<()> {
    let reports = Reports(folder);
    let commit = std::env::current_exe()
        .ok()
        .and_then(|program| std::fs::read_to_string(program.parent()?.parent()?.join("commit")).ok())
        .unwrap_or_else(|| "unknown".into());
    let tables = tables(&reports);
    let path = folder.join("record.md");
    let page = page(&reports, &tables, commit.trim(), &Machine::here());
    std::fs::write(&path, page).with_context(|| format!("cannot write {}", path.display()))?;
    let rows: Vec<_> = tables.into_iter().flat_map(|(_, rows)| rows).collect();
    measure::judge(&rows, &path)
}

/// The rows of every report, under a title.
fn tables(reports: &Reports<'_>) -> Vec<(&'static str, Vec<Bar>)> {
    let mut land = vec![measure::heightfield::twins(&reports.json("digest"))];
    land.extend(measure::heightfield::rates(&reports.json("timings")));
    let others = REPORTS.map(|(name, title)| (title, measure::rows_of(name, &reports.json(name))));
    std::iter::once(("Heights", land)).chain(others).collect()
}

fn page(reports: &Reports<'_>, tables: &[(&str, Vec<Bar>)], commit: &str, machine: &Machine) -> String {
    let timings = reports.json("timings");
    let gpu = text(&timings, "gpu/adapter").unwrap_or("unknown");
    let mut page = format!(
        "# GPU bundle\n\nCommit {commit}; {}, {} cores; {}; GPU: {gpu}.\n\n{}\n\n\
         | step | exit code | seconds |\n| --- | --- | --- |\n",
        machine.cpu,
        machine.cores,
        machine.os,
        reports.text("samples.txt"),
    );
    // Writing to a string cannot fail.
    for line in reports.text("steps.tsv").lines() {
        let _ = writeln!(page, "| {} |", line.replace('\t', " | "));
    }
    page.push_str("\n## Digest matrix\n\n");
    for backend in each(&reports.json("digest"), "backends", "{name}: {state} ({detail})") {
        let _ = writeln!(page, "- {}", backend.replace('\n', " "));
    }
    for (title, rows) in tables {
        let _ = write!(page, "\n## {title}\n\n{}", bars::markdown(rows));
    }
    page.push_str(
        "\n## Viewer\n\nFrames of 1920 x 1080, each awaited before the next one; ms.\n\n\
         | what | p50 | p99 | frames | triangles | plants drawn |\n\
         | --- | ---: | ---: | ---: | ---: | ---: |\n",
    );
    for (name, what) in VIEWS {
        let row = "{frame_ms_p50:.2} | {frame_ms_p99:.2} | {frames} | {triangles} | {plants_drawn}";
        let _ = writeln!(page, "| {what} | {} |", fill(row, &reports.json(name)));
    }
    page
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    fn in_folder(name: &str, files: &[(&str, &str)]) -> (String, String) {
        let folder = std::env::temp_dir().join(format!("tombolo-gpu-record-{name}-{}", std::process::id()));
        std::fs::create_dir_all(&folder).unwrap();
        for (file, text) in files {
            std::fs::write(folder.join(file), text).unwrap();
        }
        let error = write(&folder).unwrap_err().to_string();
        let page = std::fs::read_to_string(folder.join("record.md")).unwrap();
        std::fs::remove_dir_all(&folder).unwrap();
        (error, page)
    }

    #[test]
    fn a_folder_without_reports_misses_every_bar_and_says_so() {
        let (error, page) = in_folder("empty", &[("steps.tsv", "digest\t1\t3\n")]);
        assert!(error.contains("missed"), "{error}");
        assert!(page.contains("| digest | 1 | 3 |") && page.contains("MISSED"), "{page}");
        assert!(!page.contains("| ok |"), "{page}");
    }

    #[test]
    fn every_row_of_a_report_and_every_backend_is_in_the_record() {
        let row = |name: &str| json!({ "name": name, "figure": 1.0, "direction": "at_most", "bar": 2.0 });
        let culling = json!({ "bars": [row("on the GPU"), row("the same (control)")] }).to_string();
        let backend = json!({ "name": "naga -> x", "state": "equal", "detail": "a driver" });
        let digest = json!({ "backends": [backend], "control": { "differs": true } }).to_string();
        let (_, page) = in_folder("rows", &[("culling.json", &culling), ("digest.json", &digest)]);
        for line in ["| on the GPU | 1 |", "| the same (control) | 1 |", "- naga -> x: equal (a driver)"] {
            assert!(page.contains(line), "{line}: {page}");
        }
    }
}
