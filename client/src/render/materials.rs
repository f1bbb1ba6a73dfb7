//! The materials of the land: procedural sets, baked once at start, or the sets that a user brings.
//!
//! Owns the textures and their group of bindings. Reads no files: a user's set comes as texels.

use crate::render::pipeline::compute_pipelines;
use crate::render::relief;
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
/// Height once more, exact and not filterable: for what marches along it.
pub const HEIGHT_FORMAT: wgpu::TextureFormat = wgpu::TextureFormat::R32Float;

/// Most samples along the longer side of a pixel's footprint. On a software driver 1: there each of
/// them costs as much as the whole pixel.
const ANISOTROPY: u16 = 8;

/// A set that replaces a procedural one.
#[derive(Clone, PartialEq)]
pub struct OwnMaterial {
    /// [`MATERIAL_TEXELS`] texels, row by row.
    pub texels: Vec<BakeTexel>,
    /// Whether the texels have normals; else they follow from the heights.
    pub normals_given: bool,
    /// Whether the texels have occlusion; else it follows from the heights.
    pub occlusion_given: bool,
}

impl std::fmt::Debug for OwnMaterial {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "OwnMaterial({} texels)", self.texels.len())
    }
}

/// A user's sets, in the order of [`MATERIALS`]; the procedural set where there is none.
pub type OwnMaterials = Arc<[Option<OwnMaterial>; MATERIALS.len()]>;

/// The textures of all sets.
#[derive(Debug)]
pub struct Materials {
    /// See [`COLOUR_FORMAT`]; a layer for each set, mips down to one texel.
    pub colours: wgpu::Texture,
    /// See [`SHAPE_FORMAT`].
    pub shapes: wgpu::Texture,
    /// See [`HEIGHT_FORMAT`].
    pub heights: wgpu::Texture,
    layout: wgpu::BindGroupLayout,
    bindings: wgpu::BindGroup,
}

impl Materials {
    /// Bakes all sets. An own set of another size than [`MATERIAL_TEXELS`] is left out. `software`:
    /// the driver has no GPU.
    #[must_use]
    pub fn new(device: &wgpu::Device, queue: &wgpu::Queue, own: &OwnMaterials, software: bool) -> Self {
        let colours = array(device, "material colours", COLOUR_FORMAT);
        let shapes = array(device, "material shapes", SHAPE_FORMAT);
        let heights = array(device, "material heights", HEIGHT_FORMAT);
        bake(device, queue, [&colours, &shapes, &heights], own);
        reduce(device, queue, [&colours, &shapes, &heights]);
        let tops = relief::tops(device, queue, &heights);

        let sampler = device.create_sampler(&wgpu::SamplerDescriptor {
            label: Some("materials"),
            address_mode_u: wgpu::AddressMode::Repeat,
            address_mode_v: wgpu::AddressMode::Repeat,
            mag_filter: wgpu::FilterMode::Linear,
            min_filter: wgpu::FilterMode::Linear,
            mipmap_filter: wgpu::MipmapFilterMode::Linear,
            anisotropy_clamp: if software { 1 } else { ANISOTROPY },
            ..Default::default()
        });
        let texture = |binding, filterable| wgpu::BindGroupLayoutEntry {
            binding,
            visibility: wgpu::ShaderStages::FRAGMENT | wgpu::ShaderStages::COMPUTE,
            ty: wgpu::BindingType::Texture {
                sample_type: wgpu::TextureSampleType::Float { filterable },
                view_dimension: wgpu::TextureViewDimension::D2Array,
                multisampled: false,
            },
            count: None,
        };
        let layout = device.create_bind_group_layout(&wgpu::BindGroupLayoutDescriptor {
            label: Some("materials"),
            entries: &[
                texture(0, true),
                texture(1, true),
                texture(3, false),
                texture(4, false),
                wgpu::BindGroupLayoutEntry {
                    binding: 2,
                    visibility: wgpu::ShaderStages::FRAGMENT | wgpu::ShaderStages::COMPUTE,
                    ty: wgpu::BindingType::Sampler(wgpu::SamplerBindingType::Filtering),
                    count: None,
                },
            ],
        });
        let view = |texture: &wgpu::Texture| texture.create_view(&wgpu::TextureViewDescriptor::default());
        let bindings = device.create_bind_group(&wgpu::BindGroupDescriptor {
            label: Some("materials"),
            layout: &layout,
            entries: &[
                wgpu::BindGroupEntry {
                    binding: 0,
                    resource: wgpu::BindingResource::TextureView(&view(&colours)),
                },
                wgpu::BindGroupEntry {
                    binding: 1,
                    resource: wgpu::BindingResource::TextureView(&view(&shapes)),
                },
                wgpu::BindGroupEntry { binding: 2, resource: wgpu::BindingResource::Sampler(&sampler) },
                view_entry(3, &view(&heights)),
                view_entry(4, &view(&tops)),
            ],
        });
        Self { colours, shapes, heights, layout, bindings }
    }

    /// Layout of the group: colours, shapes, sampler, exact heights, the bounds that their relief
    /// is walked by.
    #[must_use]
    pub fn layout(&self) -> &wgpu::BindGroupLayout {
        &self.layout
    }

