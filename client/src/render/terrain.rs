//! The terrain pass: one instanced, indexed draw of all chunks in sight.

use crate::render::materials::Materials;
use crate::render::mesh;
use crate::render::pipeline::{Depth, LightPass, storage_entry, uniform_entry};
use crate::render::pool::ChunkPool;
use shaders::SHADERS;
use shaders::layout::TerrainInstance;
use wgpu::util::DeviceExt as _;

/// The pass.
#[derive(Debug)]
pub struct TerrainPass {
    pipeline: wgpu::RenderPipeline,
    /// Leaves depth alone; built when a check first asks.
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
    /// The pass over a pool of `capacity` slots: no frame can draw more chunks than are resident.
    #[must_use]
    pub fn new(
        device: &wgpu::Device,
        frame: &wgpu::Buffer,
        pool: &ChunkPool,
        materials: &Materials,
        capacity: u32,
        samples: u32,
    ) -> Self {
        let layout = device.create_bind_group_layout(&wgpu::BindGroupLayoutDescriptor {
            label: Some("draw_terrain"),
            entries: &[
                uniform_entry(0),
                storage_entry(1, wgpu::ShaderStages::VERTEX, true),
                storage_entry(2, wgpu::ShaderStages::VERTEX, true),
            ],
        });
        let bindings = device.create_bind_group(&wgpu::BindGroupDescriptor {
            label: Some("draw_terrain"),
            layout: &layout,
            entries: &[
                wgpu::BindGroupEntry { binding: 0, resource: frame.as_entire_binding() },
                wgpu::BindGroupEntry { binding: 1, resource: pool.heights().as_entire_binding() },
                wgpu::BindGroupEntry { binding: 2, resource: pool.clearances().as_entire_binding() },
            ],
        });
        let pipeline = with_pass(&[&layout, materials.layout()], samples, |pass| pass.pipeline(device));
        let indices = device.create_buffer_init(&wgpu::util::BufferInitDescriptor {
            label: Some("chunk indices"),
            contents: bytemuck::cast_slice(&mesh::indices()),
            usage: wgpu::BufferUsages::INDEX,
        });
        let instances = device.create_buffer(&wgpu::BufferDescriptor {
            label: Some("chunk instances"),
            size: u64::from(capacity) * 4 * size_of::<TerrainInstance>() as u64,
            usage: wgpu::BufferUsages::VERTEX | wgpu::BufferUsages::COPY_DST,
            mapped_at_creation: false,
        });
        Self {
            pipeline,
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

    /// Sets the chunks of the next frame.
    pub fn prepare(&mut self, queue: &wgpu::Queue, instances: &[TerrainInstance]) {
        let instances = &instances[..instances.len().min(self.capacity)];
        self.count = instances.len() as u32;
        queue.write_buffer(&self.instances, 0, bytemuck::cast_slice(instances));
    }

    /// Bytes of the buffers that grow with the number of slots, besides the pool.
    #[must_use]
    pub fn bytes(&self) -> u64 {
        self.instances.size()
    }

    /// Draws them; returns how many draw calls that took.
    pub fn draw(&self, pass: &mut wgpu::RenderPass<'_>, materials: &Materials) -> u32 {
        self.draw_with(&self.pipeline, pass, materials)
    }

    /// Draws their depth and nothing else, into a pass without colours; for checks.
    pub fn draw_depth(
        &mut self,
        device: &wgpu::Device,
        pass: &mut wgpu::RenderPass<'_>,
        materials: &Materials,
    ) {
        let layouts = [&self.layout, materials.layout()];
        let build = || with_pass(&layouts, self.samples, |pass| pass.depth_pipeline(device));
        let depth = self.depth.take().unwrap_or_else(build);
        self.draw_with(&depth, pass, materials);
        self.depth = Some(depth);
    }

    fn draw_with(
        &self,
        pipeline: &wgpu::RenderPipeline,
        pass: &mut wgpu::RenderPass<'_>,
        materials: &Materials,
    ) -> u32 {
        let mut draws = 0;
        if self.count == 0 {
            return draws;
        }
        pass.set_pipeline(pipeline);
        pass.set_bind_group(0, &self.bindings, &[]);
        pass.set_bind_group(1, materials.bindings(), &[]);
        pass.set_vertex_buffer(0, self.instances.slice(..));
        pass.set_index_buffer(self.indices.slice(..), wgpu::IndexFormat::Uint16);
        pass.draw_indexed(0..mesh::INDEX_COUNT, 0, 0..self.count);
        draws += 1;
        draws
    }
}

/// What both pipelines have in common.
fn with_pass<T>(
    layouts: &[&wgpu::BindGroupLayout],
    samples: u32,
    build: impl FnOnce(LightPass<'_>) -> T,
) -> T {
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
    build(LightPass {
        shader: &SHADERS.draw_terrain,
        layouts,
        buffers: &buffers,
        depth: Depth::Solid,
        samples,
    })
}
