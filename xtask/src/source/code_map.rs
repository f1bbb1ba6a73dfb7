//! The code map of ARCHITECTURE.md has every module of the packages that it describes by module.

use super::{Files, Finding};

/// The document.
const MAP: &str = "ARCHITECTURE.md";

/// Packages with a row for each module.
const PACKAGES: [&str; 7] = ["terrain", "protocol", "server", "client", "load", "simulation", "lab"];

/// Files that need no row: roots that only name modules, and tests.
const WITHOUT_ROW: [&str; 3] = ["lib", "main", "tests"];

/// Modules at the top of a package that the map does not name.
pub fn check(files: &Files) -> Vec<Finding> {
    let Some(map) = files.0.get(MAP) else { return Vec::new() };
    let is_missing = |path: &&str| {
        let mut parts = path.split('/');
        let (package, source, module) = (parts.next(), parts.next(), parts.next());
        let (Some(package), Some("src"), Some(module)) = (package, source, module) else { return false };
        let module = module.trim_end_matches(".rs");
        // A row may name a file of the module alone, or the module among others.
        let stem = format!("`{package}/src/{module}");
        let is_named = map.match_indices(&stem).any(|(at, _)| {
            map[at + stem.len()..].starts_with(['/', '`']) || map[at + stem.len()..].starts_with(".rs`")
        });
        PACKAGES.contains(&package) && !WITHOUT_ROW.contains(&module) && !is_named
    };
    let missing = files.with_extension(&["rs"]).map(|(path, _)| path).filter(is_missing);
    missing
        .map(|path| Finding { path: path.into(), line: 1, what: format!("no row of the code map in {MAP}") })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_module_without_a_row_is_found() {
        let map =
            "| `server/src/http/` | routes |\n| `server/src/state.rs` | state (`server/src/stats.rs`) |\n";
        let of = |path: &str| check(&Files::of(&[(MAP, map), (path, "")])).len();
        for (path, missing) in [
            ("server/src/http/path.rs", 0),
            ("server/src/state.rs", 0),
            ("server/src/stats.rs", 0),
            ("server/src/main.rs", 0),
            ("server/benches/one.rs", 0),
            ("xtask/src/demo.rs", 0),
            ("server/src/stat.rs", 1),
            ("server/src/store/mod.rs", 1),
            ("lab/src/state.rs", 1),
        ] {
            assert_eq!(of(path), missing, "{path}");
        }
    }
}
