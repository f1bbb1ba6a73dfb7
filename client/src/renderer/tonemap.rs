//! The tonemap pass: linear HDR color to encoded screen colors.

use crate::gpu::bind::{bind, layout, texture_entry, uniform_entry};
use crate::gpu::pipeline::flat_pipeline;
use crate::gpu::targets::Targets;
use shaders::SHADERS;

/// The tonemap pass.
#[derive(Debug)]
pub struct TonemapPass {
    layout: wgpu::BindGroupLayout,
    pipeline: wgpu::RenderPipeline,
    bindings: wgpu::BindGroup,
}

impl TonemapPass {
    /// The pass from `targets` to images of `format`. The format must not be sRGB: the shader
    /// encodes.
    #[must_use]
    pub fn new(
        device: &wgpu::Device,
        frame: &wgpu::Buffer,
        targets: &Targets,
        format: wgpu::TextureFormat,
    ) -> Self {
        let (fragment, d2) = (wgpu::ShaderStages::FRAGMENT, wgpu::TextureViewDimension::D2);
        let entries = [uniform_entry(0), texture_entry(1, fragment, d2, false)];
        let layout = layout(device, SHADERS.tonemap.name, &entries);
        let pipeline = flat_pipeline(device, &SHADERS.tonemap, &layout, format);
        let bindings = bind_targets(device, &layout, frame, targets);
        Self { layout, pipeline, bindings }
    }

    /// Reads from new targets from now on.
    pub fn retarget(&mut self, device: &wgpu::Device, frame: &wgpu::Buffer, targets: &Targets) {
        self.bindings = bind_targets(device, &self.layout, frame, targets);
    }

    /// Draws the image.
    pub fn draw(&self, pass: &mut wgpu::RenderPass<'_>) {
        pass.set_pipeline(&self.pipeline);
        pass.set_bind_group(0, &self.bindings, &[]);
        pass.draw(0..3, 0..1);
    }
}

fn bind_targets(
    device: &wgpu::Device,
    layout: &wgpu::BindGroupLayout,
    frame: &wgpu::Buffer,
    targets: &Targets,
) -> wgpu::BindGroup {
    let hdr = wgpu::BindingResource::TextureView(targets.hdr());
    bind(device, SHADERS.tonemap.name, layout, &[frame.as_entire_binding(), hdr])
}
