//! What marches along reliefs read on the GPU: heights twice (exact, and for the sampler), the
//! bounds of the pyramid, cones.

use crate::relief::HeightMap;
use crate::render::cones;
use crate::render::pipeline::{compute_pipelines, uniform_entry};
use half::f16;
use shaders::SHADERS;
use shaders::layout::{RELIEF_WORKGROUP, ReliefReduction};
use wgpu::util::DeviceExt as _;

/// Exact heights and bounds; not filterable everywhere.
pub(super) const EXACT: wgpu::TextureFormat = wgpu::TextureFormat::R32Float;
/// Heights for the sampler, in alpha.
const SMOOTH: wgpu::TextureFormat = wgpu::TextureFormat::Rgba16Float;

/// The textures of an array of height maps of one side.
#[derive(Debug)]
pub struct ReliefMaps {
    heights: wgpu::Texture,
    smooth: wgpu::TextureView,
    tops: wgpu::TextureView,
    exact: wgpu::TextureView,
    cones: wgpu::Texture,
    cone_view: wgpu::TextureView,
    has_cones: bool,
    sampler: wgpu::Sampler,
}

impl ReliefMaps {
    /// Finds the bounds of heights that are on the GPU already: `heights` as R32Float with all mip
    /// levels, `smooth` the same in the alpha of a filterable texture. There are no cones yet.
    #[must_use]
    pub fn over(
        device: &wgpu::Device,
        queue: &wgpu::Queue,
        heights: &wgpu::Texture,
        smooth: &wgpu::Texture,
    ) -> Self {
        let sampler = device.create_sampler(&wgpu::SamplerDescriptor {
            label: Some("reliefs"),
            address_mode_u: wgpu::AddressMode::Repeat,
            address_mode_v: wgpu::AddressMode::Repeat,
            mag_filter: wgpu::FilterMode::Linear,
            min_filter: wgpu::FilterMode::Linear,
            ..Default::default()
        });
        let cones = texture(device, "no cones", EXACT, 1, 1, 1, 1);
        let tops = tops(device, queue, heights);
        let [exact, smooth, tops, cone_view] = [heights, smooth, &tops, &cones].map(whole);
        Self { heights: heights.clone(), smooth, tops, exact, cones, cone_view, has_cones: false, sampler }
    }

    /// Uploads maps of one side. The first one's side counts; maps of other sides are left out.
    /// There are no cones yet.
    #[must_use]
    pub fn upload(device: &wgpu::Device, queue: &wgpu::Queue, maps: &[HeightMap]) -> Self {
        let side = maps.first().map_or(1, HeightMap::side) as u32;
        let maps: Vec<&HeightMap> = maps.iter().filter(|map| map.side() == side as usize).collect();
        let layers = (maps.len() as u32).max(1);
        let levels = side.ilog2() + 1;
        let heights = texture(device, "heights", EXACT, side, side, layers, levels);
        let smooth = texture(device, "heights to be filtered", SMOOTH, side, side, layers, levels);
        for (layer, map) in maps.into_iter().enumerate() {
            let layer = layer as u32;
            let mut map = map.clone();
            for level in 0..levels {
                write(queue, &heights, layer, level, map.heights());
                let filtered = |height: &f32| [0, 0, 0, f16::from_f32(*height).to_bits()];
                write(queue, &smooth, layer, level, &map.heights().iter().map(filtered).collect::<Vec<_>>());
                map = map.halved();
            }
        }
        Self::over(device, queue, &heights, &smooth)
    }

    /// Whether cones have been baked. What draws without them walks the pyramid instead.
    #[must_use]
    pub fn has_cones(&self) -> bool {
        self.has_cones
    }

    /// Bakes the cones of some layers, and waits for them. Groups of bindings made before do not
    /// have them.
    pub fn bake_cones(&mut self, device: &wgpu::Device, queue: &wgpu::Queue, layers: &[u32]) {
        self.cones = cones::bake(device, queue, &self.heights, &self.tops, layers);
        self.cone_view = whole(&self.cones);
        self.has_cones = true;
    }

    /// The cones: one picture for each mip level of the heights, as long as a block of theirs is
    /// there.
    #[must_use]
    pub fn cones(&self) -> &wgpu::Texture {
        &self.cones
    }

    /// Layout of its five bindings, from `binding` on: heights, heights to be filtered, bounds,
    /// cones, sampler.
    #[must_use]
    pub const fn layout_entries(
        binding: u32,
        visibility: wgpu::ShaderStages,
    ) -> [wgpu::BindGroupLayoutEntry; 5] {
        const fn texture(
            binding: u32,
            visibility: wgpu::ShaderStages,
            filterable: bool,
        ) -> wgpu::BindGroupLayoutEntry {
            wgpu::BindGroupLayoutEntry {
                binding,
                visibility,
                ty: wgpu::BindingType::Texture {
                    sample_type: wgpu::TextureSampleType::Float { filterable },
                    view_dimension: wgpu::TextureViewDimension::D2Array,
                    multisampled: false,
                },
                count: None,
            }
        }
        [
            texture(binding, visibility, false),
            texture(binding + 1, visibility, true),
            texture(binding + 2, visibility, false),
            texture(binding + 3, visibility, false),
            wgpu::BindGroupLayoutEntry {
                binding: binding + 4,
                visibility,
                ty: wgpu::BindingType::Sampler(wgpu::SamplerBindingType::Filtering),
                count: None,
            },
        ]
    }

