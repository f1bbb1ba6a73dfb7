//! `gallery`: draws the poses of `docs/gallery/poses.txt` into `docs/gallery/` and writes the page
//! with them. The pictures of an earlier commit stand beside them.

mod earlier;
mod page;
mod palette;
mod pose;

use crate::process;
use crate::server::Server;
use anyhow::{Context, Result, bail, ensure};
use pose::Pose;
use std::path::{Path, PathBuf};

/// Folder of the pictures; those of the earlier commit are in `before` there.
const FOLDER: &str = "docs/gallery";

/// The world of all poses.
const WORLD_SEED: u64 = 1;

/// Size of a picture, pixels.
const SIZE: &str = "480x270";

/// Most bytes of all pictures together.
const MOST_BYTES: u64 = 6_000_000;

/// Options of `gallery`.
#[derive(Clone, Debug, clap::Args)]
pub struct Options {
    /// Draws these poses alone, by name
    #[arg(long, value_delimiter = ',', value_name = "NAME")]
    only: Vec<String>,
    /// Draws the pictures of the earlier commit again, with the viewer of that commit
    #[arg(long)]
    before: bool,
    /// Writes the page alone
    #[arg(long, conflicts_with = "before")]
    page: bool,
}

/// Draws and writes.
///
/// # Errors
/// A build, the server or a viewer fails; a pose has an unknown name; the pictures are too large.
pub fn run(options: &Options) -> Result<()> {
    let poses = pose::all()?;
    for name in &options.only {
        ensure!(poses.iter().any(|pose| pose.name == *name), "gallery: no pose has the name {name}");
    }
    if !options.page {
        let chosen: Vec<&Pose> = poses
            .iter()
            .filter(|pose| options.only.is_empty() || options.only.contains(&pose.name.to_owned()))
            .collect();
        process::run(process::build(&["tombolo-server", "tombolo-view"]))
            .context("gallery: the build failed")?;
        if options.before { earlier::draw(&chosen)? } else { draw_all(&chosen)? }
    }
    page::write(&poses)?;
    let bytes = bytes_of(&process::root().join(FOLDER))?;
    ensure!(
        bytes <= MOST_BYTES,
        "gallery: the pictures have {bytes} bytes, at most {MOST_BYTES} are allowed"
    );
    println!("gallery: docs/gallery.md, {:.1} MB of pictures", bytes as f64 / 1e6);
    Ok(())
}

fn draw_all(poses: &[&Pose]) -> Result<()> {
    let server = Server::start(WORLD_SEED).context("gallery")?;
    let folder = process::root().join(FOLDER);
    for (index, pose) in poses.iter().enumerate() {
        println!("gallery: {} of {}, {}", index + 1, poses.len(), pose.name);
        let drawn = scratch(pose)?;
        let mut viewer = process::viewer();
        viewer.args(["--connect", &server.stream()]).args(pose.words());
        shoot(viewer, &drawn)?;
        palette::write(&drawn, &folder.join(pose.file()))?;
    }
    Ok(())
}

/// Where a viewer draws before the picture is reduced.
fn scratch(pose: &Pose) -> Result<PathBuf> {
    let folder = process::target().join("gallery");
    std::fs::create_dir_all(&folder)
        .with_context(|| format!("gallery: cannot create {}", folder.display()))?;
    Ok(folder.join(pose.file()))
}

/// Runs a viewer with the size of the pictures.
fn shoot(mut viewer: std::process::Command, drawn: &Path) -> Result<()> {
    // A picture of an earlier run must not pass for one of this.
    let _ = std::fs::remove_file(drawn);
    viewer.args(["--size", SIZE, "--timeout", "600", "--shot"]).arg(drawn);
    process::run(viewer).context("gallery: a picture failed")?;
    if !drawn.is_file() {
        bail!("gallery: the viewer ended well and left no {}", drawn.display());
    }
    Ok(())
}

/// Size of all pictures under a folder.
fn bytes_of(folder: &Path) -> Result<u64> {
    let mut bytes = 0;
    let entries =
        std::fs::read_dir(folder).with_context(|| format!("gallery: cannot read {}", folder.display()))?;
    for entry in entries {
        let path = entry.context("gallery")?.path();
        if path.is_dir() {
            bytes += bytes_of(&path)?;
        } else if path.extension().is_some_and(|extension| extension == "png") {
            bytes += path.metadata().context("gallery")?.len();
        }
    }
    Ok(bytes)
}
