//! The sea and the water scene: identities, the order of the tiers, and extreme cameras.

use client::features::terrain_clipmap::window::STANDARD_TEXELS;
use client::features::water::{WaterTier, WaveSettings};
use client::gpu::{Image, OffscreenTarget, offscreen};
use client::headless::Options;
use client::renderer::{RenderOptions, Renderer};
use client::scene::Scene;
use client::settings::RenderSettings;
use client::stats::Stats;
use client::stream::streamer::WorldStreamer;
use client::stream::{LocalStream, NullStream};
use std::time::Duration;
use tests::places::{SEA, moved};

fn options(scene: Scene, camera: &str) -> Options {
    Options { scene, time_s: 3.0, view_distance_m: 1500, ..tests::options_at(camera, (192, 108)) }
}

fn with(options: &Options, water: WaterTier, waves: WaveSettings) -> Options {
    Options { settings: RenderSettings { water, waves, ..options.settings }, ..options.clone() }
}

/// Renders local land.
fn drawn(options: &Options) -> Option<(Image, Stats)> {
    tests::render_or_skip(LocalStream::new(1), options)
}

/// Mean absolute difference of two panels of a picture of three, 0 to 255.
fn between_panels(picture: &Image, one: u32, other: u32) -> f64 {
    let width = picture.width / 3;
    let pixel = |x: u32, y: u32, channel: u32| {
        f64::from(picture.rgba[(4 * (y * picture.width + x) + channel) as usize])
    };
    let mut sum = 0.0;
    // Two pixels of each panel may be separator.
    for y in 0..picture.height {
        for x in 2..width {
            for channel in 0..3 {
                sum += (pixel(one * width + x, y, channel) - pixel(other * width + x, y, channel)).abs();
            }
        }
    }
    sum / f64::from(3 * (width - 2) * picture.height)
}

/// The first invalid pixel, if any: the tone pass writes magenta, a colour of no material, where
/// light is not finite.
fn broken(picture: &Image) -> Option<String> {
    let wrong = picture.rgba.chunks_exact(4).position(|pixel| pixel == [255, 0, 255, 255] || pixel[3] != 255);
    wrong.map(|index| format!("pixel {index} is not finite"))
}

/// The scene at its start.
const BAY: &str = "0,7.5,7,0,-29";

#[test]
fn without_parallax_every_tier_draws_flat_water_byte_for_byte() {
    for (scene, camera) in [(Scene::Island, SEA.as_str()), (Scene::Water, BAY)] {
        let base = options(scene, camera);
        let Some((flat, _)) = drawn(&with(&base, WaterTier::Flat, WaveSettings::default())) else { return };
        let none = WaveSettings { parallax_factor: 0.0, ..WaveSettings::default() };
        for tier in [WaterTier::Offset, WaterTier::Three, WaterTier::March] {
            let Some((zero, _)) = drawn(&with(&base, tier, none)) else { return };
            if scene == Scene::Island {
                assert!(zero.rgba == flat.rgba, "{tier:?} without parallax is not flat water");
            } else {
                assert_eq!(middle(&zero), middle(&flat), "{tier:?} without parallax is not flat water");
            }
            // Control: with parallax the picture differs.
            let Some((some, _)) = drawn(&with(&base, tier, WaveSettings::default())) else { return };
            assert!(middle(&some) != middle(&flat), "{tier:?} does nothing");
        }
    }
}

/// The middle panel: the only one that depends on the tier.
fn middle(picture: &Image) -> Vec<u8> {
    let (row, third) = (4 * picture.width as usize, 4 * (picture.width / 3) as usize);
    picture.rgba.chunks_exact(row).flat_map(|line| &line[third..2 * third]).copied().collect()
}

#[test]
fn every_tier_is_nearer_to_the_reference_than_flat_water() {
    let base = options(Scene::Water, BAY);
    for tier in [WaterTier::Offset, WaterTier::Two, WaterTier::Three, WaterTier::Four, WaterTier::March] {
        let Some((picture, stats)) = drawn(&with(&base, tier, WaveSettings::default())) else { return };
        assert_eq!((stats.chunks_drawn, stats.bytes_received, stats.delivery), (0, 0, "none"));
        let (left, centre) = (between_panels(&picture, 0, 2), between_panels(&picture, 1, 2));
        assert!(centre < 0.5 * left, "{tier:?}: {centre} against {left}");
        // Dither differs from place to place: up to one step.
        assert!(tier != WaterTier::March || centre < 0.6, "{centre}");
    }
}

