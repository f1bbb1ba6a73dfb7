//! Declared curves: rows of a measurement with typed columns. Tables, CSV, JSON and charts of all
//! curves come from [`crate::table`] and the crate `chart`.

use crate::table::Table;
use anyhow::{Context, Result};
use chart::{Chart, Choice, Panel};
use std::fmt::Display;
use std::fs::File;
use std::path::Path;

/// A curve: its tables, and its panels under one title.
#[derive(Clone, Debug)]
pub struct Curve {
    /// Name of the chart's file.
    pub name: &'static str,
    /// Title over all panels.
    pub title: &'static str,
    /// The figures.
    pub tables: Vec<Table>,
    /// The diagrams.
    pub panels: Vec<Panel>,
}

/// Measured rows with the columns declared over them. Columns are named by their titles in the
/// table.
#[derive(Clone, Debug)]
pub struct Sheet<R> {
    pub rows: Vec<R>,
    table: Table,
}

impl<R> Sheet<R> {
    /// Rows without columns.
    pub fn new(name: &'static str, caption: impl Into<String>, rows: Vec<R>) -> Self {
        let table =
            Table { name, caption: caption.into(), columns: Vec::new(), rows: vec![Vec::new(); rows.len()] };
        Self { rows, table }
    }

    /// Declares a column: its name with unit, and its value in a row.
    pub fn column(&mut self, name: impl Into<String>, value: impl Fn(&R) -> f64) {
        self.table.columns.push(name.into());
        self.rows.iter().zip(&mut self.table.rows).for_each(|(row, values)| values.push(value(row)));
    }

    /// Declares several columns.
    pub fn columns<const N: usize>(
        &mut self,
        names: [impl Into<String>; N],
        values: impl Fn(&R) -> [f64; N],
    ) {
        self.table.columns.extend(names.map(Into::into));
        self.rows.iter().zip(&mut self.table.rows).for_each(|(row, all)| all.extend(values(row)));
    }

    /// Pairs of two columns.
    pub fn points(&self, x: &str, y: &str) -> Vec<(f64, f64)> {
        self.table.points(x, y)
    }

    /// Pairs of two columns in some rows.
    pub fn points_where(&self, is_wanted: impl Fn(&R) -> bool, x: &str, y: &str) -> Vec<(f64, f64)> {
        let rows = self.rows.iter().zip(self.points(x, y));
        rows.filter(|(row, _)| is_wanted(row)).map(|(_, point)| point).collect()
    }

    /// A panel with curves over a column, each with its label and its column.
    pub fn lines(
        &self,
        panel: Panel,
        x: &str,
        curves: impl IntoIterator<Item = (&'static str, impl AsRef<str>)>,
    ) -> Panel {
        curves.into_iter().fold(panel, |panel, (label, y)| panel.line(label, self.points(x, y.as_ref())))
    }

    /// A panel with the front of two columns; `name`: the label of a row, and whether it is the
    /// default.
    pub fn front(&self, panel: Panel, x: &str, y: &str, name: impl Fn(&R) -> (String, bool)) -> Panel {
        let choice = |(row, at)| {
            let (name, is_shipped) = name(row);
            Choice { name, at, is_shipped }
        };
        panel.front(&self.rows.iter().zip(self.points(x, y)).map(choice).collect::<Vec<_>>())
    }
}

impl<R> From<Sheet<R>> for Table {
    fn from(sheet: Sheet<R>) -> Self {
        sheet.table
    }
}

/// Draws a chart into a file.
///
/// # Errors
/// The file cannot be written, or a panel has nothing to show.
pub fn draw(path: &Path, chart: &Chart) -> Result<()> {
    let written = File::create(path).map_err(anyhow::Error::from).and_then(|file| chart.write(file));
    written.with_context(|| format!("--out: cannot write `{}`", path.display()))
}

/// Names with their numbers: `0 first; 1 second`.
pub fn numbered(names: impl IntoIterator<Item = impl Display>, separator: &str) -> String {
    let numbered = names.into_iter().enumerate().map(|(index, name)| format!("{index} {name}"));
    numbered.collect::<Vec<_>>().join(separator)
}

/// Points of a logarithmic axis: values below a floor are drawn at it.
pub fn floored(points: Vec<(f64, f64)>, floor: f64) -> Vec<(f64, f64)> {
    points.into_iter().map(|(x, y)| (x, y.max(floor))).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use chart::linear;

    #[test]
    fn columns_are_values_of_rows_in_order() {
        let mut sheet = Sheet::new("t", "caption", vec![1.0, 2.0]);
        sheet.column("x", |row| *row);
        sheet.column("y, m", |row| row * row);
        assert_eq!(sheet.points("x", "y, m"), [(1.0, 1.0), (2.0, 4.0)]);
        assert_eq!(sheet.points_where(|row| *row > 1.0, "y, m", "x"), [(4.0, 2.0)]);
        let empty = || Panel::new("t", linear("x"), linear("y"));
        let panel = sheet.lines(empty(), "x", [("curve", "y, m")]);
        assert_eq!((&*panel.series[0].label, panel.series[0].points.len()), ("curve", 2));
        let front = sheet.front(empty(), "x", "y, m", |row| (row.to_string(), *row == 2.0));
        assert_eq!((&*front.series[0].names[0], &*front.series[2].label), ("1", "the default"));
        let table = Table::from(sheet);
        assert_eq!((table.columns, table.rows[1].clone()), (vec!["x".into(), "y, m".into()], vec![2.0, 4.0]));
        assert_eq!(numbered(["a", "b"], "; "), "0 a; 1 b");
    }
}
