//! The resampling pass: encoded colors of the rendered size to an image, sharpened.

use super::target::Target;
use crate::gpu::bind::{bind, layout, texture_entry, uniform_entry};
use crate::gpu::pipeline::screen_pipeline;
use shaders::SHADERS;

/// The resampling pass.
#[derive(Debug)]
pub struct ResamplePass {
    layout: wgpu::BindGroupLayout,
    pipeline: wgpu::RenderPipeline,
}

impl ResamplePass {
    /// The pass to images of `format`.
    #[must_use]
    pub fn new(device: &wgpu::Device, format: wgpu::TextureFormat) -> Self {
        let (fragment, d2) = (wgpu::ShaderStages::FRAGMENT, wgpu::TextureViewDimension::D2);
        let shader = &SHADERS.resample;
        let layout = layout(device, shader.name, &[uniform_entry(0), texture_entry(1, fragment, d2, false)]);
        let pipeline = screen_pipeline(device, shader, &layout, Target::Image.fragment(), format.into());
        Self { layout, pipeline }
    }

    /// Bindings over encoded colors.
    #[must_use]
    pub fn bind(
        &self,
        device: &wgpu::Device,
        post: &wgpu::Buffer,
        colors: &wgpu::TextureView,
    ) -> wgpu::BindGroup {
        let resources = [post.as_entire_binding(), wgpu::BindingResource::TextureView(colors)];
        bind(device, SHADERS.resample.name, &self.layout, &resources)
    }

    /// The pipeline to the image.
    #[must_use]
    pub fn pipeline(&self) -> &wgpu::RenderPipeline {
        &self.pipeline
    }
}
