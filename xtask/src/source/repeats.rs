//! Runs of equal lines in two places.

use super::lines::is_test;
use super::{Files, Finding};
use crate::test_modules::without_tests;
use std::collections::HashMap;

/// Lines that make a repeat.
const RUN: usize = 6;

/// Repeats: maximal runs of at least [`RUN`] equal lines of code in two places, outside tests and
/// examples. Blank lines, comments, imports and lone punctuation do not count as lines.
pub fn find(files: &Files) -> Vec<Finding> {
    let (mut code, mut places) = (Vec::new(), Vec::new());
    for (path, text) in files.with_extension(&["rs", "wesl", "js"]) {
        if !is_test(path) && !path.contains("/examples/") {
            let lines = without_tests(text).map(|(number, line)| (number + 1, line.trim()));
            let (numbers, lines): (Vec<_>, Vec<_>) = lines.filter(|(_, line)| is_code(line)).unzip();
            places.push((path, numbers));
            code.push(lines);
        }
    }
    let mut seen: HashMap<&[&str], Vec<(usize, usize)>> = HashMap::new();
    let mut repeats = Vec::new();
    let at = |file: usize, start: usize| format!("{}:{}", places[file].0, places[file].1[start]);
    for (file, lines) in code.iter().enumerate() {
        for (start, window) in lines.windows(RUN).enumerate() {
            let known = seen.entry(window).or_default();
            // A run that continues an earlier one is the same run.
            let is_new = |(other, at): &&(usize, usize)| {
                let continues = start > 0
                    && *at > 0
                    && code.get(*other).and_then(|lines| lines.get(at - 1)) == lines.get(start - 1);
                // A Rust twin of a shader has the same lines on purpose.
                let is_twin = is_shader(places[*other].0) != is_shader(places[file].0);
                !continues && !is_twin && (*other != file || at + RUN <= start)
            };
            repeats.extend(known.iter().filter(is_new).map(|(other, from)| Finding {
                path: places[file].0.to_owned(),
                line: places[file].1[start],
                what: format!("the same lines as {}", at(*other, *from)),
            }));
            known.push((file, start));
        }
    }
    repeats
}

fn is_shader(path: &str) -> bool {
    path.ends_with(".wesl")
}

fn is_code(line: &str) -> bool {
    let is_comment = ["//", "*", "/*", "#["].iter().any(|start| line.starts_with(start));
    let is_import = ["use ", "pub use ", "import "].iter().any(|start| line.starts_with(start));
    !is_comment && !is_import && line.chars().any(char::is_alphanumeric)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn lines(names: &str) -> String {
        names.chars().map(|name| format!("    let {name} = 1;\n\n")).collect()
    }

    #[test]
    fn a_run_of_six_lines_is_one_repeat_and_one_of_five_is_none() {
        let count_of =
            |one: &str, two: &str| find(&Files::of(&[("a.rs", &lines(one)), ("b.rs", &lines(two))])).len();
        assert_eq!(count_of("abcdefgh", "xabcdefghy"), 1, "eight equal lines are one run");
        assert_eq!(count_of("abcdef", "xyabcdefz"), 1);
        assert_eq!(count_of("abcde", "xabcdey"), 0);
        assert_eq!(count_of("abcdefabcdef", "x"), 1, "within one file");
        assert_eq!(count_of("abcdefxuvwrst", "uvwrstyabcdef"), 2);
    }

    #[test]
    fn tests_and_comments_do_not_count() {
        let text = lines("abcdefgh");
        assert_eq!(find(&Files::of(&[("a.rs", &text), ("tests/b.rs", &text)])).len(), 0);
        let comments = "// one\n".repeat(20);
        assert_eq!(find(&Files::of(&[("a.rs", &comments), ("b.rs", &comments)])).len(), 0);
    }
}
