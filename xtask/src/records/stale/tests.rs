use super::*;
use std::collections::{BTreeMap, BTreeSet};

#[test]
fn every_measured_path_exists() {
    for (name, _) in MEASURED {
        for path in measured(name).unwrap().iter().filter(|path| !path.contains('*')) {
            assert!(process::root().join(path).exists(), "{name}: {path}");
        }
    }
}

#[test]
fn every_measurement_of_programs_ages_with_the_compiler() {
    for (name, _) in MEASURED {
        let ages = measured(name).unwrap().contains(&COMPILER);
        assert_eq!(ages, !["code", "audit"].contains(&name), "{name}");
    }
}

#[test]
fn what_counts_text_ages_with_tests_and_comments_and_programs_do_not() {
    assert!(["code", "audit", "mutants", "websocket"].into_iter().all(ages_with_text));
    assert!(!["streaming", "heightfield", "visual"].into_iter().any(ages_with_text));
}

fn has_benchmarks(paths: &[&str]) -> bool {
    paths.iter().any(|path| path.starts_with("server-bench"))
}

/// A measurement of some benchmarks ages with every module that they import.
#[test]
fn benchmarks_age_with_the_modules_that_they_import() {
    let mut looked = 0;
    for (name, paths) in MEASURED {
        for path in paths.iter().filter(|path| path.starts_with("server-bench/src/")) {
            let text = std::fs::read_to_string(process::root().join(path)).unwrap();
            let imports = text.lines().filter_map(|line| line.trim_start().strip_prefix("use crate::"));
            for module in imports.filter_map(|import| import.split([':', ';', ' ']).next()) {
                let file = format!("server-bench/src/{module}.rs");
                // Definitions of `main.rs` itself have no file.
                let is_file = process::root().join(&file).exists();
                assert!(!is_file || paths.contains(&file.as_str()), "{name}: {path} imports {file}");
                looked += usize::from(is_file);
            }
        }
    }
    assert!(looked > 20, "{looked}");
}

#[test]
fn clients_age_with_what_opens_their_connections() {
    for (name, paths) in MEASURED {
        let has = |path: &str| paths.contains(&path);
        assert!(has("tls-client") || !has("load") && !has_benchmarks(paths), "{name}");
    }
}

#[test]
fn benchmarks_age_with_what_measures_and_with_their_random_numbers() {
    for (name, paths) in MEASURED {
        let own = format!("xtask/src/measure/{}.rs", name.replace('-', "_"));
        // All source text, or all of this crate.
        let has_all = ["code", "audit"].contains(&name);
        assert!(
            has_all || !process::root().join(&own).exists() || paths.contains(&own.as_str()),
            "{name}: {own}"
        );
        assert!(paths.contains(&"test-support") || !has_benchmarks(paths), "{name}");
    }
}

/// Modules of the lab that print, write or read options, and decide no figure.
const LAB_WITHOUT_FIGURES: [&str; 4] = ["curve", "note", "outputs", "report"];

/// The files of the lab under some paths.
fn lab_files(paths: &[&str]) -> BTreeMap<String, String> {
    let lab: Vec<_> = paths.iter().filter(|path| path.starts_with("lab/")).collect();
    if lab.is_empty() {
        // Without a path git would list all files.
        return BTreeMap::new();
    }
    let mut git = process::command("git");
    git.args(["ls-files", "--"]).args(lab).args(NO_FIGURES);
    let files = process::output(git).unwrap();
    let read = |path: &str| std::fs::read_to_string(process::root().join(path)).unwrap();
    files.lines().map(|path| (path.to_owned(), read(path))).collect()
}

/// The modules that a file of the lab imports by `use crate::`: `stats`, `lod::drawn`.
fn lab_modules(text: &str) -> Vec<String> {
    let imports = text.lines().filter_map(|line| line.trim_start().strip_prefix("use crate::"));
    let of = |import: &str| -> Vec<String> {
        let plain = import.trim_end_matches(';');
        match plain.strip_prefix('{') {
            Some(several) => several.trim_end_matches('}').split(',').map(|one| one.trim().into()).collect(),
            None => vec![plain.split(['{', ';']).next().unwrap_or_default().into()],
        }
    };
    imports.flat_map(of).collect()
}

/// Paths of which a list must have all of one entry, for a module such as `lod::drawn::Chunk`.
fn lab_paths(module: &str) -> Vec<Vec<String>> {
    let mut parts = module.split("::").map(str::to_lowercase);
    let outer = format!("lab/src/{}", parts.next().unwrap_or_default());
    let inner = format!("{outer}/{}.rs", parts.next().unwrap_or_default());
    let exists = |path: &String| process::root().join(path).exists();
    let whole: Vec<_> = [format!("{outer}.rs"), outer].into_iter().filter(exists).collect();
    [whole, vec![inner]].into_iter().filter(|paths| !paths.is_empty() && paths.iter().all(exists)).collect()
}

