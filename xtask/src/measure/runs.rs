//! Every run of a measurement, in one CSV file a day and machine. A record cannot choose its run.

use bars::{Bar, Figure};
use std::io::Write;
use std::path::Path;

/// Columns of the file.
const HEADER: &str = "name,commit,what,figure,unit,bar,met";

/// The runs of one measurement at one commit.
#[derive(Clone, Debug, Default)]
pub struct Runs {
    rows: Vec<Stored>,
}

#[derive(Clone, Debug, PartialEq)]
struct Stored {
    what: String,
    figure: Option<f64>,
    met: bool,
}

/// The figures of one row over the runs.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Spread {
    /// In the order of the runs; those that are missing are NaN.
    pub figures: Vec<f64>,
    /// Runs that met the bar.
    pub kept: usize,
}

/// Appends a run and returns all runs of the same measurement and commit.
///
/// # Errors
/// The file cannot be read or written.
pub fn append(path: &Path, name: &str, commit: &str, rows: &[Bar]) -> std::io::Result<Runs> {
    let is_new = !path.exists();
    let mut file = std::fs::OpenOptions::new().append(true).create(true).open(path)?;
    if is_new {
        writeln!(file, "{HEADER}")?;
    }
    for row in rows {
        let figure = match row.figure {
            Figure::Measured(figure) => figure.to_string(),
            Figure::Missing | Figure::NotMeasured { .. } => String::new(),
        };
        let [_, bar, _] = row.cells();
        let fields =
            [name, commit, &row.name, &figure, &row.unit, &bar, if row.is_met() { "yes" } else { "no" }];
        writeln!(file, "{}", fields.map(quoted).join(","))?;
    }
    Ok(Runs::read(&std::fs::read_to_string(path)?, name, commit))
}

impl Runs {
    fn read(text: &str, name: &str, commit: &str) -> Self {
        let rows = text.lines().skip(1).map(fields).filter(|fields| fields.len() == 7);
        let rows = rows.filter(|fields| fields[0] == name && fields[1] == commit).map(|fields| Stored {
            what: fields[2].clone(),
            figure: fields[3].parse().ok(),
            met: fields[6] == "yes",
        });
        Self { rows: rows.collect() }
    }

    /// Number of runs: those of the row that was recorded most often.
    pub fn count(&self) -> usize {
        let times = |row: &Stored| self.rows.iter().filter(|other| other.what == row.what).count();
        self.rows.iter().map(times).max().unwrap_or(0).max(1)
    }

    /// The figures of one row.
    pub fn of(&self, what: &str) -> Spread {
        let rows = self.rows.iter().filter(|row| row.what == what);
        Spread {
            figures: rows.clone().map(|row| row.figure.unwrap_or(f64::NAN)).collect(),
            kept: rows.filter(|row| row.met).count(),
        }
    }
}

impl Spread {
    /// The middle figure, the lower one of two; none if a run has none.
    pub fn median(&self) -> Option<f64> {
        let mut figures = self.figures.clone();
        if figures.is_empty() || figures.iter().any(|figure| figure.is_nan()) {
            return None;
        }
        figures.sort_by(f64::total_cmp);
        Some(figures[(figures.len() - 1) / 2])
    }

    /// Least and largest figure.
    pub fn range(&self) -> String {
        let least = self.figures.iter().copied().fold(f64::INFINITY, f64::min);
        let largest = self.figures.iter().copied().fold(f64::NEG_INFINITY, f64::max);
        format!("{least:.3} to {largest:.3}")
    }
}

fn quoted(field: &str) -> String {
    if field.contains([',', '"', '\n']) {
        format!("\"{}\"", field.replace('"', "\"\"").replace('\n', " "))
    } else {
        field.into()
    }
}

/// The fields of a line (RFC 4180, without line breaks in fields).
fn fields(line: &str) -> Vec<String> {
    let (mut fields, mut field, mut is_quoted) = (Vec::new(), String::new(), false);
    let mut letters = line.chars().peekable();
    while let Some(letter) = letters.next() {
        match letter {
            '"' if is_quoted && letters.peek() == Some(&'"') => {
                letters.next();
                field.push('"');
            }
            '"' => is_quoted = !is_quoted,
            ',' if !is_quoted => fields.push(std::mem::take(&mut field)),
            letter => field.push(letter),
        }
    }
    fields.push(field);
    fields
}

#[cfg(test)]
mod tests {
    use super::*;
    use bars::Limit;

    #[test]
    fn every_run_is_kept_and_the_median_is_of_all_of_them() {
        let path = std::env::temp_dir().join(format!("tombolo-runs-{}.csv", std::process::id()));
        let _ = std::fs::remove_file(&path);
        let row = |figure| [Bar::new("time, \"p99\"", Some(figure), "s", Limit::Under(3.0))];
        append(&path, "other", "abc", &row(100.0)).unwrap();
        append(&path, "x", "old", &row(100.0)).unwrap();
        for figure in [1.0, 9.0, 2.0] {
            append(&path, "x", "abc", &row(figure)).unwrap();
        }
        let runs = append(&path, "x", "abc", &row(4.0)).unwrap();
        std::fs::remove_file(&path).unwrap();
        let spread = runs.of("time, \"p99\"");
        assert_eq!(spread, Spread { figures: vec![1.0, 9.0, 2.0, 4.0], kept: 2 });
        assert_eq!(
            (runs.count(), spread.median(), spread.range().as_str()),
            (4, Some(2.0), "1.000 to 9.000")
        );
    }

    #[test]
    fn a_run_without_a_figure_leaves_no_median() {
        let text = format!("{HEADER}\nx,abc,a,1,s,b,yes\nx,abc,a,,s,b,no\n");
        let spread = Runs::read(&text, "x", "abc").of("a");
        assert_eq!((spread.median(), spread.kept, spread.figures.len()), (None, 1, 2));
    }
}
