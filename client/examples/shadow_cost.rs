//! What the land's shadow costs: `cargo run -p client --example shadow_cost -- [CAMERA] [AZIMUTH]`.
//! For several heights of the sun, milliseconds of one chunk's casting and of one frame, and what
//! the vertices have come out as.

use client::camera::Lens;
use client::feed::LocalFeed;
use client::frame::Shot;
use client::looks::{Looks, SunPlace};
use client::render::pool::ChunkPool;
use client::render::{Canvas, Gpu, RenderOptions, Renderer, picture};
use client::scene::Scene;
use client::voyage::Voyage;
use shaders::layout::{GPU_SLOT_BYTES, clearance_of_byte};
use std::error::Error;
use std::time::{Duration, Instant};

/// Times are the least of so many: what disturbs only adds.
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
        format: picture::PICTURE_FORMAT,
        slots,
    };
    let mut renderer = Renderer::new(&gpu, &options);
    let canvas = Canvas::new(&gpu.device, width, height);
    let mut voyage = Voyage::new(LocalFeed::new(1), slots);
    println!("{}, {GPU_SLOT_BYTES} bytes a chunk, {width} x {height} pixels", gpu.name());
    for elevation_deg in [3.0, 8.0, 20.0, 43.0] {
        let sun =
            |repeat: u16| SunPlace { azimuth_deg: azimuth_deg + f32::from(repeat) * 0.01, elevation_deg };
        let (mut cast, mut draw) = (Duration::MAX, Duration::MAX);
        let (mut chunks, mut dark, mut partial, mut all) = (0, 0, 0, 0);
        for repeat in 0..=REPEATS {
            let shot = Shot {
                pose: camera,
                lens: Lens { fov_deg: 60.0, width, height },
                view_distance_m: 8000,
                tolerance_px: 2.0,
                time_s: 0.0,
                looks: Looks { sun: Some(sun(repeat)), ..Looks::default() },
            };
            let selection = loop {
                let selection =
                    voyage.update(&shot, Duration::ZERO, usize::MAX, |chunk| renderer.upload(&gpu, chunk));
                if voyage.is_settled() {
                    break selection;
                }
            };
            let frame = shot.frame(Scene::Island, voyage.world(), &selection);
            gpu.queue.submit([]);
            gpu.wait()?;
            let begun = Instant::now();
            renderer.finish_shadows(&gpu, &frame)?;
            cast = cast.min(begun.elapsed());
            let begun = Instant::now();
            let mut encoder = gpu.device.create_command_encoder(&wgpu::CommandEncoderDescriptor::default());
            renderer.draw(&gpu, &frame, &mut encoder, &canvas.view);
            gpu.queue.submit([encoder.finish()]);
            gpu.wait()?;
            draw = draw.min(begun.elapsed());
            if repeat < REPEATS {
                continue;
            }
            for seen in frame.candidates.iter().filter(|candidate| candidate.in_sight) {
                chunks += 1;
                for byte in renderer.pool().read_clearances(&gpu, seen.page.slot)? {
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
            "sun {elevation_deg:>4} deg: {chunks} chunks in {cast:.0} ms, {:.2} ms each; frame {draw:.0} ms; {:.1} % dark, {:.1} % in the penumbra",
            cast / f64::from(chunks.max(1)),
            percent(dark),
            percent(partial),
        );
    }
    Ok(())
}
