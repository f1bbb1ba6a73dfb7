//! Names in documents: files, links, examples, programs, options and metrics must exist.

use super::{Files, Finding};
use std::collections::BTreeSet;

/// Extensions of names that are taken for files.
const FILE_EXTENSIONS: [&str; 16] = [
    "rs", "wesl", "wgsl", "md", "toml", "js", "css", "html", "png", "svg", "hex", "yml", "yaml", "json",
    "conf", "service",
];

/// Options of cargo that name a target, and the folder of such targets.
const CARGO_TARGETS: [(&str, &str); 3] =
    [("--example ", "examples"), ("--test ", "tests"), ("--bench ", "benches")];

/// Options of programs that are not the project's.
const FOREIGN_OPTIONS: [&str; 34] = [
    "bench",
    "release",
    "bin",
    "package",
    "example",
    "workspace",
    "cfg",
    "test",
    "help",
    "version",
    "lib",
    "all-targets",
    "no-deps",
    "locked",
    "no-install-recommends",
    "enable-unsafe-webgpu",
    "use-webgpu-adapter",
    "host",
    "user",
    "volume",
    "rm",
    "publish",
    "target",
    "features",
    "profile",
    "all",
    "no-healthcheck",
    "from-literal",
    "unshallow",
    "now",
    "build",
    "scale",
    "wait",
    "stop",
];

/// Checks the names in Markdown outside the records of measurements.
pub fn check(files: &Files) -> Vec<Finding> {
    let rust: Vec<&str> = files.with_extension(&["rs"]).map(|(_, text)| text).collect();
    let known = |needle: &str| rust.iter().any(|text| text.contains(needle));
    let known_options = defined_options(files);
    let mut found = Vec::new();
    for (path, text) in files.with_extension(&["md"]) {
        // The changelog names what has gone.
        // Notes of measurements are checked in the page that is made from them.
        let is_note = path.starts_with("docs/measurements/notes/");
        if is_note || path.starts_with("docs/measurements/2") || path == "CHANGELOG.md" {
            continue;
        }
        for (index, line) in text.lines().enumerate() {
            let mut missing = |what: String| found.push(Finding { path: path.into(), line: index + 1, what });
            for target in links(line) {
                if !exists(files, path, target) {
                    missing(format!("link to {target}, which does not exist"));
                }
            }
            for span in spans(line) {
                if is_path(span) && !exists(files, path, span) {
                    missing(format!("file {span}, which does not exist"));
                }
            }
            for (option, folder) in CARGO_TARGETS {
                for name in words_after(line, option) {
                    let ends = [format!("/{folder}/{name}.rs"), format!("/{folder}/{name}/main.rs")];
                    if !files.0.keys().any(|file| ends.iter().any(|end| file.ends_with(end))) {
                        missing(format!("{option}{name}, which does not exist"));
                    }
                }
            }
            for option in options(line) {
                if !FOREIGN_OPTIONS.contains(&option) && !known_options.contains(option) {
                    missing(format!("option --{option}, which no program has"));
                }
            }
            for metric in metrics(line) {
                if !known(&format!("\"{metric}\"")) {
                    missing(format!("metric tombolo_{metric}, which the server does not have"));
                }
            }
        }
    }
    found
}

/// Options that the programs define, as fields with `#[arg(...)]` and their other names, and those
/// that they pass to other programs. Not those of tests, and not the examples of this module.
fn defined_options(files: &Files) -> BTreeSet<String> {
    let mut options = BTreeSet::new();
    let is_source = |path: &str| !path.contains("/tests") && !path.starts_with("xtask/src/source/");
    for (_, text) in files.with_extension(&["rs"]).filter(|(path, _)| is_source(path)) {
        let text = text.split("#[cfg(test)]\nmod tests {").next().unwrap_or(text);
        let mut lines = text.lines().map(str::trim);
        while lines.by_ref().any(|line| line.starts_with("#[arg(")) {
            options.extend(lines.by_ref().find_map(field).map(|name| name.replace('_', "-")));
        }
        for start in ["long = \"", "alias = \"", "\"--"] {
            options.extend(words_after(text, start).filter(|name| !name.is_empty()).map(str::to_owned));
        }
    }
    options
}

/// The name of the field that a line declares.
fn field(line: &str) -> Option<&str> {
    let (before, _) = line.split_once(": ").filter(|_| !line.starts_with(['/', '#']))?;
    let name = before.rsplit(' ').next()?;
    let is_name = name.chars().all(|c| c.is_ascii_lowercase() || c.is_ascii_digit() || c == '_');
    let has_words = !before[..before.len() - name.len()].trim_end().contains(' ');
    (is_name && !name.is_empty() && has_words).then_some(name)
}

/// Targets of relative links, without fragments.
fn links(line: &str) -> impl Iterator<Item = &str> {
    line.match_indices("](").filter_map(|(at, _)| {
        let target = line[at + 2..].split(')').next()?;
        // A link may have a title.
        let target = target.split(['#', ' ']).next()?;
        (!target.is_empty() && !target.contains("://") && !target.starts_with("mailto:")).then_some(target)
    })
}

/// Text between backticks.
fn spans(line: &str) -> impl Iterator<Item = &str> {
    line.split('`').skip(1).step_by(2)
}

