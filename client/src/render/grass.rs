//! The passes that draw plants: what culling has kept of a field of clumps, one indirect draw for
//! each level of detail.
//!
//! Owns pipelines and bindings. The buffers belong to whoever fills them; nothing here looks into
//! them.

use crate::render::pipeline::{Depth, LightPass, Output, storage_entry, uniform_entry};
use crate::render::pool::ChunkPool;
use shaders::layout::{CLUMP_BYTES, GRASS_VERTICES, TREE_VERTICES};
use shaders::{SHADERS, Shader};
use std::ops::Range;

/// What grows.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Plant {
    /// Clumps of three tapered quads.
    Grass,
    /// Conifers.
    Tree,
}

impl Plant {
    /// Number of the kind in [`shaders::layout::Field::kind`].
    #[must_use]
    pub fn kind(self) -> u32 {
        match self {
            Self::Grass => shaders::layout::KIND_GRASS,
            Self::Tree => shaders::layout::KIND_TREES,
        }
    }

    /// Vertices of a clump at each level of detail, finest first: what the arguments of the draws
    /// have to say.
    #[must_use]
    pub fn vertices(self) -> &'static [u32] {
        match self {
            Self::Grass => &GRASS_VERTICES,
            Self::Tree => &TREE_VERTICES,
        }
    }

    fn shader(self) -> &'static Shader {
        match self {
            Self::Grass => &SHADERS.draw_grass,
            Self::Tree => &SHADERS.draw_trees,
        }
    }

    fn topology(self, level: usize) -> wgpu::PrimitiveTopology {
        match (self, level) {
            (Self::Grass, 0) => wgpu::PrimitiveTopology::TriangleStrip,
            _ => wgpu::PrimitiveTopology::TriangleList,
        }
    }
}

/// Buffers with what culling has kept of one field.
#[derive(Clone, Debug)]
pub struct KeptClumps {
    /// What grows.
    pub plant: Plant,
    /// The [`shaders::layout::Field`].
    pub field: wgpu::Buffer,
    /// The [`shaders::layout::Tile`]s of the square that clumps are counted in; usage `STORAGE`.
    pub tiles: wgpu::Buffer,
    /// The [`shaders::layout::Leaf`]s under them; usage `STORAGE`.
    pub leaves: wgpu::Buffer,
    /// Clumps of [`CLUMP_BYTES`] each; usage `VERTEX`.
    pub clumps: wgpu::Buffer,
    /// The part of `clumps`, in clumps, that each level of detail has for itself, finest first.
    pub regions: Vec<Range<u32>>,
    /// Four words for each level of detail: vertices, clumps, 0, 0; usage `INDIRECT`.
    pub arguments: wgpu::Buffer,
    /// Where they begin in it, bytes.
    pub arguments_at: u64,
}

/// Bytes of the arguments of one indirect draw.
const ARGUMENT_BYTES: u64 = 16;

/// The pass that draws fields of one kind.
#[derive(Debug)]
pub struct PlantPass {
    shader: &'static Shader,
    /// One for each level of detail.
    pipelines: Vec<wgpu::RenderPipeline>,
    layout: wgpu::BindGroupLayout,
}

impl PlantPass {
    /// The pass for plants of a kind.
    #[must_use]
    pub fn new(device: &wgpu::Device, plant: Plant, output: Output<'_>, samples: u32) -> Self {
        let shader = plant.shader();
        let layout = device.create_bind_group_layout(&wgpu::BindGroupLayoutDescriptor {
            label: Some(shader.name),
            entries: &[
                uniform_entry(0),
                uniform_entry(1),
                storage_entry(2, wgpu::ShaderStages::VERTEX, true),
                storage_entry(3, wgpu::ShaderStages::VERTEX, true),
                storage_entry(4, wgpu::ShaderStages::VERTEX, true),
            ],
        });
        let buffers = [Some(wgpu::VertexBufferLayout {
            array_stride: CLUMP_BYTES as u64,
            step_mode: wgpu::VertexStepMode::Instance,
            attributes: &wgpu::vertex_attr_array![0 => Uint32x4],
        })];
        let pass = LightPass { shader, layouts: &[&layout], buffers: &buffers, depth: Depth::Solid, samples };
        let levels = 0..plant.vertices().len();
        let pipelines = levels
            .map(|level| pass.pipeline_of_leaves(device, output, plant.topology(level), level))
            .collect();
        Self { shader, pipelines, layout }
    }

    /// What drawing these clumps reads.
    #[must_use]
    pub fn bind(
        &self,
        device: &wgpu::Device,
        frame: &wgpu::Buffer,
        pool: &ChunkPool,
        kept: &KeptClumps,
    ) -> wgpu::BindGroup {
        device.create_bind_group(&wgpu::BindGroupDescriptor {
            label: Some(self.shader.name),
            layout: &self.layout,
            entries: &[
                wgpu::BindGroupEntry { binding: 0, resource: frame.as_entire_binding() },
                wgpu::BindGroupEntry { binding: 1, resource: kept.field.as_entire_binding() },
                wgpu::BindGroupEntry { binding: 2, resource: kept.tiles.as_entire_binding() },
                wgpu::BindGroupEntry { binding: 3, resource: kept.leaves.as_entire_binding() },
                wgpu::BindGroupEntry { binding: 4, resource: pool.clearances().as_entire_binding() },
            ],
        })
    }

    /// Draws the clumps that the buffers hold when the commands run; `bindings` are theirs.
    pub fn draw(&self, pass: &mut wgpu::RenderPass<'_>, bindings: &wgpu::BindGroup, kept: &KeptClumps) {
        pass.set_bind_group(0, bindings, &[]);
        for (level, (pipeline, region)) in self.pipelines.iter().zip(&kept.regions).enumerate() {
            let [start, end] = [region.start, region.end].map(|clump| u64::from(clump) * CLUMP_BYTES as u64);
            pass.set_pipeline(pipeline);
            pass.set_vertex_buffer(0, kept.clumps.slice(start..end));
            pass.draw_indirect(&kept.arguments, kept.arguments_at + level as u64 * ARGUMENT_BYTES);
        }
    }
}
