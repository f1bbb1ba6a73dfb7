//! Passes and buffers of the trees beyond the range of per-tree culling: placing on the GPU, one
//! indirect draw.

use crate::features::terrain::pool::ChunkPool;
use crate::features::vegetation::far_trees::{FarTreeFrame, MAX_FAR_CHUNKS, MAX_FAR_TREES};
use crate::gpu::bind::{self, storage_entry};
use crate::gpu::buffer::create_buffer;
use crate::gpu::pipeline::{Depth, HDR, HdrPass, Output, compute_pass, compute_pipelines};
use shaders::SHADERS;
use shaders::layout::{
    Culling, FAR_STATE_WORDS, FAR_TREE_BYTES, FarTrees, Field, MAX_FAR_PATCHES, OccluderChunk, Planting,
};
use wgpu::BufferUsages as Usage;

/// Far trees on the GPU.
#[derive(Debug)]
pub struct FarTreePass {
    count: wgpu::ComputePipeline,
    scan: wgpu::ComputePipeline,
    write: wgpu::ComputePipeline,
    draw: wgpu::RenderPipeline,
    culling: wgpu::Buffer,
    planting: wgpu::Buffer,
    field: wgpu::Buffer,
    params: wgpu::Buffer,
    chunks: wgpu::Buffer,
    patches: wgpu::Buffer,
    state: wgpu::Buffer,
    trees: wgpu::Buffer,
    land: wgpu::BindGroup,
    placing: wgpu::BindGroup,
    drawing: wgpu::BindGroup,
}

impl FarTreePass {
    /// The passes, over the chunks of a pool.
    #[must_use]
    pub fn new(device: &wgpu::Device, uniforms: &wgpu::Buffer, pool: &ChunkPool, samples: u32) -> Self {
        let buffer = |label, bytes: usize, usage| create_buffer(device, label, bytes as u64, usage);
        let uniform = |label, bytes| buffer(label, bytes, Usage::UNIFORM | Usage::COPY_DST);
        let storage = |label, bytes, more| buffer(label, bytes, Usage::STORAGE | Usage::COPY_DST | more);
        let culling = uniform("far culling", size_of::<Culling>());
        let planting = uniform("far planting", size_of::<Planting>());
        let field = uniform("far field", size_of::<Field>());
        let params = uniform("far trees", size_of::<FarTrees>());
        let chunks = storage("far chunks", MAX_FAR_CHUNKS * size_of::<OccluderChunk>(), Usage::empty());
        let patches = storage("far patches", 8 * MAX_FAR_PATCHES, Usage::empty());
        let state = storage("far state", 4 * FAR_STATE_WORDS, Usage::INDIRECT | Usage::COPY_SRC);
        let trees = storage("far trees", FAR_TREE_BYTES * MAX_FAR_TREES as usize, Usage::VERTEX);

        let compute = wgpu::ShaderStages::COMPUTE;
        let read = |binding| storage_entry(binding, compute, true);
        let written = |binding| storage_entry(binding, compute, false);
        let of_land = bind::compute_uniform_entry;
        let land_layout =
            bind::layout(device, "far land", &[of_land(0), of_land(1), read(2), read(4), read(6)]);
        let placing_layout = bind::layout(
            device,
            "far placing",
            &[of_land(0), of_land(1), of_land(2), read(3), written(4), written(5), read(6)],
        );
        let layouts = [&land_layout, &placing_layout];
        let [count, scan, write] = compute_pipelines(
            device,
            &SHADERS.place_far_trees,
            &layouts,
            ["count_far_trees", "scan_far_trees", "write_far_trees"],
        );
        let draw_layout = bind::layout(device, "far trees", &[bind::uniform_entry(0)]);
        let attributes = wgpu::vertex_attr_array![0 => Uint32x4, 1 => Uint32x4];
        let instances = wgpu::VertexBufferLayout {
            array_stride: FAR_TREE_BYTES as u64,
            step_mode: wgpu::VertexStepMode::Instance,
            attributes: &attributes,
        };
        let draw = HdrPass {
            shader: &SHADERS.draw_far_trees,
            layouts: &[&draw_layout],
            buffers: &[Some(instances)],
            depth: Depth::Solid,
            samples,
        };
        let fragment = (samples > 1).then_some("sampled_fragment");
        let draw = draw.two_sided_pipeline(device, Output { fragment, ..HDR });
        let land = [(0, &culling), (1, &planting), (2, pool.heights()), (4, pool.records()), (6, &chunks)];
        let placing = [uniforms, &field, &params, &patches, &state, &trees, pool.sun_clearances()];
        Self {
            count,
            scan,
            write,
            draw,
            land: bind::bind_numbered(device, "far land", &land_layout, &land),
            placing: bind::bind_buffers(device, "far placing", &placing_layout, &placing),
            drawing: bind::bind_buffers(device, "far trees", &draw_layout, &[uniforms]),
            culling,
            planting,
            field,
            params,
            chunks,
            patches,
            state,
            trees,
        }
    }

    /// Records the placing; without a frame nothing is drawn.
    pub fn record(
        &self,
        queue: &wgpu::Queue,
        frame: Option<&FarTreeFrame>,
        encoder: &mut wgpu::CommandEncoder,
    ) {
        let Some(frame) = frame else {
            encoder.clear_buffer(&self.state, 0, Some(32));
            return;
        };
        queue.write_buffer(&self.culling, 0, bytemuck::bytes_of(&frame.culling));
        queue.write_buffer(&self.planting, 0, bytemuck::bytes_of(&frame.planting));
        queue.write_buffer(&self.field, 0, bytemuck::bytes_of(&frame.field));
        queue.write_buffer(&self.params, 0, bytemuck::bytes_of(&frame.params));
        queue.write_buffer(&self.chunks, 0, bytemuck::cast_slice(&frame.chunks));
        queue.write_buffer(&self.patches, 0, bytemuck::cast_slice(&frame.patches));
        let patches = frame.params.patches;
        let mut pass = compute_pass(encoder, "place far trees");
        pass.set_bind_group(0, &self.land, &[]);
        pass.set_bind_group(1, &self.placing, &[]);
        for (pipeline, groups) in [(&self.count, patches), (&self.scan, 1), (&self.write, patches)] {
            pass.set_pipeline(pipeline);
            pass.dispatch_workgroups(groups, 1, 1);
        }
    }

    /// Draws the placed trees.
    pub fn draw(&self, pass: &mut wgpu::RenderPass<'_>) {
        pass.set_pipeline(&self.draw);
        pass.set_bind_group(0, &self.drawing, &[]);
        pass.set_vertex_buffer(0, self.trees.slice(..));
        pass.draw_indirect(&self.state, 0);
    }

    /// Its counts; see `shared/far_trees.wesl`.
    pub(super) fn state(&self) -> &wgpu::Buffer {
        &self.state
    }
}
