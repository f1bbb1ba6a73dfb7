//! What the README must say beside a figure whose record is out of date or of one run.

use std::collections::BTreeMap;

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
    let unchanged = || line.to_owned();
    let Some(start) = line.find("](docs/measurements/2").filter(|_| line.starts_with('|')) else {
        return unchanged();
    };
    let Some(end) = line[start..].find(')').map(|length| start + length + 1) else { return unchanged() };
    let path = line[start + 2..end - 1].split(' ').next().unwrap_or_default();
    match caveats.get(path) {
        Some(caveat) => format!("{} ({caveat}) |", &line[..end]),
        None => format!("{} |", &line[..end]),
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
}
