//! The sky pass.

use crate::gpu::bind::{bind_buffers, layout, uniform_entry};
use crate::gpu::pipeline::{Depth, HdrPass};
use shaders::SHADERS;

/// Paints every pixel that no surface covers: sky above the horizon, deep water below it.
#[derive(Debug)]
pub struct SkyPass {
    pipeline: wgpu::RenderPipeline,
    bind_group: wgpu::BindGroup,
}

impl SkyPass {
    /// Creates the pipeline for a number of samples per pixel.
    #[must_use]
    pub fn new(device: &wgpu::Device, frame_uniforms: &wgpu::Buffer, samples: u32) -> Self {
        let shader = &SHADERS.draw_sky;
        let layout = layout(device, shader.name, &[uniform_entry(0)]);
        let bind_group = bind_buffers(device, shader.name, &layout, &[frame_uniforms]);
        let pass = HdrPass { shader, layouts: &[&layout], buffers: &[], depth: Depth::Background, samples };
        Self { pipeline: pass.pipeline(device), bind_group }
    }

    /// Records the draw.
    pub fn draw(&self, pass: &mut wgpu::RenderPass<'_>) {
        pass.set_pipeline(&self.pipeline);
        pass.set_bind_group(0, &self.bind_group, &[]);
        pass.draw(0..3, 0..1);
    }
}
