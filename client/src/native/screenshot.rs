//! `--shot`: an image and its measurements as files, with a progress display.

use crate::gpu::{Gpu, Image};
use crate::headless::{self, Progress};
use crate::native::args::Args;
use crate::native::png_file;
use crate::native::profile::Profile;
use crate::native::stream::{ServerStream, Settings};
use crate::native::textures;
use crate::stats::Stats;
use crate::stream::streamer::Link;
use crate::stream::{ChunkStream, LocalStream, NullStream};
use anyhow::Context as _;
use cli::UsageError;
use indicatif::{HumanBytes, ProgressBar, ProgressStyle};
use protocol::limits::MAX_TEXT;
use std::io::Write as _;
use std::path::Path;
use std::time::{Duration, Instant};
use tls_client::TlsClient;
use tokio_tungstenite::tungstenite::http::Uri;

/// Connects, waits for the complete view, renders, writes.
pub fn run(args: &Args, started: Instant) -> anyhow::Result<()> {
    let Some(path) = &args.shot else { return Ok(()) };
    // Checked before the view is loaded.
    if !path.extension().is_some_and(|extension| extension.eq_ignore_ascii_case("png")) {
        let line = "images are PNG files, choose a path that ends in .png";
        return Err(UsageError::new(format!("cannot write --shot {}: {line}", path.display())).into());
    }
    check_output("--shot", path)?;
    args.stats.as_deref().map_or(Ok(()), |path| check_output("--stats", path))?;
    cli::are_apart(("--shot", Some(path)), ("--stats", args.stats.as_deref()))?;
    let gpu = Gpu::open_blocking()?;
    let profile = Profile::of(args, gpu.is_software());
    let options =
        headless::Options { materials: textures::custom_materials(args)?, ..profile.headless_options(args) };
    let stream = open_stream(args)?;
    // Hidden automatically where stderr is not a terminal.
    let bar = ProgressBar::new_spinner();
    bar.set_style(ProgressStyle::with_template("{spinner} {elapsed} {msg}")?);
    bar.enable_steady_tick(Duration::from_millis(100));
    let (image_data, stats) = headless::render_on(&gpu, &options, stream, started, |progress| {
        bar.set_message(describe(progress));
    })?;
    bar.finish_and_clear();
    // After what can fail: an error is one line.
    if let Some(notice) = &profile.notice {
        eprintln!("{notice}");
    }
    write(args, path, &image_data, &stats)
}

/// Fails if the folder of a file is missing, or if the file is a folder.
///
/// # Errors
/// A [`UsageError`].
pub fn check_output(option: &str, path: &Path) -> Result<(), UsageError> {
    let folder = path.parent().filter(|folder| !folder.as_os_str().is_empty());
    let line = if path.is_dir() {
        "it is a folder, name a file"
    } else if folder.is_none_or(Path::is_dir) {
        return Ok(());
    } else {
        "the folder does not exist, create it or choose another"
    };
    Err(UsageError::new(format!("cannot write {option} {}: {line}", path.display())))
}

/// Writes the image, and the measurements if requested.
fn write(args: &Args, path: &Path, image_data: &Image, stats: &Stats) -> anyhow::Result<()> {
    png_file::write(path, image_data)
        .with_context(|| format!("cannot write --shot {}: choose a writable .png path", path.display()))?;
    if let Some(path) = &args.stats {
        write_stats(path, stats)?;
    }
    Ok(())
}

/// The stream of a scene: a server, or local generation.
pub fn open_stream(args: &Args) -> anyhow::Result<Box<dyn ChunkStream>> {
    let Some(url) = args.server() else {
        return Ok(if args.scene.is_local() {
            Box::new(NullStream)
        } else {
            Box::new(LocalStream::new(args.world_seed()))
        });
    };
    let stream =
        ServerStream::connect(stream_settings(args, url)?).context("cannot start the network thread")?;
    Ok(Box::new(stream))
}

/// Connection settings, with the token from its file.
fn stream_settings(args: &Args, url: Uri) -> anyhow::Result<Settings> {
    let token = args.token_file.as_deref().map(|path| cli::read_token(path, MAX_TEXT)).transpose()?;
    let tls = TlsClient::of_scheme(url.scheme_str(), args.ca_file.as_deref())
        .map_err(|error| UsageError::new(format!("--ca-file: {error}")))?;
    Ok(Settings { tls, token, digest: args.digest, delivery: args.delivery, ..Settings::new(url) })
}

/// Writes the measurements of a run.
pub fn write_stats(path: &Path, stats: &Stats) -> anyhow::Result<()> {
    let text = serde_json::to_string_pretty(stats)?;
    cli::replace_file(path, |mut file| file.write_all((text + "\n").as_bytes()))
        .with_context(|| format!("cannot write --stats {}", path.display()))
}

fn describe(progress: &Progress) -> String {
    let Progress { resident, missing, bytes_received, link } = progress;
    match link {
        Link::Connecting => "connecting".to_owned(),
        Link::Connected(_) => {
            format!("{resident} chunks, {}, {missing} chunks still coarse", HumanBytes(*bytes_received))
        }
        Link::Waiting { cause, .. } | Link::GivenUp(cause) => cause.clone(),
    }
}
