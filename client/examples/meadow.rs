//! Plants around the eye, scattered by the CPU over land without a server: what the passes that draw plants are looked at and timed with.
//!
//! `cargo run -p client --example meadow -- --shot OUT.png [OPTIONS]` takes the viewer's own options. Environment: `GRASS` and `TREES` (per square
//! metre), `WIND` and `LEAN` (0 to 1), `LEVEL` (all grass at one level of detail),
//! `EYE` (metres above the ground). Times are printed with the number of clumps.

use anyhow::Context as _;
use bytemuck::Zeroable as _;
use clap::Parser as _;
use client::camera::Eye;
use client::feed::LocalFeed;
use client::native::args::Args;
use client::render::grass::{KeptClumps, Plant, eye_fine};
use client::render::materials::OwnMaterials;
use client::render::{Canvas, Gpu, RenderOptions, Renderer, gpu, picture};
use client::voyage::Voyage;
use client::world::World;
use glam::Vec3;
use shaders::layout::{FINE_PER_METRE, Field};
use shaders::twin::field::{field_keeps, field_level};
use std::time::{Duration, Instant};
use terrain::ChunkKey;
use terrain::constants::{CELLS, VERTICES};
use terrain::hash::{hash2, mix};
use wgpu::util::DeviceExt as _;

/// Side of the square that clumps stand in, units, and what its corner is a multiple of.
const SQUARE: i32 = 4096 << 8;
const CORNER: i32 = 128 << 8;

fn main() -> anyhow::Result<()> {
    let args = Args::parse();
    let path = args.shot.clone().context("--shot FILE is missing: where the picture goes")?;
    let mut options = args.shot_options();
    let gpu = pollster::block_on(Gpu::open_with(gpu::instance(None), None, wgpu::Features::TIMESTAMP_QUERY))?;
    let size = (options.lens.width, options.lens.height);
    let mut voyage = Voyage::new(LocalFeed::new(1), 4000);
    let started = Instant::now();
    let shot = loop {
        let shot = options.shot(0, voyage.world());
        let selection = voyage.update(&shot, started.elapsed(), 64, |_| ());
        if voyage.is_settled() && selection.is_complete() {
            break options.shot(0, voyage.world());
        }
        anyhow::ensure!(started.elapsed() < Duration::from_secs(120), "the view did not fill");
    };
    let slots = 4000;
    let mut renderer = Renderer::with_materials(
        &gpu,
        &RenderOptions {
            scene: options.scene,
            size,
            samples: options.samples,
            format: picture::PICTURE_FORMAT,
            slots,
        },
        &OwnMaterials::default(),
    );
    voyage.world().residents().for_each(|chunk| renderer.upload(&gpu, chunk));
    if let Some(above_m) = std::env::var("EYE").ok().and_then(|text| text.parse::<f64>().ok()) {
        let units = shot.pose.eye().units;
        options.pose.position_m.y =
            voyage.world().ground(units[0], units[2]).map_or(0.0, f64::from) / 256.0 + above_m;
    }
    let shot = options.shot(0, voyage.world());
    let selection = voyage.update(&shot, started.elapsed(), usize::MAX, |_| ());
    let frame = shot.frame(options.scene, voyage.world(), &selection);
    renderer.finish_shadows(&gpu, &frame)?;
    let canvas = Canvas::new(&gpu.device, size.0, size.1);
    let light_ms = |renderer: &mut Renderer| -> anyhow::Result<f64> {
        let mut times = Vec::new();
        for _ in 0..7 {
            let mut encoder = gpu.device.create_command_encoder(&wgpu::CommandEncoderDescriptor::default());
            renderer.draw(&gpu, &frame, &mut encoder, &canvas.view);
            gpu.queue.submit([encoder.finish()]);
            gpu.wait()?;
            times.push(renderer.pass_times(&gpu)?.context("no clock")?.light_ns / 1e6);
        }
        times.sort_by(f64::total_cmp);
        Ok(times[3])
    };
    let bare_ms = light_ms(&mut renderer)?;

    let number = |name: &str, standard: f32| -> f32 {
        std::env::var(name).ok().and_then(|text| text.parse().ok()).unwrap_or(standard)
    };
    let eye = frame.eye;
    let grass = Field {
        width_low_m: 0.12,
        width_high_m: 0.26,
        height_low_m: 0.22,
        height_high_m: 0.60,
        thin_from_m: 9.0,
        widest: 8.0,
        range_m: 180.0,
        collapse_m: 50.0,
        lod_m: [12.0, 40.0],
        wind: number("WIND", 0.5),
        lean: number("LEAN", 0.6),
        ..field_of(&eye, Plant::Grass)
    };
    let trees = Field {
        width_low_m: 3.0,
        width_high_m: 5.5,
        height_low_m: 6.0,
        height_high_m: 14.0,
        thin_from_m: 400.0,
        widest: 2.0,
        range_m: 1400.0,
        collapse_m: 200.0,
        lod_m: [80.0, 1e9],
        ..field_of(&eye, Plant::Tree)
    };
    let forward = Vec3::from(frame.uniforms.ray_forward);
    let mut told = format!("bare {bare_ms:.1} ms");
    for (plant, field, per_m2) in
        [(Plant::Grass, grass, number("GRASS", 20.0)), (Plant::Tree, trees, number("TREES", 0.004))]
    {
        if per_m2 <= 0.0 {
            continue;
        }
        let forced = (plant == Plant::Grass).then(|| number("LEVEL", -1.0)).filter(|level| *level >= 0.0);
        let clumps = scatter(voyage.world(), &eye, forward, &field, per_m2, forced.map(|level| level as u32));
        renderer.plant(&gpu, buffers(&gpu.device, plant, &field, &clumps));
        let counts: Vec<usize> = clumps.iter().map(Vec::len).collect();
        told += &format!(", {plant:?} {counts:?}: {:.1} ms", light_ms(&mut renderer)?);
    }
    println!("{told}");
    let picture = canvas.read(&gpu)?;
    image::save_buffer(path, &picture.rgba, picture.width, picture.height, image::ColorType::Rgba8)?;
    Ok(())
}

