//! The scenes of reliefs: one pass that draws a list of objects, each as the knobs say or by a way
//! of its own.
//!
//! Two pipelines with one layout: one leaves the depth of the raster, so that hidden fragments are
//! dropped before they are shaded; the other writes the depth of the relief, and loses that. No
//! knob builds a pipeline: each draw chooses one.

pub mod meshes;
pub mod objects;

use crate::frame::FrameData;
use crate::relief::knobs::ReliefTier;
use crate::render::Gpu;
use crate::render::materials::Materials;
use crate::render::pipeline::{Depth, LightPass, storage_entry, uniform_entry};
use crate::render::relief::ReliefMaps;
use crate::scene::Scene;
use meshes::{Mesh, Vertex};
use objects::{LAYER, Mode, Object};
use shaders::SHADERS;
use shaders::layout::ReliefObject;
use wgpu::util::DeviceExt as _;

/// The scene.
#[derive(Debug)]
pub struct ReliefScene {
    fast: wgpu::RenderPipeline,
    deep: wgpu::RenderPipeline,
    layout: wgpu::BindGroupLayout,
    maps: ReliefMaps,
    frame: wgpu::Buffer,
    stage: Stage,
    with_depth: bool,
}

/// What stands in the scene, on the GPU.
#[derive(Debug)]
struct Stage {
    objects: Vec<Object>,
    /// First index, number of indices and first vertex of each object.
    ranges: Vec<(u32, u32, i32)>,
    vertices: wgpu::Buffer,
    indices: wgpu::Buffer,
    instances: wgpu::Buffer,
    bindings: wgpu::BindGroup,
}

impl ReliefScene {
    /// The scene with its objects, over baked materials.
    #[must_use]
    pub fn new(
        device: &wgpu::Device,
        queue: &wgpu::Queue,
        frame: &wgpu::Buffer,
        materials: &Materials,
        scene: Scene,
        samples: u32,
    ) -> Self {
        let maps = ReliefMaps::over(device, queue, &materials.heights, &materials.colours);
        let stages = wgpu::ShaderStages::VERTEX_FRAGMENT;
        let mut entries = vec![uniform_entry(0), storage_entry(1, stages, true)];
        entries.extend(ReliefMaps::layout_entries(2, stages));
        let layout = device.create_bind_group_layout(&wgpu::BindGroupLayoutDescriptor {
            label: Some(SHADERS.draw_relief.name),
            entries: &entries,
        });
        let attributes =
            wgpu::vertex_attr_array![0 => Float32x4, 1 => Float32x4, 2 => Float32x4, 3 => Float32x2];
        let buffers = [Some(wgpu::VertexBufferLayout {
            array_stride: size_of::<Vertex>() as u64,
            step_mode: wgpu::VertexStepMode::Vertex,
            attributes: &attributes,
        })];
        let pass = LightPass {
            shader: &SHADERS.draw_relief,
            layouts: &[&layout, materials.layout()],
            buffers: &buffers,
            depth: Depth::Solid,
            samples,
        };
        let fast = pass.pipeline_of(device, "fragment");
        let deep = pass.pipeline_of(device, "fragment_depth");
        let stage = Stage::new(device, &layout, frame, &maps, objects::of(scene));
        Self { fast, deep, layout, maps, frame: frame.clone(), stage, with_depth: false }
    }

    /// Puts other objects into the scene.
    pub fn arrange(&mut self, device: &wgpu::Device, objects: Vec<Object>) {
        self.stage = Stage::new(device, &self.layout, &self.frame, &self.maps, objects);
    }

