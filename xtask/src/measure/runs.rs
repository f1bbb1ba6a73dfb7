//! Every run of a measurement, in one CSV file a day and machine. A record cannot choose its run.

use bars::{Bar, Figure, Limit};
use std::io::Write;
use std::path::Path;

/// Name of the file in the folder of a day and machine.
pub const FILE: &str = "runs.csv";

/// Length of the date at the start of a folder's name, and of the hyphen behind it.
const DATE: usize = "2026-01-02-".len();

/// Columns of the file.
const HEADER: &str = "name,commit,what,figure,unit,bar,met";

/// What stands in place of a row in the line of a run that ended without figures.
const FAILED: &str = "the run failed";

/// Runs of one measurement: of one commit, or of all.
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

/// Appends a run.
///
/// # Errors
/// The file cannot be written.
pub fn append(path: &Path, name: &str, commit: &str, rows: &[Bar]) -> std::io::Result<()> {
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
    Ok(())
}

/// Appends a run that ended without figures.
///
/// # Errors
/// The file cannot be written.
pub fn append_failed(path: &Path, name: &str, commit: &str) -> std::io::Result<()> {
    append(path, name, commit, &[Bar::none(FAILED, None)])
}

impl Runs {
    /// The runs of a measurement and commit, or of all commits, on every day of a machine, in the
    /// order of the days.
    ///
    /// # Errors
    /// The folder of all days or a file cannot be read.
    pub fn of_machine(
        folder: &Path,
        machine: &str,
        name: &str,
        commit: Option<&str>,
    ) -> std::io::Result<Self> {
        let days: Vec<_> = std::fs::read_dir(folder)?.collect::<Result<_, _>>()?;
        let is_own = |day: &std::fs::DirEntry| {
            day.file_name().to_str().and_then(|day| day.get(DATE..)) == Some(machine)
        };
        let days = days.into_iter().filter(is_own);
        let mut files: Vec<_> = days.map(|day| day.path().join(FILE)).filter(|file| file.exists()).collect();
        files.sort();
        let mut runs = Self::default();
        for file in files {
            runs.rows.extend(Self::read(&std::fs::read_to_string(file)?, name, commit).rows);
        }
        Ok(runs)
    }

    fn read(text: &str, name: &str, commit: Option<&str>) -> Self {
        let rows = text.lines().skip(1).map(fields).filter(|fields| fields.len() == 7);
        let is_asked =
            |fields: &Vec<String>| fields[0] == name && commit.is_none_or(|commit| fields[1] == commit);
        let rows = rows.filter(is_asked).map(|fields| Stored {
            what: fields[2].clone(),
            figure: fields[3].parse().ok(),
            met: fields[6] == "yes",
        });
        Self { rows: rows.collect() }
    }

    /// Number of runs with figures, at least 1: those of the row that was recorded most often.
    pub fn count(&self) -> usize {
        let rows = || self.rows.iter().filter(|row| row.what != FAILED);
        let times = |row: &Stored| rows().filter(|other| other.what == row.what).count();
        rows().map(times).max().unwrap_or(0).max(1)
    }

