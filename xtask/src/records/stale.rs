//! Whether the code that a record measured has changed since.
//!
//! Code is files of this repository, and the compiler, which `rust-toolchain.toml` names. Versions of
//! dependencies in `Cargo.lock` do not count: one file holds those of every program, so an update of
//! a crate that only the viewer has would make the records of all others out of date. After an update
//! that may change a figure, its measurement is to be run again.

use crate::process;
use anyhow::Result;

/// What each measurement measures: paths from the root. Tests and documents in them do not count.
const MEASURED: [(&str, &[&str]); 14] = [
    ("code", &["*.rs", "*.wesl", "*.md"]),
    (
        "heightfield",
        &[
            "terrain",
            "lab/src/digest",
            "lab/src/timings.rs",
            "benches/noise-comparison",
            "shaders/build.rs",
            "shaders/wgsl/probe_heights.wesl",
            "shaders/wgsl/probe_heights_float.wesl",
            "shaders/wgsl/shared/base.wesl",
            "shaders/wgsl/shared/coast.wesl",
            "shaders/wgsl/shared/curves.wesl",
            "shaders/wgsl/shared/gradients.wesl",
            "shaders/wgsl/shared/hash.wesl",
            "shaders/wgsl/shared/island.wesl",
            "shaders/wgsl/shared/land.wesl",
            "shaders/wgsl/shared/lattice.wesl",
            "shaders/wgsl/shared/noise.wesl",
            "shaders/wgsl/shared/octaves.wesl",
            "shaders/wgsl/shared/ring.wesl",
            "shaders/wgsl/shared/spline.wesl",
            "shaders/wgsl/shared/weights.wesl",
        ],
    ),
    (
        "land",
        &[
            "terrain",
            // The rule of woods, which `lab/src/land/wood.rs` repeats.
            "shaders/wgsl/shared/splat.wesl",
            "shaders/wgsl/shared/pattern.wesl",
            "lab/src/land",
            "lab/src/land.rs",
            "lab/src/stability",
            "lab/src/stability.rs",
            "benches/land-comparison",
            "benches/noise-comparison/src/rounds.rs",
        ],
    ),
    ("end-to-end", &["terrain", "protocol", "shaders", "server", "client", "load", "tls-client", "cli"]),
    (
        "streaming",
        &[
            "terrain",
            "protocol",
            "server",
            "load",
            "server-bench",
            "tls-client",
            "lab/src/codec",
            "lab/src/codec.rs",
            "benches/lerc",
        ],
    ),
    ("fuzz", &["terrain", "protocol", "server", "entry-points", "fuzz"]),
    ("mutants", &["terrain", "protocol", "server/src/limits", "server/src/session", "server/src/cache"]),
    ("resilience", &["terrain", "protocol", "server", "server-bench", "tls-client", "client", "shaders"]),
    (
        "cluster",
        &[
            "terrain",
            "protocol",
            "server",
            "load",
            "tls-client",
            "simulation",
            "xtask/src/cluster",
            "deploy/nginx",
            "deploy/prometheus",
        ],
    ),
    ("terrain", &["terrain", "shaders", "client", "lab/src/lod", "lab/src/lod.rs", "lab/src/cracks.rs"]),
    ("visual", &["terrain", "shaders", "client", "lab/src/visual", "lab/src/visual.rs", "lab/src/flip.rs"]),
    ("pom", &["shaders", "client/src/features", "lab/src/pom", "lab/src/pom.rs"]),
    ("culling", &["terrain", "shaders", "client", "lab/src/culling", "lab/src/culling.rs"]),
    // The page that generated figures stand on measures nothing itself.
    ("audit", &["docs/measurements", "README.md", "xtask"]),
];

/// The version of the compiler, on which times and sizes depend as on the code.
const COMPILER: &str = "rust-toolchain.toml";

/// Measurements that count text and records, whatever the compiler.
const WITHOUT_COMPILER: [&str; 2] = ["code", "audit"];

/// Paths that a measurement measures; none if it is not known.
pub fn measured(name: &str) -> Option<Vec<&'static str>> {
    let (_, paths) = MEASURED.into_iter().find(|(known, _)| *known == name)?;
    let compiler = (!WITHOUT_COMPILER.contains(&name)).then_some(COMPILER);
    Some(paths.iter().copied().chain(compiler).collect())
}

/// Why the age of no record is known: a shallow clone lacks their commits. None in a full clone.
pub fn lacks_history() -> Option<String> {
    let mut git = process::command("git");
    git.args(["rev-parse", "--is-shallow-repository"]);
    why_shallow(process::output(git))
}

/// Why a clone of which git says this is not a full one.
fn why_shallow(said: Result<String>) -> Option<String> {
    match said {
        Ok(said) if said.trim() == "false" => None,
        Ok(_) => Some("a shallow clone lacks the commits of the records; run: git fetch --unshallow".into()),
        Err(why) => Some(format!("{why:#}")),
    }
}

/// Why a record no longer speaks of this working tree; none if it does.
pub fn reason(name: &str, commit: &str) -> Option<String> {
    let Some(paths) = measured(name) else { return Some(format!("nothing is known of `{name}`")) };
    let git = |args: &[&str]| {
        let mut git = process::command("git");
        git.args(args);
        git
    };
    let resolved = format!("{commit}^{{commit}}");
    if commit.is_empty() || !process::succeeds(git(&["rev-parse", "--verify", "--quiet", &resolved])) {
        return Some(format!("its commit `{commit}` does not exist"));
    }
    let mut diff = git(&["diff", "--name-only", commit, "--"]);
    diff.args(paths).args([
        ":(exclude,glob)**/tests/**",
        ":(exclude,glob)**/tests.rs",
        ":(exclude,glob)**/README.md",
        ":(exclude)docs/measurements",
    ]);
    match process::output(diff) {
        Ok(changed) if changed.trim().is_empty() => None,
        Ok(changed) => Some(format!("{} measured files changed since", changed.lines().count())),
        Err(why) => Some(format!("{why:#}")),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::collections::BTreeSet;

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
    fn clients_age_with_what_opens_their_connections() {
        for (name, paths) in MEASURED {
            let has = |path: &str| paths.contains(&path);
            assert!(has("tls-client") || !has("load") && !has("server-bench"), "{name}");
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
            // The constants are written by the build.
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
}
