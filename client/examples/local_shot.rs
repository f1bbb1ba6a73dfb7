//! Renders the archipelago without a server, by the viewer's own options:
//! `cargo run -p tombolo-client --example local_shot -- --shot OUT.png [OPTIONS]`.

use anyhow::Context as _;
use clap::Parser as _;
use client::headless;
use client::native::args::Args;
use client::native::profile::Profile;
use client::stream::LocalStream;
use std::time::Instant;

fn main() -> anyhow::Result<()> {
    let args = Args::parse();
    let path = args.shot.as_ref().context("--shot FILE is missing: the path of the image")?;
    let (image, stats) = headless::render(
        &Profile::of(&args, true).headless_options(&args),
        LocalStream::new(1),
        Instant::now(),
        |_| (),
    )?;
    println!("{}", serde_json::to_string(&stats)?);
    image::save_buffer(path, &image.rgba, image.width, image.height, image::ColorType::Rgba8)?;
    Ok(())
}