#[test]
fn the_sea_is_finite_for_extreme_eyes_and_settings() {
    let extreme = [
        WaveSettings::default(),
        WaveSettings { parallax_factor: 1.0, parallax_bias_m: 2.0, steepness: 4.0 },
        WaveSettings { parallax_factor: 1e30, parallax_bias_m: f32::NEG_INFINITY, steepness: f32::INFINITY },
        WaveSettings { parallax_factor: f32::NAN, parallax_bias_m: f32::NAN, steepness: f32::NAN },
    ];
    let cameras = [
        // At the plane, a hair above and below it, under water; looking level, straight down and
        // straight up.
        (0.0, 120.0, 0.0),
        (0.004, 120.0, -5.0),
        (-0.004, 120.0, 5.0),
        (-5.0, 300.0, 10.0),
        (-5.0, 300.0, -90.0),
        (-5.0, 300.0, 90.0),
        (30.0, 120.0, -90.0),
        (30.0, 120.0, 90.0),
        (20_000.0, 120.0, -45.0),
    ];
    for (index, (up_m, yaw_deg, pitch_deg)) in cameras.into_iter().enumerate() {
        let camera = &moved(&SEA, up_m, yaw_deg, pitch_deg);
        for scene in [Scene::Island, Scene::Water] {
            let mut options = options(scene, camera);
            if scene == Scene::Water {
                (options.pose.position_m.x, options.pose.position_m.z) = (0.0, 4.0);
            }
            (options.projection.width, options.projection.height) = (96, 54);
            options.projection.fov_deg = [1.0, 60.0, 170.0][index % 3];
            let waves = extreme[index % extreme.len()];
            let tier = [WaterTier::Three, WaterTier::March, WaterTier::Offset][index % 3];
            let Some((picture, _)) = drawn(&with(&options, tier, waves)) else { return };
            assert_eq!(broken(&picture), None, "{scene:?} {camera} {tier:?} {waves:?}");
        }
    }
}

#[test]
fn light_that_is_not_finite_is_detected() {
    let options = options(Scene::Water, BAY);
    let Some((picture, _)) = drawn(&options) else { return };
    assert_eq!(broken(&picture), None);
    // Control: a NaN exposure makes all light NaN. No option allows it, so the uniforms are
    // changed.
    let Some(gpu) = tests::open_gpu_or_skip() else { return };
    let size = (options.projection.width, options.projection.height);
    let format = offscreen::IMAGE_FORMAT;
    let mut renderer = Renderer::new(
        &gpu,
        &RenderOptions {
            scene: Scene::Water,
            size,
            samples: 1,
            anisotropy: 1,
            format,
            slots: 1,
            clipmap_texels: STANDARD_TEXELS,
        },
    );
    let (target, mut streamer) =
        (OffscreenTarget::new(&gpu.device, size.0, size.1), WorldStreamer::new(NullStream, 1));
    let shot = options.view(0, streamer.cache());
    let selection = streamer.update(&shot, Duration::ZERO, usize::MAX, |_| {});
    let mut frame = shot.frame(Scene::Water, streamer.cache(), &selection);
    frame.uniforms.exposure = f32::NAN;
    let mut encoder = gpu.device.create_command_encoder(&wgpu::CommandEncoderDescriptor::default());
    renderer.draw(&gpu, &frame, &mut encoder, &target.view);
    gpu.queue.submit([encoder.finish()]);
    assert!(broken(&target.read(&gpu).unwrap()).is_some(), "the check cannot fail");
}

#[test]
fn settings_change_the_picture_and_nan_is_the_default() {
    let base = options(Scene::Water, BAY);
    let tier = WaterTier::Three;
    let standard = WaveSettings::default();
    let Some((plain, _)) = drawn(&with(&base, tier, standard)) else { return };
    for waves in [
        WaveSettings { parallax_factor: 0.6, ..standard },
        WaveSettings { parallax_bias_m: 0.5, ..standard },
        WaveSettings { steepness: 2.0, ..standard },
    ] {
        let Some((changed, _)) = drawn(&with(&base, tier, waves)) else { return };
        assert!(changed.rgba != plain.rgba, "{waves:?} changes nothing");
    }
    let none = WaveSettings { parallax_factor: f32::NAN, parallax_bias_m: f32::NAN, steepness: f32::NAN };
    let Some((same, _)) = drawn(&with(&base, tier, none)) else { return };
    assert!(same.rgba == plain.rgba);
}
