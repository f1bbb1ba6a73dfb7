//! Declared curves: rows of a measurement with typed columns. Tables, CSV, JSON and charts of all
//! curves come from [`crate::table`] and [`crate::chart`].

use crate::chart::{Choice, Panel};
use crate::table::Table;
use std::fmt::Display;

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

/// A column of a [`Sheet`].
#[derive(Clone, Copy, Debug)]
pub struct Column(usize);

/// Measured rows with the columns declared over them.
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
    pub fn column(&mut self, name: impl Into<String>, value: impl Fn(&R) -> f64) -> Column {
        self.table.columns.push(name.into());
        self.rows.iter().zip(&mut self.table.rows).for_each(|(row, values)| values.push(value(row)));
        Column(self.table.columns.len() - 1)
    }

    /// Declares a column with the number of each row.
    pub fn index_column(&mut self, name: &str) -> Column {
        self.table.columns.push(name.into());
        self.table.rows.iter_mut().enumerate().for_each(|(index, values)| values.push(index as f64));
        Column(self.table.columns.len() - 1)
    }

    /// Name of a column.
    pub fn name_of(&self, column: Column) -> &str {
        &self.table.columns[column.0]
    }

    /// Pairs of two columns.
    pub fn points(&self, x: Column, y: Column) -> Vec<(f64, f64)> {
        self.table.rows.iter().map(|values| (values[x.0], values[y.0])).collect()
    }

    /// Pairs of two columns in some rows.
    pub fn points_where(&self, is_wanted: impl Fn(&R) -> bool, x: Column, y: Column) -> Vec<(f64, f64)> {
        let rows = self.rows.iter().zip(self.points(x, y));
        rows.filter(|(row, _)| is_wanted(row)).map(|(_, point)| point).collect()
    }

    /// Cost and error of every row as a choice; `name`: its label, and whether it is the default.
    pub fn choices(&self, cost: Column, error: Column, name: impl Fn(&R) -> (String, bool)) -> Vec<Choice> {
        let choice = |(row, at)| {
            let (name, is_shipped) = name(row);
            Choice { name, at, is_shipped }
        };
        self.rows.iter().zip(self.points(cost, error)).map(choice).collect()
    }
}

impl<R> From<Sheet<R>> for Table {
    fn from(sheet: Sheet<R>) -> Self {
        sheet.table
    }
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

    #[test]
    fn columns_are_values_of_rows_in_order() {
        let mut sheet = Sheet::new("t", "caption", vec![1.0, 2.0]);
        let x = sheet.column("x", |row| *row);
        let y = sheet.column("y, m", |row| row * row);
        assert_eq!(sheet.points(x, y), [(1.0, 1.0), (2.0, 4.0)]);
        assert_eq!(sheet.points_where(|row| *row > 1.0, y, x), [(4.0, 2.0)]);
        let choices = sheet.choices(x, y, |row| (row.to_string(), *row == 2.0));
        assert_eq!((choices[1].name.as_str(), choices[1].at, choices[1].is_shipped), ("2", (2.0, 4.0), true));
        let table = Table::from(sheet);
        assert_eq!((table.columns, table.rows[1].clone()), (vec!["x".into(), "y, m".into()], vec![2.0, 4.0]));
        assert_eq!(numbered(["a", "b"], "; "), "0 a; 1 b");
    }
}
