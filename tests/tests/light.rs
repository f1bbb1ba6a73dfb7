//! Light that is a number in every pixel, wherever the sun stands, the eye is and looks.
//!
//! Judged before the tone curve, which would turn what is no number into some colour: the half
//! floats of the gathered light are read back and their bits looked at.

use client::camera::Lens;
use client::feed::LocalFeed;
use client::frame::{FrameData, Shot};
use client::looks::{Looks, SunPlace};
use client::relief::ReliefKnobs;
use client::relief::knobs::{Heights, ReliefShadow, ReliefTier};
use client::render::{Canvas, Gpu, GpuError, RenderOptions, Renderer, picture};
use client::scene::Scene;
use client::voyage::Voyage;
use std::time::Duration;

const SIZE: (u32, u32) = (96, 54);
const SLOTS: u32 = 600;

/// Everything that draws: one device for all pictures.
struct Studio {
    gpu: Gpu,
    renderer: Renderer,
    canvas: Canvas,
    voyage: Voyage<LocalFeed>,
}

impl Studio {
    /// A studio; none, visibly, where there is no adapter and none is required.
    fn open() -> Option<Self> {
        let gpu = match Gpu::open_blocking() {
            Ok(gpu) => gpu,
            Err(error @ GpuError::NoAdapter(_)) if !tests::gpu_is_required() => {
                eprintln!("SKIPPED: {error}");
                return None;
            }
            Err(error) => panic!("{error}"),
        };
        let options = RenderOptions {
            scene: Scene::Island,
            size: SIZE,
            samples: 1,
            format: picture::PICTURE_FORMAT,
            slots: SLOTS,
        };
        let renderer = Renderer::new(&gpu, &options);
        let canvas = Canvas::new(&gpu.device, SIZE.0, SIZE.1);
        Some(Self { gpu, renderer, canvas, voyage: Voyage::new(LocalFeed::new(1), SLOTS) })
    }

    /// The frame of a shot, with all land that it asks for.
    fn frame(&mut self, shot: &Shot) -> FrameData {
        // A view that the pool cannot hold would never be complete.
        for _ in 0..100_000 {
            let selection = self.voyage.update(shot, Duration::ZERO, usize::MAX, |chunk| {
                self.renderer.upload(&self.gpu, chunk);
            });
            if self.voyage.is_settled() && selection.is_complete() {
                return shot.frame(Scene::Island, self.voyage.world(), &selection);
            }
        }
        panic!("{:?} does not fill", shot.pose);
    }

    /// Colour channels of the gathered light that are no finite numbers.
    fn unlit(&mut self, frame: &FrameData) -> usize {
        let light =
            self.renderer.light(&self.gpu, frame, &self.canvas).unwrap().expect("one sample per pixel");
        assert_eq!(light.len(), 4 * (SIZE.0 * SIZE.1) as usize);
        // An exponent of all ones is infinite or no number.
        light.chunks_exact(4).flat_map(|pixel| &pixel[..3]).filter(|half| **half & 0x7c00 == 0x7c00).count()
    }
}

fn shot(height_m: f64, pitch_deg: f64, fov_deg: f64) -> Shot {
    Shot {
        pose: format!("4300,{height_m},300,-60,{pitch_deg}").parse().unwrap(),
        lens: Lens { fov_deg, width: SIZE.0, height: SIZE.1 },
        view_distance_m: 3000,
        // The same on the land through every lens: a fine grid is none of this suite's business.
        tolerance_px: 12.0 * 60.0 / fov_deg,
        time_s: 1.0,
        looks: Looks::default(),
    }
}

fn under_sun(shot: &Shot, elevation_deg: f32) -> Shot {
    // In the middle of the picture, so that its disc and its mirror image are met.
    let sun = Some(SunPlace { azimuth_deg: -60.0, elevation_deg });
    Shot { looks: Looks { sun, ..shot.looks }, ..*shot }
}

#[test]
fn every_pixel_has_a_light_under_every_sun_from_every_height_in_every_direction() {
    let Some(mut studio) = Studio::open() else { return };
    for height_m in [-30.0, 2.0, 20_000.0] {
        for pitch_deg in [-90.0, 0.0, 90.0] {
            for fov_deg in [1.0, 170.0] {
                let shot = shot(height_m, pitch_deg, fov_deg);
                for elevation_deg in [-90.0, -10.0, -1.0, 0.0, 1.0, 10.0, 45.0, 90.0] {
                    let frame = studio.frame(&under_sun(&shot, elevation_deg));
                    let unlit = studio.unlit(&frame);
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
fn every_pixel_has_a_light_whatever_relief_it_shows() {
    let Some(mut studio) = Studio::open() else { return };
    let land = shot(0.0, 0.0, 60.0);
    // Lying on a hill: level gazes skim the ground.
    for (height_m, pitch_deg) in [(189.4, 0.0), (189.4, -89.9), (192.0, -20.0)] {
        let pose = format!("300,{height_m},900,30,{pitch_deg}").parse().unwrap();
        for tier in
            [ReliefTier::Offset, ReliefTier::Linear, ReliefTier::Cones, ReliefTier::Pyramid, ReliefTier::Auto]
        {
            for (amplitude, steps, heights, shadow) in [
                (0.0, 1, Heights::Exact, ReliefShadow::Soft),
                (1e-6, 256, Heights::Sampler, ReliefShadow::Hard),
                (1.0, 1, Heights::Sampler, ReliefShadow::Soft),
                (16.0, 4, Heights::Exact, ReliefShadow::Hard),
            ] {
                let relief = ReliefKnobs {
                    tier,
                    amplitude,
                    steps_min: steps,
                    steps_max: steps,
                    heights,
                    shadow,
                    ..ReliefKnobs::default()
                };
                let frame = studio.frame(&Shot { pose, looks: Looks { relief, ..land.looks }, ..land });
                assert_eq!(studio.unlit(&frame), 0, "{pose} {relief:?}");
            }
        }
    }
}

#[test]
fn options_that_are_no_numbers_change_nothing_and_a_sun_that_is_none_is_seen() {
    let Some(mut studio) = Studio::open() else { return };
    let plain = shot(60.0, -10.0, 60.0);
    let odd = SunPlace { azimuth_deg: f32::NAN, elevation_deg: 30.0 };
    let looks = Looks { sun: Some(odd), exposure_ev: f32::NAN, ..plain.looks };
    let (frame, asked) = (studio.frame(&plain), studio.frame(&Shot { looks, ..plain }));
    assert_eq!((frame.uniforms.sun, frame.uniforms.exposure), (asked.uniforms.sun, asked.uniforms.exposure));
    assert_eq!(studio.unlit(&asked), 0);

    // The control: what gets past the options is found in the picture.
    let mut broken = frame;
    broken.uniforms.sun = [f32::NAN; 3];
    broken.uniforms.eye_height_m = f32::NAN;
    assert!(studio.unlit(&broken) > 100, "the control must fail");
}
