//! The sources of land version 3, from the history: `benches/land-comparison` compiles them.

use crate::process;
use anyhow::{Context, Result, bail};
use std::path::Path;

/// The last commit whose `GENERATOR_VERSION` is 3.
const COMMIT: &str = "60f38472201615e3672d5c1c160037959e06f4f4";

/// Where the manifest of `benches/land-comparison` looks for them, from the root.
const FOLDER: &str = "target/land-version-3";

/// Why they cannot be exported; none if they can.
pub fn lacks() -> Option<String> {
    lacks_commit(COMMIT)
}

fn lacks_commit(commit: &str) -> Option<String> {
    let mut verify = process::command("git");
    verify.args(["rev-parse", "--verify", "--quiet", &format!("{commit}^{{commit}}")]);
    (!process::succeeds(verify)).then(|| {
        format!(
            "the history has no commit {}, whose land is version 3; in a shallow clone run: git fetch \
             --unshallow",
            &commit[..7]
        )
    })
}

/// Writes them, in place of what an earlier export left.
///
/// # Errors
/// The history lacks the commit, or `git` or `tar` fails.
pub fn export() -> Result<()> {
    export_to(&process::root().join(FOLDER))
}

fn export_to(folder: &Path) -> Result<()> {
    if let Some(why) = lacks() {
        bail!("{why}");
    }
    let _ = std::fs::remove_dir_all(folder);
    std::fs::create_dir_all(folder).with_context(|| format!("cannot create {}", folder.display()))?;
    let archive = folder.join("terrain.tar");
    let mut git = process::command("git");
    git.args(["archive", "--format=tar", "--output"]).arg(&archive).args([COMMIT, "terrain/src"]);
    process::run(git)?;
    let mut tar = process::command("tar");
    tar.arg("-xf").arg(&archive).arg("-C").arg(folder);
    process::run(tar)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_export_is_version_3_and_replaces_an_earlier_one() {
        if let Some(why) = lacks() {
            eprintln!("skipped: {why}");
            return;
        }
        let folder = std::env::temp_dir().join(format!("tombolo-version-3-{}", std::process::id()));
        std::fs::create_dir_all(folder.join("terrain/src")).unwrap();
        std::fs::write(folder.join("terrain/src/left.rs"), "").unwrap();
        export_to(&folder).unwrap();
        let constants = std::fs::read_to_string(folder.join("terrain/src/constants.rs")).unwrap();
        let left = folder.join("terrain/src/left.rs").exists();
        std::fs::remove_dir_all(&folder).unwrap();
        assert!(constants.contains("GENERATOR_VERSION: u32 = 3;") && !left);
    }

    #[test]
    fn a_history_without_the_commit_is_one_line_with_a_cure() {
        let why = lacks_commit(&"0".repeat(40)).unwrap();
        assert!(why.contains("0000000") && why.contains("git fetch --unshallow") && !why.contains('\n'));
    }
}
