//! The sources of FastSIMD, which the CMake files of FastNoise2 download from GitHub in the middle
//! of a build. They are fetched here before it, so that a network that does not answer is a missing
//! tool and not a broken build.

use crate::process;
use anyhow::{Context, Result, bail};
use std::path::{Path, PathBuf};
use std::process::Command;

/// Where the sources are; the CMake files clone the same with the suffix `.git`.
const URL: &str = "https://github.com/Auburn/FastSIMD";

/// The commit that they check out, of `fastnoise2-sys` 0.2.0. A newer crate that asks for another
/// one fails its build here, so this line is then changed.
const COMMIT: &str = "16450dae9528727e500e7254f635a671f9c7ee2d";

/// Where the clone lies.
fn folder() -> PathBuf {
    process::target().join("fastsimd")
}

/// Clones the sources, unless an earlier run has.
///
/// # Errors
/// The network does not answer, or the clone lacks the commit or a file of it.
pub fn fetch() -> Result<()> {
    fetch_to(&folder(), URL, COMMIT)
}

/// Whether an earlier run has cloned the sources. Downloads nothing.
pub fn is_fetched() -> bool {
    has_sources(&folder(), COMMIT)
}

fn fetch_to(folder: &Path, url: &str, commit: &str) -> Result<()> {
    if has_sources(folder, commit) {
        return Ok(());
    }
    // What an interrupted clone left would refuse the next.
    let _ = std::fs::remove_dir_all(folder);
    clone(folder, url).with_context(|| format!("cannot clone {url}"))?;
    if !has_sources(folder, commit) {
        bail!("the clone of {url} has no commit {}", &commit[..7]);
    }
    Ok(())
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
fn has_sources(folder: &Path, commit: &str) -> bool {
    let mut git = process::command("git");
    // Named, so that a broken clone does not make git look for a repository in the folders above.
    git.arg("--git-dir").arg(folder.join(".git")).arg("--work-tree").arg(folder);
    git.args(["checkout", "--quiet", "--force", "--detach", commit]);
    process::succeeds(git)
}

/// For a command that builds FastNoise2: its `git` reads [the clone](fetch) in place of the
/// network.
pub fn use_clone(build: &mut Command) {
    // Replaces what the environment configures of git: the build clones nothing else.
    build.env("GIT_CONFIG_COUNT", "1");
    // The suffix is in the longest match, which wins over a mirror that a person has configured.
    build.env("GIT_CONFIG_VALUE_0", format!("{URL}.git"));
    build.env("GIT_CONFIG_KEY_0", format!("url.{}.insteadOf", folder().display()));
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A git that reads no configuration of the machine but a file.
    fn git(configuration: &Path, words: &[&str]) -> Command {
        let mut git = process::command("git");
        git.args(words).env_remove("GIT_CONFIG_COUNT");
        git.env("GIT_CONFIG_GLOBAL", configuration).env("GIT_CONFIG_NOSYSTEM", "1");
        git
    }

    #[test]
    fn a_clone_has_the_commit_or_the_error_says_what_is_missing() {
        let scratch = std::env::temp_dir().join(format!("tombolo-fast-simd-{}", std::process::id()));
        let (source, nothing) = (scratch.join("source"), Path::new("/dev/null"));
        let source = source.to_str().unwrap();
        process::run(git(nothing, &["init", "--quiet", source])).unwrap();
        let words = "-c user.name=x -c user.email=x commit --quiet --allow-empty -m x";
        let words = ["-C", source].into_iter().chain(words.split(' ')).collect::<Vec<_>>();
        process::run(git(nothing, &words)).unwrap();
        let commit = process::output(git(nothing, &["-C", source, "rev-parse", "HEAD"])).unwrap();
        let fetch = |url: &str, commit| fetch_to(&scratch.join("clone"), url, commit);
        let without = fetch(source, COMMIT).unwrap_err();
        let silent = fetch(scratch.join("nowhere").to_str().unwrap(), COMMIT).unwrap_err();
        let found = fetch(source, commit.trim());
        let again = fetch("no clone is made of this", commit.trim());
        std::fs::remove_dir_all(&scratch).unwrap();
        assert!(without.to_string().contains("has no commit 16450da"), "{without:#}");
        assert!(silent.to_string().contains("cannot clone"), "{silent:#}");
        found.unwrap();
        again.unwrap();
    }

    #[test]
    fn a_build_reads_the_clone_whatever_mirror_is_configured() {
        let mirror = std::env::temp_dir().join(format!("tombolo-mirror-{}", std::process::id()));
        std::fs::write(&mirror, format!("[url \"/mirror\"]\n\tinsteadOf = {URL}\n")).unwrap();
        let asked = format!("{URL}.git");
        // The address that git would read in place of the one of the CMake files.
        let plain = git(&mirror, &["ls-remote", "--get-url", &asked]);
        let mut build = git(&mirror, &["ls-remote", "--get-url", &asked]);
        use_clone(&mut build);
        let read = [plain, build].map(|git| process::output(git).unwrap().trim().to_owned());
        std::fs::remove_file(&mirror).unwrap();
        assert_eq!(read, ["/mirror.git".to_owned(), folder().display().to_string()]);
    }
}
