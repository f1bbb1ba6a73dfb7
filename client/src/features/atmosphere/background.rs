//! The sky background pass.

use crate::gpu::bind::{bind_buffers, layout, uniform_entry};
use crate::gpu::pipeline::{Depth, HdrPass};
use shaders::SHADERS;

/// Draws the sky where no land is.
#[derive(Debug)]
pub struct BackgroundPass {
    pipeline: wgpu::RenderPipeline,
    bindings: wgpu::BindGroup,
}

impl BackgroundPass {
    /// The sky, and deep water where no land is resident.
    #[must_use]
    pub fn sky(device: &wgpu::Device, frame: &wgpu::Buffer, samples: u32) -> Self {
        let shader = &SHADERS.draw_sky;
        let layout = layout(device, shader.name, &[uniform_entry(0)]);
        let bindings = bind_buffers(device, shader.name, &layout, &[frame]);
        let pass = HdrPass { shader, layouts: &[&layout], buffers: &[], depth: Depth::Background, samples };
        Self { pipeline: pass.pipeline(device), bindings }
    }

    /// Records the draw.
    pub fn draw(&self, pass: &mut wgpu::RenderPass<'_>) {
        pass.set_pipeline(&self.pipeline);
        pass.set_bind_group(0, &self.bindings, &[]);
        pass.draw(0..3, 0..1);
    }
}
