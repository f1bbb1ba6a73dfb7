//! The sources of FastSIMD, which the CMake files of FastNoise2 download from GitHub in the middle of
//! a build. They are fetched here before it, so that a network that does not answer is a missing tool
//! and not a broken build.

use crate::process;
use anyhow::{Context, Result, bail};
use std::path::{Path, PathBuf};

/// Where the sources are; the CMake files clone the same with the suffix `.git`.
const URL: &str = "https://github.com/Auburn/FastSIMD";

/// The commit that they check out, of `fastnoise2-sys` 0.2.0. A newer crate that asks for another one
/// fails its build here, so this line is then changed.
const COMMIT: &str = "16450dae9528727e500e7254f635a671f9c7ee2d";

/// Attempts to clone: a busy network refuses some.
const ATTEMPTS: u32 = 3;

/// Where the clone lies.
fn folder() -> PathBuf {
    process::target().join("fastsimd")
}

/// Clones the sources, unless an earlier run has.
///
/// # Errors
/// The network does not answer, or the clone lacks the commit or a file of it.
pub fn fetch() -> Result<()> {
    fetch_to(&folder(), URL)
}

fn fetch_to(folder: &Path, url: &str) -> Result<()> {
    if has_sources(folder) {
        return Ok(());
    }
    let mut last = Ok(());
    for _ in 0..ATTEMPTS {
        // What an interrupted clone left would refuse the next.
        let _ = std::fs::remove_dir_all(folder);
        last = clone(folder, url);
        if last.is_ok() && has_sources(folder) {
            return Ok(());
        }
    }
    last.with_context(|| format!("cannot clone {url}"))?;
    bail!("the clone of {url} has no commit {}", &COMMIT[..7])
}

fn clone(folder: &Path, url: &str) -> Result<()> {
    let mut git = process::command("git");
    // A connection that carries nothing ends after half a minute.
    git.args(["-c", "http.lowSpeedLimit=1000", "-c", "http.lowSpeedTime=30", "clone", "--quiet", url]);
    // No prompt for a name or a password: this runs without a person too.
    git.arg(folder).env("GIT_TERMINAL_PROMPT", "0");
    process::output(git).map(drop)
}

/// Whether every file of the commit can be checked out.
fn has_sources(folder: &Path) -> bool {
    let mut git = process::command("git");
    // Named, so that a broken clone does not make git look for a repository in the folders above.
    git.arg("--git-dir").arg(folder.join(".git")).arg("--work-tree").arg(folder);
    git.args(["checkout", "--quiet", "--force", "--detach", COMMIT]);
    process::succeeds(git)
}

/// For a command that builds FastNoise2: its `git` reads [the clone](fetch) in place of the network.
pub fn use_clone(build: &mut std::process::Command) {
    build.env("GIT_CONFIG_COUNT", "1");
    // The longest match wins over a mirror that a person has configured.
    build.env("GIT_CONFIG_VALUE_0", format!("{URL}.git"));
    build.env("GIT_CONFIG_KEY_0", format!("url.{}.insteadOf", folder().display()));
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_repository_without_the_commit_is_refused_and_so_is_one_that_does_not_answer() {
        let scratch = std::env::temp_dir().join(format!("tombolo-fast-simd-{}", std::process::id()));
        let other = scratch.join("other");
        let mut init = process::command("git");
        init.args(["init", "--quiet"]).arg(&other);
        process::run(init).unwrap();
        let clone = scratch.join("clone");
        let without = fetch_to(&clone, &other.display().to_string()).unwrap_err();
        let silent = fetch_to(&clone, &scratch.join("nowhere").display().to_string()).unwrap_err();
        std::fs::remove_dir_all(&scratch).unwrap();
        assert!(without.to_string().contains("has no commit 16450da"), "{without:#}");
        assert!(silent.to_string().contains("cannot clone"), "{silent:#}");
    }
}
