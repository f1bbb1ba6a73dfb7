//! The dated record of a measurement: what it ran on, the command, the figures.

use super::bars::Row;
use crate::{machine, process};
use anyhow::{Context, Result};
use std::fmt::Write;
use std::path::PathBuf;

/// What a record holds besides the rows.
#[derive(Clone, Debug)]
pub struct Heading<'a> {
    /// Name of the measurement, also the file's.
    pub name: &'a str,
    /// Name of the GPU and its backend, as the viewer told.
    pub adapter: Option<&'a str>,
    /// Sentences on how the figures came about.
    pub notes: &'a [String],
}

/// Writes `docs/measurements/<date>-<machine>/<name>.md` and returns its path.
///
/// # Errors
/// The date is not known or the file cannot be written.
pub fn write(heading: &Heading<'_>, rows: &[Row]) -> Result<PathBuf> {
    let machine = machine::Machine::here();
    let date = machine::today()?;
    let folder = process::root().join("docs/measurements").join(format!("{date}-{}", machine.slug()));
    std::fs::create_dir_all(&folder).with_context(|| format!("cannot create {}", folder.display()))?;
    let path = folder.join(heading.name).with_extension("md");
    let text = page(heading, rows, &machine, &date, &machine::commit());
    std::fs::write(&path, text).with_context(|| format!("cannot write {}", path.display()))?;
    Ok(path)
}

fn page(heading: &Heading<'_>, rows: &[Row], machine: &machine::Machine, date: &str, commit: &str) -> String {
    let memory = machine.memory_mib.map_or("unknown".into(), |mib| format!("{mib} MiB"));
    let facts = [
        ("Date", date.into()),
        ("Commit", commit.into()),
        ("CPU", format!("{}, {} cores", machine.cpu, machine.cores)),
        ("Memory", memory),
        ("System", machine.os.clone()),
        ("GPU", heading.adapter.unwrap_or("none seen").into()),
        ("Command", format!("`cargo xtask measure {}`", heading.name)),
    ];
    let mut page = format!("# {}\n\n| | |\n| --- | --- |\n", heading.name);
    // Writing to a string cannot fail.
    for (name, value) in facts {
        let _ = writeln!(page, "| {name} | {} |", cell(&value));
    }
    page.push_str("\n| what | figure | bar | |\n| --- | ---: | --- | --- |\n");
    for row in rows {
        let _ = writeln!(page, "| {} | {} |", cell(&row.what), row.cells().join(" | "));
    }
    if !heading.notes.is_empty() {
        page.push('\n');
        for note in heading.notes {
            let _ = writeln!(page, "- {note}");
        }
    }
    page
}

/// A value that cannot break the table.
fn cell(text: &str) -> String {
    text.replace('|', "/").replace('\n', " ")
}

#[cfg(test)]
mod tests {
    use super::super::bars::Bar;
    use super::*;

    #[test]
    fn a_page_names_machine_commit_command_and_every_row() {
        let machine =
            machine::Machine { cpu: "Some | CPU".into(), cores: 2, memory_mib: Some(4096), os: "OS".into() };
        let rows =
            [Row::new("cold", Some(1.5), Bar::Under(3.0), "s"), Row::new("lost", None, Bar::AtMost(0.0), "")];
        let notes = ["worst of three".into()];
        let heading = Heading { name: "first-voyage", adapter: Some("soft"), notes: &notes };
        let page = page(&heading, &rows, &machine, "2026-01-02", "abc");
        for part in [
            "Some / CPU, 2 cores",
            "4096 MiB",
            "soft",
            "abc",
            "`cargo xtask measure first-voyage`",
            "| cold | 1.500 s | under 3 s | ok |",
            "| lost | missing | at most 0 | MISSED |",
            "- worst of three",
        ] {
            assert!(page.contains(part), "{part} is not in:\n{page}");
        }
    }
}
