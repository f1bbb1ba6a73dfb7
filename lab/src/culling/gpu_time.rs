//! Time of culling and drawing a million clumps at 1920 x 1080, by the GPU's own clock where it has
//! one: the passes of the viewer over a meadow seen from above, with its four samples per pixel.
//!
//! The plants are drawn into an empty picture: no land hides a part of them, so the figure is no
//! lower than that of a frame.

use crate::culling::cases::Case;
use crate::culling::id_buffer::frame_of;
use crate::culling::scene::Scene;
use crate::stats::median;
use anyhow::{Context, Result, ensure};
use client::features::terrain::pool::ChunkPool;
use client::features::vegetation::renderer::VegetationRenderer;
use client::features::vegetation::tree_cells::TreeCells;
use client::features::vegetation::{Cull, VegetationSettings};
use client::frame::FrameData;
use client::gpu::buffer::create_buffer;
use client::gpu::targets::Targets;
use client::gpu::timestamps::{Ticks, Timestamps};
use client::gpu::{self, Gpu};
use serde::Serialize;
use std::time::Instant;
use terrain::Land;
use wgpu::BufferUsages as Usage;

/// Clumps drawn, at least.
pub const CLUMPS: u64 = 1_000_000;

/// The timed pass.
#[derive(Clone, Copy, Debug)]
struct Plan {
    /// Size of the picture, pixels.
    size: (u32, u32),
    /// Clumps drawn, at least.
    clumps: u64,
    /// Ranges of grass without thinning, metres; the first that shows so many clumps is taken.
    ranges_m: &'static [f32],
    /// Frames timed after the first, on a GPU and on a software adapter; the median counts.
    frames: [usize; 2],
}

/// The bar's.
const PLAN: Plan = Plan {
    size: (1920, 1080),
    clumps: CLUMPS,
    ranges_m: &[400.0, 550.0, 700.0, 900.0, 1200.0, 1600.0],
    frames: [31, 1],
};

/// Samples per pixel: the viewer's own.
const SAMPLES: u32 = 4;

/// Slots of the pool.
const SLOTS: u32 = 2000;

/// Height of the eye above the start of the scene `grass`, metres, and its pitch, degrees: the
/// ground hides few clumps.
const ABOVE_M: f64 = 40.0;
const PITCH_DEG: f64 = -14.0;

/// Clumps of grass on a cell: as many as the settings allow, and the control's share of them.
const DENSITIES: [u32; 2] = [VegetationSettings::MAX_DENSITY, VegetationSettings::MAX_DENSITY / 8];

/// Times of a million clumps. Field names are a contract with scripts.
#[derive(Clone, Debug, Serialize)]
pub struct GpuTime {
    pub adapter: String,
    pub is_software: bool,
    /// Pixels across and down.
    pub size: (u32, u32),
    pub samples: u32,
    /// Range of the grass, metres.
    pub range_m: f32,
    /// Clumps that pass the frustum test alone.
    pub in_view: u64,
    pub full: Timed,
    /// With an eighth of the grass: the control.
    pub sparse: Timed,
}

/// Medians over frames, milliseconds.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct Timed {
    /// Clumps drawn.
    pub clumps: u64,
    /// By the GPU's clock; none if it has none.
    pub passes: Option<Passes>,
    /// Until the GPU was done, as the program sees it; submission included.
    pub program_ms: f64,
    /// That of the GPU's clock, else of the program's.
    pub whole_ms: f64,
}

/// Times by the GPU's clock, milliseconds.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct Passes {
    pub cull_ms: f64,
    pub draw_ms: f64,
    /// From the begin of the culling to the end of the drawing.
    pub whole_ms: f64,
}

/// Times the meadow of the scene `grass` with enough grass.
///
/// # Errors
/// There is no GPU, it failed, its clock stands still, or no range shows enough clumps.
pub fn measure(land: &Land) -> Result<GpuTime> {
    measure_plan(land, &PLAN)
}

