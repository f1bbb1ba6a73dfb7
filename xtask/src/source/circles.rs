//! Import cycles between modules.
//!
//! An edge goes from a file to the module that a `crate::` or `super::` path in it names. An edge
//! between two files counts as one between the two sibling modules that hold them, under their
//! nearest common ancestor, so a cycle is reported between sibling modules. A module and its own
//! descendants make no cycle: in Rust a parent declares and uses its children. Tests do not count.

use super::lines::is_test;
use super::{Files, Finding};
use crate::test_modules::without_tests;
use std::collections::{BTreeMap, BTreeSet};

/// Path of a module in its crate; the crate's root is empty.
type Module = Vec<String>;

/// An edge between two sibling modules, with the file and line of its import.
type Arrows = BTreeMap<(Module, Module), (String, usize)>;

/// The modules of a package, each with its path and text.
type Modules<'a> = BTreeMap<Module, (&'a str, &'a str)>;

/// Each cycle once, with one of its import lines.
pub fn check(files: &Files) -> Vec<Finding> {
    sources(files).values().flat_map(|modules| circles(&arrows(modules))).collect()
}

/// The files of the same package that some files import.
#[cfg(test)]
pub fn imported(files: &Files, is_importer: impl Fn(&str) -> bool) -> BTreeSet<String> {
    let mut found = BTreeSet::new();
    for modules in sources(files).values() {
        let reexports = reexports(modules);
        for (module, (_, text)) in modules.iter().filter(|(_, (path, _))| is_importer(path)) {
            let resolved =
                imports(text).into_iter().filter_map(|(_, path)| resolve(module, &path, modules, &reexports));
            found.extend(resolved.filter_map(|target| Some(modules.get(&target)?.0.to_owned())));
        }
    }
    found
}

/// The modules of every package, without tests.
fn sources(files: &Files) -> BTreeMap<&str, Modules<'_>> {
    let mut sources: BTreeMap<&str, Modules<'_>> = BTreeMap::new();
    for (path, text) in files.with_extension(&["rs"]) {
        let Some((package, file)) = path.split_once("/src/") else { continue };
        if !is_test(path) && files.0.contains_key(&format!("{package}/Cargo.toml")) {
            sources.entry(package).or_default().insert(module_of(file), (path, text));
        }
    }
    sources
}

fn module_of(file: &str) -> Module {
    let stem = file.trim_end_matches(".rs");
    let stem = stem.strip_suffix("/mod").unwrap_or(stem);
    let parts = stem.split('/').map(str::to_owned).collect::<Vec<_>>();
    if ["lib", "main"].contains(&stem) { Vec::new() } else { parts }
}

fn arrows(modules: &Modules<'_>) -> Arrows {
    let reexports = reexports(modules);
    let mut arrows = Arrows::new();
    for (module, (path, text)) in modules {
        for (line, target) in imports(text) {
            let Some(target) = resolve(module, &target, modules, &reexports) else { continue };
            let shared = module.iter().zip(&target).take_while(|(one, other)| one == other).count();
            if shared == module.len() || shared == target.len() {
                continue;
            }
            let (from, to) = (module[..=shared].to_vec(), target[..=shared].to_vec());
            arrows.entry((from, to)).or_insert_with(|| ((*path).to_owned(), line));
        }
    }
    arrows
}

/// Names that a module offers although another one defines them: module and name, to module.
fn reexports(modules: &Modules<'_>) -> BTreeMap<(Module, String), Module> {
    let mut found = BTreeMap::new();
    for (module, (_, text)) in modules {
        for line in text
            .split(';')
            .filter_map(|item| item.trim_start_matches(|c: char| c != 'p').strip_prefix("pub use "))
        {
            for path in expand(line) {
                let mut path = path;
                let Some(name) = path.pop() else { continue };
                let at = if path.first().is_some_and(|first| first == "crate") {
                    path[1..].to_vec()
                } else {
                    [module.clone(), path.iter().filter(|part| *part != "self").cloned().collect()].concat()
                };
                if modules.contains_key(&at) && at != *module {
                    found.insert((module.clone(), name), at);
                }
            }
        }
    }
    found
}

/// The module that a path names from within a module.
fn resolve(
    from: &Module,
    path: &[String],
    modules: &Modules<'_>,
    reexports: &BTreeMap<(Module, String), Module>,
) -> Option<Module> {
    let mut rest = path;
    let mut at = match rest.first()?.as_str() {
        "crate" => Vec::new(),
        _ => from.clone(),
    };
    while rest.first().is_some_and(|part| part == "super") {
        at.pop();
        rest = &rest[1..];
    }
    if rest.first().is_some_and(|part| part == "crate") {
        rest = &rest[1..];
    }
    for part in rest {
        let below = [at.clone(), vec![part.clone()]].concat();
        if modules.contains_key(&below) {
            at = below;
        } else {
            // A re-exported name belongs where it is defined.
            return Some(reexports.get(&(at.clone(), part.clone())).cloned().unwrap_or(at));
        }
    }
    Some(at)
}

/// Paths that begin with `crate` or `super`, with their lines from 1.
fn imports(text: &str) -> Vec<(usize, Vec<String>)> {
    let code: Vec<_> = without_tests(text)
        .map(|(_, line)| line.find("//").map_or(line, |comment| &line[..comment]))
        .collect();
    let code = code.join("\n");
    let mut found = Vec::new();
    for start in ["crate::", "super::"] {
        for (at, _) in code.match_indices(start) {
            let before = code[..at].chars().next_back();
            let continues = before.is_some_and(|c| c.is_alphanumeric() || c == '_' || c == '$');
            // `super::super::x` is read from its beginning.
            let is_inner = code[..at].ends_with("super::");
            if !continues && !is_inner {
                let line = code[..at].matches('\n').count() + 1;
                found.extend(expand(&code[at..]).into_iter().map(|path| (line, path)));
            }
        }
    }
    found
}