fn is_path(span: &str) -> bool {
    let plain = |c: char| c.is_ascii_alphanumeric() || "_-./".contains(c);
    let has_extension =
        span.rsplit_once('.').is_some_and(|(stem, ext)| !stem.is_empty() && FILE_EXTENSIONS.contains(&ext));
    let is_folder = span.ends_with('/') && span.len() > 1 && !span.starts_with('/');
    // A bare picture is an example of a user's own file.
    let is_example = !span.contains('/') && span.ends_with(".png");
    span.chars().all(plain)
        && !is_example
        && (has_extension || is_folder)
        && !span.starts_with("target/")
        && !span.starts_with('/')
}

/// Whether a path exists from the root, from the document's folder, or, for a bare name, anywhere.
fn exists(files: &Files, document: &str, target: &str) -> bool {
    let folder = document.rsplit_once('/').map_or("", |(folder, _)| folder);
    let joined = normalized(&format!("{folder}/{target}"));
    [normalized(target), joined].iter().any(|path| has(files, path))
        || files.0.keys().any(|file| file.ends_with(&format!("/{}", target.trim_end_matches('/'))))
        || (target.ends_with('/') && files.0.keys().any(|file| file.contains(&format!("/{target}"))))
}

fn has(files: &Files, path: &str) -> bool {
    let folder = format!("{}/", path.trim_end_matches('/'));
    // Pictures are not text and are looked for on the disk.
    files.0.contains_key(path)
        || files.0.keys().any(|file| file.starts_with(&folder))
        || crate::process::root().join(path).is_file()
}

fn normalized(path: &str) -> String {
    let mut parts: Vec<&str> = Vec::new();
    for part in path.split('/') {
        match part {
            "" | "." => {}
            ".." => {
                parts.pop();
            }
            part => parts.push(part),
        }
    }
    parts.join("/")
}

fn words_after<'a>(line: &'a str, start: &str) -> impl Iterator<Item = &'a str> {
    line.match_indices(start).map(move |(at, _)| name_at(&line[at + start.len()..]))
}

fn name_at(text: &str) -> &str {
    let end = text.find(|c: char| !c.is_ascii_alphanumeric() && !"_-".contains(c)).unwrap_or(text.len());
    text[..end].trim_end_matches('-')
}

/// Long options that a line names.
fn options(line: &str) -> impl Iterator<Item = &str> {
    line.match_indices("--").filter_map(|(at, _)| {
        let before = line[..at].chars().next_back().unwrap_or(' ');
        let name = name_at(&line[at + 2..]);
        let starts = name.starts_with(|c: char| c.is_ascii_lowercase());
        (starts && !before.is_ascii_alphanumeric() && before != '-').then_some(name)
    })
}

/// Metrics that a line names, without prefix and without the endings that the exposition adds.
fn metrics(line: &str) -> impl Iterator<Item = &str> {
    line.match_indices("tombolo_").filter_map(|(at, start)| {
        let name = name_at(&line[at + start.len()..]);
        let whole = line[..at].chars().next_back().is_none_or(|c| !c.is_ascii_alphanumeric() && c != '_');
        let is_log_filter = line[at + start.len() + name.len()..].starts_with('=') || name.is_empty();
        let endings = ["_total", "_bucket", "_sum", "_count", "_info"];
        let bare = endings.iter().find_map(|ending| name.strip_suffix(ending)).unwrap_or(name);
        (whole && !is_log_filter && !bare.ends_with('_')).then_some(bare)
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn found(line: &str) -> usize {
        let files = Files::of(&[
            ("docs/a.md", line),
            ("docs/b.md", ""),
            (
                "server/src/metrics.rs",
                "register(\"views\"); register(\"view_seconds\");\n\
                 #[arg(\nvalue_name = \"MB\"\n)]\npub cache_mb: u64,\nold_field: u64,\n\
                 #[arg(long = \"listen\")]\npub(crate) address: String,\n\
                 #[cfg(test)]\nmod tests {\n#[arg(long)]\nof_tests: u64,",
            ),
            ("terrain/examples/kernels.rs", ""),
            ("server/tests/http/main.rs", ""),
        ]);
        check(&files).len()
    }

    #[test]
    fn what_does_not_exist_is_found() {
        for line in [
            "see [b](c.md)",
            "open `server/src/nothing.rs`",
            "in `server/nowhere/`",
            "cargo run --example relief",
            "cargo test --test fixtures",
            "cargo bench --bench framing",
            "`deploy/nginx/nowhere.conf`",
            "`--no-such-thing` bounds it",
            "`--old-field` is a field and no option",
            "`--of-tests` is an option of a test",
            "`tombolo_nothing_total` counts",
        ] {
            assert_eq!(found(line), 1, "{line}");
        }
    }

    #[test]
    fn what_exists_is_not() {
        for line in [
            "see [b](b.md#part) and [web](https://x.org/y.md)",
            "open `server/src/metrics.rs`, `metrics.rs`, `server/`",
            "cargo run --release --example kernels",
            "cargo test --test http",
            "`--listen` and `--cache-mb 5`, `--address`, a -- dash",
            "`tombolo_views_total`, `tombolo_view_seconds_bucket`",
        ] {
            assert_eq!(found(line), 0, "{line}");
        }
    }
}
