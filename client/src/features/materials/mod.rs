//! Ground materials: procedural sets, baked at start, or custom sets.
//!
//! Owns the textures and their bind group. Reads no files: custom sets are passed as texels.

use crate::features::pom::maps;
use crate::gpu::bind;
use crate::gpu::buffer::create_buffer;
use crate::gpu::pipeline::{compute_pass, compute_pipelines};
use shaders::SHADERS;
use shaders::layout::{BAKE_WORKGROUP, Bake, BakeTexel, MATERIALS, REDUCE_WORKGROUP};
use std::sync::Arc;

/// Texels a side of every set, a power of two. A set covers 4 or 8 metres, so a texel is 8 or 16
/// millimetres.
pub const MATERIAL_SIZE: u32 = 512;

/// Texels of a set.
pub const MATERIAL_TEXELS: usize = (MATERIAL_SIZE * MATERIAL_SIZE) as usize;

const LEVELS: u32 = MATERIAL_SIZE.ilog2() + 1;
const LAYERS: u32 = MATERIALS.len() as u32;

/// Albedo (linear) and height: both are filtered.
pub const COLOUR_FORMAT: wgpu::TextureFormat = wgpu::TextureFormat::Rgba16Float;
/// Normal along u and v (128 is 0), roughness, occlusion.
pub const SHAPE_FORMAT: wgpu::TextureFormat = wgpu::TextureFormat::Rgba8Unorm;
/// Height again, exact and not filterable, for the ray march.
pub const HEIGHT_FORMAT: wgpu::TextureFormat = wgpu::TextureFormat::R32Float;

/// A custom set that replaces a procedural one.
#[derive(Clone, PartialEq)]
pub struct CustomMaterial {
    /// [`MATERIAL_TEXELS`] texels, row by row.
    pub texels: Vec<BakeTexel>,
    /// Whether the texels have normals; else they follow from the heights.
    pub normals_given: bool,
    /// Whether the texels have occlusion; else it follows from the heights.
    pub occlusion_given: bool,
}

impl std::fmt::Debug for CustomMaterial {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "CustomMaterial({} texels)", self.texels.len())
    }
}

/// Custom sets, in the order of [`MATERIALS`]; the procedural set where there is none.
pub type CustomMaterials = Arc<[Option<CustomMaterial>; MATERIALS.len()]>;

/// The textures of all sets.
#[derive(Debug)]
pub struct Materials {
    /// See [`COLOUR_FORMAT`]; a layer for each set, mips down to one texel.
    pub colours: wgpu::Texture,
    /// See [`SHAPE_FORMAT`].
    pub shapes: wgpu::Texture,
    /// See [`HEIGHT_FORMAT`].
    pub heights: wgpu::Texture,
    /// See [`maps::max_mips`].
    pub max_mips: wgpu::Texture,
    layout: wgpu::BindGroupLayout,
    bindings: wgpu::BindGroup,
}

