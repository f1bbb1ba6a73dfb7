//! The antialiasing pass: encoded colours with smooth edges.

use super::target::{Target, pipelines};
use crate::gpu::bind::{bind, layout, sampler_entry, texture_entry};
use shaders::SHADERS;

/// The antialiasing pass.
#[derive(Debug)]
pub struct AntialiasPass {
    layout: wgpu::BindGroupLayout,
    /// Into the image, and for a pass that filters.
    pipelines: [wgpu::RenderPipeline; 2],
}

impl AntialiasPass {
    /// The pass to images of `format`.
    #[must_use]
    pub fn new(device: &wgpu::Device, format: wgpu::TextureFormat) -> Self {
        let (fragment, d2) = (wgpu::ShaderStages::FRAGMENT, wgpu::TextureViewDimension::D2);
        let shader = &SHADERS.antialias;
        let entries = [texture_entry(0, fragment, d2, true), sampler_entry(1, fragment)];
        let layout = layout(device, shader.name, &entries);
        Self { pipelines: pipelines(device, shader, &layout, format), layout }
    }

    /// Bindings over encoded colours.
    #[must_use]
    pub fn bind(
        &self,
        device: &wgpu::Device,
        colors: &wgpu::TextureView,
        sampler: &wgpu::Sampler,
    ) -> wgpu::BindGroup {
        let resources = [wgpu::BindingResource::TextureView(colors), wgpu::BindingResource::Sampler(sampler)];
        bind(device, SHADERS.antialias.name, &self.layout, &resources)
    }

    /// The pipeline to a target.
    #[must_use]
    pub fn pipeline(&self, target: Target) -> &wgpu::RenderPipeline {
        &self.pipelines[target as usize]
    }
}