fn measure_plan(land: &Land, plan: &Plan) -> Result<GpuTime> {
    let mut bench = Bench::open(plan.size)?;
    let [full, sparse] = DENSITIES;
    for range_m in plan.ranges_m.iter().copied() {
        let scene = meadow(land, plan.size, full, range_m)?;
        scene.world.residents().for_each(|chunk| bench.pool.upload(&bench.gpu.queue, chunk));
        let frame = frame_of(&scene, Cull::Hierarchical);
        if bench.clumps(&frame)? < plan.clumps {
            continue;
        }
        let in_view = bench.clumps(&frame_of(&scene, Cull::Frustum))?;
        let full = bench.timed(&frame, plan)?;
        let sparse =
            bench.timed(&frame_of(&meadow(land, plan.size, sparse, range_m)?, Cull::Hierarchical), plan)?;
        return Ok(GpuTime {
            adapter: bench.gpu.name(),
            is_software: bench.gpu.is_software(),
            size: plan.size,
            samples: SAMPLES,
            range_m,
            in_view,
            full,
            sparse,
        });
    }
    anyhow::bail!("none of the ranges of grass {:?} m shows {} clumps", plan.ranges_m, plan.clumps)
}

/// The meadow of the scene `grass` with so much grass up to a range, without trees.
fn meadow(land: &Land, size: (u32, u32), density: u32, range_m: f32) -> Result<Scene> {
    let plants = VegetationSettings {
        density,
        range_m,
        thin_from_m: range_m,
        trees: 0,
        ..VegetationSettings::STANDARD
    };
    let mut case = Case::at_start(client::scene::Scene::Grass, size, plants);
    case.shot.pose.position_m.y += ABOVE_M;
    case.shot.pose.pitch_deg = PITCH_DEG;
    Scene::of(land, &case, SLOTS).context("nothing grows in the scene `grass`")
}

/// The passes of the vegetation alone, on the best adapter.
struct Bench {
    gpu: Gpu,
    uniforms: wgpu::Buffer,
    pool: ChunkPool,
    trees: TreeCells,
    vegetation: VegetationRenderer,
    targets: Targets,
    clock: Option<Timestamps>,
}

impl Bench {
    fn open(size: (u32, u32)) -> Result<Self> {
        let opened = Gpu::open_with(gpu::instance(None), None, wgpu::Features::TIMESTAMP_QUERY);
        let gpu = pollster::block_on(opened).context("times of plants need a GPU")?;
        let device = &gpu.device;
        let bytes = size_of::<shaders::layout::Frame>() as u64;
        Ok(Self {
            uniforms: create_buffer(device, "frame", bytes, Usage::UNIFORM | Usage::COPY_DST),
            pool: ChunkPool::new(device, SLOTS),
            trees: TreeCells::new(device),
            vegetation: VegetationRenderer::new(device),
            targets: Targets::new(device, size, SAMPLES),
            clock: Timestamps::new(device, "times of plants", TIMESTAMPS),
            gpu,
        })
    }

    /// Culls a frame's plants.
    fn cull(&mut self, frame: &FrameData, encoder: &mut wgpu::CommandEncoder) -> Result<()> {
        let plants = frame.plants.as_ref().context("a frame without plants")?;
        self.gpu.queue.write_buffer(&self.uniforms, 0, bytemuck::bytes_of(&frame.uniforms));
        let (gpu, uniforms, pool) = (&self.gpu, &self.uniforms, &self.pool);
        self.vegetation.cull(gpu, uniforms, (pool, &self.trees), SAMPLES, plants, encoder);
        Ok(())
    }

    /// Clumps that the tests of a frame keep.
    fn clumps(&mut self, frame: &FrameData) -> Result<u64> {
        let mut encoder = self.encoder();
        self.cull(frame, &mut encoder)?;
        self.gpu.queue.submit([encoder.finish()]);
        let stats = self.vegetation.read_stats(&self.gpu)?;
        ensure!(stats.blocks_lost + stats.clumps_lost == 0, "no room for all visible clumps: {stats:?}");
        Ok(stats.clumps.into())
    }

    fn encoder(&self) -> wgpu::CommandEncoder {
        self.gpu.device.create_command_encoder(&wgpu::CommandEncoderDescriptor::default())
    }