/// Low corner of the square around the eye, units.
fn corner(eye: &Eye) -> (i32, i32) {
    let low = |units: i32| (units - SQUARE / 2).div_euclid(CORNER) * CORNER;
    (low(eye.units[0]), low(eye.units[2]))
}

fn field_of(eye: &Eye, plant: Plant) -> Field {
    let [eye_x, eye_y, eye_z] = eye_fine(eye, corner(eye));
    Field { eye_x, eye_y, eye_z, kind: plant.kind(), ..Field::zeroed() }
}

/// Clumps for each level of detail: on a jittered grid, where the grass record says so, in front of the eye.
fn scatter(
    world: &World,
    eye: &Eye,
    forward: Vec3,
    field: &Field,
    per_m2: f32,
    forced: Option<u32>,
) -> Vec<Vec<[u32; 4]>> {
    let mut levels = vec![Vec::new(); 3];
    let cell_fine = ((FINE_PER_METRE as f32) / per_m2.sqrt()) as i32;
    let reach = (field.range_m * FINE_PER_METRE as f32) as i32 / cell_fine + 1;
    let (corner_x, corner_z) = corner(eye);
    let mut heights: std::collections::HashMap<ChunkKey, Option<&[i32; 4225]>> = Default::default();
    for row in -reach..=reach {
        for column in -reach..=reach {
            let cell = (field.eye_x.div_euclid(cell_fine) + column, field.eye_z.div_euclid(cell_fine) + row);
            let seed = hash2(field.kind * 77 + 5, cell.0, cell.1);
            let place = |cell: i32, word: u32| {
                cell * cell_fine + ((u64::from(mix(word)) * cell_fine as u64) >> 32) as i32
            };
            let (x, z) = (place(cell.0, seed), place(cell.1, seed ^ 0x55));
            let rank = mix(seed ^ 0x77) >> 24;
            let across = [x - field.eye_x, z - field.eye_z].map(|fine| fine as f32 / FINE_PER_METRE as f32);
            let level_m = across[0].hypot(across[1]);
            if !field_keeps(field, rank, level_m) {
                continue;
            }
            // World units, then the drawn triangle of the finest chunk.
            let units = (corner_x + (x >> 4), corner_z + (z >> 4));
            let key = ChunkKey::containing(0, units.0, units.1);
            let Some(heights) =
                *heights.entry(key).or_insert_with(|| world.get(key).map(|chunk| &*chunk.heights))
            else {
                continue;
            };
            let (low_x, low_z) = key.origin();
            // Within the chunk, in cells.
            let local = |corner: i32, fine: i32, low: i32| {
                (f64::from(corner - low) * 16.0 + f64::from(fine)) / f64::from(2 * FINE_PER_METRE)
            };
            let (u, v) = (local(corner_x, x, low_x), local(corner_z, z, low_z));
            let (column, row) = ((u as usize).min(CELLS - 1), (v as usize).min(CELLS - 1));
            let (fu, fv) = (u - column as f64, v - row as f64);
            let at = |dx: usize, dz: usize| f64::from(heights[(row + dz) * VERTICES + column + dx]) / 256.0;
            let (low, high) = (at(0, 0), at(1, 1));
            let (east, south) =
                if fu >= fv { (at(1, 0) - low, high - at(1, 0)) } else { (high - at(0, 1), at(0, 1) - low) };
            let y_m = low + east * fu + south * fv;
            let normal = Vec3::new(-(east / 2.0) as f32, 1.0, -(south / 2.0) as f32).normalize();
            if y_m < 3.0 || normal.y < 0.75 {
                continue;
            }
            let offset = Vec3::new(
                across[0],
                (y_m - f64::from(field.eye_y) / f64::from(FINE_PER_METRE)) as f32,
                across[1],
            );
            let distance_m = offset.length();
            let behind = offset.dot(forward) < -2.0 - field.height_high_m;
            if behind
                || offset.dot(forward) < 0.45 * distance_m - 6.0
                || !field_keeps(field, rank, distance_m)
            {
                continue;
            }
            let snorm = |value: f32| ((value * 127.0).round() as i32 as u32) << 24;
            let level = forced.unwrap_or_else(|| field_level(field, distance_m));
            levels[level as usize].push([
                x as u32 | snorm(normal.x),
                z as u32 | snorm(normal.z),
                (y_m * f64::from(FINE_PER_METRE)).round() as i32 as u32,
                (mix(seed ^ 0x99) & 0xff_ffff) | (rank << 24),
            ]);
        }
    }
    levels
}

fn buffers(device: &wgpu::Device, plant: Plant, field: &Field, levels: &[Vec<[u32; 4]>]) -> KeptClumps {
    let (mut clumps, mut regions, mut arguments) = (Vec::<[u32; 4]>::new(), Vec::new(), Vec::new());
    for (level, vertices) in levels.iter().zip(plant.vertices()) {
        let first = clumps.len() as u32;
        clumps.extend(level);
        // An empty region could not be bound.
        clumps.push([0; 4]);
        regions.push(first..clumps.len() as u32);
        arguments.extend([*vertices, level.len() as u32, 0, 0]);
    }
    let buffer = |contents: &[u8], usage| {
        device.create_buffer_init(&wgpu::util::BufferInitDescriptor {
            label: Some("meadow"),
            contents,
            usage,
        })
    };
    KeptClumps {
        plant,
        field: buffer(bytemuck::bytes_of(field), wgpu::BufferUsages::UNIFORM),
        clumps: buffer(bytemuck::cast_slice(&clumps), wgpu::BufferUsages::VERTEX),
        regions,
        arguments: buffer(bytemuck::cast_slice(&arguments), wgpu::BufferUsages::INDIRECT),
    }
}
