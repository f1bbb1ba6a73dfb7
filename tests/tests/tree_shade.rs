//! Shadows of trees on the GPU against rays through the same trees on the CPU.

use client::cache::ChunkCache;
use client::features::terrain::pool::ChunkPool;
use client::features::vegetation::renderer::VegetationRenderer;
use client::features::vegetation::tree_cells::TreeCells;
use client::features::vegetation::{PlantShadows, VegetationSettings};
use client::gpu::Gpu;
use client::gpu::bind::bind_numbered;
use client::lod::select;
use client::scene::Scene;
use client::settings::{RenderSettings, SunPosition};
use client::view::ViewParams;
use shaders::SHADERS;
use shaders::layout::SUN_RADIUS;
use shaders::twin::clump::{add, scaled};
use shaders::twin::crown::{Caster, crown_chord, crown_of, trunk_radius_m};
use terrain::hash::mix;
use terrain::{Land, lod};
use wgpu::BufferUsages as Usage;
use wgpu::util::DeviceExt as _;

const SLOTS: u32 = 1500;
/// Places that are compared, and how far they lie from the eye, metres.
const PLACES: u32 = 2000;
const NEAR_M: f32 = 90.0;
/// Difference of the share of the sun from which on a place is wrong.
const WRONG: f32 = 0.1;

type Vec3 = [f32; 3];

/// A wood around the eye, on the GPU.
struct Wood {
    gpu: Gpu,
    uniforms: wgpu::Buffer,
    trees: TreeCells,
    /// Places on the ground, metres from the eye.
    places: Vec<Vec3>,
    sun: Vec3,
}

fn wood(elevation_deg: f32, shadows: PlantShadows) -> Option<Wood> {
    let gpu = tests::open_gpu_or_skip()?;
    let plants = VegetationSettings { density: 0, trees: 3, shadows, ..VegetationSettings::STANDARD };
    let sun = Some(SunPosition { azimuth_deg: 205.0, elevation_deg });
    let view = tests::view_at("60,8,0,320,2", (160, 90), 1500, 4.0);
    let view = ViewParams { settings: RenderSettings { plants, sun, ..view.settings }, ..view };
    let land = Land::new(1);
    let mut world = ChunkCache::new(SLOTS);
    world.set_land(Land::new(1));
    for needed in lod::select(&land, &view.viewer(), usize::MAX) {
        world.insert(land.chunk(needed.key));
    }
    let eye = view.pose.eye();
    let view = ViewParams { pose: view.pose.above(world.ground(eye.units[0], eye.units[2])), ..view };
    let selection = select(&mut world, &view.viewer());
    let frame = view.frame(Scene::Island, &world, &selection);

    let pool = ChunkPool::new(&gpu.device, SLOTS);
    world.residents().for_each(|chunk| pool.upload(&gpu.queue, chunk));
    let uniforms = gpu.device.create_buffer_init(&wgpu::util::BufferInitDescriptor {
        label: Some("frame"),
        contents: bytemuck::bytes_of(&frame.uniforms),
        usage: Usage::UNIFORM | Usage::COPY_DST,
    });
    let trees = TreeCells::new(&gpu.device);
    let mut vegetation = VegetationRenderer::new(&gpu.device);
    let mut encoder = gpu.device.create_command_encoder(&wgpu::CommandEncoderDescriptor::default());
    let plants = frame.plants.as_ref().expect("the view has trees");
    vegetation.cull(&gpu, &uniforms, (&pool, &trees), 1, plants, &mut encoder);
    gpu.queue.submit([encoder.finish()]);

    let eye = view.pose.eye();
    let unit = |seed: u32| f64::from(mix(seed) >> 8) / f64::from(1 << 24);
    let places = (0..PLACES).map(|place| {
        let at = [0, 1].map(|axis| ((2.0 * unit(2 * place + axis) - 1.0) * f64::from(NEAR_M) * 256.0) as i32);
        let ground = world.ground(eye.units[0] + at[0], eye.units[2] + at[1]).expect("land around the eye");
        [at[0], ground - eye.units[1], at[1]].map(|units| units as f32 / 256.0)
    });
    Some(Wood { places: places.collect(), sun: frame.uniforms.sun, gpu, uniforms, trees })
}

impl Wood {
    /// What the shader leaves of the sun at each place.
    fn found(&self) -> Vec<f32> {
        let device = &self.gpu.device;
        let module = device.create_shader_module(wgpu::ShaderModuleDescriptor {
            label: Some("probe"),
            source: wgpu::ShaderSource::Wgsl(SHADERS.probe_tree_shade.wgsl.into()),
        });
        let pipeline = device.create_compute_pipeline(&wgpu::ComputePipelineDescriptor {
            label: Some("probe"),
            layout: None,
            module: &module,
            entry_point: None,
            compilation_options: wgpu::PipelineCompilationOptions::default(),
            cache: None,
        });
        let places: Vec<[f32; 4]> = self.places.iter().map(|[x, y, z]| [*x, *y, *z, 0.0]).collect();
        let input = device.create_buffer_init(&wgpu::util::BufferInitDescriptor {
            label: Some("places"),
            contents: bytemuck::cast_slice(&places),
            usage: Usage::STORAGE,
        });
        let output = device.create_buffer(&wgpu::BufferDescriptor {
            label: Some("shades"),
            size: 8 * places.len() as u64,
            usage: Usage::STORAGE | Usage::COPY_SRC,
            mapped_at_creation: false,
        });
        let buffers = [
            (0, &self.uniforms),
            (8, self.trees.cells()),
            (9, self.trees.marks()),
            (11, &input),
            (12, &output),
        ];
        let bindings = bind_numbered(device, "probe", &pipeline.get_bind_group_layout(0), &buffers);
        let mut encoder = device.create_command_encoder(&wgpu::CommandEncoderDescriptor::default());
        {
            let mut pass = encoder.begin_compute_pass(&wgpu::ComputePassDescriptor::default());
            pass.set_pipeline(&pipeline);
            pass.set_bind_group(0, &bindings, &[]);
            pass.dispatch_workgroups(PLACES.div_ceil(64), 1, 1);
        }
        self.gpu.queue.submit([encoder.finish()]);
        let bytes = self.gpu.read_buffer(&output, 0..output.size()).expect("the GPU works");
        let words: Vec<[f32; 2]> = bytemuck::pod_collect_to_vec(&bytes);
        words.iter().map(|[sun, _]| *sun).collect()
    }