    /// Places the objects for the eye of the next frame, and bakes cones when they are first asked
    /// for.
    pub fn prepare(&mut self, gpu: &Gpu, frame: &FrameData) {
        let Gpu { device, queue, .. } = gpu;
        let is_marched = self.stage.objects.iter().any(|object| object.mode == Mode::Knobs);
        if frame.uniforms.relief.tier == ReliefTier::Cones as u32 && is_marched && !self.maps.has_cones() {
            self.maps.bake_cones(device, queue, &[LAYER]);
            self.stage.bindings =
                bindings(device, &self.layout, &self.frame, &self.stage.instances, &self.maps);
        }
        let place = |object: &Object| object.layout(&frame.eye, frame.relief_tiling.into());
        let instances: Vec<ReliefObject> = self.stage.objects.iter().map(place).collect();
        queue.write_buffer(&self.stage.instances, 0, bytemuck::cast_slice(&instances));
        self.with_depth = frame.uniforms.relief.depth != 0;
    }

    /// Draws all objects.
    pub fn draw(&self, pass: &mut wgpu::RenderPass<'_>, materials: &Materials) {
        if self.stage.objects.is_empty() {
            return;
        }
        pass.set_bind_group(0, &self.stage.bindings, &[]);
        pass.set_bind_group(1, materials.bindings(), &[]);
        pass.set_vertex_buffer(0, self.stage.vertices.slice(..));
        pass.set_index_buffer(self.stage.indices.slice(..), wgpu::IndexFormat::Uint32);
        for (index, (object, (first, count, base))) in
            self.stage.objects.iter().zip(&self.stage.ranges).enumerate()
        {
            // Only what is marched has another depth than its raster.
            let is_deep = self.with_depth && matches!(object.mode, Mode::Knobs | Mode::Offset);
            pass.set_pipeline(if is_deep { &self.deep } else { &self.fast });
            pass.draw_indexed(*first..first + count, *base, index as u32..index as u32 + 1);
        }
    }
}

impl Stage {
    fn new(
        device: &wgpu::Device,
        layout: &wgpu::BindGroupLayout,
        frame: &wgpu::Buffer,
        maps: &ReliefMaps,
        objects: Vec<Object>,
    ) -> Self {
        let (mut vertices, mut indices, mut ranges) = (Vec::new(), Vec::new(), Vec::new());
        for object in &objects {
            let mesh = Mesh::of(object);
            ranges.push((indices.len() as u32, mesh.indices.len() as u32, vertices.len() as i32));
            vertices.extend(mesh.vertices);
            indices.extend(mesh.indices);
        }
        // Buffers of no bytes are not allowed.
        if objects.is_empty() {
            vertices.push(Vertex::default());
            indices.push(0);
        }
        let filled = |label, contents: &[u8], usage| {
            device.create_buffer_init(&wgpu::util::BufferInitDescriptor {
                label: Some(label),
                contents,
                usage,
            })
        };
        let vertices = filled("objects", bytemuck::cast_slice(&vertices), wgpu::BufferUsages::VERTEX);
        let indices = filled("indices of objects", bytemuck::cast_slice(&indices), wgpu::BufferUsages::INDEX);
        let instances = device.create_buffer(&wgpu::BufferDescriptor {
            label: Some("places of objects"),
            size: (size_of::<ReliefObject>() * objects.len().max(1)) as u64,
            usage: wgpu::BufferUsages::STORAGE | wgpu::BufferUsages::COPY_DST,
            mapped_at_creation: false,
        });
        let bindings = bindings(device, layout, frame, &instances, maps);
        Self { objects, ranges, vertices, indices, instances, bindings }
    }
}

fn bindings(
    device: &wgpu::Device,
    layout: &wgpu::BindGroupLayout,
    frame: &wgpu::Buffer,
    instances: &wgpu::Buffer,
    maps: &ReliefMaps,
) -> wgpu::BindGroup {
    let mut entries = vec![
        wgpu::BindGroupEntry { binding: 0, resource: frame.as_entire_binding() },
        wgpu::BindGroupEntry { binding: 1, resource: instances.as_entire_binding() },
    ];
    entries.extend(maps.entries(2));
    device.create_bind_group(&wgpu::BindGroupDescriptor {
        label: Some(SHADERS.draw_relief.name),
        layout,
        entries: &entries,
    })
}