impl Materials {
    /// Bakes all sets. Custom sets of another size than [`MATERIAL_TEXELS`] are skipped.
    /// `anisotropy`: most samples of a filtered texel along the longer axis of a pixel's footprint,
    /// 1 (none) to 16. Drivers filter alike with 1 only.
    #[must_use]
    pub fn new(
        device: &wgpu::Device,
        queue: &wgpu::Queue,
        custom: &CustomMaterials,
        anisotropy: u16,
    ) -> Self {
        let colours = array(device, "material colours", COLOUR_FORMAT);
        let shapes = array(device, "material shapes", SHAPE_FORMAT);
        let heights = array(device, "material heights", HEIGHT_FORMAT);
        bake(device, queue, [&colours, &shapes, &heights], custom);
        reduce(device, queue, [&colours, &shapes, &heights]);
        let max_mips = maps::max_mips(device, queue, &heights);

        let sampler = device.create_sampler(&wgpu::SamplerDescriptor {
            label: Some("materials"),
            address_mode_u: wgpu::AddressMode::Repeat,
            address_mode_v: wgpu::AddressMode::Repeat,
            mag_filter: wgpu::FilterMode::Linear,
            min_filter: wgpu::FilterMode::Linear,
            mipmap_filter: wgpu::MipmapFilterMode::Linear,
            anisotropy_clamp: anisotropy,
            ..Default::default()
        });
        let stages = wgpu::ShaderStages::FRAGMENT | wgpu::ShaderStages::COMPUTE;
        let array = wgpu::TextureViewDimension::D2Array;
        let entries = [
            bind::texture_entry(0, stages, array, true),
            bind::texture_entry(1, stages, array, true),
            bind::sampler_entry(2, stages),
            bind::texture_entry(3, stages, array, false),
            bind::texture_entry(4, stages, array, false),
        ];
        let layout = bind::layout(device, "materials", &entries);
        let views = [&colours, &shapes, &heights, &max_mips]
            .map(|texture| texture.create_view(&wgpu::TextureViewDescriptor::default()));
        let [colour_view, shape_view, height_view, max_view] =
            views.each_ref().map(wgpu::BindingResource::TextureView);
        let sampler = wgpu::BindingResource::Sampler(&sampler);
        let resources = [colour_view, shape_view, sampler, height_view, max_view];
        let bindings = bind::bind(device, "materials", &layout, &resources);
        Self { colours, shapes, heights, max_mips, layout, bindings }
    }

    /// Layout of the bind group: colours, shapes, sampler, exact heights, max mips.
    #[must_use]
    pub fn layout(&self) -> &wgpu::BindGroupLayout {
        &self.layout
    }

    /// The bind group.
    #[must_use]
    pub fn bindings(&self) -> &wgpu::BindGroup {
        &self.bindings
    }
}

fn array(device: &wgpu::Device, label: &str, format: wgpu::TextureFormat) -> wgpu::Texture {
    device.create_texture(&wgpu::TextureDescriptor {
        label: Some(label),
        size: wgpu::Extent3d { width: MATERIAL_SIZE, height: MATERIAL_SIZE, depth_or_array_layers: LAYERS },
        mip_level_count: LEVELS,
        sample_count: 1,
        dimension: wgpu::TextureDimension::D2,
        format,
        usage: wgpu::TextureUsages::TEXTURE_BINDING
            | wgpu::TextureUsages::STORAGE_BINDING
            | wgpu::TextureUsages::COPY_SRC,
        view_formats: &[],
    })
}

/// All layers of one level of a texture.
fn level(texture: &wgpu::Texture, level: u32) -> wgpu::TextureView {
    texture.create_view(&wgpu::TextureViewDescriptor {
        dimension: Some(wgpu::TextureViewDimension::D2Array),
        base_mip_level: level,
        mip_level_count: Some(1),
        ..Default::default()
    })
}

