//! Which lines of a Rust file are tests.

/// The lines of a file with their numbers from 0, up to its test module. Such a module ends a file.
pub fn without_tests(text: &str) -> impl Iterator<Item = (usize, &str)> {
    let end = text
        .lines()
        .zip(text.lines().skip(1))
        .position(|(line, next)| line == "#[cfg(test)]" && next.starts_with("mod ") && next.ends_with('{'));
    text.lines().enumerate().take(end.unwrap_or(usize::MAX))
}

/// Whether two versions of a file differ in tests alone.
pub fn differ_in_tests_alone(one: &str, other: &str) -> bool {
    let lines = |text| without_tests(text).map(|(_, line)| line);
    lines(one).eq(lines(other))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_change_before_the_test_module_is_seen_and_one_in_it_is_not() {
        let file = |code: &str, test: &str| format!("{code}\n#[cfg(test)]\nmod tests {{\n{test}\n}}\n");
        let one = file("fn a() {}", "    fn b() {}");
        assert!(differ_in_tests_alone(&one, &file("fn a() {}", "    fn c() {}")));
        assert!(!differ_in_tests_alone(&one, &file("fn c() {}", "    fn b() {}")));
        assert!(!differ_in_tests_alone("fn a() {}\n", "fn a() {}\nfn b() {}\n"));
    }
}
