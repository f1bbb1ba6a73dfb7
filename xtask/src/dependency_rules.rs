//! Dependencies that a crate must not have: asks cargo for each crate's dependency tree and expects
//! no forbidden name.

use crate::process;
use anyhow::{Context, Result, bail};
use std::collections::BTreeSet;

/// Crates on which one crate must never depend, directly or not. Tests may; users never build
/// those.
struct Rule {
    /// Without the prefix.
    package: &'static str,
    /// Packages of this workspace, without the prefix.
    own: &'static [&'static str],
    /// Packages of others.
    libraries: &'static [&'static str],
    why: &'static str,
}

impl Rule {
    /// Full names of what is forbidden.
    fn forbidden(&self) -> Vec<String> {
        let own = self.own.iter().map(|name| full_name(name));
        own.chain(self.libraries.iter().map(ToString::to_string)).collect()
    }
}

/// The name of a package of this workspace.
fn full_name(package: &str) -> String {
    format!("tombolo-{package}")
}

/// Libraries that draw.
const DRAWING: &[&str] = &["wgpu", "winit", "egui"];

const RULES: [Rule; 9] = [
    Rule {
        package: "terrain",
        own: &[
            "protocol",
            "shaders",
            "server",
            "client",
            "load",
            "lab",
            "cli",
            "bars",
            "chart",
            "tls-client",
            "server-bench",
            "simulation",
            "test-support",
            "installed-browser",
            "entry-points",
        ],
        libraries: &["serde", "noise", "tokio", "wgpu"],
        why: "terrain is pure and depends on no other crate",
    },
    Rule {
        package: "protocol",
        own: &["shaders", "server", "client", "load", "lab"],
        libraries: &["tokio", "axum", "tungstenite", "wgpu"],
        why: "the protocol does no IO",
    },
    Rule {
        package: "shaders",
        own: &["protocol", "server", "client", "load", "lab"],
        libraries: &["tokio", "wgpu"],
        why: "shaders are text and layouts; drawing with them is the client's",
    },
    Rule {
        package: "server",
        own: &["client", "shaders", "load", "lab"],
        libraries: DRAWING,
        why: "a server draws nothing",
    },
    Rule {
        package: "client",
        own: &["server", "load", "lab"],
        libraries: &["axum", "noise"],
        why: "a viewer serves nothing",
    },
    Rule {
        package: "load",
        own: &["client", "shaders", "server", "lab"],
        libraries: DRAWING,
        why: "a load test runs where no GPU is",
    },
    Rule {
        package: "simulation",
        own: &["client", "shaders", "server", "lab"],
        libraries: DRAWING,
        why: "a simulation models the server and does not run it",
    },
    Rule {
        package: "server-bench",
        own: &["client", "shaders", "server", "load", "lab"],
        libraries: DRAWING,
        why: "server benchmarks run the server as a process",
    },
    Rule {
        package: "lab",
        own: &["server", "load"],
        libraries: &["axum", "fastnoise2", "winit", "egui"],
        why: "the lab measures into textures, it serves nothing and opens no window",
    },
];

/// Checks every rule.
///
/// # Errors
/// The first crate that depends on a forbidden one, with the command that shows the way.
pub fn check() -> Result<()> {
    match violations()?.first() {
        Some(violation) => bail!("{violation}"),
        None => Ok(()),
    }
}

/// For each rule that is broken, one forbidden package that the crate depends on, in a sentence.
///
/// # Errors
/// Cargo does not give the dependencies of a crate.
pub fn violations() -> Result<Vec<String>> {
    let mut violations = Vec::new();
    for rule in RULES {
        let (package, forbidden) = (&full_name(rule.package), rule.forbidden());
        // Build scripts do not ship: the shader linker may use what the library may not.
        let has_no_build_tools = ["server", "terrain"].contains(&rule.package);
        let edges = if has_no_build_tools { "normal,build" } else { "normal" };
        let line = format!("tree --package {package} --edges {edges} --prefix none --format {{p}}");
        let tree = process::output(process::cargo(&line)).context("cannot ask for the dependency tree")?;
        if let Some(found) = violation(package, &forbidden, &tree)? {
            violations.push(format!(
                "{package} depends on {found}, and {}; see: cargo tree --package {package} --edges \
                 {edges} --invert {found}",
                rule.why
            ));
            continue;
        }
        println!("{package}: none of {}", forbidden.join(", "));
    }
    Ok(violations)
}

/// The first forbidden name in a tree of one `name version` a line. A tree without the package
/// itself is no answer.
fn violation(package: &str, forbidden: &[impl AsRef<str>], tree: &str) -> Result<Option<String>> {
    let names: BTreeSet<_> = tree.lines().filter_map(|line| line.split_whitespace().next()).collect();
    if !names.contains(package) {
        bail!(
            "the dependency tree of {package} does not contain {package}: cargo's output was not understood"
        );
    }
    Ok(forbidden.iter().map(AsRef::as_ref).find(|name| names.contains(name)).map(str::to_owned))
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
        for folder in RULES.iter().flat_map(|rule| [&[rule.package], rule.own].concat()) {
            let manifest = process::root().join(folder).join("Cargo.toml");
            let text = std::fs::read_to_string(manifest).unwrap();
            assert!(text.contains(&format!("name = \"{}\"", full_name(folder))), "{folder}");
        }
    }

    #[test]
    fn an_empty_or_strange_tree_is_no_pass() {
        for tree in ["", "error: no such package", "client v0.1.0"] {
            assert!(violation("server", &["wgpu"], tree).is_err(), "{tree:?}");
        }
    }
}
