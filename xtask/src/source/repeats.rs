//! Runs of equal lines in two places.

use super::Files;
use super::lines::{is_test, without_tests};
use std::collections::HashMap;

/// Lines that make a repeat.
const RUN: usize = 6;

/// Number of repeats: maximal runs of at least [`RUN`] equal lines of code in two places, outside
/// tests and examples. Blank lines, comments, imports and lone punctuation do not count as lines.
pub fn count(files: &Files) -> usize {
    let mut code = Vec::new();
    for (path, text) in files.with_extension(&["rs", "wesl", "js"]) {
        if !is_test(path) && !path.contains("/examples/") {
            let lines = without_tests(text).map(|(_, line)| line.trim()).filter(|line| is_code(line));
            code.push(lines.collect::<Vec<_>>());
        }
    }
    let mut seen: HashMap<&[&str], Vec<(usize, usize)>> = HashMap::new();
    let mut repeats = 0;
    for (file, lines) in code.iter().enumerate() {
        for (start, window) in lines.windows(RUN).enumerate() {
            let places = seen.entry(window).or_default();
            // A run that continues an earlier one is the same run.
            let is_new = |(other, at): &&(usize, usize)| {
                let continues = start > 0
                    && *at > 0
                    && code.get(*other).and_then(|lines| lines.get(at - 1)) == lines.get(start - 1);
                !continues && (*other != file || at + RUN <= start)
            };
            repeats += places.iter().filter(is_new).count();
            places.push((file, start));
        }
    }
    repeats
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
            |one: &str, two: &str| count(&Files::of(&[("a.rs", &lines(one)), ("b.rs", &lines(two))]));
        assert_eq!(count_of("abcdefgh", "xabcdefghy"), 1, "eight equal lines are one run");
        assert_eq!(count_of("abcdef", "xyabcdefz"), 1);
        assert_eq!(count_of("abcde", "xabcdey"), 0);
        assert_eq!(count_of("abcdefabcdef", "x"), 1, "within one file");
        assert_eq!(count_of("abcdefxuvwrst", "uvwrstyabcdef"), 2);
    }

    #[test]
    fn tests_and_comments_do_not_count() {
        let text = lines("abcdefgh");
        assert_eq!(count(&Files::of(&[("a.rs", &text), ("tests/b.rs", &text)])), 0);
        let comments = "// one\n".repeat(20);
        assert_eq!(count(&Files::of(&[("a.rs", &comments), ("b.rs", &comments)])), 0);
    }
}