    /// Its five bindings.
    #[must_use]
    pub fn entries(&self, binding: u32) -> [wgpu::BindGroupEntry<'_>; 5] {
        let view = |step: u32, view| wgpu::BindGroupEntry {
            binding: binding + step,
            resource: wgpu::BindingResource::TextureView(view),
        };
        [
            view(0, &self.exact),
            view(1, &self.smooth),
            view(2, &self.tops),
            view(3, &self.cone_view),
            wgpu::BindGroupEntry {
                binding: binding + 4,
                resource: wgpu::BindingResource::Sampler(&self.sampler),
            },
        ]
    }
}

pub(super) fn texture(
    device: &wgpu::Device,
    label: &str,
    format: wgpu::TextureFormat,
    width: u32,
    height: u32,
    layers: u32,
    levels: u32,
) -> wgpu::Texture {
    use wgpu::TextureUsages as Usage;
    let stored = if format == EXACT { Usage::STORAGE_BINDING } else { Usage::empty() };
    device.create_texture(&wgpu::TextureDescriptor {
        label: Some(label),
        size: wgpu::Extent3d { width, height, depth_or_array_layers: layers },
        mip_level_count: levels,
        sample_count: 1,
        dimension: wgpu::TextureDimension::D2,
        format,
        usage: Usage::TEXTURE_BINDING | Usage::COPY_DST | Usage::COPY_SRC | stored,
        view_formats: &[],
    })
}

fn write<T: bytemuck::Pod>(
    queue: &wgpu::Queue,
    texture: &wgpu::Texture,
    layer: u32,
    level: u32,
    texels: &[T],
) {
    let (width, height) = (texture.width() >> level, texture.height() >> level);
    queue.write_texture(
        wgpu::TexelCopyTextureInfo {
            texture,
            mip_level: level,
            origin: wgpu::Origin3d { x: 0, y: 0, z: layer },
            aspect: wgpu::TextureAspect::All,
        },
        bytemuck::cast_slice(texels),
        wgpu::TexelCopyBufferLayout {
            offset: 0,
            bytes_per_row: Some(width * size_of::<T>() as u32),
            rows_per_image: Some(height),
        },
        wgpu::Extent3d { width, height, depth_or_array_layers: 1 },
    );
}

pub(super) fn whole(texture: &wgpu::Texture) -> wgpu::TextureView {
    texture.create_view(&wgpu::TextureViewDescriptor {
        dimension: Some(wgpu::TextureViewDimension::D2Array),
        ..Default::default()
    })
}

/// The bounds of all mip levels of heights, laid out as `shared/relief_walk.wesl` reads them.
#[must_use]
pub fn tops(device: &wgpu::Device, queue: &wgpu::Queue, heights: &wgpu::Texture) -> wgpu::Texture {
    let (side, layers) = (heights.width(), heights.depth_or_array_layers());
    let tops = texture(device, "bounds of reliefs", EXACT, side + side / 2, 2 * side, layers, 1);
    let shader = SHADERS.reduce_relief;
    let layout = device.create_bind_group_layout(&wgpu::BindGroupLayoutDescriptor {
        label: Some(shader.name),
        entries: &[
            wgpu::BindGroupLayoutEntry { visibility: wgpu::ShaderStages::COMPUTE, ..uniform_entry(0) },
            ReliefMaps::layout_entries(1, wgpu::ShaderStages::COMPUTE)[0],
            wgpu::BindGroupLayoutEntry {
                binding: 2,
                visibility: wgpu::ShaderStages::COMPUTE,
                ty: wgpu::BindingType::StorageTexture {
                    access: wgpu::StorageTextureAccess::ReadWrite,
                    format: EXACT,
                    view_dimension: wgpu::TextureViewDimension::D2Array,
                },
                count: None,
            },
        ],
    });
    let [pipeline] = compute_pipelines(device, &shader, &[&layout], ["reduce_relief"]);
    let (read, written) = (whole(heights), whole(&tops));
    let mut encoder =
        device.create_command_encoder(&wgpu::CommandEncoderDescriptor { label: Some(shader.name) });
    let mut pass = encoder.begin_compute_pass(&wgpu::ComputePassDescriptor {
        label: Some(shader.name),
        timestamp_writes: None,
    });
    pass.set_pipeline(&pipeline);
    let bits = side.ilog2();
    for (lod, level) in (0..=bits).flat_map(|lod| (0..=bits - lod).map(move |level| (lod, level))) {
        let order = ReliefReduction { side, lod, level, reserved: 0 };
        let order = device.create_buffer_init(&wgpu::util::BufferInitDescriptor {
            label: Some("bounds to find"),
            contents: bytemuck::bytes_of(&order),
            usage: wgpu::BufferUsages::UNIFORM,
        });
        let bindings = device.create_bind_group(&wgpu::BindGroupDescriptor {
            label: Some(shader.name),
            layout: &layout,
            entries: &[
                wgpu::BindGroupEntry { binding: 0, resource: order.as_entire_binding() },
                wgpu::BindGroupEntry { binding: 1, resource: wgpu::BindingResource::TextureView(&read) },
                wgpu::BindGroupEntry { binding: 2, resource: wgpu::BindingResource::TextureView(&written) },
            ],
        });
        pass.set_bind_group(0, &bindings, &[]);
        let groups = (side >> (lod + level)).div_ceil(RELIEF_WORKGROUP);
        pass.dispatch_workgroups(groups, groups, layers);
    }
    drop(pass);
    queue.submit([encoder.finish()]);
    tops
}
