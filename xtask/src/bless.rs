//! `bless`: rewrites what tests compare with from what the code does now. The difference is for a
//! person to judge. Fixtures are promises to deployed peers: one that exists changes only together
//! with a version.

use crate::process;
use anyhow::{Context, Result, bail};
use std::collections::BTreeMap;
use std::path::Path;

/// Files to rewrite.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub enum What {
    /// The frozen bytes of messages and chunks
    Fixtures,
    /// The golden pictures
    Pictures,
    /// The table of shader resources
    Resources,
    /// The linked shaders
    Shaders,
}

/// The folder of the fixtures. Its folders `version_N` hold those of older versions.
const FIXTURES: &str = "protocol/fixtures";

/// The constants of which one must change with a fixture, and where they are.
const VERSIONS: [(&str, &str); 3] = [
    ("PROTOCOL_VERSION", "protocol/src/lib.rs"),
    ("VERSION", "protocol/src/chunk_codec.rs"),
    ("GENERATOR_VERSION", "terrain/src/constants.rs"),
];

/// Contents of files by their path.
type Contents = BTreeMap<String, String>;

/// Shows what the comparing tests find; with `writes`, reruns them so that they write instead.
///
/// # Errors
/// Without `writes`, something differs. Else a test that fails although it was allowed to write, or
/// a fixture that changed without a version; it is then as before.
pub fn run(what: What, writes: bool) -> Result<()> {
    let before = fixtures(&process::root().join(FIXTURES))?;
    let tests = || {
        // The package alone where others may need a new pass to compile.
        let packages = if what == What::Shaders { "--package tombolo-shaders" } else { "--workspace" };
        let mut tests = process::cargo(&format!("nextest run {packages} --no-fail-fast -E"));
        tests.arg(match what {
            What::Fixtures => "package(tombolo-protocol) & binary(fixtures)",
            What::Pictures => "binary(/pictures/)",
            What::Resources => "package(tombolo-shaders) & test(the_table_of_resources_is_current)",
            What::Shaders => "package(tombolo-shaders) & test(the_linked_passes_are_current)",
        });
        tests
    };
    println!("bless: what differs now:");
    let is_equal = process::run(tests()).is_ok();
    if process::interrupted() {
        bail!("bless: interrupted");
    }
    if !writes && !is_equal {
        bail!(
            "bless: the failures above show what differs, drawn pictures by their path; after looking at \
             them write with --write"
        );
    }
    if !writes {
        println!("bless: nothing differs");
        return Ok(());
    }
    let mut writing = tests();
    writing.env("TOMBOLO_BLESS", "1");
    process::run(writing).context("bless: a test fails although it may write; fix it first")?;
    let after = fixtures(&process::root().join(FIXTURES))?;
    let broken = broken_promises(&before, &after, has_new_version()?);
    for path in &broken {
        std::fs::write(process::root().join(FIXTURES).join(path), &before[path.as_str()])
            .with_context(|| format!("bless: cannot restore {path}"))?;
    }
    if !broken.is_empty() {
        let names: Vec<_> = VERSIONS.iter().map(|(name, _)| *name).collect();
        bail!(
            "bless: frozen bytes would change without a new version, so they are as before: {}. Change one \
             of {}, and move the old bytes to {FIXTURES}/version_N",
            broken.join(", "),
            names.join(", ")
        );
    }
    process::run(tests())
        .context("bless: what was written fails the comparison, or a near miss passes it")?;
    let mut changes = process::command("git");
    changes.args(["status", "--short"]);
    let changes = process::output(changes).context("bless: cannot ask git what changed")?;
    println!("bless: changed files in the working tree (look at the diff before committing):\n{changes}");
    Ok(())
}

/// Fixtures that existed and changed, although no version is new or they are of an older version.
fn broken_promises(before: &Contents, after: &Contents, has_new_version: bool) -> Vec<String> {
    let is_changed = |path: &str| after.get(path) != before.get(path);
    let is_old = |path: &str| path.starts_with("version_");
    let broken = before.keys().filter(|path| is_changed(path) && (is_old(path) || !has_new_version));
    broken.cloned().collect()
}

