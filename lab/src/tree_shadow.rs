//! Shadows of trees on the GPU against rays through the same trees on the CPU.

use crate::probe_pass;
use crate::world_builder::WorldBuilder;
use client::cache::ChunkCache;
use client::camera::{Eye, Projection};
use client::features::terrain::pool::ChunkPool;
use client::features::vegetation::renderer::VegetationRenderer;
use client::features::vegetation::tree_cells::TreeCells;
use client::features::vegetation::{PlantShadows, VegetationSettings};
use client::gpu::bind::bind_numbered;
use client::gpu::buffer::create_buffer;
use client::gpu::pipeline::compute_pass;
use client::gpu::{Gpu, GpuError};
use client::lod::select;
use client::scene::Scene;
use client::settings::{RenderSettings, SunPosition};
use client::view::ViewParams;
use shaders::SHADERS;
use shaders::layout::SUN_RADIUS;
use shaders::twin::clump::{add, scaled};
use shaders::twin::crown::{Caster, crown_chord, crown_of, trunk_radius_m};
use terrain::Land;
use terrain::hash::mix;
use wgpu::BufferUsages as Usage;

const SLOTS: u32 = 1500;

/// Places that are compared, and how far they lie from the middle of their square along either
/// axis, metres.
pub const PLACES: u32 = 8000;
const HALF_M: f32 = 90.0;

/// Lines of a picture whose far trees are known one by one, and how far away the middle of the
/// square lies then, metres.
const FAR_LINES: u32 = 1080;
const FAR_M: [f32; 3] = [700.0, 850.0, 1000.0];

/// Trees that far from the middle of the square cast no shadow in it, metres.
const CASTS_M: f32 = 300.0;

/// Difference of the share of the sun from which on a place, or the mean of a block, is wrong.
pub const WRONG: f32 = 0.1;

/// Blocks along a side of the square of places: 30 m wide. Where trees are not known one by one,
/// the mean of a block is what shadows can be compared by.
const BLOCKS: usize = 6;

/// A vector, metres or unit.
pub type Vec3 = [f32; 3];

/// A wood around the eye, on the GPU.
#[derive(Debug)]
pub struct Wood {
    gpu: Gpu,
    world: ChunkCache,
    eye: Eye,
    middle_m: [f32; 2],
    uniforms: wgpu::Buffer,
    trees: TreeCells,
    /// Places on the ground, metres from the eye.
    pub places: Vec<Vec3>,
    normals: Vec<Vec3>,
    /// Direction of the sun, unit.
    pub sun: Vec3,
}

/// Share of the sun that the shader leaves at a place.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Shade {
    /// By the trees that are known one by one.
    pub near: f32,
    /// By the share of woods, as far away.
    pub far: f32,
}

impl Wood {
    /// The wood at a sun of this elevation, on `gpu`.
    ///
    /// # Panics
    /// The view has no trees.
    #[must_use]
    pub fn open(gpu: Gpu, elevation_deg: f32, shadows: PlantShadows) -> Self {
        let mut wood = Self::placed(gpu, elevation_deg, shadows, (90, 1500));
        wood.look_at([0.0; 2]);
        wood
    }

    /// The densest square of the wood 700 m to 1,000 m away, in a picture of 1,080 lines.
    ///
    /// # Errors
    /// The GPU failed.
    ///
    /// # Panics
    /// The view has no trees.
    pub fn open_far(gpu: Gpu, elevation_deg: f32) -> Result<Self, GpuError> {
        let mut wood = Self::placed(gpu, elevation_deg, PlantShadows::On, (FAR_LINES, 2000));
        let trees = wood.placed_trees()?;
        let middles = FAR_M.iter().flat_map(|far_m| {
            (0..24).map(move |turn| {
                let (sin, cos) = (turn as f32 * std::f32::consts::TAU / 24.0).sin_cos();
                [far_m * cos, far_m * sin]
            })
        });
        let count = |middle: &[f32; 2]| trees.iter().filter(|tree| is_within(tree, *middle, HALF_M)).count();
        let densest = middles.max_by_key(count).expect("there are squares");
        wood.look_at(densest);
        Ok(wood)
    }

