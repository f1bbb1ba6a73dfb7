//! Dependencies that a crate must not have: asks cargo for each crate's dependency tree and expects
//! no forbidden name.

use crate::process;
use anyhow::{Context, Result, bail};
use std::collections::BTreeSet;

/// What one crate must never depend on, directly or not. Tests may; users never build those.
struct Rule {
    package: &'static str,
    forbidden: &'static [&'static str],
    why: &'static str,
}

const RULES: [Rule; 8] = [
    Rule {
        package: "tombolo-terrain",
        forbidden: &[
            "tombolo-protocol",
            "tombolo-shaders",
            "tombolo-server",
            "tombolo-client",
            "tombolo-load",
            "tombolo-lab",
            "tombolo-cli",
            "serde",
            "noise",
            "tokio",
            "wgpu",
            "tombolo-bars",
            "tombolo-server-bench",
        ],
        why: "terrain is pure and depends on no other crate",
    },
    Rule {
        package: "tombolo-protocol",
        forbidden: &[
            "tombolo-shaders",
            "tombolo-server",
            "tombolo-client",
            "tombolo-load",
            "tombolo-lab",
            "tokio",
            "axum",
            "tungstenite",
            "wgpu",
        ],
        why: "the protocol does no IO",
    },
    Rule {
        package: "tombolo-shaders",
        forbidden: &[
            "tombolo-protocol",
            "tombolo-server",
            "tombolo-client",
            "tombolo-load",
            "tombolo-lab",
            "tokio",
            "wgpu",
        ],
        why: "shaders are text and layouts; drawing with them is the client's",
    },
    Rule {
        package: "tombolo-server",
        forbidden: &[
            "wgpu",
            "winit",
            "egui",
            "tombolo-client",
            "tombolo-shaders",
            "tombolo-load",
            "tombolo-lab",
        ],
        why: "a server draws nothing",
    },
    Rule {
        package: "tombolo-client",
        forbidden: &["axum", "tombolo-server", "tombolo-load", "tombolo-lab", "noise"],
        why: "a viewer serves nothing",
    },
    Rule {
        package: "tombolo-load",
        forbidden: &[
            "wgpu",
            "winit",
            "egui",
            "tombolo-client",
            "tombolo-shaders",
            "tombolo-server",
            "tombolo-lab",
        ],
        why: "a load test runs where no GPU is",
    },
    Rule {
        package: "tombolo-server-bench",
        forbidden: &[
            "wgpu",
            "winit",
            "egui",
            "tombolo-client",
            "tombolo-shaders",
            "tombolo-server",
            "tombolo-load",
            "tombolo-lab",
        ],
        why: "server benchmarks run the server as a process",
    },
    Rule {
        package: "tombolo-lab",
        forbidden: &["axum", "tombolo-server", "tombolo-load", "fastnoise2"],
        why: "the lab measures, it serves nothing",
    },
];

/// Checks every rule.
///
/// # Errors
/// The first crate that depends on a forbidden one, with the command that shows the way.
pub fn check() -> Result<()> {
    for rule in RULES {
        let package = rule.package;
        // Build scripts do not ship: the shader linker may use what the library may not.
        let ships_with_build_scripts = ["tombolo-server", "tombolo-terrain"].contains(&package);
        let edges = if ships_with_build_scripts { "normal,build" } else { "normal" };
        let line = format!("tree --package {package} --edges {edges} --prefix none --format {{p}}");
        let tree = process::output(process::cargo(&line)).context("cannot ask for the dependency tree")?;
        if let Some(found) = violation(package, rule.forbidden, &tree)? {
            bail!(
                "{package} depends on {found}, and {}; see: cargo tree --package {package} --edges \
                 {edges} --invert {found}",
                rule.why
            );
        }
        println!("{package}: none of {}", rule.forbidden.join(", "));
    }
    Ok(())
}

/// The first forbidden name in a tree of one `name version` a line. A tree without the package
/// itself is no answer.
fn violation(package: &str, forbidden: &[&str], tree: &str) -> Result<Option<String>> {
    let names: BTreeSet<_> = tree.lines().filter_map(|line| line.split_whitespace().next()).collect();
    if !names.contains(package) {
        bail!(
            "the dependency tree of {package} does not contain {package}: cargo's output was not understood"
        );
    }
    Ok(forbidden.iter().find(|name| names.contains(**name)).map(ToString::to_string))
}

#[cfg(test)]
mod tests {
    use super::*;

    const TREE: &str = "server v0.1.0 (/somewhere/server)\naxum v0.8.9\nserde v1.0.229\nwgpu-types v30.0.0\n";

    #[test]
    fn a_forbidden_name_is_found_and_a_longer_name_is_another_crate() {
        assert_eq!(violation("server", &["wgpu", "winit"], TREE).unwrap(), None);
        assert_eq!(violation("server", &["winit", "serde"], TREE).unwrap(), Some("serde".into()));
    }

    /// A renamed package would otherwise be forbidden under a name that no package has.
    #[test]
    fn own_packages_exist_under_the_names_of_the_rules() {
        let own =
            RULES.iter().flat_map(|rule| [rule.package].into_iter().chain(rule.forbidden.iter().copied()));
        let own: BTreeSet<_> = own.filter_map(|name| name.strip_prefix("tombolo-")).collect();
        assert!(own.len() > 5, "{own:?}");
        for folder in own {
            let manifest = process::root().join(folder).join("Cargo.toml");
            let text = std::fs::read_to_string(manifest).unwrap();
            assert!(text.contains(&format!("name = \"tombolo-{folder}\"")), "{folder}");
        }
    }

    #[test]
    fn an_empty_or_strange_tree_is_no_pass() {
        for tree in ["", "error: no such package", "client v0.1.0"] {
            assert!(violation("server", &["wgpu"], tree).is_err(), "{tree:?}");
        }
    }
}
