//! Which lines of a Rust file are code, and which are tests.

/// The lines of a file with their numbers from 0, up to its test module. Such a module ends a file.
pub fn without_tests(text: &str) -> impl Iterator<Item = (usize, &str)> {
    let end = text
        .lines()
        .zip(text.lines().skip(1))
        .position(|(line, next)| line == "#[cfg(test)]" && next.starts_with("mod ") && next.ends_with('{'));
    text.lines().enumerate().take(end.unwrap_or(usize::MAX))
}

/// Whether two versions of a file have the same code, apart from tests, lines of comments, and line
/// breaks in place of spaces.
pub fn have_equal_code(one: &str, other: &str) -> bool {
    let is_code = |line: &&str| !line.trim_start().starts_with("//");
    let words = |text| {
        let lines = without_tests(text).map(|(_, line)| line);
        lines.filter(is_code).flat_map(str::split_whitespace)
    };
    words(one).eq(words(other))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_change_of_code_is_seen_and_one_of_tests_or_comments_is_not() {
        let file = |code: &str, test: &str| format!("{code}\n#[cfg(test)]\nmod tests {{\n{test}\n}}\n");
        let one = file("fn a() {}", "    fn b() {}");
        assert!(have_equal_code(&one, &file("fn a() {}", "    fn c() {}")));
        assert!(have_equal_code(&one, &file("/// Does nothing.\nfn a() {}", "    fn b() {}")));
        assert!(have_equal_code(&one, "fn a() {}\n"), "the first test of a file");
        assert!(have_equal_code(&one, &file("fn a()\n    {}", "    fn b() {}")), "a line break");
        assert!(!have_equal_code(&one, &file("fn c() {}", "    fn b() {}")));
        assert!(!have_equal_code("fn a() {}\n", "fn a() {}\nfn b() {}\n"));
    }
}
