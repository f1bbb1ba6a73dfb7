//! Extreme eyes, lenses, sizes and shapes of land: each has a defined picture.

use client::camera::Pose;
use client::features::terrain::pool::ChunkPool;
use client::features::terrain_clipmap::window::STANDARD_TEXELS;
use client::gpu::{Image, OffscreenTarget, offscreen};
use client::headless::Options;
use client::renderer::{RenderOptions, Renderer};
use client::scene::Scene;
use client::settings::{Normals, RenderSettings, Show};
use client::stream::LocalStream;
use client::stream::streamer::WorldStreamer;
use std::time::Duration;
use terrain::constants::{UNITS_PER_METRE, VERTEX_COUNT, VERTICES};
use terrain::{ChunkKey, Land, Position};
use tests::deformed_source::DeformedSource;
use tests::golden::Difference;
use tests::render_or_skip;

fn options(camera: &str) -> Options {
    Options { view_distance_m: 3000, ..tests::options_at(camera, (96, 54)) }
}

fn drawn(options: &Options) -> Option<Image> {
    let (picture, _) = render_or_skip(LocalStream::new(1), options)?;
    assert!(picture.rgba.chunks_exact(4).all(|pixel| pixel[3] == 255));
    Some(picture)
}

/// Mean of a channel, 0 to 255.
fn mean(picture: &Image, channel: usize) -> f64 {
    let sum: u64 = picture.rgba.chunks_exact(4).map(|pixel| u64::from(pixel[channel])).sum();
    sum as f64 / (picture.rgba.len() / 4) as f64
}

/// Height of the land at a place, metres.
fn ground_m(x_m: i32, z_m: i32) -> f64 {
    let place = Position::new(x_m * UNITS_PER_METRE, z_m * UNITS_PER_METRE).unwrap();
    f64::from(Land::new(1).height_at(place)) / f64::from(UNITS_PER_METRE)
}

/// A point on a hill of the home island, metres.
const HILL: (i32, i32) = (400, 900);

#[test]
fn an_eye_below_the_ground_is_lifted_to_just_above_it() {
    let ground = ground_m(HILL.0, HILL.1);
    assert!(ground > 60.0, "{ground}");
    let at = |height: f64| format!("{},{height},{},30,-5", HILL.0, HILL.1);
    let Some((buried, stats)) = render_or_skip(LocalStream::new(1), &options(&at(ground - 50.0))) else {
        return;
    };
    let lifted: Pose = stats.camera.parse().unwrap();
    assert!((0.4..4.0).contains(&(lifted.position_m.y - ground)), "{} over {ground}", lifted.position_m.y);
    let exact = Options {
        pose: Pose { position_m: lifted.position_m.with_y(ground + 400.0), ..lifted },
        ..options(&at(0.0))
    };
    let (Some(standing), Some(far)) = (drawn(&options(&stats.camera)), drawn(&exact)) else { return };
    let same = Difference::between(&buried, &standing);
    assert!(same.is_tolerable(), "{same:?}");
    assert!(!Difference::between(&buried, &far).is_tolerable(), "the control must fail");
}

#[test]
fn extreme_eyes_and_lenses_yield_pictures() {
    let ground = ground_m(HILL.0, HILL.1);
    for (height, pitch) in [
        (ground + 0.5, 0.0),
        (ground + 2.0, 90.0),
        (ground + 2.0, -90.0),
        (3_000.0, -90.0),
        (20_000.0, -89.0),
    ] {
        for fov_deg in [1.0, 60.0, 170.0] {
            let camera = format!("{},{height},{},0,{pitch}", HILL.0, HILL.1);
            let mut options = options(&camera);
            options.projection.fov_deg = fov_deg;
            let Some(picture) = drawn(&options) else { return };
            let [red, green, blue] = [0, 1, 2].map(|channel| mean(&picture, channel));
            let is_sky = pitch == 90.0 && fov_deg < 100.0;
            assert!(red + green + blue > 30.0, "{camera} at {fov_deg} degrees is black");
            assert!(!is_sky || blue > 1.1 * red, "{camera} at {fov_deg} degrees shows no sky: {red} {blue}");
        }
    }
    // In the sea, 5 km off the coast: below, at and above the surface.
    for height in [-30.0, -0.01, 0.0, 0.01] {
        for pitch in [-90.0, 0.0, 90.0] {
            let Some(picture) = drawn(&options(&format!("9000,{height},9000,0,{pitch}"))) else { return };
            let total: f64 = [0, 1, 2].map(|channel| mean(&picture, channel)).into_iter().sum();
            assert!(total > 3.0, "{height} m, {pitch} degrees is black");
        }
    }
}

#[test]
fn pictures_of_extreme_sizes_are_drawn() {
    for (width, height) in [(1, 1), (1, 300), (300, 1), (7, 13)] {
        let mut options = options("-1300,160,1500,70,-8");
        (options.projection.width, options.projection.height) = (width, height);
        let Some(picture) = drawn(&options) else { return };
        assert_eq!((picture.width, picture.height), (width, height));
        assert!(mean(&picture, 2) > 5.0, "{width} x {height} is black");
    }
}

