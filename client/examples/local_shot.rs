//! Renders the home island without a server: `cargo run -p client --example local_shot -- OUT.png [CAMERA] [WxH] [SAMPLES] [SHOW] [TOLERANCE] [SUN] [SHADOWS]`.

use client::feed::LocalFeed;
use client::headless::{Options, render};
use client::looks::SunPlace;
use std::error::Error;
use std::time::Instant;

fn main() -> Result<(), Box<dyn Error>> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let mut options = Options::default();
    if let Some(camera) = arguments.get(1) {
        options.pose = camera.parse()?;
    }
    if let Some((width, height)) = arguments.get(2).and_then(|size| size.split_once('x')) {
        (options.lens.width, options.lens.height) = (width.parse()?, height.parse()?);
    }
    options.samples = arguments.get(3).map_or(Ok(4), |samples| samples.parse())?;
    if let Some(show) = arguments.get(4) {
        options.looks.show = clap::ValueEnum::from_str(show, false)?;
    }
    if let Some(tolerance) = arguments.get(5) {
        options.tolerance_px = tolerance.parse()?;
    }
    if let Some((azimuth, elevation)) = arguments.get(6).and_then(|sun| sun.split_once(',')) {
        let place = SunPlace { azimuth_deg: azimuth.parse()?, elevation_deg: elevation.parse()? };
        options.looks.sun = Some(place);
    }
    if let Some(shadows) = arguments.get(7) {
        options.looks.shadows = clap::ValueEnum::from_str(shadows, false)?;
    }
    options.frames = 3;
    let (picture, stats) = render(&options, LocalFeed::new(1), Instant::now(), |_| ())?;
    println!("{}", serde_json::to_string(&stats)?);
    let path = arguments.first().map_or("local_shot.png", String::as_str);
    image::save_buffer(path, &picture.rgba, picture.width, picture.height, image::ColorType::Rgba8)?;
    Ok(())
}
