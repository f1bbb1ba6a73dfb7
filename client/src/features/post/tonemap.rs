//! The tonemap pass: linear HDR colour to encoded screen colours.

use super::target::{Target, pipelines};
use crate::gpu::bind::{bind, layout, sampler_entry, texture_entry, uniform_entry};
use shaders::SHADERS;

/// The tonemap pass.
#[derive(Debug)]
pub struct TonemapPass {
    layout: wgpu::BindGroupLayout,
    /// Into the image, and for a pass that filters.
    pipelines: [wgpu::RenderPipeline; 2],
}

impl TonemapPass {
    /// The pass to images of `format`. The format must not be sRGB: the shader encodes.
    #[must_use]
    pub fn new(device: &wgpu::Device, format: wgpu::TextureFormat) -> Self {
        let (fragment, d2) = (wgpu::ShaderStages::FRAGMENT, wgpu::TextureViewDimension::D2);
        let shader = &SHADERS.tonemap;
        let entries = [
            uniform_entry(0),
            uniform_entry(1),
            uniform_entry(2),
            texture_entry(3, fragment, d2, false),
            texture_entry(4, fragment, d2, true),
            sampler_entry(5, fragment),
        ];
        let layout = layout(device, shader.name, &entries);
        Self { pipelines: pipelines(device, shader, &layout, format), layout }
    }

    /// Bindings over the HDR colour; `bloom` is not read where the settings have none.
    #[must_use]
    pub fn bind(
        &self,
        device: &wgpu::Device,
        [frame, post, exposure]: [&wgpu::Buffer; 3],
        [hdr, bloom]: [&wgpu::TextureView; 2],
        sampler: &wgpu::Sampler,
    ) -> wgpu::BindGroup {
        let resources = [
            frame.as_entire_binding(),
            post.as_entire_binding(),
            exposure.as_entire_binding(),
            wgpu::BindingResource::TextureView(hdr),
            wgpu::BindingResource::TextureView(bloom),
            wgpu::BindingResource::Sampler(sampler),
        ];
        bind(device, SHADERS.tonemap.name, &self.layout, &resources)
    }

    /// The pipeline to a target.
    #[must_use]
    pub fn pipeline(&self, target: Target) -> &wgpu::RenderPipeline {
        &self.pipelines[target as usize]
    }
}