    /// All trees that were placed, of every cell.
    fn casters(&self) -> Vec<Caster> {
        let cells = self.trees.cells();
        let bytes = self.gpu.read_buffer(cells, 0..cells.size()).expect("the GPU works");
        let words: Vec<[u32; 4]> = bytemuck::pod_collect_to_vec(&bytes);
        let trees = words[2..].iter().filter(|words| words[3] != 0);
        trees
            .map(|words| Caster {
                root_m: [0, 1, 2].map(|axis| f32::from_bits(words[axis])),
                width_m: (words[3] & 4095) as f32 / 128.0,
                height_m: (words[3] >> 12 & 4095) as f32 / 128.0,
                species: words[3] >> 24 & 3,
            })
            .collect()
    }
}

/// What a ray meets of a tree: the share that passes the crown, nothing behind the trunk.
fn ray_past(tree: &Caster, place: Vec3, toward: Vec3) -> f32 {
    let at_m = add(place, scaled(tree.root_m, -1.0));
    let crown = crown_of(tree);
    let passed = (-crown.density * crown_chord(&crown, at_m, toward)).exp();
    // Nearest to the axis.
    let flat = toward[0].hypot(toward[2]);
    let way = -(at_m[0] * toward[0] + at_m[2] * toward[2]) / (flat * flat);
    let beside = (at_m[0] + way * toward[0]).hypot(at_m[2] + way * toward[2]);
    let up = at_m[1] + way * toward[1];
    let is_trunk = way > 0.0 && beside < trunk_radius_m(tree) && (0.0..0.8 * tree.height_m).contains(&up);
    if is_trunk { 0.0 } else { passed }
}

/// The share of the sun's disc that all trees leave: 61 rays over it, each through every tree.
fn truth(trees: &[Caster], place: Vec3, sun: Vec3) -> f32 {
    let flat = sun[0].hypot(sun[2]);
    let side = [-sun[2] / flat, 0.0, sun[0] / flat];
    let above = [-sun[0] * sun[1] / flat, flat, -sun[2] * sun[1] / flat];
    // None of them is farther from the middle ray than any crown.
    let near: Vec<&Caster> = trees
        .iter()
        .filter(|tree| {
            let to = add(tree.root_m, scaled(place, -1.0));
            (to[0] * side[0] + to[2] * side[2]).abs() < 6.0
        })
        .collect();
    let rays = (0..61).map(|ray| {
        let (out, turn) = (((ray as f32 + 0.5) / 61.0).sqrt(), 2.399_963 * ray as f32);
        let aside = scaled(side, SUN_RADIUS as f32 * out * turn.cos());
        let toward = add(add(sun, aside), scaled(above, SUN_RADIUS as f32 * out * turn.sin()));
        let length = toward.iter().map(|part| part * part).sum::<f32>().sqrt();
        let toward = scaled(toward, 1.0 / length);
        near.iter().map(|tree| ray_past(tree, place, toward)).product::<f32>()
    });
    rays.sum::<f32>() / 61.0
}

/// The share of places where two shares of the sun differ.
fn wrong(found: &[f32], expected: &[f32]) -> f64 {
    let wrong = found.iter().zip(expected).filter(|(a, b)| (*a - *b).abs() > WRONG).count();
    wrong as f64 / found.len() as f64
}

#[test]
fn tree_shadows_agree_with_rays_through_all_trees() {
    for elevation_deg in [12.0, 30.0, 45.0, 70.0] {
        let Some(wood) = wood(elevation_deg, PlantShadows::On) else { return };
        let (found, trees) = (wood.found(), wood.casters());
        let at =
            |sun: Vec3| -> Vec<f32> { wood.places.iter().map(|place| truth(&trees, *place, sun)).collect() };
        let expected = at(wood.sun);
        let dark = expected.iter().filter(|sun| **sun < 0.5).count() as f64 / f64::from(PLACES);
        let share = wrong(&found, &expected);
        // Controls: the sun moved by 5 degrees, and no shadows.
        let turn = 5.0f32.to_radians();
        let [x, y, z] = wood.sun;
        let moved = at([x * turn.cos() - z * turn.sin(), y, x * turn.sin() + z * turn.cos()]);
        let control = wrong(&found, &moved);
        println!(
            "sun {elevation_deg} degrees, {} trees: {:.1} % of {PLACES} places in shadow, {:.2} % wrong; \
             sun moved by 5 degrees {:.1} %",
            trees.len(),
            100.0 * dark,
            100.0 * share,
            100.0 * control
        );
        assert!(dark > 0.05 && trees.len() > 100, "{dark} {}", trees.len());
        assert!(share <= 0.02, "{elevation_deg}: {share}");
        assert!(control > 0.02, "{elevation_deg}: {control}");
    }
}

#[test]
fn without_plant_shadows_all_places_have_the_whole_sun() {
    let Some(wood) = wood(30.0, PlantShadows::Off) else { return };
    assert!(wood.found().iter().all(|sun| *sun == 1.0));
    assert!(!wood.casters().is_empty(), "the trees are placed all the same");
}
