//! Parallax on the streamed land: no effect without amplitude, and no seams at the borders of
//! chunks and levels.

use client::features::pom::PomSettings;
use client::features::pom::settings::PomMethod;
use client::gpu::Image;
use client::headless::Options;
use client::settings::{RenderSettings, Shadows};
use client::stream::{ChunkStream, LocalStream};
use terrain::constants::{UNITS_PER_METRE, VERTEX_COUNT};
use terrain::{ChunkKey, lod};
use tests::deformed_source::DeformedSource;

/// Bushes at arm's length, on a hill.
const CAMERA: &str = "300,0,900,30,-22";

fn options(camera: &str, relief: PomSettings) -> Options {
    let options = tests::options_at(camera, (160, 90));
    // Terrain shadows are computed per vertex, so they depend on levels.
    let settings = RenderSettings { pom: relief, shadows: Shadows::Off, ..options.settings };
    Options { view_distance_m: 2000, settings, ..options }
}

fn drawn(feed: impl ChunkStream, options: &Options) -> Option<Image> {
    tests::render_or_skip(feed, options).map(|(picture, _)| picture)
}

/// Pixels of which a channel differs by more than `most`.
fn differing(one: &Image, other: &Image, most: u8) -> usize {
    let pixels = one.rgba.chunks_exact(4).zip(other.rgba.chunks_exact(4));
    pixels.filter(|(a, b)| a.iter().zip(*b).any(|(a, b)| a.abs_diff(*b) > most)).count()
}

#[test]
fn zero_amplitude_equals_flat_land_byte_for_byte() {
    let land = |tier, amplitude| {
        let relief = PomSettings { method: tier, amplitude, ..PomSettings::default() };
        drawn(LocalStream::new(1), &options(CAMERA, relief))
    };
    let Some(flat) = land(PomMethod::Flat, 1.0) else { return };
    for tier in [PomMethod::Offset, PomMethod::Linear, PomMethod::MaxMip, PomMethod::Auto] {
        let Some(gone) = land(tier, 0.0) else { return };
        assert_eq!(differing(&flat, &gone, 0), 0, "{tier:?}");
    }
    let Some(raised) = land(PomMethod::Auto, 1.0) else { return };
    assert!(differing(&flat, &raised, 8) > 2_000, "{}", differing(&flat, &raised, 8));
}

#[test]
fn land_with_cones_equals_maximum_mipmap_traversal() {
    let land = |tier| {
        drawn(LocalStream::new(1), &options(CAMERA, PomSettings { method: tier, ..PomSettings::default() }))
    };
    let (Some(cones), Some(walk)) = (land(PomMethod::Cones), land(PomMethod::MaxMip)) else { return };
    assert_eq!(differing(&cones, &walk, 0), 0);
    let Some(control) = land(PomMethod::Offset) else { return };
    assert!(differing(&control, &walk, 0) > 200, "{}", differing(&control, &walk, 0));
}

fn level(_: ChunkKey, heights: &mut [i32; VERTEX_COUNT], _: u32) -> u32 {
    heights.fill(12 * UNITS_PER_METRE);
    0
}

/// As [`level`], with an error that makes viewers request all levels.
fn level_in_small_pieces(key: ChunkKey, heights: &mut [i32; VERTEX_COUNT], _: u32) -> u32 {
    heights.fill(12 * UNITS_PER_METRE);
    lod::level_error(key.level())
}

#[test]
fn borders_of_chunks_and_levels_are_invisible() {
    let relief = PomSettings::default();
    // On a corner of four chunks, looking along one of their borders.
    let options = options("0,13.7,0.5,0,-14", relief);
    let Some(whole) = drawn(DeformedSource::new(1, level), &options) else { return };
    let Some(pieces) = drawn(DeformedSource::new(1, level_in_small_pieces), &options) else { return };
    // Positions are interpolated over other triangles: a few rays pass the edge of a leaf on its
    // other side.
    let pixels = whole.rgba.len() / 4;
    let seams = differing(&whole, &pieces, 8);
    assert!(seams <= pixels / 100, "{seams} of {pixels}");
    let flat = Options {
        settings: RenderSettings {
            pom: PomSettings { method: PomMethod::Flat, ..relief },
            ..options.settings
        },
        ..options
    };
    let Some(flat) = drawn(DeformedSource::new(1, level_in_small_pieces), &flat) else { return };
    let raised = differing(&flat, &pieces, 8);
    assert!(
        raised > 20 * seams.max(pixels / 400),
        "there must be a relief that could have seams: {raised}, {seams}"
    );
}