/// Every fixture by its path in the folder, at most one folder deep.
fn fixtures(folder: &Path) -> Result<Contents> {
    let mut found = Contents::new();
    let mut folders = vec![(folder.to_path_buf(), String::new())];
    while let Some((folder, prefix)) = folders.pop() {
        let entries =
            std::fs::read_dir(&folder).with_context(|| format!("bless: cannot read {}", folder.display()))?;
        for entry in entries {
            let path = entry.context("bless")?.path();
            let name =
                format!("{prefix}{}", path.file_name().map_or("".into(), |name| name.to_string_lossy()));
            if path.is_dir() {
                folders.push((path, format!("{name}/")));
            } else {
                let text = std::fs::read_to_string(&path)
                    .with_context(|| format!("bless: cannot read {}", path.display()))?;
                found.insert(name, text);
            }
        }
    }
    Ok(found)
}

/// Whether one of the versions is another one than that of the commit.
fn has_new_version() -> Result<bool> {
    for (name, path) in VERSIONS {
        let mut show = process::command("git");
        show.args(["show", &format!("HEAD:{path}")]);
        let committed = process::output(show).context("bless: cannot ask git for the committed version")?;
        let now = std::fs::read_to_string(process::root().join(path))
            .with_context(|| format!("bless: cannot read {path}"))?;
        let value =
            |text: &str| version(text, name).with_context(|| format!("bless: {path} has no constant {name}"));
        if value(&committed)? != value(&now)? {
            return Ok(true);
        }
    }
    Ok(false)
}

/// The value of `pub const NAME: TYPE = VALUE;`.
fn version(text: &str, name: &str) -> Option<String> {
    let start = format!("pub const {name}: ");
    let line = text.lines().find_map(|line| line.strip_prefix(&start))?;
    Some(line.split_once('=')?.1.trim().trim_end_matches(';').into())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn contents(files: &[(&str, &str)]) -> Contents {
        files.iter().map(|(path, text)| ((*path).to_owned(), (*text).to_owned())).collect()
    }

    #[test]
    fn a_fixture_changes_only_with_a_version_and_one_of_an_older_version_never() {
        let before = contents(&[("hello.hex", "00"), ("version_1/hello.hex", "01")]);
        let added = contents(&[("hello.hex", "00"), ("new.hex", "02"), ("version_1/hello.hex", "01")]);
        let changed = contents(&[("hello.hex", "ff"), ("version_1/hello.hex", "01")]);
        let old = contents(&[("hello.hex", "00"), ("version_1/hello.hex", "ff")]);
        assert_eq!(broken_promises(&before, &added, false), [""; 0]);
        assert_eq!(broken_promises(&before, &changed, false), ["hello.hex"]);
        assert_eq!(broken_promises(&before, &changed, true), [""; 0]);
        for has_new_version in [false, true] {
            assert_eq!(broken_promises(&before, &old, has_new_version), ["version_1/hello.hex"]);
        }
        assert_eq!(broken_promises(&before, &Contents::new(), false).len(), 2);
    }

    #[test]
    fn every_version_is_found_in_its_file() {
        for (name, path) in VERSIONS {
            let text = std::fs::read_to_string(process::root().join(path)).unwrap();
            assert!(version(&text, name).is_some_and(|value| value.parse::<u32>().is_ok()), "{name}");
        }
        assert_eq!(version("pub const VERSION: u16 = 3;\n", "VERSION").as_deref(), Some("3"));
        assert_eq!(version("pub const OTHER: u16 = 3;\n", "VERSION"), None);
    }

    #[test]
    fn the_fixtures_are_read_with_those_of_older_versions() {
        let all = fixtures(&process::root().join(FIXTURES)).unwrap();
        assert!(all.contains_key("hello.hex") && all.keys().any(|path| path.starts_with("version_1/")));
    }
}
