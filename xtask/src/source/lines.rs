//! Counts of lines.

use super::{Files, Finding};
use crate::test_modules::without_tests;

/// Most lines of the README.
pub const README_LIMIT: usize = 80;

/// A README over [`README_LIMIT`] lines.
pub fn check_readme(files: &Files) -> Vec<Finding> {
    let count = readme(files);
    let what = format!("{count} lines, at most {README_LIMIT}");
    let finding = || Finding { path: "README.md".into(), line: README_LIMIT + 1, what };
    if count > README_LIMIT { vec![finding()] } else { Vec::new() }
}

/// Lines of the README.
pub fn readme(files: &Files) -> usize {
    files.0.get("README.md").map_or(usize::MAX, |text| text.lines().count())
}

/// Folders of code that measures and is not part of the product.
const MEASURING: [&str; 6] = ["lab/", "server-bench/", "bars/", "chart/", "xtask/src/measure", "benches/"];

/// Lines of Rust that measure, without tests: files under `tests/`, and modules behind
/// `#[cfg(test)]`, are left out.
pub fn measuring(files: &Files) -> usize {
    let measures = |path: &str| MEASURING.iter().any(|folder| path.starts_with(folder));
    files
        .with_extension(&["rs"])
        .filter(|(path, _)| measures(path) && !is_test(path))
        .map(|(_, text)| without_tests(text).count())
        .sum()
}

/// Whether a whole file is a test.
pub fn is_test(path: &str) -> bool {
    path.starts_with("tests/") || path.contains("/tests/") || path.ends_with("/tests.rs")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn tests_do_not_count_and_other_folders_neither() {
        let module = "fn a() {}\n\n#[cfg(test)]\nmod tests {\n    fn b() {}\n}\n";
        let files = Files::of(&[
            ("lab/src/a.rs", module),
            ("lab/tests/b.rs", "fn c() {}\n"),
            ("server/src/c.rs", module),
            ("benches/d/src/main.rs", "fn d() {}\n"),
        ]);
        assert_eq!(measuring(&files), 3);
    }

    #[test]
    fn a_readme_of_81_lines_is_found_and_one_of_80_is_not() {
        for (count, found) in [(80, 0), (81, 1)] {
            assert_eq!(check_readme(&Files::of(&[("README.md", &"x\n".repeat(count))])).len(), found);
        }
        assert_eq!(check_readme(&Files::default()).len(), 1, "no README is no README that fits");
    }
}
