//! Textures of parallax occlusion mapping: heights twice (exact, and filterable), max mips, cones.

use crate::features::pom::cone_bake::ConeBake;
use crate::features::pom::height_map::HeightMap;
use crate::features::pom::textures::{UNFILTERED_FORMAT, texture, whole};
use crate::gpu::bind;
use crate::gpu::pipeline::{compute_pass, compute_pipelines};
use crate::gpu::{Gpu, GpuError};
use half::f16;
use shaders::SHADERS;
use shaders::layout::{MAX_MIP_WORKGROUP, MaxMipReduction};
use wgpu::util::DeviceExt as _;

/// Filterable heights, in alpha.
const FILTERED_FORMAT: wgpu::TextureFormat = wgpu::TextureFormat::Rgba16Float;

/// Textures of an array of height maps of one size.
#[derive(Debug)]
pub struct PomMaps {
    heights: wgpu::Texture,
    smooth: wgpu::TextureView,
    max_mips: wgpu::TextureView,
    exact: wgpu::TextureView,
    cones: wgpu::Texture,
    cone_view: wgpu::TextureView,
    has_cones: bool,
    sampler: wgpu::Sampler,
}

impl PomMaps {
    /// Maps over textures: `heights` as R32Float with all mip levels, `smooth` the same in the
    /// alpha of a filterable texture, and the [`max_mips`] of the heights. Without cones.
    #[must_use]
    pub fn over(
        device: &wgpu::Device,
        heights: &wgpu::Texture,
        smooth: &wgpu::Texture,
        max_mips: &wgpu::Texture,
    ) -> Self {
        let sampler = device.create_sampler(&wgpu::SamplerDescriptor {
            label: Some("parallax maps"),
            address_mode_u: wgpu::AddressMode::Repeat,
            address_mode_v: wgpu::AddressMode::Repeat,
            mag_filter: wgpu::FilterMode::Linear,
            min_filter: wgpu::FilterMode::Linear,
            ..Default::default()
        });
        let cones = texture(device, "no cones", UNFILTERED_FORMAT, 1, 1, 1, 1);
        let [exact, smooth, max_mips, cone_view] = [heights, smooth, max_mips, &cones].map(whole);
        Self {
            heights: heights.clone(),
            smooth,
            max_mips,
            exact,
            cones,
            cone_view,
            has_cones: false,
            sampler,
        }
    }

    /// Uploads maps of one size; the first one sets the size, maps of other sizes are skipped.
    /// Without cones.
    #[must_use]
    pub fn upload(device: &wgpu::Device, queue: &wgpu::Queue, maps: &[HeightMap]) -> Self {
        let side = maps.first().map_or(1, HeightMap::side) as u32;
        let maps: Vec<&HeightMap> = maps.iter().filter(|map| map.side() == side as usize).collect();
        let layers = (maps.len() as u32).max(1);
        let levels = side.ilog2() + 1;
        let heights = texture(device, "heights", UNFILTERED_FORMAT, side, side, layers, levels);
        let smooth = texture(device, "filterable heights", FILTERED_FORMAT, side, side, layers, levels);
        for (layer, map) in maps.into_iter().enumerate() {
            let layer = layer as u32;
            let mut map = map.clone();
            for level in 0..levels {
                write(queue, &heights, layer, level, map.heights());
                let filtered = |height: &f32| [0, 0, 0, f16::from_f32(*height).to_bits()];
                write(queue, &smooth, layer, level, &map.heights().iter().map(filtered).collect::<Vec<_>>());
                map = map.next_mip();
            }
        }
        Self::over(device, &heights, &smooth, &max_mips(device, queue, &heights))
    }

    /// Whether cones have been baked. Shaders use the max mips instead where they are not.
    #[must_use]
    pub fn has_cones(&self) -> bool {
        self.has_cones
    }

    /// Starts to bake the cones of some layers, for [`PomMaps::set_cones`].
    #[must_use]
    pub fn start_cones(&self, device: &wgpu::Device, layers: &[u32]) -> ConeBake {
        ConeBake::start(device, &self.heights, &self.max_mips, layers)
    }

    /// Takes baked cones. Bind groups created before do not see them.
    pub fn set_cones(&mut self, baked: ConeBake) {
        self.cones = baked.result();
        self.cone_view = whole(&self.cones);
        self.has_cones = true;
    }

    /// Bakes the cones of some layers, and waits for them.
    ///
    /// # Errors
    /// The device is lost.
    pub fn bake_cones(&mut self, gpu: &Gpu, layers: &[u32]) -> Result<(), GpuError> {
        let mut bake = self.start_cones(&gpu.device, layers);
        while !bake.poll(&gpu.device, &gpu.queue)? {
            gpu.wait()?;
        }
        self.set_cones(bake);
        Ok(())
    }

    /// The cones, one mip level for each mip level of the heights that has whole blocks.
    #[must_use]
    pub fn cones(&self) -> &wgpu::Texture {
        &self.cones
    }

