//! Whether the figures of a record are those of its runs in `runs.csv`.

use super::runs::{Runs, Spread};
use crate::process;
use crate::records;
use crate::records::record::{FOLDER, Record, Row};
use anyhow::{Context, Result};
use bars::{Bar, Limit};

/// Rows of all records that differ from their runs.
///
/// # Errors
/// A record or the folder of all cannot be read.
pub fn faults() -> Result<Vec<String>> {
    let days = process::root().join(FOLDER);
    let mut faults = Vec::new();
    for record in &records::all()? {
        let runs = Runs::of_machine(&days, record.machine(), &record.name, Some(record.commit()))
            .with_context(|| format!("cannot read the runs of {}", record.path))?;
        faults.extend(of_record(record, &runs));
    }
    Ok(faults)
}

fn of_record<'a>(record: &'a Record, runs: &'a Runs) -> impl Iterator<Item = String> + 'a {
    record.rows.iter().filter_map(move |row| {
        let why = fault(row, &runs.of(&row.what), runs.count())?;
        Some(format!("{}: `{}`: {why}", record.path, row.what))
    })
}

/// Why a row is not that of its runs; none if it is. `runs` is the number of runs of its record.
fn fault(row: &Row, spread: &Spread, runs: usize) -> Option<String> {
    let (number, unit) = row.figure.split_once(' ').unwrap_or((&row.figure, ""));
    let is_measured = number.parse::<f64>().is_ok();
    if !is_measured && spread.figures.iter().all(|figure| figure.is_nan()) {
        return None;
    }
    let limit = limit(&row.bar);
    let is_complete = spread.figures.len() >= runs;
    let figure = is_complete.then(|| spread.median(limit)).flatten();
    let unit = if is_measured { unit } else { "" };
    let [figure, _, verdict] = Bar::new("", figure, unit.to_owned(), limit).cells();
    if figure != row.figure {
        return Some(format!("states {}, its runs {figure}", row.figure));
    }
    if verdict != row.verdict {
        return Some(format!("states `{}`, its runs `{verdict}`", row.verdict));
    }
    let kept = format!("{} of {runs}", spread.kept);
    let stated = row.kept.split(';').next().unwrap_or_default();
    (stated != kept).then(|| format!("states that {stated} kept the bar, its runs {kept}"))
}

/// The limit of a bar's text.
fn limit(bar: &str) -> Limit {
    let of = |words: &str| bar.strip_prefix(words)?.split(' ').next()?.parse().ok();
    let at_least = of("at least ").map(Limit::AtLeast);
    let at_most = || of("at most ").map(Limit::AtMost);
    let under = || of("under ").map(Limit::Under);
    at_least.or_else(at_most).or_else(under).unwrap_or(Limit::Reported)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rows_of_every_record_are_those_of_its_runs() {
        assert_eq!(faults().unwrap(), [""; 0]);
    }

    #[test]
    fn a_row_is_that_of_its_runs_or_a_fault() {
        let row = |figure: &str, bar: &str, verdict: &str, kept: &str| Row {
            what: "time".into(),
            figure: figure.into(),
            bar: bar.into(),
            verdict: verdict.into(),
            range: String::new(),
            kept: kept.into(),
        };
        let spread = |figures: &[f64], kept| Spread { figures: figures.into(), kept };
        let two = spread(&[2.0, 2.5], 1);
        assert_eq!(fault(&row("2.500 s", "under 2.500 s", "MISSED", "1 of 2"), &two, 2), None);
        assert_eq!(
            fault(
                &row("2 s", "at least 2 s", "ok", "2 of 2; all commits: 2 of 5"),
                &spread(&[2.0, 2.5], 2),
                2
            ),
            None
        );
        assert_eq!(fault(&row("missing", "at least 2 s", "MISSED", "1 of 2"), &spread(&[2.0], 1), 2), None);
        assert_eq!(
            fault(&row("not measured", "under 2 ms", "needs a GPU", ""), &spread(&[f64::NAN], 1), 1),
            None
        );
        for (row, says) in [
            (row("2 s", "under 2.500 s", "ok", "1 of 2"), "states 2 s, its runs 2.500 s"),
            (row("2.500 s", "under 2.500 s", "ok", "1 of 2"), "states `ok`, its runs `MISSED`"),
            (
                row("2.500 s", "under 2.500 s", "MISSED", "2 of 2"),
                "states that 2 of 2 kept the bar, its runs 1 of 2",
            ),
        ] {
            assert_eq!(fault(&row, &two, 2).as_deref(), Some(says));
        }
        let none = fault(&row("2 s", "reported", "ok", "1 of 1"), &spread(&[], 0), 1);
        assert_eq!(none.as_deref(), Some("states 2 s, its runs missing"));
    }
}
