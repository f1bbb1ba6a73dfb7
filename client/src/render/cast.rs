//! The shadow pass: finds how far the sun clears the land's horizon, for a few chunks at a time,
//! and keeps it beside their heights.

use crate::render::pipeline::{compute_pipelines, storage_entry, uniform_entry};
use crate::render::pool::ChunkPool;
use crate::shadow::{Casting, Quota};
use shaders::SHADERS;
use shaders::layout::{
    CLEARANCE_WORDS, CastTarget, Caster, FILL_WORKGROUP, MAX_ROOTS, NODES_PER_SLOT, PageNode,
};

/// Chunks of one dispatch at most.
pub const MAX_CASTS: usize = 64;

/// What is done before a frame that is to be smooth: 34,000 walks. At 60 frames a second, what is
/// seen of a usual view (some 50 chunks) is up to date within an eighth of a second, the rest of it
/// within a few.
pub const PER_FRAME: Quota = Quota { chunks: 8, ahead: 2 };

/// What is done at once when only the finished picture counts.
pub const ALL_IN_SIGHT: Quota = Quota { chunks: MAX_CASTS, ahead: 0 };

/// The pass.
#[derive(Debug)]
pub struct CastPass {
    pipeline: wgpu::ComputePipeline,
    bindings: wgpu::BindGroup,
    caster: wgpu::Buffer,
    nodes: wgpu::Buffer,
    targets: wgpu::Buffer,
}

impl CastPass {
    /// The pass over a pool of `slots` slots.
    #[must_use]
    pub fn new(device: &wgpu::Device, pool: &ChunkPool, slots: u32) -> Self {
        use wgpu::BufferUsages as Usage;
        let buffer = |label, size: usize, usage| {
            device.create_buffer(&wgpu::BufferDescriptor {
                label: Some(label),
                size: size as u64,
                usage: usage | Usage::COPY_DST,
                mapped_at_creation: false,
            })
        };
        let caster = buffer("caster", size_of::<Caster>(), Usage::UNIFORM);
        let nodes = MAX_ROOTS + NODES_PER_SLOT * slots as usize;
        let nodes = buffer("page table", nodes * size_of::<PageNode>(), Usage::STORAGE);
        let targets = buffer("chunks to cast on", MAX_CASTS * size_of::<CastTarget>(), Usage::STORAGE);
        let shader = &SHADERS.cast_shadows;
        let compute = wgpu::ShaderStages::COMPUTE;
        let layout = device.create_bind_group_layout(&wgpu::BindGroupLayoutDescriptor {
            label: Some(shader.name),
            entries: &[
                wgpu::BindGroupLayoutEntry { visibility: compute, ..uniform_entry(0) },
                storage_entry(1, compute, true),
                storage_entry(2, compute, true),
                storage_entry(3, compute, true),
                storage_entry(4, compute, true),
                storage_entry(5, compute, false),
            ],
        });
        let buffers = [&caster, pool.heights(), pool.maxima(), &nodes, &targets, pool.clearances()];
        let bindings = device.create_bind_group(&wgpu::BindGroupDescriptor {
            label: Some(shader.name),
            layout: &layout,
            entries: &std::array::from_fn::<_, 6, _>(|binding| wgpu::BindGroupEntry {
                binding: binding as u32,
                resource: buffers[binding].as_entire_binding(),
            }),
        });
        let [pipeline] = compute_pipelines(device, shader, &[&layout], ["cast_shadows"]);
        Self { pipeline, bindings, caster, nodes, targets }
    }

    /// Bytes of the buffers that grow with the number of slots, besides the pool.
    #[must_use]
    pub fn bytes(&self) -> u64 {
        self.nodes.size()
    }

    /// Records a casting of at most [`MAX_CASTS`] chunks. One per submission: the next one
    /// overwrites what this one reads.
    pub fn record(&self, queue: &wgpu::Queue, casting: &Casting<'_>, encoder: &mut wgpu::CommandEncoder) {
        let targets = &casting.targets[..casting.targets.len().min(MAX_CASTS)];
        queue.write_buffer(&self.caster, 0, bytemuck::bytes_of(&casting.caster));
        queue.write_buffer(&self.targets, 0, bytemuck::cast_slice(targets));
        if let Some(table) = casting.table {
            queue.write_buffer(&self.nodes, 0, bytemuck::cast_slice(&table.nodes));
        }
        let mut pass = encoder.begin_compute_pass(&wgpu::ComputePassDescriptor {
            label: Some("cast shadows"),
            timestamp_writes: None,
        });
        pass.set_pipeline(&self.pipeline);
        pass.set_bind_group(0, &self.bindings, &[]);
        pass.dispatch_workgroups((CLEARANCE_WORDS as u32).div_ceil(FILL_WORKGROUP), targets.len() as u32, 1);
    }
}
