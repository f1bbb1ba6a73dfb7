//! Some poses of the gallery, drawn as thumbnails, against golden ones: a place that moves or a
//! preset that changes shows here.

use clap::Parser as _;
use client::gpu::Image;
use client::headless::{self, Options};
use client::native::args::Args;
use client::native::profile::Profile;
use client::stream::LocalStream;
use std::time::Instant;
use tests::golden::{self, Difference, FINE_TOLERANCE};

/// The same file that `cargo xtask gallery` draws from.
const POSES: &str = include_str!("../../docs/gallery/poses.txt");

/// Poses that are drawn here.
const DRAWN: [&str; 8] = ["start", "beach", "summit", "forest", "cliff", "next-island", "meadow", "evening"];

/// Names and options of all poses.
fn poses() -> Vec<(&'static str, Args)> {
    let lines = POSES.lines().filter(|line| !line.is_empty() && !line.starts_with('#'));
    let parsed = lines.map(|line| {
        let parts: Vec<&str> = line.split('|').map(str::trim).collect();
        // Drivers filter alike without anisotropy only.
        let words = ["tombolo-view", "--size", "96x54", "--samples", "1", "--anisotropy", "1"].into_iter();
        let args = Args::try_parse_from(words.chain(parts[2].split_whitespace()));
        (parts[0], args.unwrap_or_else(|error| panic!("{line}: {error}")))
    });
    parsed.collect()
}

/// The options of a pose as a GPU would draw it, whatever driver this is.
fn options(args: &Args) -> Options {
    Profile::of(args, false).headless_options(args)
}

fn drawn(args: &Args) -> Option<Image> {
    let stream = LocalStream::new(args.world_seed());
    let rendered = headless::render(&options(args), stream, Instant::now(), |_| {});
    tests::rendering::rendered_or_skip(rendered).map(|(image, _)| image)
}

#[test]
fn the_viewer_takes_the_options_of_every_pose() {
    let poses = poses();
    assert!(poses.len() >= 24 && DRAWN.iter().all(|name| poses.iter().any(|(other, _)| other == name)));
    for (name, args) in &poses {
        let profile = Profile::of(args, true);
        assert_eq!(profile, Profile::of(args, false), "{name} looks the same on every driver");
    }
}

#[test]
fn poses_of_the_gallery_equal_their_golden_thumbnails() {
    let poses = poses();
    let chosen = poses.iter().filter(|(name, _)| DRAWN.contains(name));
    let mut wrong = Vec::new();
    for (name, args) in chosen {
        let Some(picture) = drawn(args) else { return };
        wrong.extend(golden::check_within(&format!("gallery-{name}"), &picture, FINE_TOLERANCE).err());
    }
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
}

#[test]
fn another_pose_and_a_pose_without_plants_fail_the_comparison() {
    if golden::is_blessing() {
        return;
    }
    let poses = poses();
    let args = |name: &str| poses.iter().find(|(other, _)| *other == name).unwrap().1.clone();
    let Some(bare) = drawn(&Args { plants: without_plants(&args("meadow")), ..args("meadow") }) else {
        return;
    };
    let cliff = golden::golden("gallery-cliff").unwrap();
    for (name, what, picture) in [("meadow", "without plants", &bare), ("beach", "another pose", &cliff)] {
        let golden = golden::golden(&format!("gallery-{name}")).unwrap();
        let difference = Difference::between(&golden, picture);
        golden::require_rejected(&format!("gallery-{name}, {what}"), difference, FINE_TOLERANCE);
    }
}

fn without_plants(args: &Args) -> client::native::vegetation_args::VegetationArgs {
    client::native::vegetation_args::VegetationArgs { grass: Some(0), trees: Some(0), ..args.plants.clone() }
}
