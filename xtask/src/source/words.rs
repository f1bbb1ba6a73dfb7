//! Words that the project no longer uses: private names of what has a standard term.

use super::{Files, Finding};

/// One word or phrase a line, with the standard term behind `->`. Lines that begin with `#` are
/// comments.
const RETIRED: &str = include_str!("retired_words.txt");

/// Files that are not checked: the list itself, its tests, lock files, and records from before
/// a word was retired.
const EXEMPT: [&str; 3] = ["xtask/src/source/retired_words.txt", "xtask/src/source/words.rs", "Cargo.lock"];

/// Names that scripts outside the project use; they stay.
const KEPT: [&str; 1] = ["first-voyage"];

/// Extensions of checked files.
const CHECKED: [&str; 9] = ["rs", "wesl", "wgsl", "md", "toml", "js", "css", "html", "json"];

/// A retired word or phrase.
struct Retired {
    /// Lower case, split at spaces.
    words: Vec<&'static str>,
    instead: &'static str,
}

fn retired() -> Vec<Retired> {
    let lines = RETIRED.lines().map(str::trim).filter(|line| !line.is_empty() && !line.starts_with('#'));
    lines
        .filter_map(|line| line.split_once("->"))
        .map(|(old, instead)| Retired { words: old.split_whitespace().collect(), instead: instead.trim() })
        .collect()
}

/// Retired words in identifiers, messages, comments, documents and file names.
pub fn check(files: &Files) -> Vec<Finding> {
    let retired = retired();
    let mut found = Vec::new();
    for (path, text) in files.with_extension(&CHECKED) {
        if EXEMPT.contains(&path)
            || path.starts_with("docs/measurements/")
            || path.starts_with("protocol/fixtures/")
        {
            continue;
        }
        let lines = std::iter::once((0, path)).chain(text.lines().enumerate().map(|(n, line)| (n + 1, line)));
        for (line, text) in lines {
            let text = KEPT.iter().fold(text.to_owned(), |text, kept| text.replace(kept, ""));
            let words = words_of(&text);
            for retired in &retired {
                if words.windows(retired.words.len()).any(|window| window == retired.words) {
                    let what = format!("`{}`: say {}", retired.words.join(" "), retired.instead);
                    found.push(Finding { path: path.into(), line, what });
                }
            }
        }
    }
    found
}

/// The words of a line in lower case; identifiers are split at underscores and capitals.
fn words_of(line: &str) -> Vec<String> {
    let mut words = Vec::new();
    let mut word = String::new();
    let mut was_lower = false;
    for letter in line.chars() {
        let ends = !letter.is_ascii_alphabetic() || (letter.is_ascii_uppercase() && was_lower);
        if ends && !word.is_empty() {
            words.push(std::mem::take(&mut word));
        }
        if letter.is_ascii_alphabetic() {
            word.push(letter.to_ascii_lowercase());
        }
        was_lower = letter.is_ascii_lowercase();
    }
    if !word.is_empty() {
        words.push(word);
    }
    words
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_planted_word_is_found_wherever_it_stands() {
        for (path, text) in [
            ("a.rs", "fn open_the_purse() {}"),
            ("a.rs", "struct BigPurse;"),
            ("a.rs", "// A purse holds ten seconds."),
            ("a.md", "looked for in vain"),
            ("a.wesl", "let PURSE: i32 = 1;"),
            ("server/src/purse.rs", ""),
        ] {
            assert_eq!(check(&Files::of(&[(path, text)])).len(), 1, "{path}: {text}");
        }
    }

    #[test]
    fn longer_words_records_and_other_files_are_left_alone() {
        for (path, text) in [
            ("a.rs", "let purser = pursed;"),
            ("docs/measurements/2026-01-01-x/a.md", "purse"),
            ("a.png", "purse"),
            ("a.md", "in a vain attempt"),
        ] {
            assert_eq!(check(&Files::of(&[(path, text)])), [], "{path}: {text}");
        }
    }

    #[test]
    fn every_line_of_the_list_is_understood() {
        let lines = RETIRED.lines().map(str::trim).filter(|line| !line.is_empty() && !line.starts_with('#'));
        assert_eq!(lines.count(), retired().len());
        assert!(retired().iter().all(|retired| !retired.words.is_empty() && !retired.instead.is_empty()));
    }
}
