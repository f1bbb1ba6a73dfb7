//! Tables of bars for people.

use crate::{Bar, Figure, Limit, Verdict};
use std::fmt::Write;

impl Bar {
    /// Figure, bar and verdict as three texts.
    #[must_use]
    pub fn cells(&self) -> [String; 3] {
        let figure = match &self.figure {
            Figure::Measured(figure) => with_unit(*figure, &self.unit),
            Figure::Missing => "missing".into(),
            Figure::NotMeasured { .. } => "not measured".into(),
        };
        let bar = match self.limit {
            Limit::Under(limit) => format!("under {}", with_unit(limit, &self.unit)),
            Limit::AtMost(limit) => format!("at most {}", with_unit(limit, &self.unit)),
            Limit::AtLeast(limit) => format!("at least {}", with_unit(limit, &self.unit)),
            Limit::Reported => "reported".into(),
        };
        let verdict = match (self.verdict(), &self.figure) {
            (Verdict::NotMeasured, Figure::NotMeasured { reason }) => reason.clone(),
            (Verdict::Missed, _) => "MISSED".into(),
            _ => "ok".into(),
        };
        [figure, bar, verdict]
    }
}

/// A table for a terminal, one row a line.
#[must_use]
pub fn text(bars: &[Bar]) -> String {
    let rows: Vec<_> = bars.iter().map(|bar| (&bar.name, bar.cells())).collect();
    let width = |cell: fn(&[String; 3]) -> &String| {
        rows.iter().map(|(_, cells)| cell(cells).chars().count()).max().unwrap_or_default()
    };
    let name = rows.iter().map(|(name, _)| name.chars().count()).max().unwrap_or_default();
    let (figure, bar) = (width(|cells| &cells[0]), width(|cells| &cells[1]));
    let mut table = String::new();
    for (what, [left, middle, right]) in &rows {
        // Writing to a string cannot fail.
        let _ = writeln!(table, "{what:<name$}  {left:>figure$}  {middle:<bar$}  {right}");
    }
    table
}

/// The same as a Markdown table, followed by the notes as a list.
#[must_use]
pub fn markdown(bars: &[Bar]) -> String {
    let mut table = String::from("| what | figure | bar | |\n| --- | ---: | --- | --- |\n");
    for bar in bars {
        let cells = bar.cells().map(|text| cell(&text));
        let _ = writeln!(table, "| {} | {} |", cell(&bar.name), cells.join(" | "));
    }
    for (index, bar) in bars.iter().filter(|bar| bar.note.is_some()).enumerate() {
        let gap = if index == 0 { "\n" } else { "" };
        let _ = writeln!(table, "{gap}- {}: {}", bar.name, bar.note.as_deref().unwrap_or_default());
    }
    table
}

/// A text that cannot break a Markdown table.
fn cell(text: &str) -> String {
    text.replace('|', "/").replace('\n', " ")
}

/// Whole numbers as such, the rest with three decimals: enough to tell a figure from its bar.
fn with_unit(value: f64, unit: &str) -> String {
    let number = if value.fract() == 0.0 { format!("{value:.0}") } else { format!("{value:.3}") };
    if unit.is_empty() { number } else { format!("{number} {unit}") }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn cells_show_figure_bar_and_verdict() {
        for (bar, cells) in [
            (Bar::new("x", 2.5, "s", Limit::Under(3.0)), ["2.500 s", "under 3 s", "ok"]),
            (Bar::new("x", None, "", Limit::AtMost(0.0)), ["missing", "at most 0", "MISSED"]),
            (Bar::new("x", 41.0, "x", Limit::AtLeast(40.0)), ["41 x", "at least 40 x", "ok"]),
            (Bar::new("x", 1.0, "", Limit::Reported), ["1", "reported", "ok"]),
            (
                Bar::under("x", None, "ms", 2.0).not_measured_if(true, "needs a GPU"),
                ["not measured", "under 2 ms", "needs a GPU"],
            ),
        ] {
            assert_eq!(bar.cells(), cells);
        }
    }

    #[test]
    fn text_tables_are_aligned() {
        let bars = [
            Bar::new("short", 1.0, "", Limit::AtMost(2.0)),
            Bar::new("a longer name", None, "", Limit::AtLeast(25_000.0)),
        ];
        let expected = "short                1  at most 2       ok\n\
                        a longer name  missing  at least 25000  MISSED\n";
        assert_eq!(text(&bars), expected);
    }

    #[test]
    fn markdown_tables_escape_cells_and_list_notes() {
        let bars = [
            Bar::new("a | b", 1.5, "s", Limit::Under(3.0)).with_note("defined so"),
            Bar::new("c", None, "", Limit::AtMost(0.0)),
        ];
        let expected = "| what | figure | bar | |\n| --- | ---: | --- | --- |\n\
                        | a / b | 1.500 s | under 3 s | ok |\n\
                        | c | missing | at most 0 | MISSED |\n\
                        \n- a | b: defined so\n";
        assert_eq!(markdown(&bars), expected);
    }
}