    /// Culls and draws a frame once without timing, then several times.
    fn timed(&mut self, frame: &FrameData, plan: &Plan) -> Result<Timed> {
        let clumps = self.clumps(frame)?;
        let count = plan.frames[usize::from(self.gpu.is_software())];
        let (mut program, mut passes) = (Vec::new(), Vec::new());
        for index in 0..=count {
            let begun = Instant::now();
            self.draw(frame)?;
            let taken_ms = begun.elapsed().as_secs_f64() * 1e3;
            if index > 0 {
                program.push(taken_ms);
                let ticks = self.clock.as_ref().map(|clock| clock.read(&self.gpu)).transpose()?;
                passes.extend(ticks.as_ref().map(passes_of));
            }
        }
        let passes = (!passes.is_empty()).then(|| {
            let of = |time: fn(&Passes) -> f64| median(passes.iter().map(time));
            Passes {
                cull_ms: of(|passes| passes.cull_ms),
                draw_ms: of(|passes| passes.draw_ms),
                whole_ms: of(|passes| passes.whole_ms),
            }
        });
        if let Some(Passes { cull_ms, draw_ms, whole_ms }) = passes {
            // A query set that is never written reads as zeros, and zero is no time.
            ensure!(
                cull_ms > 0.0 && draw_ms > 0.0 && whole_ms >= draw_ms,
                "the GPU's timestamps do not advance"
            );
        }
        let program_ms = median(program);
        let whole_ms = passes.map_or(program_ms, |passes| passes.whole_ms);
        Ok(Timed { clumps, passes, program_ms, whole_ms })
    }

    fn draw(&mut self, frame: &FrameData) -> Result<()> {
        let mut encoder = self.encoder();
        if let Some(clock) = &self.clock {
            clock.mark(&mut encoder, CULL_BEGIN);
        }
        self.cull(frame, &mut encoder)?;
        if let Some(clock) = &self.clock {
            clock.mark(&mut encoder, CULL_END);
        }
        {
            let times = self.clock.as_ref().map(|clock| clock.writes(DRAW_BEGIN));
            let mut pass = self.targets.begin_hdr(&mut encoder, wgpu::Color::BLACK, times);
            self.vegetation.draw_grass(&mut pass);
            self.vegetation.draw_trees(&mut pass);
        }
        if let Some(clock) = &self.clock {
            clock.resolve(&mut encoder);
        }
        self.gpu.queue.submit([encoder.finish()]);
        Ok(self.gpu.wait()?)
    }
}

/// Timestamps.
const CULL_BEGIN: u32 = 0;
const CULL_END: u32 = 1;
const DRAW_BEGIN: u32 = 2;
const DRAW_END: u32 = 3;
const TIMESTAMPS: u32 = 4;

/// Times between the timestamps of a frame.
fn passes_of(ticks: &Ticks) -> Passes {
    let between_ms = |from, to| ticks.between_ns(from, to) / 1e6;
    Passes {
        cull_ms: between_ms(CULL_BEGIN, CULL_END),
        draw_ms: between_ms(DRAW_BEGIN, DRAW_END),
        whole_ms: between_ms(CULL_BEGIN, DRAW_END),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The passes of the bar with fewer clumps and pixels.
    #[test]
    fn the_passes_are_timed_where_the_adapter_has_timestamps() {
        let gpu = match Gpu::open_blocking() {
            Ok(gpu) => gpu,
            Err(error) => {
                assert!(std::env::var_os("TOMBOLO_REQUIRE_GPU").is_none(), "a GPU is required: {error}");
                eprintln!("SKIPPED: {error}");
                return;
            }
        };
        let has_clock = gpu.adapter.features().contains(wgpu::Features::TIMESTAMP_QUERY);
        let plan = Plan { size: (192, 108), clumps: 5_000, ranges_m: &[1.0, 80.0, 160.0], frames: [1, 1] };
        let found = measure_plan(&Land::new(1), &plan).unwrap();
        eprintln!("{found:?}");
        let (full, sparse) = (found.full, found.sparse);
        assert!(found.range_m > 1.0 && full.clumps >= plan.clumps && found.in_view >= full.clumps);
        assert!(2 * sparse.clumps < full.clumps, "the control has fewer clumps");
        assert_eq!(full.passes.is_some(), has_clock);
        assert_eq!(full.whole_ms, full.passes.map_or(full.program_ms, |passes| passes.whole_ms));
    }

    #[test]
    fn times_are_between_the_timestamps_of_each_pass() {
        let passes = passes_of(&Ticks::new(vec![1_000_000, 3_000_000, 3_500_000, 7_500_000], 2.0));
        assert_eq!((passes.cull_ms, passes.draw_ms, passes.whole_ms), (4.0, 8.0, 13.0));
        let reset = passes_of(&Ticks::new(vec![9_000_000, 1, 2, 3], 1.0));
        assert_eq!(reset.whole_ms, 0.0, "a clock that was reset gives no time");
    }
}
