//! The pictures of an earlier commit, drawn by its own viewer and server.

use super::pose::Pose;
use super::{FOLDER, WORLD_SEED, palette, scratch, shoot};
use crate::process;
use crate::server::Server;
use anyhow::{Context, Result};
use std::path::{Path, PathBuf};

/// The commit: the last one with the look before plants were on by default.
pub const COMMIT: &str = "84fdcef";

/// Options that the viewer of that commit lacks, each with its value.
const NEWER: [&str; 2] = ["--place", "--quality"];

/// Checks the commit out, builds it, and draws the poses.
///
/// # Errors
/// Git, the build, the server or a viewer fails.
pub fn draw(poses: &[&Pose]) -> Result<()> {
    let server = Server::start(WORLD_SEED).context("gallery")?;
    let viewer = built()?;
    let folder = process::root().join(FOLDER).join("before");
    std::fs::create_dir_all(&folder)
        .with_context(|| format!("gallery: cannot create {}", folder.display()))?;
    for (index, pose) in poses.iter().enumerate() {
        println!("gallery: {} of {}, {} before", index + 1, poses.len(), pose.name);
        let drawn = scratch(pose)?;
        let camera = if pose.has_place() { Some(camera(pose, &server, &drawn)?) } else { None };
        let mut command = process::command(&viewer);
        process::quiet_drivers(&mut command);
        command.args(["--connect", &server.stream()]).args(older(pose));
        if let Some(camera) = camera {
            command.arg(format!("--camera={camera}"));
        }
        shoot(command, &drawn)?;
        palette::write(&drawn, &folder.join(pose.file()))?;
    }
    Ok(())
}

/// The options of a pose that the earlier viewer has too.
fn older(pose: &Pose) -> Vec<&'static str> {
    let mut words = pose.words();
    let mut kept = Vec::new();
    while let Some(word) = words.next() {
        if NEWER.contains(&word) {
            words.next();
        } else {
            kept.push(word);
        }
    }
    kept
}

/// The camera of a pose whose place today's viewer finds.
fn camera(pose: &Pose, server: &Server, drawn: &Path) -> Result<String> {
    let stats = drawn.with_extension("json");
    let mut viewer = process::viewer();
    viewer.args(["--connect", &server.stream()]).args(pose.words());
    viewer.args(["--size", "16x9", "--view-distance", "200", "--grass", "0", "--trees", "0", "--stats"]);
    viewer.arg(&stats).arg("--shot").arg(drawn);
    process::run(viewer).context("gallery: a place was not found")?;
    let text = std::fs::read_to_string(&stats)
        .with_context(|| format!("gallery: cannot read {}", stats.display()))?;
    let stats: serde_json::Value = serde_json::from_str(&text).context("gallery")?;
    stats["camera"].as_str().map(str::to_owned).context("gallery: the viewer's stats have no camera")
}

/// The viewer of the commit, in a worktree under the folder of build results.
fn built() -> Result<PathBuf> {
    let tree = process::target().join("gallery").join(COMMIT);
    if !tree.join("Cargo.toml").is_file() {
        let mut git = process::command("git");
        git.args(["worktree", "add", "--force", "--detach"]).arg(&tree).arg(COMMIT);
        process::run(git).context("gallery: cannot check out the earlier commit")?;
    }
    let target = tree.join("target");
    let mut build = process::cargo("build --release --bin tombolo-view");
    build.current_dir(&tree).env("CARGO_TARGET_DIR", &target);
    process::run(build).context("gallery: the build of the earlier commit failed")?;
    Ok(target.join("release").join(format!("tombolo-view{}", std::env::consts::EXE_SUFFIX)))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn options_of_today_are_left_out_with_their_values() {
        let pose =
            Pose { name: "a", title: "a", options: "--place beach --sun 1,2 --quality medium --grass 3" };
        assert_eq!(older(&pose), ["--sun", "1,2", "--grass", "3"]);
    }
}