/// The paths of one use tree at the beginning of a text: `a::{b, c::d}` gives `a::b` and `a::c::d`.
fn expand(text: &str) -> Vec<Vec<String>> {
    let mut rest = text;
    let mut paths = Vec::new();
    tree(&mut rest, &[], &mut paths);
    paths
}

fn tree(rest: &mut &str, above: &[String], paths: &mut Vec<Vec<String>>) {
    let mut path = above.to_vec();
    loop {
        *rest = rest.trim_start();
        if let Some(inner) = rest.strip_prefix('{') {
            *rest = inner;
            loop {
                tree(rest, &path, paths);
                *rest = rest.trim_start();
                match rest.strip_prefix(',') {
                    Some(after) => *rest = after.trim_start(),
                    None => break,
                }
                if rest.starts_with('}') {
                    break;
                }
            }
            *rest = rest.strip_prefix('}').unwrap_or(rest);
            return;
        }
        let length = rest.find(|c: char| !c.is_alphanumeric() && c != '_' && c != '*').unwrap_or(rest.len());
        let (name, after) = rest.split_at(length);
        if name.is_empty() {
            break;
        }
        path.push(name.to_owned());
        *rest = after;
        match rest.strip_prefix("::") {
            Some(after) => *rest = after,
            None => break,
        }
    }
    if path.len() > above.len() {
        paths.push(path);
    }
    // `x as y` names x.
    if let Some(after) = rest.trim_start().strip_prefix("as ") {
        let length = after.find(|c: char| !c.is_alphanumeric() && c != '_').unwrap_or(after.len());
        *rest = &after[length..];
    }
}

/// Import cycles: strongly connected groups of more than one module, each at an edge within it.
fn circles(arrows: &Arrows) -> Vec<Finding> {
    let reach = |from: &Module| {
        let mut seen = BTreeSet::new();
        let mut open = vec![from.clone()];
        while let Some(module) = open.pop() {
            for (_, to) in arrows.keys().filter(|(one, _)| *one == module) {
                if seen.insert(to.clone()) {
                    open.push(to.clone());
                }
            }
        }
        seen
    };
    let modules: BTreeSet<_> = arrows.keys().map(|(from, _)| from.clone()).collect();
    let reached: BTreeMap<_, _> = modules.iter().map(|module| (module.clone(), reach(module))).collect();
    let reaches = |from: &Module, to: &Module| reached.get(from).is_some_and(|seen| seen.contains(to));
    let mut done = BTreeSet::new();
    let mut found = Vec::new();
    for module in &modules {
        if !reaches(module, module) || done.contains(module) {
            continue;
        }
        let group: Vec<_> = modules
            .iter()
            .filter(|other| reaches(module, other) && reaches(other, module))
            .cloned()
            .collect();
        let names: Vec<_> = group.iter().map(|module| module.join("::")).collect();
        let inside = arrows.iter().filter(|((from, to), _)| group.contains(from) && group.contains(to));
        let drawn: Vec<_> = inside
            .map(|((from, to), (path, line))| {
                format!("{} -> {} ({path}:{line})", from.join("::"), to.join("::"))
            })
            .collect();
        let (path, line) =
            arrows.iter().find(|((from, _), _)| from == module).map(|(_, at)| at.clone()).unwrap_or_default();
        done.extend(group);
        found.push(Finding { path, line, what: format!("{}: {}", names.join(", "), drawn.join("; ")) });
    }
    found
}

#[cfg(test)]
mod tests {
    use super::*;

    fn found(files: &[(&str, &str)]) -> Vec<String> {
        let mut all = vec![("x/Cargo.toml", "")];
        all.extend(files);
        check(&Files::of(&all))
            .into_iter()
            .map(|found| found.what.split(':').next().unwrap().to_owned())
            .collect()
    }

    #[test]
    fn a_circle_of_two_files_is_found_and_a_line_is_none() {
        let a = ("x/src/a.rs", "use crate::b::B;\n");
        assert_eq!(
            found(&[("x/src/lib.rs", "mod a;\nmod b;\n"), a, ("x/src/b.rs", "use super::a::A;\n")]),
            ["a, b"]
        );
        assert_eq!(found(&[a, ("x/src/b.rs", "")]), [""; 0]);
    }

    #[test]
    fn circles_through_groups_re_exports_and_folders_are_found() {
        let a = ("x/src/a/one.rs", "use crate::{c::C, b::{self, B}};\n");
        let b = ("x/src/b.rs", "fn f() { crate::A::new() }\n");
        let root = ("x/src/lib.rs", "mod b;\npub mod a;\npub use a::one::A;\n");
        assert_eq!(found(&[root, ("x/src/a/mod.rs", "pub mod one;"), a, b, ("x/src/c.rs", "")]), ["a, b"]);
        let three = [
            ("x/src/a.rs", "use crate::b;"),
            ("x/src/b.rs", "use crate::c;"),
            ("x/src/c.rs", "use crate::a;"),
        ];
        assert_eq!(found(&three), ["a, b, c"]);
    }

    #[test]
    fn parents_tests_and_comments_make_no_circle() {
        let parent = ("x/src/a.rs", "mod child;\nuse child::C;\npub struct P;\n");
        assert_eq!(found(&[parent, ("x/src/a/child.rs", "use super::P;\n")]), [""; 0]);
        let test = "#[cfg(test)]\nmod tests {\n    use crate::a::P;\n}\n";
        assert_eq!(found(&[("x/src/a.rs", "use crate::b;\n// crate::c\n"), ("x/src/b.rs", test)]), [""; 0]);
    }
}