    /// The trees of a view of so many lines and metres, without places.
    fn placed(
        gpu: Gpu,
        elevation_deg: f32,
        shadows: PlantShadows,
        (lines, view_distance_m): (u32, u32),
    ) -> Self {
        let plants = VegetationSettings { density: 0, trees: 3, shadows, ..VegetationSettings::STANDARD };
        let sun = Some(SunPosition { azimuth_deg: 205.0, elevation_deg });
        let view = ViewParams {
            pose: "60,8,0,320,2".parse().expect("a pose"),
            projection: Projection { fov_deg: 60.0, width: lines * 16 / 9, height: lines },
            view_distance_m,
            // Places and trees stand on the same land, however coarse.
            tolerance_px: f64::from(lines) / 22.5,
            time_s: 0.0,
            settings: RenderSettings { plants, sun, ..RenderSettings::default() },
        };
        let mut world = WorldBuilder::new(Land::new(1)).world(&view.viewer(), SLOTS, |_| true);
        let eye = view.pose.eye();
        let view = ViewParams { pose: view.pose.above(world.ground(eye.units[0], eye.units[2])), ..view };
        let selection = select(&mut world, &view.viewer());
        let frame = view.frame(Scene::Island, &world, &selection);

        let pool = ChunkPool::new(&gpu.device, SLOTS);
        world.residents().for_each(|chunk| pool.upload(&gpu.queue, chunk));
        let uniforms = probe_pass::filled(&gpu, bytemuck::bytes_of(&frame.uniforms), Usage::UNIFORM);
        let trees = TreeCells::new(&gpu.device);
        let mut vegetation = VegetationRenderer::new(&gpu.device);
        let mut encoder = gpu.device.create_command_encoder(&wgpu::CommandEncoderDescriptor::default());
        let plants = frame.plants.as_ref().expect("the view has trees");
        vegetation.cull(&gpu, &uniforms, (&pool, &trees), 1, plants, &mut encoder);
        gpu.queue.submit([encoder.finish()]);

        Self {
            eye: view.pose.eye(),
            middle_m: [0.0; 2],
            places: Vec::new(),
            normals: Vec::new(),
            sun: frame.uniforms.sun,
            world,
            gpu,
            uniforms,
            trees,
        }
    }

    /// Chooses the places: in the square around a point, metres east and south of the eye.
    fn look_at(&mut self, middle_m: [f32; 2]) {
        let eye = &self.eye;
        let unit = |seed: u32| f64::from(mix(seed) >> 8) / f64::from(1 << 24);
        let ground = |at: [i32; 2]| {
            self.world.ground(eye.units[0] + at[0], eye.units[2] + at[1]).expect("land around the eye")
        };
        let at: Vec<[i32; 2]> = (0..PLACES)
            .map(|place| {
                let aside = |axis: u32| (2.0 * unit(2 * place + axis) - 1.0) * f64::from(HALF_M);
                [0, 1].map(|axis| ((f64::from(middle_m[axis as usize]) + aside(axis)) * 256.0) as i32)
            })
            .collect();
        let places =
            at.iter().map(|at| [at[0], ground(*at) - eye.units[1], at[1]].map(|units| units as f32 / 256.0));
        // Slopes over 4 m, as those of clumps.
        let normals = at.iter().map(|[x, z]| {
            let slope = |east: i32, south: i32| {
                (ground([x - east, z - south]) - ground([x + east, z + south])) as f32 / 1024.0
            };
            let normal = [slope(512, 0), 1.0, slope(0, 512)];
            scaled(normal, 1.0 / normal.iter().map(|part| part * part).sum::<f32>().sqrt())
        });
        let (places, normals) = (places.collect(), normals.collect());
        (self.places, self.normals, self.middle_m) = (places, normals, middle_m);
    }

    /// Share of the sun that the shader leaves at each place.
    ///
    /// # Errors
    /// The GPU failed.
    pub fn found(&self) -> Result<Vec<Shade>, GpuError> {
        let device = &self.gpu.device;
        let pipeline = probe_pass::pipeline(&self.gpu, &SHADERS.probe_tree_shade, None);
        let words = self.places.iter().zip(&self.normals);
        let places: Vec<[f32; 4]> =
            words.flat_map(|(at, normal)| [*at, *normal].map(|[x, y, z]| [x, y, z, 0.0])).collect();
        let input = probe_pass::filled(&self.gpu, bytemuck::cast_slice(&places), Usage::STORAGE);
        let bytes = 16 * self.places.len() as u64;
        let output = create_buffer(device, "shades", bytes, Usage::STORAGE | Usage::COPY_SRC);
        let (cells, marks) = (self.trees.cells(), self.trees.marks());
        let buffers = [(0, &self.uniforms), (8, cells), (9, marks), (11, &input), (12, &output)];
        let bindings = bind_numbered(device, "probe", &pipeline.get_bind_group_layout(0), &buffers);
        let mut encoder = device.create_command_encoder(&wgpu::CommandEncoderDescriptor::default());
        let mut pass = compute_pass(&mut encoder, "shades");
        pass.set_pipeline(&pipeline);
        pass.set_bind_group(0, &bindings, &[]);
        pass.dispatch_workgroups(PLACES.div_ceil(64), 1, 1);
        drop(pass);
        self.gpu.queue.submit([encoder.finish()]);
        let bytes = self.gpu.read_buffer(&output, 0..output.size())?;
        let words: Vec<[f32; 4]> = bytemuck::pod_collect_to_vec(&bytes);
        Ok(words.iter().map(|[near, _, far, _]| Shade { near: *near, far: *far }).collect())
    }

