//! What the README must say beside a figure whose record is out of date or of one run.

use super::link;
use std::collections::BTreeMap;

/// A caveat: the code has changed since the record.
pub const OLDER_CODE: &str = "older code";

/// A caveat: the figure is of one run.
pub const ONE_RUN: &str = "one run";

/// Between caveats of one record.
pub const SEPARATOR: &str = ", ";

/// Caveats of records by path; a record without one is absent.
pub type Caveats = BTreeMap<String, String>;

/// The README with the caveat of each quoted record in parentheses behind its link, in the rows of
/// tables.
pub fn annotated(readme: &str, caveats: &Caveats) -> String {
    let mut text: String = readme.lines().map(|line| row(line, caveats) + "\n").collect();
    if !readme.ends_with('\n') {
        text.pop();
    }
    text
}

/// Rows of the README whose caveat is missing, wrong or too many.
pub fn wrong_rows(readme: &str, caveats: &Caveats) -> usize {
    let right = annotated(readme, caveats);
    readme.lines().zip(right.lines()).filter(|(is, should_be)| is != should_be).count()
}

fn row(line: &str, caveats: &Caveats) -> String {
    let Some(link) = link::first(line).filter(|_| line.starts_with('|')) else { return line.to_owned() };
    let (head, rest) = line.split_at(link.end);
    let rest = without_caveat(rest);
    match caveats.get(link.path) {
        Some(caveat) => format!("{head} ({caveat}){rest}"),
        None => format!("{head}{rest}"),
    }
}

/// What stands behind a link, without the caveat that begins it. Other parentheses are kept.
fn without_caveat(rest: &str) -> &str {
    let is_caveat = |text: &str| text.split(SEPARATOR).all(|part| [OLDER_CODE, ONE_RUN].contains(&part));
    match rest.strip_prefix(" (").and_then(|rest| rest.split_once(')')) {
        Some((text, behind)) if is_caveat(text) => behind,
        _ => rest,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const LINK: &str = "| time | 0.2 | [a](docs/measurements/2026-x/a.md \"row (of 2\")";

    #[test]
    fn a_row_says_what_its_record_lacks_and_nothing_else() {
        let old = Caveats::from([("docs/measurements/2026-x/a.md".into(), "older code, one run".into())]);
        let marked =
            format!("# T\n\n{LINK} (older code, one run) |\nsee [a](docs/measurements/2026-x/a.md)\n");
        let plain = marked.replace(" (older code, one run)", "");
        for text in [&marked, &plain] {
            assert_eq!(annotated(text, &old), marked);
            assert_eq!(annotated(text, &Caveats::new()), plain);
        }
        assert_eq!((wrong_rows(&marked, &old), wrong_rows(&plain, &old)), (0, 1));
        assert_eq!((wrong_rows(&marked, &Caveats::new()), wrong_rows(&plain, &Caveats::new())), (1, 0));
    }

    #[test]
    fn what_stands_behind_the_link_is_kept() {
        let path = "docs/measurements/2026-x/a.md";
        let old = Caveats::from([(path.into(), OLDER_CODE.into())]);
        let link = format!("| time | 0.2 | [a]({path} \"row (of 2), all\")");
        for rest in [" |", " | a fourth (column) |", " (on a laptop) |", ""] {
            let (plain, marked) = (format!("{link}{rest}"), format!("{link} (older code){rest}"));
            for text in [&plain, &marked, &format!("{link} (one run){rest}")] {
                assert_eq!(annotated(text, &old), marked);
                assert_eq!(annotated(text, &Caveats::new()), plain);
            }
        }
    }
}
