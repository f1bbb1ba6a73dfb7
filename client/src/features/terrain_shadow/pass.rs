//! The terrain shadow pass: traces the sun clearance above the horizon for a few chunks at a time
//! and stores it beside their heights.

use crate::features::terrain::pool::ChunkPool;
use crate::features::terrain_shadow::schedule::{Quota, ShadowBatch};
use crate::gpu::bind;
use crate::gpu::buffer::create_buffer;
use crate::gpu::pipeline::{compute_pass, compute_pipelines};
use shaders::SHADERS;
use shaders::layout::{
    CLEARANCE_WORDS, FILL_WORKGROUP, MAX_ROOTS, NODES_PER_SLOT, PageNode, ShadowTarget, SunParams,
};

/// Most chunks of one dispatch.
pub const MAX_SHADOW_CHUNKS: usize = 64;

/// Quota of an interactive frame: 34,000 rays. At 60 frames a second the visible chunks of a usual
/// view (about 50) are current within an eighth of a second, the rest within a few seconds.
pub const PER_FRAME: Quota = Quota { chunks: 8, hidden: 2 };

/// Quota of a still image.
pub const ALL_VISIBLE: Quota = Quota { chunks: MAX_SHADOW_CHUNKS, hidden: 0 };

/// The pass.
#[derive(Debug)]
pub struct TerrainShadowPass {
    pipeline: wgpu::ComputePipeline,
    bindings: wgpu::BindGroup,
    sun: wgpu::Buffer,
    nodes: wgpu::Buffer,
    targets: wgpu::Buffer,
}

impl TerrainShadowPass {
    /// The pass over a pool of `slots` slots.
    #[must_use]
    pub fn new(device: &wgpu::Device, pool: &ChunkPool, slots: u32) -> Self {
        use wgpu::BufferUsages as Usage;
        let buffer =
            |label, size: usize, usage| create_buffer(device, label, size as u64, usage | Usage::COPY_DST);
        let sun = buffer("sun", size_of::<SunParams>(), Usage::UNIFORM);
        let nodes = MAX_ROOTS + NODES_PER_SLOT * slots as usize;
        let nodes = buffer("page table", nodes * size_of::<PageNode>(), Usage::STORAGE);
        let targets =
            buffer("chunks to trace", MAX_SHADOW_CHUNKS * size_of::<ShadowTarget>(), Usage::STORAGE);
        let shader = &SHADERS.trace_terrain_shadow;
        let compute = wgpu::ShaderStages::COMPUTE;
        let entries = [
            bind::compute_uniform_entry(0),
            bind::storage_entry(1, compute, true),
            bind::storage_entry(2, compute, true),
            bind::storage_entry(3, compute, true),
            bind::storage_entry(4, compute, true),
            bind::storage_entry(5, compute, false),
        ];
        let layout = bind::layout(device, shader.name, &entries);
        let buffers = [&sun, pool.heights(), pool.maxima(), &nodes, &targets, pool.sun_clearances()];
        let bindings = bind::bind_buffers(device, shader.name, &layout, &buffers);
        let [pipeline] = compute_pipelines(device, shader, &[&layout], ["trace_terrain_shadow"]);
        Self { pipeline, bindings, sun, nodes, targets }
    }

    /// Bytes of the buffers that grow with the number of slots, without the pool.
    #[must_use]
    pub fn bytes(&self) -> u64 {
        self.nodes.size()
    }

    /// Records a batch of at most [`MAX_SHADOW_CHUNKS`] chunks. One per submission: the next one
    /// overwrites what this one reads.
    pub fn record(&self, queue: &wgpu::Queue, batch: &ShadowBatch<'_>, encoder: &mut wgpu::CommandEncoder) {
        let targets = &batch.targets[..batch.targets.len().min(MAX_SHADOW_CHUNKS)];
        queue.write_buffer(&self.sun, 0, bytemuck::bytes_of(&batch.sun));
        queue.write_buffer(&self.targets, 0, bytemuck::cast_slice(targets));
        if let Some(table) = batch.table {
            queue.write_buffer(&self.nodes, 0, bytemuck::cast_slice(&table.nodes));
        }
        let mut pass = compute_pass(encoder, "terrain shadow");
        pass.set_pipeline(&self.pipeline);
        pass.set_bind_group(0, &self.bindings, &[]);
        pass.dispatch_workgroups((CLEARANCE_WORDS as u32).div_ceil(FILL_WORKGROUP), targets.len() as u32, 1);
    }
}