#[test]
fn files_of_the_lab_are_listed_with_the_modules_that_they_import() {
    let mut found = 0;
    for (name, paths) in MEASURED {
        let files = lab_files(paths);
        let covers = |path: &String| {
            paths.iter().any(|listed| path == listed || path.starts_with(&format!("{listed}/")))
        };
        for (file, text) in &files {
            for module in lab_modules(text) {
                let outer = module.split("::").next().unwrap_or_default().to_lowercase();
                if LAB_WITHOUT_FIGURES.contains(&outer.as_str()) {
                    continue;
                }
                let ways = lab_paths(&module);
                assert!(!ways.is_empty(), "{file} imports {module}, of which no file is known");
                let is_listed = ways.iter().any(|paths| paths.iter().all(covers));
                assert!(is_listed, "{name}: {file} imports {module}: none of {ways:?} is listed");
                found += 1;
            }
        }
    }
    // The control: imports are found at all.
    assert!(found > 50, "{found} imports");
}

#[test]
fn tests_decide_no_figure() {
    let listed = |more: &[&str]| {
        let mut git = process::command("git");
        git.args(["ls-files", "--", "simulation", "load", "server"]).args(more);
        process::output(git).unwrap()
    };
    for place in ["/tests.rs", "/tests/", "/examples/"] {
        assert!(listed(&[]).contains(place), "the control: there are some in {place}");
        assert!(!listed(&TESTS).contains(place), "{place}");
    }
}

#[test]
fn only_a_full_clone_has_the_commits_of_the_records() {
    assert_eq!(why_shallow(Ok("false\n".into())), None);
    assert!(why_shallow(Ok("true\n".into())).is_some_and(|why| why.contains("--unshallow")));
    assert!(why_shallow(Err(anyhow::anyhow!("no git"))).is_some_and(|why| why == "no git"));
}

/// The shared modules that a shader imports, directly or not.
fn imported(shader: &str, found: &mut BTreeSet<String>) {
    let text = std::fs::read_to_string(process::root().join(shader)).unwrap();
    for line in text.lines().filter_map(|line| line.strip_prefix("import package::shared::")) {
        let module = line.split("::").next().unwrap();
        // The constants are written by the linker.
        let path = format!("shaders/wgsl/shared/{module}.wesl");
        if module != "constants" && found.insert(path.clone()) {
            imported(&path, found);
        }
    }
}

#[test]
fn the_measured_height_shaders_are_listed_with_all_that_they_import() {
    let passes = ["shaders/wgsl/probe_heights.wesl", "shaders/wgsl/probe_heights_float.wesl"];
    let mut found = BTreeSet::from(passes.map(String::from));
    for pass in passes {
        imported(pass, &mut found);
    }
    let paths = measured("heightfield").unwrap().into_iter().map(String::from);
    let listed: BTreeSet<String> = paths.filter(|path| path.ends_with(".wesl")).collect();
    assert_eq!(listed, found);
}

#[test]
fn a_commit_that_does_not_exist_and_an_unknown_measurement_are_stale() {
    for (name, commit) in [("streaming", "0000000000"), ("streaming", ""), ("nothing", "HEAD")] {
        assert!(reason(name, commit).is_some(), "{name} {commit}");
    }
}

#[test]
fn the_first_commit_is_stale_for_every_measurement() {
    if let Some(why) = lacks_history() {
        eprintln!("skipped: {why}");
        return;
    }
    let mut first = process::command("git");
    first.args(["rev-list", "--max-parents=0", "HEAD"]);
    let first = process::output(first).unwrap();
    let first = first.lines().next().unwrap();
    for (name, _) in MEASURED {
        assert!(reason(name, first).is_some(), "{name}");
    }
}

#[test]
fn comments_and_dependencies_of_tests_do_not_count() {
    for (path, before, comment, code) in [
        ("a.wesl", "// One.\nfn f() {}\n", "// Two.\n\n    // More.\nfn f() {}\n", "// One.\nfn f() { }\n"),
        ("Cargo.toml", "# One.\na = 1\n", "a = 1\n", "# One.\na = 2\n"),
        (
            "a/Cargo.toml",
            "[dependencies]\na = 1\n[dev-dependencies]\nb = 1\n[[test]]\nc = 1\n[lints]\nd = 1\n",
            "[dependencies]\na = 1\n[target.'cfg(unix)'.dev-dependencies]\nb = 2\n[lints]\nd = 1\n",
            "[dependencies]\na = 1\n[dev-dependencies]\nb = 1\n[lints]\nd = 2\n",
        ),
    ] {
        let have_equal = comparison(path).unwrap();
        assert!(have_equal(before, comment) && !have_equal(before, code), "{path}");
    }
    assert!(comparison("a.png").is_none() && comparison("Dockerfile").is_none());
}