    /// The group.
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
fn bake(device: &wgpu::Device, queue: &wgpu::Queue, textures: [&wgpu::Texture; 3], own: &OwnMaterials) {
    use wgpu::BufferUsages as Usage;
    let buffer = |label, size, usage| {
        device.create_buffer(&wgpu::BufferDescriptor {
            label: Some(label),
            size,
            usage,
            mapped_at_creation: false,
        })
    };
    let order = buffer("material to bake", size_of::<Bake>() as u64, Usage::UNIFORM | Usage::COPY_DST);
    let bytes = (MATERIAL_TEXELS * size_of::<BakeTexel>()) as u64;
    let texels = buffer("texels to bake", bytes, Usage::STORAGE | Usage::COPY_DST);
    let shader = SHADERS.bake_materials;
    let layout = device.create_bind_group_layout(&wgpu::BindGroupLayoutDescriptor {
        label: Some(shader.name),
        entries: &[
            compute_entry(0, buffer_type(wgpu::BufferBindingType::Uniform)),
            compute_entry(1, buffer_type(wgpu::BufferBindingType::Storage { read_only: false })),
            compute_entry(2, stored(textures[0])),
            compute_entry(3, stored(textures[1])),
            compute_entry(4, stored(textures[2])),
        ],
    });
    let views = textures.map(|texture| level(texture, 0));
    let bindings = device.create_bind_group(&wgpu::BindGroupDescriptor {
        label: Some(shader.name),
        layout: &layout,
        entries: &[
            wgpu::BindGroupEntry { binding: 0, resource: order.as_entire_binding() },
            wgpu::BindGroupEntry { binding: 1, resource: texels.as_entire_binding() },
            view_entry(2, &views[0]),
            view_entry(3, &views[1]),
            view_entry(4, &views[2]),
        ],
    });
    let [grow, settle] = compute_pipelines(device, &shader, &[&layout], ["grow", "settle"]);
    for (layer, own) in own.iter().enumerate() {
        let own = own.as_ref().filter(|own| own.texels.len() == MATERIAL_TEXELS);
        let bake = Bake {
            layer: layer as u32,
            size: MATERIAL_SIZE,
            normals_given: own.is_some_and(|own| own.normals_given).into(),
            occlusion_given: own.is_some_and(|own| own.occlusion_given).into(),
        };
        queue.write_buffer(&order, 0, bytemuck::bytes_of(&bake));
        if let Some(own) = own {
            queue.write_buffer(&texels, 0, bytemuck::cast_slice(&own.texels));
        }
        let mut encoder = device.create_command_encoder(&wgpu::CommandEncoderDescriptor::default());
        {
            let mut pass = encoder.begin_compute_pass(&wgpu::ComputePassDescriptor {
                label: Some(shader.name),
                timestamp_writes: None,
            });
            pass.set_bind_group(0, &bindings, &[]);
            let columns = MATERIAL_SIZE.div_ceil(BAKE_WORKGROUP);
            if own.is_none() {
                pass.set_pipeline(&grow);
                pass.dispatch_workgroups(columns, MATERIAL_SIZE, 1);
            }
            pass.set_pipeline(&settle);
            pass.dispatch_workgroups(columns, MATERIAL_SIZE, 1);
        }
        // One submission each: the next set is written to the same buffers.
        queue.submit([encoder.finish()]);
    }
}

/// Makes all further levels.
fn reduce(device: &wgpu::Device, queue: &wgpu::Queue, textures: [&wgpu::Texture; 3]) {
    let shader = SHADERS.reduce_materials;
    let read = wgpu::BindingType::Texture {
        sample_type: wgpu::TextureSampleType::Float { filterable: false },
        view_dimension: wgpu::TextureViewDimension::D2Array,
        multisampled: false,
    };
    let layout = device.create_bind_group_layout(&wgpu::BindGroupLayoutDescriptor {
        label: Some(shader.name),
        entries: &[
            compute_entry(0, read),
            compute_entry(1, read),
            compute_entry(2, read),
            compute_entry(3, stored(textures[0])),
            compute_entry(4, stored(textures[1])),
            compute_entry(5, stored(textures[2])),
        ],
    });
    let [pipeline] = compute_pipelines(device, &shader, &[&layout], ["reduce"]);
    let mut encoder = device.create_command_encoder(&wgpu::CommandEncoderDescriptor::default());
    for below in 1..LEVELS {
        let from = textures.map(|texture| level(texture, below - 1));
        let to = textures.map(|texture| level(texture, below));
        let bindings = device.create_bind_group(&wgpu::BindGroupDescriptor {
            label: Some(shader.name),
            layout: &layout,
            entries: &[
                view_entry(0, &from[0]),
                view_entry(1, &from[1]),
                view_entry(2, &from[2]),
                view_entry(3, &to[0]),
                view_entry(4, &to[1]),
                view_entry(5, &to[2]),
            ],
        });
        let groups = (MATERIAL_SIZE >> below).div_ceil(REDUCE_WORKGROUP);
        let mut pass = encoder.begin_compute_pass(&wgpu::ComputePassDescriptor {
            label: Some(shader.name),
            timestamp_writes: None,
        });
        pass.set_pipeline(&pipeline);
        pass.set_bind_group(0, &bindings, &[]);
        pass.dispatch_workgroups(groups, groups, LAYERS);
    }
    queue.submit([encoder.finish()]);
}

fn compute_entry(binding: u32, ty: wgpu::BindingType) -> wgpu::BindGroupLayoutEntry {
    wgpu::BindGroupLayoutEntry { binding, visibility: wgpu::ShaderStages::COMPUTE, ty, count: None }
}

fn buffer_type(ty: wgpu::BufferBindingType) -> wgpu::BindingType {
    wgpu::BindingType::Buffer { ty, has_dynamic_offset: false, min_binding_size: None }
}

fn stored(texture: &wgpu::Texture) -> wgpu::BindingType {
    wgpu::BindingType::StorageTexture {
        access: wgpu::StorageTextureAccess::WriteOnly,
        format: texture.format(),
        view_dimension: wgpu::TextureViewDimension::D2Array,
    }
}

fn view_entry(binding: u32, view: &wgpu::TextureView) -> wgpu::BindGroupEntry<'_> {
    wgpu::BindGroupEntry { binding, resource: wgpu::BindingResource::TextureView(view) }
}
