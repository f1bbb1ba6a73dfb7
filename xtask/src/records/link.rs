//! Links of Markdown to records.

use super::record::FOLDER;

/// A link to a record.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Link<'a> {
    /// Of the record, from the root.
    pub path: &'a str,
    /// Of the link, without its quotation marks; none without one.
    pub title: Option<&'a str>,
    /// Byte behind the link in the text that it was found in.
    pub end: usize,
}

/// The first link of a line to a record; none without one that ends.
pub fn first(line: &str) -> Option<Link<'_>> {
    let start = line.find(&format!("]({FOLDER}2"))? + 2;
    let target = &line[start..];
    let (path, rest) = target.split_at(target.find([' ', ')'])?);
    // Parentheses in a title do not end the link.
    let (title, rest) = match rest.strip_prefix(" \"") {
        Some(titled) => titled.split_once("\")").map(|(title, rest)| (Some(title), rest))?,
        None => (None, rest.split_once(')')?.1),
    };
    Some(Link { path, title, end: line.len() - rest.len() })
}

/// The record to which the definition of a link leads, `[name]: path`; none of another line.
pub fn definition(line: &str) -> Option<&str> {
    let (_, target) = line.trim_start().strip_prefix('[')?.split_once("]: ")?;
    let path = target.split_whitespace().next()?;
    path.starts_with(&format!("{FOLDER}2")).then_some(path)
}

/// Every link of a line to a record.
pub fn all(line: &str) -> impl Iterator<Item = Link<'_>> {
    let mut rest = line;
    std::iter::from_fn(move || {
        let link = first(rest)?;
        rest = &rest[link.end..];
        Some(link)
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    const PATH: &str = "docs/measurements/2026-x/a.md";

    #[test]
    fn a_link_ends_behind_its_title_whatever_stands_in_it() {
        for title in ["a row", "row (of 2)", "row (of 2) and (of 3", ") ("] {
            let head = format!("| a (b) | 1 | [x]({PATH} \"{title}\")");
            let line = format!("{head} (one run) | (more) |");
            assert_eq!(first(&line), Some(Link { path: PATH, title: Some(title), end: head.len() }));
        }
        let line = format!("[x]({PATH}) (y)");
        assert_eq!(first(&line), Some(Link { path: PATH, title: None, end: line.len() - 4 }));
    }

    #[test]
    fn a_line_has_every_link_of_it() {
        let line = format!("[x]({PATH} \"a\") and [y]({PATH}) and [z](docs/measurements/README.md)");
        let titles: Vec<_> = all(&line).map(|link| link.title).collect();
        assert_eq!(titles, [Some("a"), None]);
    }

    #[test]
    fn other_links_and_one_that_does_not_end_are_none() {
        for line in ["[x](docs/measurements/README.md)", "[x](docs/measurements/2026-x/a.md \"row)", PATH, ""]
        {
            assert_eq!(first(line), None, "{line}");
        }
    }
}
