//! Tables of numbers: text on standard output, CSV and JSON.

use anyhow::{Context, Result};
use serde::Serialize;
use std::fmt;
use std::fmt::Write as _;
use std::path::Path;

/// A table. Every column's name carries its unit.
#[derive(Clone, Debug, Serialize)]
pub struct Table {
    /// Its name, and that of its files.
    pub name: &'static str,
    /// One sentence: what was measured and how.
    pub caption: String,
    /// Names of the columns.
    pub columns: Vec<String>,
    /// Rows of as many values; a missing value is not a number.
    pub rows: Vec<Vec<f64>>,
}

impl Table {
    /// Pairs of two columns.
    ///
    /// # Panics
    /// If there is no such column.
    pub fn points(&self, x: &str, y: &str) -> Vec<(f64, f64)> {
        let column = |name: &str| self.columns.iter().position(|column| column == name);
        let [x, y] = [x, y].map(|name| column(name).unwrap_or_else(|| panic!("no column `{name}`")));
        self.rows.iter().map(|row| (row[x], row[y])).collect()
    }

    /// Writes `NAME.csv` into a folder.
    ///
    /// # Errors
    /// The file cannot be written.
    pub fn write_csv(&self, folder: &Path) -> Result<()> {
        let path = folder.join(format!("{}.csv", self.name));
        std::fs::write(&path, self.csv()).with_context(|| format!("--out: cannot write `{}`", path.display()))
    }

    fn csv(&self) -> String {
        let quoted = |text: &str| if text.contains(',') { format!("\"{text}\"") } else { text.to_owned() };
        let mut csv = self.columns.iter().map(|column| quoted(column)).collect::<Vec<_>>().join(",");
        csv.push('\n');
        for row in &self.rows {
            let cells =
                row.iter().map(|value| if value.is_nan() { String::new() } else { value.to_string() });
            let _ = writeln!(csv, "{}", cells.collect::<Vec<_>>().join(","));
        }
        csv
    }
}

impl fmt::Display for Table {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(f, "{}: {}", self.name, self.caption)?;
        let width = |column: &String| column.chars().count().max(9);
        for column in &self.columns {
            write!(f, "{column:>width$}  ", width = width(column))?;
        }
        writeln!(f)?;
        for row in &self.rows {
            for (value, column) in row.iter().zip(&self.columns) {
                write!(f, "{:>width$}  ", shown(*value), width = width(column))?;
            }
            writeln!(f)?;
        }
        Ok(())
    }
}

/// Four significant digits; whole numbers whole.
fn shown(value: f64) -> String {
    if value.is_nan() {
        "-".into()
    } else if value == 0.0 || (value.fract() == 0.0 && value.abs() < 1e9) {
        format!("{value}")
    } else if value.abs() < 1e-4 {
        format!("{value:.2e}")
    } else {
        let digits = (3 - value.abs().log10().floor() as i32).clamp(0, 7) as usize;
        format!("{value:.digits$}")
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn table() -> Table {
        let rows = vec![vec![1.0, f64::NAN], vec![0.012_345, 2e-7]];
        Table { name: "t", caption: "caption.".into(), columns: vec!["a, m".into(), "b".into()], rows }
    }

    #[test]
    fn csv_quotes_commas_and_leaves_missing_values_empty() {
        assert_eq!(table().csv(), "\"a, m\",b\n1,\n0.012345,0.0000002\n");
    }

    #[test]
    fn text_has_four_digits_and_a_dash() {
        let text = table().to_string();
        assert!(text.contains("0.01235") && text.contains("2.00e-7") && text.contains(" -  "), "{text}");
        assert_eq!(table().points("a, m", "b")[1], (0.012_345, 2e-7));
    }
}
