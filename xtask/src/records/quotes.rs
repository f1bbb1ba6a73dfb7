//! Figures that tables of the README quote from records.
//!
//! A record of older code, of a changed working tree or of one run must not be quoted: its row then
//! has [`WITHDRAWN`] in place of the figure, until there is a fit record.

use super::link;
use super::record::Record;

/// Placeholder of a figure whose record must not be quoted.
pub const WITHDRAWN: &str = "to be measured again";

/// Records that links of a text lead to, in their own place or in a definition, except those of
/// withdrawn figures.
pub fn quoted(text: &str) -> Vec<&str> {
    let lines = text.lines().filter(|line| !is_withdrawn(line));
    lines.flat_map(|line| link::all(line).map(|link| link.path).chain(link::definition(line))).collect()
}

/// The README with figures of unfit records withdrawn, and withdrawn figures of fit ones as their
/// records state them. `fit` are the records that may be quoted.
pub fn corrected(readme: &str, fit: &[&Record]) -> String {
    let mut text: String = readme.lines().map(|line| row(line, fit) + "\n").collect();
    if !readme.ends_with('\n') {
        text.pop();
    }
    text
}

/// Rows of the README whose figure is to be withdrawn or stated.
pub fn wrong_rows(readme: &str, fit: &[&Record]) -> usize {
    let right = corrected(readme, fit);
    readme.lines().zip(right.lines()).filter(|(is, should_be)| is != should_be).count()
}

fn row(line: &str, fit: &[&Record]) -> String {
    let Some((what, figure, rest, link)) = parts(line) else { return line.to_owned() };
    let record = fit.iter().find(|record| record.path == link.path);
    let stated = || {
        let row = record?.rows.iter().find(|row| Some(row.what.as_str()) == link.title)?;
        Some(row.figure.as_str())
    };
    let figure = match (record, figure == WITHDRAWN) {
        (None, _) => WITHDRAWN,
        (Some(_), false) => figure,
        (Some(_), true) => stated().unwrap_or(WITHDRAWN),
    };
    format!("|{what}| {figure} |{rest}")
}

/// The first cell, the trimmed second one, what follows it, and the link therein.
fn parts(line: &str) -> Option<(&str, &str, &str, link::Link<'_>)> {
    let (what, rest) = line.strip_prefix('|')?.split_once('|')?;
    let (figure, rest) = rest.split_once('|')?;
    Some((what, figure.trim(), rest, link::first(rest)?))
}

/// Whether a line is a row of a withdrawn figure.
pub fn is_withdrawn(line: &str) -> bool {
    parts(line).is_some_and(|(_, figure, _, _)| figure == WITHDRAWN)
}

#[cfg(test)]
mod tests {
    use super::super::record::Row;
    use super::*;

    const PATH: &str = "docs/measurements/2026-x/a.md";

    fn line(figure: &str) -> String {
        format!("| time | {figure} | [a]({PATH} \"row (of 2)\") |")
    }

    fn record(figure: &str) -> Record {
        let row = Row { what: "row (of 2)".into(), figure: figure.into(), ..Row::default() };
        Record { path: PATH.into(), rows: vec![row], ..Record::default() }
    }

    #[test]
    fn a_figure_of_an_unfit_record_is_withdrawn_and_stated_again_by_a_fit_one() {
        let text = |figure: &str| format!("# T\n\n{}\nsee [x](docs/a.md)\n", line(figure));
        let (quoted, withdrawn) = (text("0.2"), text(WITHDRAWN));
        assert_eq!(corrected(&quoted, &[]), withdrawn);
        assert_eq!((wrong_rows(&quoted, &[]), wrong_rows(&withdrawn, &[])), (1, 0));
        let fit = record("0.21 x");
        assert_eq!(corrected(&withdrawn, &[&fit]), text("0.21 x"));
        assert_eq!((wrong_rows(&quoted, &[&fit]), wrong_rows(&withdrawn, &[&fit])), (0, 1));
        // A figure at another precision is `source`'s matter.
        assert_eq!(corrected(&quoted, &[&fit]), quoted);
    }

    #[test]
    fn only_figures_that_stand_there_are_quotes() {
        assert_eq!(quoted(&format!("{}\n[all](docs/measurements/README.md)", line("0.2"))), [PATH]);
        assert_eq!(quoted(&line(WITHDRAWN)), [""; 0]);
        // Prose has no cell that could be withdrawn.
        let prose = format!("[a]({PATH}) and [b]({PATH} \"row\"): to be measured again");
        assert_eq!(quoted(&prose), [PATH, PATH]);
        assert_eq!(quoted(&format!("[0.2][a]\n\n[a]: {PATH} \"row\"\n[b]: docs/viewer.md")), [PATH]);
    }

    #[test]
    fn a_row_that_the_record_lacks_stays_withdrawn() {
        let other = Record { path: PATH.into(), ..Record::default() };
        assert_eq!(corrected(&line(WITHDRAWN), &[&other]), line(WITHDRAWN));
    }
}
