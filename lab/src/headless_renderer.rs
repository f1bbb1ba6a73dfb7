//! A renderer that is opened once and takes many pictures: opening a device takes longer than
//! drawing.

use client::frame::FrameData;
use client::render::cull::{Chosen, Told};
use client::render::garden::Garden;
use client::render::grass::KeptClumps;
use client::render::pool::ChunkPool;
use client::render::{Canvas, Gpu, GpuError, PassTimes, Picture, RenderOptions, Renderer, gpu, picture};
use client::scene::Scene;
use client::world::World;
use std::time::{Duration, Instant};

/// A GPU with a renderer and a canvas of one size, one sample per pixel.
#[derive(Debug)]
pub struct Studio {
    gpu: Gpu,
    renderer: Renderer,
    canvas: Canvas,
    slots: u32,
}

/// What was chosen of one kind of plants.
#[derive(Clone, Debug)]
pub struct ChosenKind {
    /// `shaders::layout::KIND_*`.
    pub kind: u32,
    /// Four words each, see `shaders/wgsl/shared/clump.wesl`; by level of detail, finest first.
    pub clumps: Vec<[u32; 4]>,
    /// What it came to.
    pub told: Told,
}

impl Studio {
    /// Opens the best adapter for pictures of a size in pixels and worlds of at most `slots` slots.
    ///
    /// # Errors
    /// There is no adapter, or it cannot be opened.
    pub fn open(size: (u32, u32), slots: u32) -> Result<Self, GpuError> {
        Self::open_with(size, slots, wgpu::Features::empty())
    }

    /// The same with the GPU's own clock, where it has one.
    ///
    /// # Errors
    /// As [`Studio::open`].
    pub fn open_timed(size: (u32, u32), slots: u32) -> Result<Self, GpuError> {
        Self::open_with(size, slots, wgpu::Features::TIMESTAMP_QUERY)
    }

    fn open_with(size: (u32, u32), slots: u32, wished: wgpu::Features) -> Result<Self, GpuError> {
        let gpu = pollster::block_on(Gpu::open_with(gpu::instance(None), None, wished))?;
        let slots = ChunkPool::slots_within(&gpu.device.limits(), slots);
        let options =
            RenderOptions { scene: Scene::Island, size, samples: 1, format: picture::PICTURE_FORMAT, slots };
        let renderer = Renderer::new(&gpu, &options);
        let canvas = Canvas::new(&gpu.device, size.0, size.1);
        Ok(Self { gpu, renderer, canvas, slots })
    }

    /// Slots of a world that can be drawn.
    #[must_use]
    pub fn slots(&self) -> u32 {
        self.slots
    }

    /// Name and backend of the adapter, for people.
    #[must_use]
    pub fn adapter(&self) -> String {
        self.gpu.name()
    }

    /// Whether the adapter is a processor that plays a GPU.
    #[must_use]
    pub fn is_software(&self) -> bool {
        self.gpu.adapter.get_info().device_type == wgpu::DeviceType::Cpu
    }

    /// Bytes on the GPU that one more chunk takes.
    #[must_use]
    pub fn bytes_per_chunk(&self) -> u64 {
        self.renderer.bytes_per_chunk()
    }

    /// Draw calls that the land of the last frame took.
    #[must_use]
    pub fn terrain_draws(&self) -> u32 {
        self.renderer.terrain_draws()
    }

    /// What the passes of the last frame took by the GPU's clock; none without one.
    ///
    /// # Errors
    /// The GPU failed.
    pub fn pass_times(&self) -> Result<Option<PassTimes>, GpuError> {
        self.renderer.pass_times(&self.gpu)
    }

    /// Brings in a whole world; what was there before is overwritten slot by slot.
    pub fn furnish(&mut self, world: &World) {
        for chunk in world.keys().filter_map(|key| world.get(key)) {
            self.renderer.upload(&self.gpu, chunk);
        }
        // Uploads are staged until a submission.
        self.gpu.queue.submit([]);
    }

    /// Draws a frame with the shadows that have been found; returns how long it took until the GPU
    /// was done.
    ///
    /// # Errors
    /// The GPU failed.
    pub fn draw(&mut self, frame: &FrameData) -> Result<Duration, GpuError> {
        let begun = Instant::now();
        let mut encoder = self.gpu.device.create_command_encoder(&wgpu::CommandEncoderDescriptor::default());
        self.renderer.draw(&self.gpu, frame, &mut encoder, &self.canvas.view);
        self.gpu.queue.submit([encoder.finish()]);
        self.gpu.wait()?;
        Ok(begun.elapsed())
    }

    /// Draws a frame with all its shadows and brings the picture back.
    ///
    /// # Errors
    /// The GPU failed.
    pub fn picture(&mut self, frame: &FrameData) -> Result<Picture, GpuError> {
        self.renderer.finish_shadows(&self.gpu, frame)?;
        self.draw(frame)?;
        self.canvas.read(&self.gpu)
    }

    /// Chooses a frame's plants and draws nothing; returns how long it took until the GPU was done.
    ///
    /// # Errors
    /// The GPU failed.
    pub fn choose(&mut self, frame: &FrameData) -> Result<Duration, GpuError> {
        let begun = Instant::now();
        let mut encoder = self.gpu.device.create_command_encoder(&wgpu::CommandEncoderDescriptor::default());
        self.renderer.choose(&self.gpu, frame, &mut encoder);
        self.gpu.queue.submit([encoder.finish()]);
        self.gpu.wait()?;
        Ok(begun.elapsed())
    }

    /// Draws the plants that were last chosen by their names, at a size; see [`Renderer::names`].
    ///
    /// # Errors
    /// The GPU failed.
    pub fn names(&mut self, frame: &FrameData, size: (u32, u32)) -> Result<Vec<[u32; 2]>, GpuError> {
        self.renderer.resize(&self.gpu, size);
        let names = self.renderer.names(&self.gpu, frame)?;
        names.ok_or_else(|| GpuError::Fault("names are drawn with one sample per pixel".into()))
    }

    /// What the last choice of plants kept, kind by kind.
    ///
    /// # Errors
    /// The GPU failed.
    pub fn chosen(&self) -> Result<Vec<ChosenKind>, GpuError> {
        let kinds = self.renderer.garden().into_iter().flat_map(Garden::kept);
        let read = |(kept, chosen): (&KeptClumps, &Chosen)| {
            let (clumps, told) = (chosen.read(&self.gpu)?.concat(), chosen.told(&self.gpu)?);
            Ok(ChosenKind { kind: kept.plant.kind(), clumps, told })
        };
        kinds.map(read).collect()
    }
}
