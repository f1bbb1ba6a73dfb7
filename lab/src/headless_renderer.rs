//! An off-screen renderer for many pictures: opening a device takes longer than drawing one.

use client::cache::ChunkCache;
use client::features::terrain::pool::ChunkPool;
use client::features::terrain_clipmap::window::STANDARD_TEXELS;
use client::features::vegetation::draw::VisibleClumps;
use client::features::vegetation::gpu_cull::{CullBuffers, CullStats};
use client::features::vegetation::renderer::VegetationRenderer;
use client::frame::FrameData;
use client::gpu;
use client::gpu::{Gpu, GpuError, Image, OffscreenTarget, PassTimes, offscreen};
use client::renderer::{RenderOptions, Renderer};
use client::scene::Scene;
use std::time::{Duration, Instant};

/// A GPU with a renderer and a canvas of one size, one sample per pixel.
#[derive(Debug)]
pub struct HeadlessRenderer {
    gpu: Gpu,
    renderer: Renderer,
    target: OffscreenTarget,
    slots: u32,
}

/// Draws a frame with the shadows traced so far; returns the time until the GPU is done.
pub(crate) fn draw(
    gpu: &Gpu,
    renderer: &mut Renderer,
    frame: &FrameData,
    target: &OffscreenTarget,
) -> Result<Duration, GpuError> {
    let begun = Instant::now();
    let mut encoder = gpu.device.create_command_encoder(&wgpu::CommandEncoderDescriptor::default());
    renderer.draw(gpu, frame, &mut encoder, &target.view);
    gpu.queue.submit([encoder.finish()]);
    gpu.wait()?;
    Ok(begun.elapsed())
}

/// Visible clumps of one kind of plants.
#[derive(Clone, Debug)]
pub struct ChosenKind {
    /// `shaders::layout::KIND_*`.
    pub kind: u32,
    /// Four words each, see `shaders/wgsl/shared/clump.wesl`; by level of detail, finest first.
    pub clumps: Vec<[u32; 4]>,
    /// Counters of the culling pass.
    pub stats: CullStats,
}

impl HeadlessRenderer {
    /// Opens the best adapter for pictures of a size in pixels and worlds of at most `slots` slots.
    pub fn open(size: (u32, u32), slots: u32) -> Result<Self, GpuError> {
        Self::open_with(size, slots, wgpu::Features::empty())
    }

    /// The same with optional features of the adapter.
    pub fn open_with(size: (u32, u32), slots: u32, optional: wgpu::Features) -> Result<Self, GpuError> {
        let gpu = pollster::block_on(Gpu::open_with(gpu::instance(None), None, optional))?;
        let slots = ChunkPool::slots_within(&gpu.device.limits(), slots);
        let options = RenderOptions {
            scene: Scene::Island,
            size,
            samples: 1,
            anisotropy: 1,
            format: offscreen::IMAGE_FORMAT,
            slots,
            clipmap_texels: STANDARD_TEXELS,
        };
        let renderer = Renderer::new(&gpu, &options);
        let target = OffscreenTarget::new(&gpu.device, size.0, size.1);
        Ok(Self { gpu, renderer, target, slots })
    }

    /// Slots of a world that can be drawn.
    pub fn slots(&self) -> u32 {
        self.slots
    }

    /// Name and backend of the adapter, for people.
    pub fn adapter(&self) -> String {
        self.gpu.name()
    }

    /// Whether the adapter is a software rasteriser.
    pub fn is_software(&self) -> bool {
        self.gpu.is_software()
    }

    /// Bytes on the GPU that one more chunk takes.
    pub fn bytes_per_chunk(&self) -> u64 {
        self.renderer.bytes_per_chunk()
    }

    /// Draw calls that the land of the last frame took.
    pub fn terrain_draws(&self) -> u32 {
        self.renderer.terrain_draws()
    }

    /// Times of the passes of the last frame by the GPU's clock; none without one.
    pub fn pass_times(&self) -> Result<Option<PassTimes>, GpuError> {
        self.renderer.pass_times(&self.gpu)
    }

    /// Uploads a whole world; earlier chunks are overwritten slot by slot.
    pub fn upload_world(&mut self, world: &ChunkCache) {
        for chunk in world.keys().filter_map(|key| world.get(key)) {
            self.renderer.upload(&self.gpu, chunk);
        }
        // Uploads are staged until a submission.
        self.gpu.queue.submit([]);
    }

    /// Draws a frame with the shadows traced so far; returns the time until the GPU is done.
    pub fn draw(&mut self, frame: &FrameData) -> Result<Duration, GpuError> {
        draw(&self.gpu, &mut self.renderer, frame, &self.target)
    }

    /// Draws a frame with all its shadows and reads the picture back.
    pub fn picture(&mut self, frame: &FrameData) -> Result<Image, GpuError> {
        self.renderer.finish_shading(&self.gpu, frame)?;
        self.draw(frame)?;
        self.target.read(&self.gpu)
    }

    /// [`HeadlessRenderer::picture`] in another size, pixels, which later pictures keep.
    pub fn picture_of(&mut self, frame: &FrameData, size: (u32, u32)) -> Result<Image, GpuError> {
        self.renderer.resize(size);
        self.target = OffscreenTarget::new(&self.gpu.device, size.0, size.1);
        self.picture(frame)
    }

    /// Draws a frame with all its shadows and returns its linear light, four channels a pixel.
    pub fn linear_light(&mut self, frame: &FrameData) -> Result<Vec<[f32; 4]>, GpuError> {
        self.renderer.finish_shading(&self.gpu, frame)?;
        let light = self.renderer.read_hdr(&self.gpu, frame, &self.target)?;
        let light = light.ok_or_else(|| GpuError::Fault("light is read with one sample per pixel".into()))?;
        let channel = |bits: u16| half::f16::from_bits(bits).to_f32();
        Ok(light.chunks_exact(4).map(|p| [p[0], p[1], p[2], p[3]].map(channel)).collect())
    }

    /// Culls a frame's plants without drawing; returns the time until the GPU is done.
    pub fn choose(&mut self, frame: &FrameData) -> Result<Duration, GpuError> {
        let begun = Instant::now();
        let mut encoder = self.gpu.device.create_command_encoder(&wgpu::CommandEncoderDescriptor::default());
        self.renderer.cull_vegetation(&self.gpu, frame, &mut encoder);
        self.gpu.queue.submit([encoder.finish()]);
        self.gpu.wait()?;
        Ok(begun.elapsed())
    }

    /// Draws the IDs of the plants of the last culling pass, at a size; see [`Renderer::read_ids`].
    pub fn id_buffer(&mut self, frame: &FrameData, size: (u32, u32)) -> Result<Vec<[u32; 2]>, GpuError> {
        self.renderer.resize(size);
        let names = self.renderer.read_ids(&self.gpu, frame)?;
        names.ok_or_else(|| GpuError::Fault("the ID buffer takes one sample per pixel".into()))
    }

    /// Visible clumps of the last culling pass, kind by kind.
    pub fn chosen(&self) -> Result<Vec<ChosenKind>, GpuError> {
        let kinds = self.renderer.vegetation().into_iter().flat_map(VegetationRenderer::buffers);
        let read = |(kept, chosen): (&VisibleClumps, &CullBuffers)| {
            let (clumps, stats) = (chosen.read(&self.gpu)?.concat(), chosen.read_stats(&self.gpu)?);
            Ok(ChosenKind { kind: kept.species.kind(), clumps, stats })
        };
        kinds.map(read).collect()
    }
}
