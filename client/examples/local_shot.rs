//! Renders the land of the default seed without a server:
//! `cargo run -p tombolo-client --example local_shot -- --shot OUT.png [OPTIONS]`.
//!
//! Options are those of the viewer. The options of the server, the seed, statistics and texture
//! files have no effect.

use anyhow::Context as _;
use clap::Parser as _;
use client::headless;
use client::native::args::Args;
use client::native::profile::Profile;
use client::scene::DEFAULT_WORLD_SEED;
use client::stream::LocalStream;
use std::time::Instant;

fn main() -> anyhow::Result<()> {
    let args = Args::parse();
    let is_software = true;
    let path = args.shot.as_ref().context("--shot FILE is missing: the path of the image")?;
    let (image, stats) = headless::render(
        &Profile::of(&args, is_software).headless_options(&args),
        LocalStream::new(DEFAULT_WORLD_SEED),
        Instant::now(),
        |_| (),
    )?;
    println!("{}", serde_json::to_string(&stats)?);
    image::save_buffer(path, &image.rgba, image.width, image.height, image::ColorType::Rgba8)?;
    Ok(())
}
