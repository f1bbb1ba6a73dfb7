//! Preparation of the visible clumps: what is the same for all vertices of a clump, once a frame.

use crate::features::terrain::pool::ChunkPool;
use crate::features::vegetation::draw::{Species, VisibleClumps};
use crate::features::vegetation::tree_cells::TreeCells;
use crate::gpu::bind::{self, storage_entry};
use crate::gpu::pipeline::{compute_pass, compute_pipelines};
use shaders::layout::{INDIRECT_PREPARE, INDIRECT_WORDS};
use shaders::{SHADERS, Shader};

/// The pass that prepares the clumps of one species.
#[derive(Debug)]
pub struct PreparePass {
    shader: &'static Shader,
    pipeline: wgpu::ComputePipeline,
    layout: wgpu::BindGroupLayout,
    species: Species,
}

impl PreparePass {
    /// The pass of a species.
    #[must_use]
    pub fn new(device: &wgpu::Device, species: Species) -> Self {
        let (shader, entry_point) = match species {
            Species::Grass => (&SHADERS.prepare_grass, "prepare_grass"),
            Species::Tree => (&SHADERS.prepare_trees, "prepare_trees"),
        };
        let compute = wgpu::ShaderStages::COMPUTE;
        let read = |binding| storage_entry(binding, compute, true);
        let entries = [
            bind::compute_uniform_entry(0),
            bind::compute_uniform_entry(1),
            read(2),
            read(3),
            read(4),
            read(8),
            read(own_binding(species)),
            read(11),
            storage_entry(12, compute, false),
        ];
        let layout = bind::layout(device, shader.name, &entries);
        let [pipeline] = compute_pipelines(device, shader, &[&layout], [entry_point]);
        Self { shader, pipeline, layout, species }
    }

    /// The bind group of these buffers.
    #[must_use]
    pub fn bind(
        &self,
        device: &wgpu::Device,
        frame: &wgpu::Buffer,
        pool: &ChunkPool,
        trees: &TreeCells,
        clumps: &VisibleClumps,
    ) -> wgpu::BindGroup {
        let own = match self.species {
            Species::Grass => trees.marks(),
            Species::Tree => trees.lights(),
        };
        let buffers = [
            (0, frame),
            (1, &clumps.field),
            (2, &clumps.tiles),
            (3, &clumps.leaves),
            (4, pool.sun_clearances()),
            (8, trees.cells()),
            (own_binding(self.species), own),
            (11, &clumps.clumps),
            (12, &clumps.prepared),
        ];
        bind::bind_numbered(device, self.shader.name, &self.layout, &buffers)
    }

    /// Records the preparation of the clumps that the buffers hold, after the culling and the
    /// placing of trees.
    pub fn record(
        &self,
        bindings: &wgpu::BindGroup,
        clumps: &VisibleClumps,
        encoder: &mut wgpu::CommandEncoder,
    ) {
        // A copy of the arguments: eight storage buffers would be all that a browser has.
        let arguments = &clumps.arguments;
        encoder.copy_buffer_to_buffer(arguments, 0, &clumps.prepared, 0, 4 * INDIRECT_WORDS as u64);
        let mut pass = compute_pass(encoder, self.shader.name);
        pass.set_pipeline(&self.pipeline);
        pass.set_bind_group(0, bindings, &[]);
        pass.dispatch_workgroups_indirect(arguments, 4 * INDIRECT_PREPARE as u64);
    }
}

/// The binding that only one species needs: how far cells look for shadows, or the light of trees.
fn own_binding(species: Species) -> u32 {
    match species {
        Species::Grass => 9,
        Species::Tree => 10,
    }
}
