//! Parallax on the streamed land: gone without a trace where there is no relief, and blind to the
//! borders of chunks and levels.

use client::camera::Lens;
use client::feed::{Feed, LocalFeed};
use client::headless::{self, HeadlessError, Options};
use client::looks::{Looks, Shadows};
use client::relief::ReliefKnobs;
use client::relief::knobs::ReliefTier;
use client::render::Picture;
use std::time::Instant;
use terrain::constants::{UNITS_PER_METRE, VERTEX_COUNT};
use terrain::{ChunkKey, lod};
use tests::molded::Molded;

/// Bushes at arm's length, on a hill.
const CAMERA: &str = "300,191,900,30,-22";

fn options(camera: &str, relief: ReliefKnobs) -> Options {
    Options {
        pose: camera.parse().unwrap(),
        lens: Lens { width: 160, height: 90, fov_deg: 60.0 },
        view_distance_m: 2000,
        samples: 1,
        // The land's shadow is found per vertex, so it depends on levels.
        looks: Looks { relief, shadows: Shadows::Off, ..Looks::default() },
        ..Options::default()
    }
}

/// Draws; none, visibly, where there is no adapter and none is required.
fn drawn(feed: impl Feed, options: &Options) -> Option<Picture> {
    match headless::render(options, feed, Instant::now(), |_| {}) {
        Ok((picture, _)) => Some(picture),
        Err(HeadlessError::Gpu(error)) if !tests::gpu_is_required() => {
            eprintln!("SKIPPED: {error}");
            None
        }
        Err(error) => panic!("{error}"),
    }
}

/// Pixels of which a channel differs by more than `most`.
fn differing(one: &Picture, other: &Picture, most: u8) -> usize {
    let pixels = one.rgba.chunks_exact(4).zip(other.rgba.chunks_exact(4));
    pixels.filter(|(a, b)| a.iter().zip(*b).any(|(a, b)| a.abs_diff(*b) > most)).count()
}

#[test]
fn without_amplitude_the_land_is_the_flat_one_to_the_last_byte_and_with_it_it_is_not() {
    let land = |tier, amplitude| {
        let relief = ReliefKnobs { tier, amplitude, ..ReliefKnobs::default() };
        drawn(LocalFeed::new(1), &options(CAMERA, relief))
    };
    let Some(flat) = land(ReliefTier::Flat, 1.0) else { return };
    for tier in [ReliefTier::Offset, ReliefTier::Linear, ReliefTier::Pyramid, ReliefTier::Auto] {
        let Some(gone) = land(tier, 0.0) else { return };
        assert_eq!(differing(&flat, &gone, 0), 0, "{tier:?}");
    }
    let Some(raised) = land(ReliefTier::Auto, 1.0) else { return };
    assert!(differing(&flat, &raised, 8) > 2_000, "{}", differing(&flat, &raised, 8));
}

#[test]
fn where_cones_are_asked_for_the_land_is_drawn_by_the_exact_walk_to_the_last_byte() {
    let land =
        |tier| drawn(LocalFeed::new(1), &options(CAMERA, ReliefKnobs { tier, ..ReliefKnobs::default() }));
    let (Some(cones), Some(walk)) = (land(ReliefTier::Cones), land(ReliefTier::Pyramid)) else { return };
    assert_eq!(differing(&cones, &walk, 0), 0);
    let Some(control) = land(ReliefTier::Offset) else { return };
    assert!(differing(&control, &walk, 0) > 200, "{}", differing(&control, &walk, 0));
}

fn level(_: ChunkKey, heights: &mut [i32; VERTEX_COUNT], _: u32) -> u32 {
    heights.fill(12 * UNITS_PER_METRE);
    0
}

/// As flat, but it says of itself what makes viewers ask for all levels.
fn level_in_small_pieces(key: ChunkKey, heights: &mut [i32; VERTEX_COUNT], _: u32) -> u32 {
    heights.fill(12 * UNITS_PER_METRE);
    lod::level_error(key.level())
}

#[test]
fn borders_of_chunks_and_levels_do_not_show() {
    let relief = ReliefKnobs::default();
    // On a corner of four chunks, looking along one of their borders.
    let options = options("0,13.7,0.5,0,-14", relief);
    let Some(whole) = drawn(Molded::new(1, level), &options) else { return };
    let Some(pieces) = drawn(Molded::new(1, level_in_small_pieces), &options) else { return };
    // Positions are interpolated over other triangles: a few rays pass the edge of a leaf on its
    // other side.
    let pixels = whole.rgba.len() / 4;
    let seams = differing(&whole, &pieces, 8);
    assert!(seams <= pixels / 100, "{seams} of {pixels}");
    let flat = Options {
        looks: Looks { relief: ReliefKnobs { tier: ReliefTier::Flat, ..relief }, ..options.looks },
        ..options
    };
    let Some(flat) = drawn(Molded::new(1, level_in_small_pieces), &flat) else { return };
    let raised = differing(&flat, &pieces, 8);
    assert!(
        raised > 20 * seams.max(pixels / 400),
        "there must be a relief that could have seams: {raised}, {seams}"
    );
}
