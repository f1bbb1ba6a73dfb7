//! The resampling pass: encoded colours of the rendered size to an image, sharpened.

use super::target::Target;
use crate::gpu::bind::{bind, layout, sampler_entry, texture_entry, uniform_entry};
use crate::gpu::pipeline::screen_pipeline;
use shaders::SHADERS;

/// The resampling pass.
#[derive(Debug)]
pub struct ResamplePass {
    layout: wgpu::BindGroupLayout,
    /// For all settings, and for images that are only enlarged.
    pipelines: [wgpu::RenderPipeline; 2],
}

impl ResamplePass {
    /// The pass to images of `format`.
    #[must_use]
    pub fn new(device: &wgpu::Device, format: wgpu::TextureFormat) -> Self {
        let (fragment, d2) = (wgpu::ShaderStages::FRAGMENT, wgpu::TextureViewDimension::D2);
        let shader = &SHADERS.resample;
        let entries = [uniform_entry(0), texture_entry(1, fragment, d2, true), sampler_entry(2, fragment)];
        let layout = layout(device, shader.name, &entries);
        let pipelines = [Target::Image.fragment(), "fragment_enlarged"]
            .map(|fragment| screen_pipeline(device, shader, &layout, fragment, format.into()));
        Self { layout, pipelines }
    }

    /// Bindings over encoded colours.
    #[must_use]
    pub fn bind(
        &self,
        device: &wgpu::Device,
        post: &wgpu::Buffer,
        colors: &wgpu::TextureView,
        sampler: &wgpu::Sampler,
    ) -> wgpu::BindGroup {
        let resources = [
            post.as_entire_binding(),
            wgpu::BindingResource::TextureView(colors),
            wgpu::BindingResource::Sampler(sampler),
        ];
        bind(device, SHADERS.resample.name, &self.layout, &resources)
    }

    /// The pipeline to the image; of one that is only enlarged, neither smaller nor sharpened, a
    /// cheaper one.
    #[must_use]
    pub fn pipeline(&self, is_enlarged: bool) -> &wgpu::RenderPipeline {
        &self.pipelines[usize::from(is_enlarged)]
    }
}
