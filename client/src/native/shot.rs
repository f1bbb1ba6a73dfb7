//! `--shot`: a picture and its numbers as files, with a progress display for people.

use crate::feed::{Feed, LocalFeed, NoFeed};
use crate::headless::{self, Progress};
use crate::native::args::Args;
use crate::native::stream::{Settings, SocketFeed};
use crate::native::textures;
use crate::render::Picture;
use crate::stats::Stats;
use crate::voyage::Link;
use anyhow::Context as _;
use indicatif::{HumanBytes, ProgressBar, ProgressStyle};
use protocol::limits::MAX_TEXT;
use std::path::Path;
use std::time::{Duration, Instant};
use tokio_tungstenite::tungstenite::http::Uri;

/// Connects, waits for the complete view, renders, writes.
pub fn run(args: &Args, started: Instant) -> anyhow::Result<()> {
    let Some(path) = &args.shot else { return Ok(()) };
    // Told before a view is waited for, not after.
    anyhow::ensure!(
        path.extension().is_some_and(|extension| extension.eq_ignore_ascii_case("png")),
        "cannot write --shot {}: pictures are PNG, choose a path that ends in .png",
        path.display()
    );
    has_folder("--shot", path)?;
    args.stats.as_deref().map_or(Ok(()), |path| has_folder("--stats", path))?;
    let options = headless::Options { materials: textures::own(args)?, ..args.shot_options() };
    if args.scene.is_local() {
        let (picture, stats) = headless::render_local(&options, started)?;
        return write(args, path, &picture, &stats);
    }
    let feed = feed(args)?;
    // Hidden by itself where stderr is no terminal.
    let bar = ProgressBar::new_spinner();
    bar.set_style(ProgressStyle::with_template("{spinner} {elapsed} {msg}")?);
    bar.enable_steady_tick(Duration::from_millis(100));
    let (picture, stats) = headless::render(&options, feed, started, |progress| {
        bar.set_message(describe(progress));
    })?;
    bar.finish_and_clear();
    write(args, path, &picture, &stats)
}

/// Fails where the folder of a file is missing.
fn has_folder(option: &str, path: &Path) -> anyhow::Result<()> {
    let folder = path.parent().filter(|folder| !folder.as_os_str().is_empty());
    anyhow::ensure!(
        folder.is_none_or(Path::is_dir),
        "cannot write {option} {}: there is no such folder, create it or choose another",
        path.display()
    );
    Ok(())
}

/// Writes the picture, and the record of the run where one is asked for.
fn write(args: &Args, path: &Path, picture: &Picture, stats: &Stats) -> anyhow::Result<()> {
    image::save_buffer(path, &picture.rgba, picture.width, picture.height, image::ColorType::Rgba8)
        .with_context(|| format!("cannot write --shot {}: choose a writable .png path", path.display()))?;
    if let Some(path) = &args.stats {
        write_stats(path, stats)?;
    }
    Ok(())
}

/// What brings the land of a scene: a server, or the scene itself.
pub fn feed(args: &Args) -> anyhow::Result<Box<dyn Feed>> {
    let Some(url) = args.server() else {
        return Ok(if args.scene.is_local() {
            Box::new(NoFeed)
        } else {
            Box::new(LocalFeed::new(args.world_seed))
        });
    };
    let feed = SocketFeed::connect(settings(args, url)?).context("cannot start the network thread")?;
    Ok(Box::new(feed))
}

/// Where to connect, as whom (with the token from its file) and for what.
fn settings(args: &Args, url: Uri) -> anyhow::Result<Settings> {
    let token = args.token_file.as_deref().map(|path| cli::read_token(path, MAX_TEXT)).transpose()?;
    Ok(Settings { url, token, digest: args.digest, delivery: args.delivery })
}

/// Writes the record of a run.
pub fn write_stats(path: &Path, stats: &Stats) -> anyhow::Result<()> {
    let text = serde_json::to_string_pretty(stats)?;
    std::fs::write(path, text + "\n").with_context(|| format!("cannot write --stats {}", path.display()))
}

fn describe(progress: &Progress) -> String {
    let Progress { resident, wanting, bytes_received, link } = progress;
    match link {
        Link::Connecting => "connecting".to_owned(),
        Link::Connected(_) => {
            format!("{resident} chunks, {}, {wanting} places still coarse", HumanBytes(*bytes_received))
        }
        Link::Waiting { cause, .. } | Link::Refused(cause) => cause.clone(),
    }
}