/// Writes the largest level of every set.
fn bake(device: &wgpu::Device, queue: &wgpu::Queue, textures: [&wgpu::Texture; 3], custom: &CustomMaterials) {
    use wgpu::BufferUsages as Usage;
    let buffer = |label, size, usage| create_buffer(device, label, size, usage);
    let order = buffer("material to bake", size_of::<Bake>() as u64, Usage::UNIFORM | Usage::COPY_DST);
    let bytes = (MATERIAL_TEXELS * size_of::<BakeTexel>()) as u64;
    let texels = buffer("texels to bake", bytes, Usage::STORAGE | Usage::COPY_DST);
    let shader = SHADERS.bake_materials;
    let stored = textures.map(wgpu::Texture::format);
    let write = wgpu::StorageTextureAccess::WriteOnly;
    let entries = [
        bind::compute_uniform_entry(0),
        bind::storage_entry(1, wgpu::ShaderStages::COMPUTE, false),
        bind::storage_texture_entry(2, stored[0], write),
        bind::storage_texture_entry(3, stored[1], write),
        bind::storage_texture_entry(4, stored[2], write),
    ];
    let layout = bind::layout(device, shader.name, &entries);
    let views = textures.map(|texture| level(texture, 0));
    let [colours, shapes, heights] = views.each_ref().map(wgpu::BindingResource::TextureView);
    let resources = [order.as_entire_binding(), texels.as_entire_binding(), colours, shapes, heights];
    let bindings = bind::bind(device, shader.name, &layout, &resources);
    let entry_points = ["evaluate_recipe", "derive_and_store"];
    let [evaluate, store] = compute_pipelines(device, &shader, &[&layout], entry_points);
    for (layer, custom) in custom.iter().enumerate() {
        let custom = custom.as_ref().filter(|custom| custom.texels.len() == MATERIAL_TEXELS);
        let bake = Bake {
            layer: layer as u32,
            size: MATERIAL_SIZE,
            normals_given: custom.is_some_and(|custom| custom.normals_given).into(),
            occlusion_given: custom.is_some_and(|custom| custom.occlusion_given).into(),
        };
        queue.write_buffer(&order, 0, bytemuck::bytes_of(&bake));
        if let Some(custom) = custom {
            queue.write_buffer(&texels, 0, bytemuck::cast_slice(&custom.texels));
        }
        let mut encoder = device.create_command_encoder(&wgpu::CommandEncoderDescriptor::default());
        {
            let mut pass = compute_pass(&mut encoder, shader.name);
            pass.set_bind_group(0, &bindings, &[]);
            let columns = MATERIAL_SIZE.div_ceil(BAKE_WORKGROUP);
            if custom.is_none() {
                pass.set_pipeline(&evaluate);
                pass.dispatch_workgroups(columns, MATERIAL_SIZE, 1);
            }
            pass.set_pipeline(&store);
            pass.dispatch_workgroups(columns, MATERIAL_SIZE, 1);
        }
        // One submission each: the next set reuses the buffers.
        queue.submit([encoder.finish()]);
    }
}

/// Computes all further mip levels.
fn reduce(device: &wgpu::Device, queue: &wgpu::Queue, textures: [&wgpu::Texture; 3]) {
    let shader = SHADERS.reduce_materials;
    let stored = textures.map(wgpu::Texture::format);
    let (stages, array) = (wgpu::ShaderStages::COMPUTE, wgpu::TextureViewDimension::D2Array);
    let write = wgpu::StorageTextureAccess::WriteOnly;
    let entries = [
        bind::texture_entry(0, stages, array, false),
        bind::texture_entry(1, stages, array, false),
        bind::texture_entry(2, stages, array, false),
        bind::storage_texture_entry(3, stored[0], write),
        bind::storage_texture_entry(4, stored[1], write),
        bind::storage_texture_entry(5, stored[2], write),
    ];
    let layout = bind::layout(device, shader.name, &entries);
    let [pipeline] = compute_pipelines(device, &shader, &[&layout], ["reduce"]);
    let mut encoder = device.create_command_encoder(&wgpu::CommandEncoderDescriptor::default());
    for below in 1..LEVELS {
        let from = textures.map(|texture| level(texture, below - 1));
        let to = textures.map(|texture| level(texture, below));
        let resources = [&from[0], &from[1], &from[2], &to[0], &to[1], &to[2]];
        let resources = resources.map(wgpu::BindingResource::TextureView);
        let bindings = bind::bind(device, shader.name, &layout, &resources);
        let groups = (MATERIAL_SIZE >> below).div_ceil(REDUCE_WORKGROUP);
        let mut pass = compute_pass(&mut encoder, shader.name);
        pass.set_pipeline(&pipeline);
        pass.set_bind_group(0, &bindings, &[]);
        pass.dispatch_workgroups(groups, groups, LAYERS);
    }
    queue.submit([encoder.finish()]);
}
