//! The terrain pass: one instanced, indexed draw of all visible chunks.

use crate::features::materials::Materials;
use crate::features::terrain::mesh;
use crate::features::terrain::pool::ChunkPool;
use crate::features::terrain_clipmap::TerrainClipmap;
use crate::gpu::bind::bind_numbered;
use crate::gpu::bind::{self, storage_entry, uniform_entry};
use crate::gpu::buffer::create_buffer;
use crate::gpu::pipeline::{Depth, HdrPass};
use shaders::SHADERS;
use shaders::layout::TerrainInstance;
use wgpu::util::DeviceExt as _;

/// The pass.
#[derive(Debug)]
pub struct TerrainPass {
    pipeline: wgpu::RenderPipeline,
    /// The debug views; built on first use.
    inspected: Option<wgpu::RenderPipeline>,
    /// Depth only; built on first use.
    depth: Option<wgpu::RenderPipeline>,
    layout: wgpu::BindGroupLayout,
    samples: u32,
    bindings: wgpu::BindGroup,
    indices: wgpu::Buffer,
    instances: wgpu::Buffer,
    capacity: usize,
    count: u32,
}

impl TerrainPass {
    /// The pass over a pool of `capacity` slots, which bounds the chunks of a frame, and over the
    /// cells and marks of trees. The other layouts are those of the materials and of the clipmap.
    #[must_use]
    pub fn new(
        device: &wgpu::Device,
        frame: &wgpu::Buffer,
        pool: &ChunkPool,
        (cells, marks): (&wgpu::Buffer, &wgpu::Buffer),
        [materials, clipmap]: [&wgpu::BindGroupLayout; 2],
        capacity: u32,
        samples: u32,
    ) -> Self {
        let vertex = wgpu::ShaderStages::VERTEX;
        let fragment = wgpu::ShaderStages::FRAGMENT;
        let entries = [
            uniform_entry(0),
            storage_entry(1, vertex, true),
            storage_entry(2, vertex, true),
            storage_entry(8, fragment, true),
            storage_entry(9, fragment, true),
        ];
        let layout = bind::layout(device, "draw_terrain", &entries);
        let buffers = [(0, frame), (1, pool.heights()), (2, pool.sun_clearances()), (8, cells), (9, marks)];
        let bindings = bind_numbered(device, "draw_terrain", &layout, &buffers);
        let pipeline = with_pass(&[&layout, materials, clipmap], samples, |pass| pass.pipeline(device));
        let indices = device.create_buffer_init(&wgpu::util::BufferInitDescriptor {
            label: Some("chunk indices"),
            contents: bytemuck::cast_slice(&mesh::indices()),
            usage: wgpu::BufferUsages::INDEX,
        });
        let instances = create_buffer(
            device,
            "chunk instances",
            u64::from(capacity) * 4 * size_of::<TerrainInstance>() as u64,
            wgpu::BufferUsages::VERTEX | wgpu::BufferUsages::COPY_DST,
        );
        Self {
            pipeline,
            inspected: None,
            depth: None,
            layout,
            samples,
            bindings,
            indices,
            instances,
            capacity: 4 * capacity as usize,
            count: 0,
        }
    }

    /// Sets the instances of the next frame.
    pub fn prepare(&mut self, queue: &wgpu::Queue, instances: &[TerrainInstance]) {
        let instances = &instances[..instances.len().min(self.capacity)];
        self.count = instances.len() as u32;
        queue.write_buffer(&self.instances, 0, bytemuck::cast_slice(instances));
    }

    /// Bytes of the buffers that grow with the number of slots, without the pool.
    #[must_use]
    pub fn bytes(&self) -> u64 {
        self.instances.size()
    }

    /// Records the draw; returns the number of draw calls.
    pub fn draw(
        &self,
        pass: &mut wgpu::RenderPass<'_>,
        materials: &Materials,
        clipmap: &TerrainClipmap,
    ) -> u32 {
        self.draw_with(&self.pipeline, pass, materials, clipmap)
    }

    /// Records the draw of the debug views; returns the number of draw calls.
    pub fn draw_inspected(
        &mut self,
        device: &wgpu::Device,
        pass: &mut wgpu::RenderPass<'_>,
        materials: &Materials,
        clipmap: &TerrainClipmap,
    ) -> u32 {
        let layouts = [&self.layout, materials.layout(), clipmap.layout()];
        let entry = "fragment_inspected";
        let build = || with_pass(&layouts, self.samples, |pass| pass.pipeline_with_fragment(device, entry));
        let pipeline = self.inspected.get_or_insert_with(build).clone();
        self.draw_with(&pipeline, pass, materials, clipmap)
    }

    /// Draws depth only, into a pass without colour attachments; for checks.
    pub fn draw_depth(
        &mut self,
        device: &wgpu::Device,
        pass: &mut wgpu::RenderPass<'_>,
        materials: &Materials,
        clipmap: &TerrainClipmap,
    ) {
        let layouts = [&self.layout, materials.layout(), clipmap.layout()];
        let build = || with_pass(&layouts, self.samples, |pass| pass.depth_pipeline(device));
        let pipeline = self.depth.get_or_insert_with(build).clone();
        self.draw_with(&pipeline, pass, materials, clipmap);
    }

    fn draw_with(
        &self,
        pipeline: &wgpu::RenderPipeline,
        pass: &mut wgpu::RenderPass<'_>,
        materials: &Materials,
        clipmap: &TerrainClipmap,
    ) -> u32 {
        if self.count == 0 {
            return 0;
        }
        pass.set_pipeline(pipeline);
        pass.set_bind_group(0, &self.bindings, &[]);
        pass.set_bind_group(1, materials.bindings(), &[]);
        pass.set_bind_group(2, clipmap.bindings(), &[]);
        pass.set_vertex_buffer(0, self.instances.slice(..));
        pass.set_index_buffer(self.indices.slice(..), wgpu::IndexFormat::Uint16);
        pass.draw_indexed(0..mesh::INDEX_COUNT, 0, 0..self.count);
        1
    }
}

/// The pass of all pipelines.
fn with_pass<T>(layouts: &[&wgpu::BindGroupLayout], samples: u32, build: impl FnOnce(HdrPass<'_>) -> T) -> T {
    let attributes = TerrainInstance::ATTRIBUTES.map(|attribute| wgpu::VertexAttribute {
        shader_location: attribute.location,
        offset: attribute.offset as u64,
        format: match (attribute.float, attribute.components) {
            (true, _) => wgpu::VertexFormat::Float32x4,
            (false, 2) => wgpu::VertexFormat::Uint32x2,
            (false, _) => wgpu::VertexFormat::Uint32x4,
        },
    });
    let buffers = [Some(wgpu::VertexBufferLayout {
        array_stride: size_of::<TerrainInstance>() as u64,
        step_mode: wgpu::VertexStepMode::Instance,
        attributes: &attributes,
    })];
    build(HdrPass { shader: &SHADERS.draw_terrain, layouts, buffers: &buffers, depth: Depth::Solid, samples })
}
