//! Indirect draws of visible clumps, one for each level of detail.
//!
//! Owns pipelines and bind groups; the buffers are filled elsewhere.

use crate::gpu::bind;
use crate::gpu::pipeline::{Depth, HDR, HdrPass, Output};
use shaders::layout::{CLUMP_BYTES, GRASS_VERTICES, PREPARED_BYTES, PREPARED_HEAD, TREE_VERTICES};
use shaders::{SHADERS, Shader};
use std::ops::Range;

/// Ids of plants; only checks draw them.
pub const ID_FORMAT: wgpu::TextureFormat = wgpu::TextureFormat::Rg32Uint;

/// A plant species.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Species {
    /// Clumps of blades.
    Grass,
    /// Trees.
    Tree,
}

impl Species {
    /// Number of the species in [`shaders::layout::Field::kind`].
    #[must_use]
    pub fn kind(self) -> u32 {
        match self {
            Self::Grass => shaders::layout::KIND_GRASS,
            Self::Tree => shaders::layout::KIND_TREES,
        }
    }

    /// Vertices of a clump at each level of detail, finest first, for the indirect arguments.
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

    /// Entry points that draw a level of detail, in place of a shader's usual ones: of trees, the
    /// last level is impostors. Leaves and impostors cover each of several samples by itself.
    fn entry_points(self, level: usize, samples: u32) -> [Option<&'static str>; 2] {
        match (self, level) {
            (Self::Tree, 2) if samples > 1 => [Some("far_vertex"), Some("sampled_far_fragment")],
            (Self::Tree, 2) => [Some("far_vertex"), Some("far_fragment")],
            (Self::Tree, _) if samples > 1 => [None, Some("sampled_fragment")],
            _ => [None, None],
        }
    }

    fn topology(self, level: usize) -> wgpu::PrimitiveTopology {
        match (self, level) {
            (Self::Grass, 0) => wgpu::PrimitiveTopology::TriangleStrip,
            _ => wgpu::PrimitiveTopology::TriangleList,
        }
    }
}

/// Buffers of the visible clumps of one species.
#[derive(Clone, Debug)]
pub struct VisibleClumps {
    /// The species.
    pub species: Species,
    /// The [`shaders::layout::Field`].
    pub field: wgpu::Buffer,
    /// The [`shaders::layout::OcclusionNode`]s of the grid; usage `STORAGE`.
    pub tiles: wgpu::Buffer,
    /// The [`shaders::layout::OccluderChunk`]s under them; usage `STORAGE`.
    pub leaves: wgpu::Buffer,
    /// Clumps of [`CLUMP_BYTES`] each; usage `VERTEX` and `STORAGE`.
    pub clumps: wgpu::Buffer,
    /// What is prepared for each, [`PREPARED_BYTES`], after [`PREPARED_HEAD`] of them; usage
    /// `VERTEX`, `STORAGE` and `COPY_DST`.
    pub prepared: wgpu::Buffer,
    /// The region of `clumps`, in clumps, of each level of detail, finest first.
    pub regions: Vec<Range<u32>>,
    /// Four words for each level of detail: vertices, clumps, 0, 0; usage `INDIRECT`.
    pub arguments: wgpu::Buffer,
    /// Their offset, bytes.
    pub arguments_at: u64,
}

/// Bytes of the arguments of one indirect draw.
const ARGUMENT_BYTES: u64 = 16;

/// The draw pass of one species.
#[derive(Debug)]
pub struct ClumpPass {
    shader: &'static Shader,
    /// One for each level of detail.
    pipelines: Vec<wgpu::RenderPipeline>,
    layout: wgpu::BindGroupLayout,
}

impl ClumpPass {
    /// The pass that draws the light of a species.
    #[must_use]
    pub fn new(device: &wgpu::Device, species: Species, samples: u32) -> Self {
        Self::with_shader(device, species, species.shader(), HDR, samples)
    }

    /// The pass that draws the IDs of a species, one sample per pixel; for checks.
    #[must_use]
    pub fn ids(device: &wgpu::Device, species: Species) -> Self {
        let vertex = match species {
            Species::Grass => "grass_vertex",
            Species::Tree => "tree_vertex",
        };
        let output = Output { vertex: Some(vertex), fragment: None, format: Some(ID_FORMAT) };
        Self::with_shader(device, species, &SHADERS.draw_plant_ids, output, 1)
    }

    fn with_shader(
        device: &wgpu::Device,
        species: Species,
        shader: &'static Shader,
        output: Output<'_>,
        samples: u32,
    ) -> Self {
        let layout = bind::layout(device, shader.name, &[bind::uniform_entry(0), bind::uniform_entry(1)]);
        let [words, prepared] =
            [wgpu::vertex_attr_array![0 => Uint32x4], wgpu::vertex_attr_array![1 => Uint32x4]];
        let instances = |bytes: usize, attributes| {
            let step_mode = wgpu::VertexStepMode::Instance;
            Some(wgpu::VertexBufferLayout { array_stride: bytes as u64, step_mode, attributes })
        };
        let buffers = [instances(CLUMP_BYTES, &words), instances(PREPARED_BYTES, &prepared)];
        let pass = HdrPass { shader, layouts: &[&layout], buffers: &buffers, depth: Depth::Solid, samples };
        let levels = 0..species.vertices().len();
        let pipelines = levels.map(|level| {
            let [vertex, fragment] = species.entry_points(level, samples);
            let output =
                Output { vertex: vertex.or(output.vertex), fragment: fragment.or(output.fragment), ..output };
            pass.clump_pipeline(device, output, species.topology(level), level)
        });
        let pipelines = pipelines.collect();
        Self { shader, pipelines, layout }
    }

    /// The bind group of these buffers.
    #[must_use]
    pub fn bind(
        &self,
        device: &wgpu::Device,
        frame: &wgpu::Buffer,
        clumps: &VisibleClumps,
    ) -> wgpu::BindGroup {
        bind::bind_buffers(device, self.shader.name, &self.layout, &[frame, &clumps.field])
    }

    /// Draws the clumps that the buffers hold when the commands run; `bindings` must be of these
    /// buffers.
    pub fn draw(&self, pass: &mut wgpu::RenderPass<'_>, bindings: &wgpu::BindGroup, clumps: &VisibleClumps) {
        pass.set_bind_group(0, bindings, &[]);
        for (level, (pipeline, region)) in self.pipelines.iter().zip(&clumps.regions).enumerate() {
            pass.set_pipeline(pipeline);
            let slots = [(&clumps.clumps, 0, CLUMP_BYTES), (&clumps.prepared, PREPARED_HEAD, PREPARED_BYTES)];
            for (slot, (buffer, head, bytes)) in slots.into_iter().enumerate() {
                let [start, end] =
                    [region.start, region.end].map(|clump| (head as u64 + u64::from(clump)) * bytes as u64);
                pass.set_vertex_buffer(slot as u32, buffer.slice(start..end));
            }
            pass.draw_indirect(&clumps.arguments, clumps.arguments_at + level as u64 * ARGUMENT_BYTES);
        }
    }
}
