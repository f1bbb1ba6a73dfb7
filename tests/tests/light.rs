//! Finite light in every pixel, for every sun, eye and direction.
//!
//! Tested before tone mapping, which would turn a NaN into some colour: the half floats of the HDR
//! target are read back and their bits tested.

use client::camera::Projection;
use client::features::pom::PomSettings;
use client::features::pom::settings::{Heights, PomMethod, PomShadow};
use client::features::terrain_clipmap::window::STANDARD_TEXELS;
use client::frame::FrameData;
use client::gpu::{Gpu, OffscreenTarget, offscreen};
use client::renderer::{RenderOptions, Renderer};
use client::scene::Scene;
use client::settings::{RenderSettings, SunPosition};
use client::stream::LocalStream;
use client::stream::streamer::WorldStreamer;
use client::view::ViewParams;
use std::time::Duration;

const SIZE: (u32, u32) = (96, 54);
const SLOTS: u32 = 600;

/// The renderer with its source: one device for all pictures.
struct LightProbe {
    gpu: Gpu,
    renderer: Renderer,
    target: OffscreenTarget,
    streamer: WorldStreamer<LocalStream>,
}

impl LightProbe {
    fn open() -> Option<Self> {
        let gpu = tests::open_gpu_or_skip()?;
        let options = RenderOptions {
            scene: Scene::Island,
            size: SIZE,
            samples: 1,
            anisotropy: 1,
            format: offscreen::IMAGE_FORMAT,
            slots: SLOTS,
            clipmap_texels: STANDARD_TEXELS,
        };
        let renderer = Renderer::new(&gpu, &options);
        let target = OffscreenTarget::new(&gpu.device, SIZE.0, SIZE.1);
        Some(Self { gpu, renderer, target, streamer: WorldStreamer::new(LocalStream::new(1), SLOTS) })
    }

    /// The frame of a view with all its chunks.
    fn frame(&mut self, view: &ViewParams) -> FrameData {
        // A view that exceeds the pool would never be complete.
        for _ in 0..100_000 {
            let selection = self.streamer.update(view, Duration::ZERO, usize::MAX, |chunk| {
                self.renderer.upload(&self.gpu, chunk);
            });
            if self.streamer.is_settled() && selection.is_complete() {
                return view.frame(Scene::Island, self.streamer.cache(), &selection);
            }
        }
        panic!("{:?} does not fill", view.pose);
    }

    /// Colour channels of the HDR target that are not finite.
    fn unlit(&mut self, frame: &FrameData) -> usize {
        let light =
            self.renderer.read_hdr(&self.gpu, frame, &self.target).unwrap().expect("one sample per pixel");
        assert_eq!(light.len(), 4 * (SIZE.0 * SIZE.1) as usize);
        // An exponent of all ones is infinite or NaN.
        light.chunks_exact(4).flat_map(|pixel| &pixel[..3]).filter(|half| **half & 0x7c00 == 0x7c00).count()
    }
}

fn view(height_m: f64, pitch_deg: f64, fov_deg: f64) -> ViewParams {
    // The same detail of the land through every lens: a fine grid is not tested here.
    let tolerance_px = 12.0 * 60.0 / fov_deg;
    let view = tests::view_at(&format!("4300,{height_m},300,-60,{pitch_deg}"), SIZE, 3000, tolerance_px);
    ViewParams { projection: Projection { fov_deg, ..view.projection }, time_s: 1.0, ..view }
}

fn under_sun(view: &ViewParams, elevation_deg: f32) -> ViewParams {
    // In the middle of the picture, so that the disc and its reflection are in view.
    let sun = Some(SunPosition { azimuth_deg: -60.0, elevation_deg });
    ViewParams { settings: RenderSettings { sun, ..view.settings }, ..*view }
}

#[test]
fn light_is_finite_for_every_sun_height_and_direction() {
    let Some(mut probe) = LightProbe::open() else { return };
    for height_m in [-30.0, 2.0, 20_000.0] {
        for pitch_deg in [-90.0, 0.0, 90.0] {
            for fov_deg in [1.0, 170.0] {
                let view = view(height_m, pitch_deg, fov_deg);
                for elevation_deg in [-90.0, -10.0, -1.0, 0.0, 1.0, 10.0, 45.0, 90.0] {
                    let frame = probe.frame(&under_sun(&view, elevation_deg));
                    let unlit = probe.unlit(&frame);
                    assert_eq!(
                        unlit, 0,
                        "eye {height_m} m, pitch {pitch_deg}, field of view {fov_deg}, sun {elevation_deg}"
                    );
                }
            }
        }
    }
}

#[test]
fn light_is_finite_for_every_relief() {
    let Some(mut probe) = LightProbe::open() else { return };
    let land = view(0.0, 0.0, 60.0);
    // Close to the ground on a hill: horizontal rays graze the ground.
    for (height_m, pitch_deg) in [(189.4, 0.0), (189.4, -89.9), (192.0, -20.0)] {
        let pose = format!("300,{height_m},900,30,{pitch_deg}").parse().unwrap();
        for tier in
            [PomMethod::Offset, PomMethod::Linear, PomMethod::Cones, PomMethod::MaxMip, PomMethod::Auto]
        {
            for (amplitude, steps, heights, shadow) in [
                (0.0, 1, Heights::Exact, PomShadow::Soft),
                (1e-6, 256, Heights::Sampler, PomShadow::Hard),
                (1.0, 1, Heights::Sampler, PomShadow::Soft),
                (16.0, 4, Heights::Exact, PomShadow::Hard),
            ] {
                let relief = PomSettings {
                    method: tier,
                    amplitude,
                    steps_min: steps,
                    steps_max: steps,
                    heights,
                    shadow,
                    ..PomSettings::default()
                };
                let frame = probe.frame(&ViewParams {
                    pose,
                    settings: RenderSettings { pom: relief, ..land.settings },
                    ..land
                });
                assert_eq!(probe.unlit(&frame), 0, "{pose} {relief:?}");
            }
        }
    }
}

#[test]
fn nan_options_have_no_effect_and_a_nan_sun_is_detected() {
    let Some(mut probe) = LightProbe::open() else { return };
    let plain = view(60.0, -10.0, 60.0);
    let odd = SunPosition { azimuth_deg: f32::NAN, elevation_deg: 30.0 };
    let settings = RenderSettings { sun: Some(odd), exposure_ev: f32::NAN, ..plain.settings };
    let (frame, with_nan) = (probe.frame(&plain), probe.frame(&ViewParams { settings, ..plain }));
    assert_eq!(
        (frame.uniforms.sun, frame.uniforms.exposure),
        (with_nan.uniforms.sun, with_nan.uniforms.exposure)
    );
    assert_eq!(probe.unlit(&with_nan), 0);

    // Control: a NaN in the uniforms is detected in the picture.
    let mut broken = frame;
    broken.uniforms.sun = [f32::NAN; 3];
    broken.uniforms.eye_height_m = f32::NAN;
    assert!(probe.unlit(&broken) > 100, "the control must fail");
}