    /// Number of runs without figures.
    pub fn failed(&self) -> usize {
        self.rows.iter().filter(|row| row.what == FAILED).count()
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
    /// The middle figure; none if a run has none. Of two middle ones the worse by the limit: the
    /// better one would let a bar be kept by the best of two runs. Without a bar the larger one.
    pub fn median(&self, limit: Limit) -> Option<f64> {
        let mut figures = self.figures.clone();
        if figures.is_empty() || figures.iter().any(|figure| figure.is_nan()) {
            return None;
        }
        figures.sort_by(f64::total_cmp);
        let lower = (figures.len() - 1) / 2;
        Some(match limit {
            Limit::AtLeast(_) => figures[lower],
            Limit::Under(_) | Limit::AtMost(_) | Limit::Reported => figures[figures.len() / 2],
        })
    }

    /// Least and largest figure; empty without any.
    pub fn range(&self) -> String {
        let least = self.figures.iter().copied().fold(f64::INFINITY, f64::min);
        let largest = self.figures.iter().copied().fold(f64::NEG_INFINITY, f64::max);
        if least > largest { String::new() } else { format!("{least:.3} to {largest:.3}") }
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

    #[test]
    fn every_run_is_kept_and_the_median_is_of_all_of_them() {
        let path = std::env::temp_dir().join(format!("tombolo-runs-{}.csv", std::process::id()));
        let _ = std::fs::remove_file(&path);
        let limit = Limit::Under(3.0);
        let row = |figure| [Bar::new("time, \"p99\"", Some(figure), "s", limit)];
        append(&path, "other", "abc", &row(100.0)).unwrap();
        append(&path, "x", "old", &row(100.0)).unwrap();
        for figure in [1.0, 9.0, 2.0, 4.0] {
            append(&path, "x", "abc", &row(figure)).unwrap();
        }
        let runs = Runs::read(&std::fs::read_to_string(&path).unwrap(), "x", Some("abc"));
        let of_all = Runs::read(&std::fs::read_to_string(&path).unwrap(), "x", None);
        assert_eq!(of_all.of("time, \"p99\"").figures, [100.0, 1.0, 9.0, 2.0, 4.0]);
        std::fs::remove_file(&path).unwrap();
        let spread = runs.of("time, \"p99\"");
        assert_eq!(spread, Spread { figures: vec![1.0, 9.0, 2.0, 4.0], kept: 2 });
        assert_eq!(
            (runs.count(), spread.median(limit), spread.range().as_str()),
            (4, Some(4.0), "1.000 to 9.000")
        );
    }

    #[test]
    fn of_two_middle_figures_the_worse_one_counts() {
        let spread = |figures: &[f64]| Spread { figures: figures.into(), kept: 0 };
        let two = spread(&[7.0, 5.0]);
        for limit in [Limit::Under(6.0), Limit::AtMost(6.0), Limit::Reported] {
            assert_eq!(two.median(limit), Some(7.0), "{limit:?}");
        }
        assert_eq!(two.median(Limit::AtLeast(6.0)), Some(5.0));
        // The control: the middle one of three is the same whatever the limit.
        let three = spread(&[7.0, 5.0, 6.0]);
        assert_eq!(
            [Limit::AtMost(6.0), Limit::AtLeast(6.0)].map(|limit| three.median(limit)),
            [Some(6.0); 2]
        );
    }

    #[test]
    fn runs_of_a_commit_on_earlier_days_count_and_those_of_other_machines_do_not() {
        let folder = std::env::temp_dir().join(format!("tombolo-days-{}", std::process::id()));
        let _ = std::fs::remove_dir_all(&folder);
        let days = [
            ("2026-01-02-cpu-2-cores", 1.0),
            ("2026-01-04-cpu-2-cores", 3.0),
            ("2026-01-03-cpu-2-cores", 2.0),
            ("2026-01-03-other-cpu-2-cores", 9.0),
            ("2026-01-03-cpu-2-cores-x", 9.0),
        ];
        for (day, figure) in days {
            std::fs::create_dir_all(folder.join(day)).unwrap();
            let row = Bar::reported("time", Some(figure), "s");
            append(&folder.join(day).join(FILE), "x", "abc", &[row]).unwrap();
        }
        // A day without runs, and a file among the days.
        std::fs::create_dir_all(folder.join("2026-01-05-cpu-2-cores")).unwrap();
        std::fs::write(folder.join("README.md"), "").unwrap();
        let runs = |commit| Runs::of_machine(&folder, "cpu-2-cores", "x", commit).unwrap();
        assert_eq!(runs(Some("abc")).of("time").figures, [1.0, 2.0, 3.0]);
        assert_eq!(runs(None).of("time").figures, [1.0, 2.0, 3.0]);
        assert!(runs(Some("old")).of("time").figures.is_empty());
        std::fs::remove_dir_all(&folder).unwrap();
    }

    #[test]
    fn a_run_without_a_figure_leaves_no_median() {
        let text = format!("{HEADER}\nx,abc,a,1,s,b,yes\nx,abc,a,,s,b,no\n");
        let spread = Runs::read(&text, "x", Some("abc")).of("a");
        let median = spread.median(Limit::Under(3.0));
        assert_eq!((median, spread.kept, spread.figures.len()), (None, 1, 2));
    }
}
