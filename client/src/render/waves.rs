//! The distortion map of the sea: baked once by compute, then only read.

use shaders::SHADERS;
use shaders::layout::{WAVE_MAP_SIDE, WAVE_WORKGROUP};

/// Levels of the map, down to one texel.
pub const WAVE_LEVELS: u32 = WAVE_MAP_SIDE.ilog2() + 1;

/// Writable by compute and filterable everywhere; eleven bits of height are 0.4 mm of the highest
/// crest.
const WAVE_FORMAT: wgpu::TextureFormat = wgpu::TextureFormat::Rgba16Float;

/// The map with the sampler that its readers share.
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
        let module = device.create_shader_module(wgpu::ShaderModuleDescriptor {
            label: Some(SHADERS.bake_waves.name),
            source: wgpu::ShaderSource::Wgsl(SHADERS.bake_waves.wgsl.into()),
        });
        let pipeline = |entry_point| {
            device.create_compute_pipeline(&wgpu::ComputePipelineDescriptor {
                label: Some(entry_point),
                layout: None,
                module: &module,
                entry_point: Some(entry_point),
                compilation_options: wgpu::PipelineCompilationOptions::default(),
                cache: None,
            })
        };
        let (bake, shrink) = (pipeline("bake_waves"), pipeline("shrink_waves"));
        let mut encoder =
            device.create_command_encoder(&wgpu::CommandEncoderDescriptor { label: Some("bake waves") });
        for target in 0..WAVE_LEVELS {
            let pipeline = if target == 0 { &bake } else { &shrink };
            let (written, read) = (level(target), level(target.saturating_sub(1)));
            let mut entries = vec![wgpu::BindGroupEntry {
                binding: 0,
                resource: wgpu::BindingResource::TextureView(&written),
            }];
            if target > 0 {
                entries.push(wgpu::BindGroupEntry {
                    binding: 1,
                    resource: wgpu::BindingResource::TextureView(&read),
                });
            }
            let bindings = device.create_bind_group(&wgpu::BindGroupDescriptor {
                label: Some("bake waves"),
                layout: &pipeline.get_bind_group_layout(0),
                entries: &entries,
            });
            let mut pass = encoder.begin_compute_pass(&wgpu::ComputePassDescriptor {
                label: Some("bake waves"),
                timestamp_writes: None,
            });
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
        [
            wgpu::BindGroupLayoutEntry {
                binding,
                visibility: stages,
                ty: wgpu::BindingType::Texture {
                    sample_type: wgpu::TextureSampleType::Float { filterable: true },
                    view_dimension: wgpu::TextureViewDimension::D2,
                    multisampled: false,
                },
                count: None,
            },
            wgpu::BindGroupLayoutEntry {
                binding: binding + 1,
                visibility: stages,
                ty: wgpu::BindingType::Sampler(wgpu::SamplerBindingType::Filtering),
                count: None,
            },
        ]
    }

    /// Its two bindings.
    #[must_use]
    pub fn entries(&self, binding: u32) -> [wgpu::BindGroupEntry<'_>; 2] {
        [
            wgpu::BindGroupEntry { binding, resource: wgpu::BindingResource::TextureView(&self.view) },
            wgpu::BindGroupEntry {
                binding: binding + 1,
                resource: wgpu::BindingResource::Sampler(&self.sampler),
            },
        ]
    }
}