    /// Layout of its five bindings, from `binding` on: heights, filterable heights, max mips,
    /// cones, sampler.
    #[must_use]
    pub const fn layout_entries(
        binding: u32,
        visibility: wgpu::ShaderStages,
    ) -> [wgpu::BindGroupLayoutEntry; 5] {
        let array = wgpu::TextureViewDimension::D2Array;
        [
            bind::texture_entry(binding, visibility, array, false),
            bind::texture_entry(binding + 1, visibility, array, true),
            bind::texture_entry(binding + 2, visibility, array, false),
            bind::texture_entry(binding + 3, visibility, array, false),
            bind::sampler_entry(binding + 4, visibility),
        ]
    }

    /// Its five bindings, in the order of [`PomMaps::layout_entries`].
    #[must_use]
    pub fn resources(&self) -> [wgpu::BindingResource<'_>; 5] {
        let view = wgpu::BindingResource::TextureView;
        let sampler = wgpu::BindingResource::Sampler(&self.sampler);
        [view(&self.exact), view(&self.smooth), view(&self.max_mips), view(&self.cone_view), sampler]
    }

    /// Its five bindings as entries, from `binding` on.
    #[must_use]
    pub fn entries(&self, binding: u32) -> [wgpu::BindGroupEntry<'_>; 5] {
        let mut next = binding;
        self.resources().map(|resource| {
            next += 1;
            wgpu::BindGroupEntry { binding: next - 1, resource }
        })
    }
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

/// Where the bounds of a level of a mip level begin; `max_mip_corner` of
/// `shared/max_mip_traversal.wesl`.
const fn max_mip_corner(map_side: u32, lod: u32, level: u32) -> wgpu::Origin3d {
    let side = map_side >> lod;
    let south = 2 * (map_side - side);
    if level == 0 {
        return wgpu::Origin3d { x: 0, y: south, z: 0 };
    }
    wgpu::Origin3d { x: side, y: south + side - 2 * (side >> level), z: 0 }
}

/// The max mips of all mip levels of heights (maximum mipmaps: Tevs, Ihrke, Seidel, "Maximum
/// Mipmaps for Fast, Accurate, and Scalable Dynamic Height Field Rendering", I3D 2008), in the
/// layout that the shader reads.
#[must_use]
pub fn max_mips(device: &wgpu::Device, queue: &wgpu::Queue, heights: &wgpu::Texture) -> wgpu::Texture {
    let (side, layers) = (heights.width(), heights.depth_or_array_layers());
    let [max_mips, found] = ["max mips", "new max mips"]
        .map(|label| texture(device, label, UNFILTERED_FORMAT, side + side / 2, 2 * side, layers, 1));
    let shader = SHADERS.reduce_max_mip;
    let entries = [
        bind::compute_uniform_entry(0),
        PomMaps::layout_entries(1, wgpu::ShaderStages::COMPUTE)[0],
        bind::texture_entry(2, wgpu::ShaderStages::COMPUTE, wgpu::TextureViewDimension::D2Array, false),
        bind::storage_texture_entry(3, UNFILTERED_FORMAT, wgpu::StorageTextureAccess::WriteOnly),
    ];
    let layout = bind::layout(device, shader.name, &entries);
    let [pipeline] = compute_pipelines(device, &shader, &[&layout], ["reduce_max_mip"]);
    let [heights, finer, written] = [heights, &max_mips, &found].map(whole);
    let mut encoder =
        device.create_command_encoder(&wgpu::CommandEncoderDescriptor { label: Some(shader.name) });
    let bits = side.ilog2();
    for (lod, level) in (0..=bits).flat_map(|lod| (0..=bits - lod).map(move |level| (lod, level))) {
        let order = MaxMipReduction { side, lod, level, reserved: 0 };
        let order = device.create_buffer_init(&wgpu::util::BufferInitDescriptor {
            label: Some("max mips to compute"),
            contents: bytemuck::bytes_of(&order),
            usage: wgpu::BufferUsages::UNIFORM,
        });
        let view = wgpu::BindingResource::TextureView;
        let resources = [order.as_entire_binding(), view(&heights), view(&finer), view(&written)];
        let bindings = bind::bind(device, shader.name, &layout, &resources);
        let bounds = side >> (lod + level);
        let mut pass = compute_pass(&mut encoder, shader.name);
        pass.set_pipeline(&pipeline);
        pass.set_bind_group(0, &bindings, &[]);
        let groups = bounds.div_ceil(MAX_MIP_WORKGROUP);
        pass.dispatch_workgroups(groups, groups, layers);
        drop(pass);
        let origin = max_mip_corner(side, lod, level);
        let copy = |texture| wgpu::TexelCopyTextureInfo {
            texture,
            mip_level: 0,
            origin,
            aspect: wgpu::TextureAspect::All,
        };
        let extent = wgpu::Extent3d { width: bounds, height: bounds, depth_or_array_layers: layers };
        encoder.copy_texture_to_texture(copy(&found), copy(&max_mips), extent);
    }
    queue.submit([encoder.finish()]);
    max_mips
}
