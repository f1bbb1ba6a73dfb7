//! Cost of terrain shadows:
//! `cargo run -p tombolo-client --example shadow_cost -- [CAMERA] [AZIMUTH]`. For several heights
//! of the sun, milliseconds of tracing one chunk and of one frame, and the shares of dark and
//! penumbra vertices.

use client::camera::Projection;
use client::features::terrain::pool::ChunkPool;
use client::features::terrain_clipmap::window::STANDARD_TEXELS;
use client::gpu::{Gpu, OffscreenTarget, offscreen};
use client::renderer::{RenderOptions, Renderer};
use client::scene::Scene;
use client::settings::{RenderSettings, SunPosition};
use client::stream::LocalStream;
use client::stream::streamer::WorldStreamer;
use client::view::ViewParams;
use shaders::layout::{GPU_SLOT_BYTES, clearance_of_byte};
use std::error::Error;
use std::time::{Duration, Instant};

/// Repetitions; the minimum counts, because disturbances only add time.
const REPEATS: u16 = 3;

fn main() -> Result<(), Box<dyn Error>> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let camera = arguments.first().map_or("300,420,900,20,-12", String::as_str).parse()?;
    let azimuth_deg: f32 = arguments.get(1).map_or(Ok(130.0), |azimuth| azimuth.parse())?;
    let gpu = Gpu::open_blocking()?;
    let (width, height) = (640, 360);
    let slots = ChunkPool::slots_within(&gpu.device.limits(), 4000);
    let options = RenderOptions {
        scene: Scene::Island,
        size: (width, height),
        samples: 1,
        anisotropy: 1,
        format: offscreen::IMAGE_FORMAT,
        slots,
        clipmap_texels: STANDARD_TEXELS,
    };
    let mut renderer = Renderer::new(&gpu, &options);
    let target = OffscreenTarget::new(&gpu.device, width, height);
    let mut streamer = WorldStreamer::new(LocalStream::new(1), slots);
    println!("{}, {GPU_SLOT_BYTES} bytes a chunk, {width} x {height} pixels", gpu.name());
    for elevation_deg in [3.0, 8.0, 20.0, 43.0] {
        let sun =
            |repeat: u16| SunPosition { azimuth_deg: azimuth_deg + f32::from(repeat) * 0.01, elevation_deg };
        let (mut cast, mut draw) = (Duration::MAX, Duration::MAX);
        let (mut chunks, mut dark, mut partial, mut all) = (0, 0, 0, 0);
        for repeat in 0..=REPEATS {
            let view = ViewParams {
                pose: camera,
                projection: Projection { fov_deg: 60.0, width, height },
                view_distance_m: 8000,
                tolerance_px: 2.0,
                time_s: 0.0,
                settings: RenderSettings { sun: Some(sun(repeat)), ..RenderSettings::default() },
            };
            let selection = loop {
                let selection =
                    streamer.update(&view, Duration::ZERO, usize::MAX, |chunk| renderer.upload(&gpu, chunk));
                if streamer.is_settled() {
                    break selection;
                }
            };
            let frame = view.frame(Scene::Island, streamer.cache(), &selection);
            gpu.queue.submit([]);
            gpu.wait()?;
            let begun = Instant::now();
            renderer.finish_shading(&gpu, &frame)?;
            cast = cast.min(begun.elapsed());
            let begun = Instant::now();
            let mut encoder = gpu.device.create_command_encoder(&wgpu::CommandEncoderDescriptor::default());
            renderer.draw(&gpu, &frame, &mut encoder, &target.view);
            gpu.queue.submit([encoder.finish()]);
            gpu.wait()?;
            draw = draw.min(begun.elapsed());
            if repeat < REPEATS {
                continue;
            }
            for seen in frame.candidates.iter().filter(|candidate| candidate.is_visible) {
                chunks += 1;
                for byte in renderer.pool().read_sun_clearances(&gpu, seen.page.slot)? {
                    let clearance = clearance_of_byte(byte);
                    dark += u32::from(clearance <= -1.0);
                    partial += u32::from(clearance.abs() < 1.0);
                    all += 1u32;
                }
            }
        }
        let percent = |count: u32| 100.0 * f64::from(count) / f64::from(all.max(1));
        let (cast, draw) = (cast.as_secs_f64() * 1e3, draw.as_secs_f64() * 1e3);
        println!(
            "sun {elevation_deg:>4} deg: {chunks} chunks in {cast:.0} ms, {:.2} ms each; frame \
             {draw:.0} ms; {:.1} % dark, {:.1} % in the penumbra",
            cast / f64::from(chunks.max(1)),
            percent(dark),
            percent(partial),
        );
    }
    Ok(())
}
