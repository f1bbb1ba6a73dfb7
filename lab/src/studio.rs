//! A renderer that is opened once and takes many pictures: opening a device takes longer than drawing.

use anyhow::Result;
use client::frame::FrameData;
use client::render::pool::ChunkPool;
use client::render::{Canvas, Gpu, GpuError, Picture, RenderOptions, Renderer, gpu, picture};
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

impl Studio {
    /// Opens the best adapter for pictures of a size in pixels and worlds of at most `slots` slots.
    ///
    /// # Errors
    /// There is no adapter, or it cannot be opened.
    pub fn open(size: (u32, u32), slots: u32) -> Result<Self, GpuError> {
        let gpu = pollster::block_on(Gpu::open(gpu::instance(None), None))?;
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

    /// The device, for people's eyes and for timing.
    #[must_use]
    pub fn gpu(&self) -> &Gpu {
        &self.gpu
    }

    /// Brings in a whole world; what was there before is overwritten slot by slot.
    pub fn furnish(&mut self, world: &World) {
        for chunk in world.keys().filter_map(|key| world.get(key)) {
            self.renderer.upload(&self.gpu, chunk);
        }
        // Uploads are staged until a submission.
        self.gpu.queue.submit([]);
    }

    /// Draws a frame with the shadows that have been found; returns how long it took until the GPU was done.
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
}
