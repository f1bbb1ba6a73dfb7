//! Plants chosen by the CPU twin and drawn, over land without a server: what the passes that draw plants are looked at and timed with.
//!
//! `cargo run -p client --example meadow -- --scene grass --shot OUT.png [OPTIONS]` takes the viewer's own options. Environment: `EYE` (metres above the
//! ground), `DETAIL` (all grass at one level of detail). Prints how many clumps there are at each level and the least time of the pass that gathers
//! light, without and with them.

use anyhow::Context as _;
use clap::Parser as _;
use client::feed::LocalFeed;
use client::native::args::Args;
use client::plants::kept::{BySlot, kept_of};
use client::plants::{Cull, PlantFrame, Stand};
use client::render::grass::{KeptClumps, Plant};
use client::render::materials::OwnMaterials;
use client::render::{Canvas, Gpu, RenderOptions, Renderer, gpu, picture};
use client::voyage::Voyage;
use client::world::World;
use glam::Vec3;
use shaders::layout::KIND_GRASS;
use shaders::twin::surface::Surface;
use std::time::{Duration, Instant};
use wgpu::util::DeviceExt as _;

const SLOTS: u32 = 4000;

/// A number of the environment.
fn number<T: std::str::FromStr>(name: &str) -> Option<T> {
    std::env::var(name).ok()?.parse().ok()
}

fn main() -> anyhow::Result<()> {
    let args = Args::parse();
    let path = args.shot.clone().context("--shot FILE is missing: where the picture goes")?;
    let mut options = args.shot_options();
    // The twin finds what is hidden as the GPU does, but one clump after the other.
    options.looks.plants.cull = Cull::Frustum;
    let gpu = pollster::block_on(Gpu::open_with(gpu::instance(None), None, wgpu::Features::TIMESTAMP_QUERY))?;
    let size = (options.lens.width, options.lens.height);
    let mut voyage = Voyage::new(LocalFeed::new(1), SLOTS);
    let started = Instant::now();
    loop {
        let shot = options.shot(0, voyage.world());
        let selection = voyage.update(&shot, started.elapsed(), 64, |_| ());
        if voyage.is_settled() && selection.is_complete() {
            break;
        }
        anyhow::ensure!(started.elapsed() < Duration::from_secs(120), "the view did not fill in 2 minutes");
    }
    if let Some(above_m) = number::<f64>("EYE") {
        let units = options.pose.eye().units;
        let ground = voyage.world().ground(units[0], units[2]).map_or(0.0, f64::from);
        options.pose.position_m.y = ground / 256.0 + above_m;
    }
    let mut renderer = Renderer::with_materials(
        &gpu,
        &RenderOptions {
            scene: options.scene,
            size,
            samples: options.samples,
            format: picture::PICTURE_FORMAT,
            slots: SLOTS,
        },
        &OwnMaterials::default(),
    );
    voyage.world().residents().for_each(|chunk| renderer.upload(&gpu, chunk));
    let shot = options.shot(0, voyage.world());
    let selection = voyage.update(&shot, started.elapsed(), 0, |_| ());
    let frame = shot.frame(options.scene, voyage.world(), &selection);
    renderer.finish_shadows(&gpu, &frame)?;
    let canvas = Canvas::new(&gpu.device, size.0, size.1);
    let light_ms = |renderer: &mut Renderer| -> anyhow::Result<f64> {
        let mut times = Vec::new();
        for _ in 0..5 {
            let mut encoder = gpu.device.create_command_encoder(&wgpu::CommandEncoderDescriptor::default());
            renderer.draw(&gpu, &frame, &mut encoder, &canvas.view);
            gpu.queue.submit([encoder.finish()]);
            gpu.wait()?;
            times.push(renderer.pass_times(&gpu)?.context("the device has no clock")?.light_ns / 1e6);
        }
        Ok(times.into_iter().fold(f64::MAX, f64::min))
    };
    let mut told = format!("bare {:.0} ms", light_ms(&mut renderer)?);
    if let Some(plants) = shot.plants(voyage.world(), &selection.drawn) {
        for stand in &plants.stands {
            let (kept, counts) = buffers(&gpu.device, voyage.world(), &plants, stand);
            let plant = kept.plant;
            renderer.plant(&gpu, kept);
            told += &format!(", {plant:?} {counts:?}: {:.0} ms", light_ms(&mut renderer)?);
        }
    }
    println!("{told}");
    let picture = canvas.read(&gpu)?;
    image::save_buffer(path, &picture.rgba, picture.width, picture.height, image::ColorType::Rgba8)?;
    Ok(())
}

/// What is drawn of a stand, and how many clumps at each level of detail.
fn buffers(
    device: &wgpu::Device,
    world: &World,
    plants: &PlantFrame,
    stand: &Stand,
) -> (KeptClumps, Vec<u32>) {
    let plant = if stand.planting.kind == KIND_GRASS { Plant::Grass } else { Plant::Tree };
    let slots = BySlot::new(world);
    let (tiles, leaves) = (&plants.square.tiles, &plants.square.leaves);
    let surface = Surface { slots: &slots, tiles, leaves };
    let mut levels = vec![Vec::new(); plant.vertices().len()];
    for kept in kept_of(world, plants, stand) {
        let clump = kept.clump;
        // The slope over 2 m.
        let rise = |x: i32, z: i32| {
            (surface.height_at(clump.x + x, clump.z + z) - surface.height_at(clump.x - x, clump.z - z)) as f32
                / 8192.0
        };
        let normal = Vec3::new(-rise(4096, 0), 1.0, -rise(0, 4096)).normalize();
        let signed = |value: f32| ((value * 127.0).round() as i32 as u32) << 24;
        let forced = number::<usize>("DETAIL").filter(|_| plant == Plant::Grass);
        levels[forced.unwrap_or(kept.detail as usize)].push([
            clump.x as u32 | signed(normal.x),
            clump.z as u32 | signed(normal.z),
            clump.y as u32,
            clump.looks,
        ]);
    }
    let counts: Vec<u32> = levels.iter().map(|level| level.len() as u32).collect();
    let (mut clumps, mut regions, mut arguments) = (Vec::<[u32; 4]>::new(), Vec::new(), Vec::new());
    for (level, vertices) in levels.into_iter().zip(plant.vertices()) {
        let (first, count) = (clumps.len() as u32, level.len() as u32);
        clumps.extend(level);
        // An empty region could not be bound.
        clumps.push([0; 4]);
        regions.push(first..clumps.len() as u32);
        arguments.extend([*vertices, count, 0, 0]);
    }
    let buffer = |contents: &[u8], usage| {
        device.create_buffer_init(&wgpu::util::BufferInitDescriptor {
            label: Some("meadow"),
            contents,
            usage,
        })
    };
    let kept = KeptClumps {
        plant,
        field: buffer(bytemuck::bytes_of(&stand.field), wgpu::BufferUsages::UNIFORM),
        tiles: buffer(bytemuck::cast_slice(tiles), wgpu::BufferUsages::STORAGE),
        leaves: buffer(bytemuck::cast_slice(leaves), wgpu::BufferUsages::STORAGE),
        clumps: buffer(bytemuck::cast_slice(&clumps), wgpu::BufferUsages::VERTEX),
        regions,
        arguments: buffer(bytemuck::cast_slice(&arguments), wgpu::BufferUsages::INDIRECT),
        arguments_at: 0,
    };
    (kept, counts)
}