#[test]
fn a_renderer_resized_in_every_frame_draws_every_size() {
    let Some(gpu) = tests::open_gpu_or_skip() else { return };
    let slots = ChunkPool::slots_within(&gpu.device.limits(), 2000);
    let options = options("-1300,160,1500,70,-8");
    let format = offscreen::IMAGE_FORMAT;
    let mut renderer = Renderer::new(
        &gpu,
        &RenderOptions {
            scene: options.scene,
            size: (0, 0),
            samples: 1,
            anisotropy: 1,
            format,
            slots,
            clipmap_texels: STANDARD_TEXELS,
        },
    );
    let mut streamer = WorldStreamer::new(LocalStream::new(1), slots);
    for (width, height) in [(0, 0), (64, 36), (1, 1), (0, 7), (200, 3), (64, 36), (65, 36), (64, 36)] {
        renderer.resize((width, height));
        let mut view = options.view(0, streamer.cache());
        (view.projection.width, view.projection.height) = (width.max(1), height.max(1));
        let selection = streamer.update(&view, Duration::ZERO, usize::MAX, |chunk| {
            renderer.upload(&gpu, chunk);
        });
        let frame = view.frame(Scene::Island, streamer.cache(), &selection);
        let target = OffscreenTarget::new(&gpu.device, width, height);
        let mut encoder = gpu.device.create_command_encoder(&wgpu::CommandEncoderDescriptor::default());
        renderer.draw(&gpu, &frame, &mut encoder, &target.view);
        gpu.queue.submit([encoder.finish()]);
        gpu.wait().unwrap();
        let picture = target.read(&gpu).unwrap();
        assert_eq!((picture.width, picture.height), (width.max(1), height.max(1)));
        assert!(mean(&picture, 2) > 5.0, "{width} x {height}");
    }
}

fn flat(_: ChunkKey, heights: &mut [i32; VERTEX_COUNT], _: u32) -> u32 {
    heights.fill(10 * UNITS_PER_METRE);
    0
}

/// Place and height of the spike, units: on a plain, so that nothing hides it or shows its shadow.
const SPIKE: (i32, i32, i32) = (-400 * UNITS_PER_METRE, -3000 * UNITS_PER_METRE, 4000 * UNITS_PER_METRE);

fn spiked(key: ChunkKey, heights: &mut [i32; VERTEX_COUNT], error: u32) -> u32 {
    let (x0, z0) = key.origin();
    let step = |value: i32, low: i32| (i64::from(value) - i64::from(low), i64::from(key.spacing()));
    let ((dx, spacing), (dz, _)) = (step(SPIKE.0, x0), step(SPIKE.1, z0));
    let side = i64::from(key.side());
    if !(0..=side).contains(&dx) || !(0..=side).contains(&dz) {
        return error;
    }
    if dx % spacing == 0 && dz % spacing == 0 {
        heights[(dz / spacing) as usize * VERTICES + (dx / spacing) as usize] = SPIKE.2;
    }
    if key.level() == 0 { error } else { error.max(SPIKE.2 as u32) }
}

#[test]
fn flat_land_is_drawn_coarse_and_whole() {
    let options = options("30,40,20,10,-30");
    let Some((picture, stats)) = render_or_skip(DeformedSource::new(1, flat), &options) else { return };
    assert!((1..=25).contains(&stats.chunks_drawn), "flat land needs no detail: {stats:?}");
    // The clipmap would show the land of the seed.
    let settings = RenderSettings { show: Show::Levels, normals: Normals::Mesh, ..RenderSettings::default() };
    let levels = Options { settings, ..options };
    let Some((levels, _)) = render_or_skip(DeformedSource::new(1, flat), &levels) else { return };
    // One level, lit alike everywhere: below the horizon all pixels are of one colour but for
    // dither.
    let low = &levels.rgba[levels.rgba.len() / 2..];
    assert!(low.chunks_exact(4).all(|pixel| (0..3).all(|i| pixel[i].abs_diff(low[i]) <= 2)));
    assert!(mean(&picture, 1) > 10.0);
}

#[test]
fn a_spike_of_one_vertex_and_4_km_is_drawn_where_it_stands() {
    // On the ground 25 m south of the spike, whose foot is 4 m wide, looking north.
    let options = options("-400,0,-2975,0,20");
    let Some((plain, _)) = render_or_skip(LocalStream::new(1), &options) else { return };
    let Some((spiky, stats)) = render_or_skip(DeformedSource::new(1, spiked), &options) else { return };
    assert!(stats.chunks_drawn > 4, "{stats:?}");
    let differs = |x: usize, y: usize| {
        let at = 4 * (y * 96 + x);
        (0..3).any(|i| plain.rgba[at + i].abs_diff(spiky.rgba[at + i]) > 24)
    };
    assert!(
        (0..20).all(|y| (40..56).any(|x| differs(x, y))),
        "it stands in the middle, up to the upper edge"
    );
    assert!((0..54).all(|y| !differs(5, y)), "and nowhere else");
}
