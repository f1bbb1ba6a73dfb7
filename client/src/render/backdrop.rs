//! The pass that needs nothing but the frame's uniforms: the sky.

use crate::render::pipeline::{Depth, LightPass, uniform_entry};
use shaders::{SHADERS, Shader};

/// A pass that covers what no land does.
#[derive(Debug)]
pub struct BackdropPass {
    pipeline: wgpu::RenderPipeline,
    bindings: wgpu::BindGroup,
    vertices: u32,
}

impl BackdropPass {
    /// The sky, and deep water where no land is resident.
    #[must_use]
    pub fn sky(device: &wgpu::Device, frame: &wgpu::Buffer, samples: u32) -> Self {
        Self::new(device, frame, &SHADERS.draw_sky, Depth::Background, 3, samples)
    }

    fn new(
        device: &wgpu::Device,
        frame: &wgpu::Buffer,
        shader: &Shader,
        depth: Depth,
        vertices: u32,
        samples: u32,
    ) -> Self {
        let layout = device.create_bind_group_layout(&wgpu::BindGroupLayoutDescriptor {
            label: Some(shader.name),
            entries: &[uniform_entry(0)],
        });
        let bindings = device.create_bind_group(&wgpu::BindGroupDescriptor {
            label: Some(shader.name),
            layout: &layout,
            entries: &[wgpu::BindGroupEntry { binding: 0, resource: frame.as_entire_binding() }],
        });
        let pipeline =
            LightPass { shader, layouts: &[&layout], buffers: &[], depth, samples }.pipeline(device);
        Self { pipeline, bindings, vertices }
    }

    /// Draws it.
    pub fn draw(&self, pass: &mut wgpu::RenderPass<'_>) {
        pass.set_pipeline(&self.pipeline);
        pass.set_bind_group(0, &self.bindings, &[]);
        pass.draw(0..self.vertices, 0..1);
    }
}