    /// The trees that were placed and may cast a shadow on a place.
    ///
    /// # Errors
    /// The GPU failed.
    pub fn casters(&self) -> Result<Vec<Caster>, GpuError> {
        let mut trees = self.placed_trees()?;
        trees.retain(|tree| is_within(tree, self.middle_m, HALF_M + CASTS_M));
        Ok(trees)
    }

    /// All trees that were placed, of every cell.
    fn placed_trees(&self) -> Result<Vec<Caster>, GpuError> {
        let cells = self.trees.cells();
        let bytes = self.gpu.read_buffer(cells, 0..cells.size())?;
        let words: Vec<[u32; 4]> = bytemuck::pod_collect_to_vec(&bytes);
        let side = words[1][2] as usize;
        let trees = words[2..][..4 * side * side].iter().filter(|words| words[3] != 0);
        let casters = trees.map(|words| Caster {
            root_m: [0, 1, 2].map(|axis| f32::from_bits(words[axis])),
            // Steps of `SHAPE_STEPS` in `shared/tree_cells.wesl`.
            width_m: (words[3] & 4095) as f32 / 64.0,
            height_m: (words[3] >> 12 & 4095) as f32 / 64.0,
            species: words[3] >> 24 & 3,
        });
        Ok(casters.collect())
    }

    /// The truth at each place, at a sun.
    #[must_use]
    pub fn truth(&self, trees: &[Caster], sun: Vec3) -> Vec<f32> {
        self.places.iter().map(|place| truth(trees, *place, sun)).collect()
    }

    /// Means of the blocks of places of a value of each.
    #[must_use]
    pub fn block_means(&self, values: &[f32]) -> Vec<f32> {
        let mut sums = [(0.0, 0.0); BLOCKS * BLOCKS];
        for (place, value) in self.places.iter().zip(values) {
            let [east, south] = [place[0] - self.middle_m[0], place[2] - self.middle_m[1]];
            let block = |at: f32| (((at / HALF_M + 1.0) * 0.5 * BLOCKS as f32) as usize).min(BLOCKS - 1);
            let sum = &mut sums[block(south) * BLOCKS + block(east)];
            *sum = (sum.0 + value, sum.1 + 1.0);
        }
        sums.iter().map(|(sum, count)| sum / f32::max(*count, 1.0)).collect()
    }
}

/// Whether a tree stands in a square around a point, metres from the eye.
fn is_within(tree: &Caster, middle_m: [f32; 2], half_m: f32) -> bool {
    (tree.root_m[0] - middle_m[0]).abs() < half_m && (tree.root_m[2] - middle_m[1]).abs() < half_m
}

/// Transmittance of a tree along a ray: the share that passes the crown, 0 behind the trunk.
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
    // Crowns reach less than 6 m, and rays of the disc climb at most 0.02 less than the middle one
    // up to 60 degrees: no other tree is met by any of them.
    let climb = sun[1] / flat - 0.02;
    let near: Vec<&Caster> = trees
        .iter()
        .filter(|tree| {
            let to = add(tree.root_m, scaled(place, -1.0));
            let along = (to[0] * sun[0] + to[2] * sun[2]) / flat;
            let is_beside = (to[0] * side[0] + to[2] * side[2]).abs() >= 6.0;
            !is_beside && along > -6.0 && to[1] + tree.height_m + 1.0 > (along - 6.0) * climb
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

/// The sun turned by 5 degrees: the control.
#[must_use]
pub fn turned([x, y, z]: Vec3) -> Vec3 {
    let turn = 5.0f32.to_radians();
    [x * turn.cos() - z * turn.sin(), y, x * turn.sin() + z * turn.cos()]
}

/// The share of values that differ by more than [`WRONG`].
#[must_use]
pub fn wrong(found: &[f32], expected: &[f32]) -> f64 {
    let wrong = found.iter().zip(expected).filter(|(a, b)| (*a - *b).abs() > WRONG).count();
    wrong as f64 / found.len().max(1) as f64
}
