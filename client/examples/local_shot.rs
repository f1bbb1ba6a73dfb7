//! Renders the archipelago without a server, by the viewer's own options:
//! `cargo run -p client --example local_shot -- --shot OUT.png [OPTIONS]`.

use anyhow::Context as _;
use clap::Parser as _;
use client::feed::LocalFeed;
use client::headless;
use client::native::args::Args;
use std::time::Instant;

fn main() -> anyhow::Result<()> {
    let args = Args::parse();
    let path = args.shot.as_ref().context("--shot FILE is missing: where the picture goes")?;
    let (picture, stats) = headless::render(&args.shot_options(), LocalFeed::new(1), Instant::now(), |_| ())?;
    println!("{}", serde_json::to_string(&stats)?);
    image::save_buffer(path, &picture.rgba, picture.width, picture.height, image::ColorType::Rgba8)?;
    Ok(())
}
