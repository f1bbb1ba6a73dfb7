//! The wave map of the sea, baked once by compute passes.

use crate::gpu::bind;
use crate::gpu::pipeline::{compute_pass, derived_compute_pipelines};
use shaders::SHADERS;
use shaders::layout::{WAVE_MAP_SIDE, WAVE_WORKGROUP};

/// Levels of the map, down to one texel.
pub const WAVE_LEVELS: u32 = WAVE_MAP_SIDE.ilog2() + 1;

/// Writable by compute shaders and filterable on every device; eleven bits of height are 0.4 mm of
/// the highest crest.
const WAVE_FORMAT: wgpu::TextureFormat = wgpu::TextureFormat::Rgba16Float;

/// The wave map and its sampler.
#[derive(Debug)]
pub struct WaveMap {
    view: wgpu::TextureView,
    sampler: wgpu::Sampler,
}

impl WaveMap {
    /// Bakes the map; the work is submitted, later submissions read the finished map.
    #[must_use]
    pub fn bake(device: &wgpu::Device, queue: &wgpu::Queue) -> Self {
        let texture = device.create_texture(&wgpu::TextureDescriptor {
            label: Some("waves"),
            size: wgpu::Extent3d { width: WAVE_MAP_SIDE, height: WAVE_MAP_SIDE, depth_or_array_layers: 1 },
            mip_level_count: WAVE_LEVELS,
            sample_count: 1,
            dimension: wgpu::TextureDimension::D2,
            format: WAVE_FORMAT,
            usage: wgpu::TextureUsages::STORAGE_BINDING | wgpu::TextureUsages::TEXTURE_BINDING,
            view_formats: &[],
        });
        let level = |level| {
            texture.create_view(&wgpu::TextureViewDescriptor {
                label: Some("waves, one level"),
                base_mip_level: level,
                mip_level_count: Some(1),
                ..Default::default()
            })
        };
        let entry_points = ["bake_waves", "reduce_waves"];
        let [bake, shrink] = derived_compute_pipelines(device, &SHADERS.bake_waves, entry_points);
        let mut encoder =
            device.create_command_encoder(&wgpu::CommandEncoderDescriptor { label: Some("bake waves") });
        for target in 0..WAVE_LEVELS {
            let pipeline = if target == 0 { &bake } else { &shrink };
            let (written, read) = (level(target), level(target.saturating_sub(1)));
            let resources = [&written, &read].map(wgpu::BindingResource::TextureView);
            // The first level has no input.
            let resources = if target == 0 { &resources[..1] } else { &resources[..] };
            let group = pipeline.get_bind_group_layout(0);
            let bindings = bind::bind(device, "bake waves", &group, resources);
            let mut pass = compute_pass(&mut encoder, "bake waves");
            pass.set_pipeline(pipeline);
            pass.set_bind_group(0, &bindings, &[]);
            let groups = (WAVE_MAP_SIDE >> target).div_ceil(WAVE_WORKGROUP);
            pass.dispatch_workgroups(groups, groups, 1);
        }
        queue.submit([encoder.finish()]);
        let sampler = device.create_sampler(&wgpu::SamplerDescriptor {
            label: Some("waves"),
            address_mode_u: wgpu::AddressMode::Repeat,
            address_mode_v: wgpu::AddressMode::Repeat,
            mag_filter: wgpu::FilterMode::Linear,
            min_filter: wgpu::FilterMode::Linear,
            mipmap_filter: wgpu::MipmapFilterMode::Linear,
            ..Default::default()
        });
        Self { view: texture.create_view(&wgpu::TextureViewDescriptor::default()), sampler }
    }

    /// Layout of its two bindings, from `binding` on: the map and its sampler.
    #[must_use]
    pub const fn layout_entries(binding: u32, stages: wgpu::ShaderStages) -> [wgpu::BindGroupLayoutEntry; 2] {
        let d2 = wgpu::TextureViewDimension::D2;
        [bind::texture_entry(binding, stages, d2, true), bind::sampler_entry(binding + 1, stages)]
    }

    /// Its two bindings, in the order of [`WaveMap::layout_entries`].
    #[must_use]
    pub fn resources(&self) -> [wgpu::BindingResource<'_>; 2] {
        [wgpu::BindingResource::TextureView(&self.view), wgpu::BindingResource::Sampler(&self.sampler)]
    }

    /// Its two bindings as entries, from `binding` on.
    #[must_use]
    pub fn entries(&self, binding: u32) -> [wgpu::BindGroupEntry<'_>; 2] {
        let [map, sampler] = self.resources();
        [
            wgpu::BindGroupEntry { binding, resource: map },
            wgpu::BindGroupEntry { binding: binding + 1, resource: sampler },
        ]
    }
}
