//! Parallax scenes: one pass that draws a list of objects, each by the settings or by a fixed
//! method.
//!
//! Two pipelines with one layout: one keeps the raster depth, so that early depth tests work; the
//! other writes the depth of the displaced surface, without early tests. Each draw selects one; no
//! setting builds a pipeline.

use crate::features::materials::Materials;
use crate::features::pom::cone_bake::ConeBake;
use crate::features::pom::maps::PomMaps;
use crate::features::pom::settings::PomMethod;
use crate::frame::FrameData;
use crate::gpu::bind;
use crate::gpu::buffer::create_buffer;
use crate::gpu::pipeline::{Depth, HdrPass};
use crate::gpu::{Gpu, GpuError};
use crate::renderer::scenes::meshes::{Mesh, Vertex};
use crate::scene::Scene;
use crate::scene::objects::{self, LAYER, Mode, Object};
use shaders::SHADERS;
use shaders::layout::PomObject;
use wgpu::util::DeviceExt as _;

/// The scene.
#[derive(Debug)]
pub struct PomScene {
    fast: wgpu::RenderPipeline,
    deep: wgpu::RenderPipeline,
    layout: wgpu::BindGroupLayout,
    maps: PomMaps,
    /// Cones in the making; the max mips stand in for them.
    bake: Option<ConeBake>,
    frame: wgpu::Buffer,
    objects_gpu: SceneObjects,
    with_depth: bool,
}

/// GPU buffers of the scene's objects.
#[derive(Debug)]
struct SceneObjects {
    objects: Vec<Object>,
    /// First index, number of indices and first vertex of each object.
    ranges: Vec<(u32, u32, i32)>,
    vertices: wgpu::Buffer,
    indices: wgpu::Buffer,
    instances: wgpu::Buffer,
    bindings: wgpu::BindGroup,
}

impl PomScene {
    /// The scene with its objects, over baked materials.
    #[must_use]
    pub fn new(
        device: &wgpu::Device,
        frame: &wgpu::Buffer,
        materials: &Materials,
        scene: Scene,
        samples: u32,
    ) -> Self {
        let maps = PomMaps::over(device, &materials.heights, &materials.colours, &materials.max_mips);
        let stages = wgpu::ShaderStages::VERTEX_FRAGMENT;
        let mut entries = vec![bind::uniform_entry(0), bind::storage_entry(1, stages, true)];
        entries.extend(PomMaps::layout_entries(2, stages));
        let layout = bind::layout(device, SHADERS.draw_pom.name, &entries);
        let attributes =
            wgpu::vertex_attr_array![0 => Float32x4, 1 => Float32x4, 2 => Float32x4, 3 => Float32x2];
        let buffers = [Some(wgpu::VertexBufferLayout {
            array_stride: size_of::<Vertex>() as u64,
            step_mode: wgpu::VertexStepMode::Vertex,
            attributes: &attributes,
        })];
        let pass = HdrPass {
            shader: &SHADERS.draw_pom,
            layouts: &[&layout, materials.layout()],
            buffers: &buffers,
            depth: Depth::Solid,
            samples,
        };
        let fast = pass.pipeline_with_fragment(device, "fragment");
        let deep = pass.pipeline_with_fragment(device, "fragment_depth");
        let objects_gpu = SceneObjects::new(device, &layout, frame, &maps, objects::of(scene));
        Self { fast, deep, layout, maps, bake: None, frame: frame.clone(), objects_gpu, with_depth: false }
    }

    /// Replaces the objects of the scene.
    pub fn set_objects(&mut self, device: &wgpu::Device, objects: Vec<Object>) {
        self.objects_gpu = SceneObjects::new(device, &self.layout, &self.frame, &self.maps, objects);
    }

    /// Continues to bake the cones if a frame needs them, without waiting. Returns whether it has
    /// what it needs.
    ///
    /// # Errors
    /// The device is lost.
    pub fn bake(&mut self, gpu: &Gpu, frame: &FrameData) -> Result<bool, GpuError> {
        let Gpu { device, queue, .. } = gpu;
        let is_marched = self.objects_gpu.objects.iter().any(|object| object.mode == Mode::Settings);
        if frame.uniforms.pom.tier != PomMethod::Cones as u32 || !is_marched || self.maps.has_cones() {
            return Ok(true);
        }
        let bake = self.bake.get_or_insert_with(|| self.maps.start_cones(device, &[LAYER]));
        if !bake.poll(device, queue)? {
            return Ok(false);
        }
        if let Some(baked) = self.bake.take() {
            self.maps.set_cones(baked);
        }
        self.objects_gpu.bindings =
            bindings(device, &self.layout, &self.frame, &self.objects_gpu.instances, &self.maps);
        Ok(true)
    }

    /// Updates the objects for the next frame's eye.
    pub fn prepare(&mut self, gpu: &Gpu, frame: &FrameData) {
        // A lost device reports its fault at the next check.
        let _ = self.bake(gpu, frame);
        let queue = &gpu.queue;
        let place = |object: &Object| object.layout(&frame.eye, frame.pom_tiling.into());
        let instances: Vec<PomObject> = self.objects_gpu.objects.iter().map(place).collect();
        queue.write_buffer(&self.objects_gpu.instances, 0, bytemuck::cast_slice(&instances));
        self.with_depth = frame.uniforms.pom.depth != 0;
    }

    /// Draws all objects.
    pub fn draw(&self, pass: &mut wgpu::RenderPass<'_>, materials: &Materials) {
        if self.objects_gpu.objects.is_empty() {
            return;
        }
        pass.set_bind_group(0, &self.objects_gpu.bindings, &[]);
        pass.set_bind_group(1, materials.bindings(), &[]);
        pass.set_vertex_buffer(0, self.objects_gpu.vertices.slice(..));
        pass.set_index_buffer(self.objects_gpu.indices.slice(..), wgpu::IndexFormat::Uint32);
        for (index, (object, (first, count, base))) in
            self.objects_gpu.objects.iter().zip(&self.objects_gpu.ranges).enumerate()
        {
            // Only marched surfaces differ from the raster depth.
            let is_deep = self.with_depth && matches!(object.mode, Mode::Settings | Mode::Offset);
            pass.set_pipeline(if is_deep { &self.deep } else { &self.fast });
            pass.draw_indexed(*first..first + count, *base, index as u32..index as u32 + 1);
        }
    }
}

impl SceneObjects {
    fn new(
        device: &wgpu::Device,
        layout: &wgpu::BindGroupLayout,
        frame: &wgpu::Buffer,
        maps: &PomMaps,
        objects: Vec<Object>,
    ) -> Self {
        let (mut vertices, mut indices, mut ranges) = (Vec::new(), Vec::new(), Vec::new());
        for object in &objects {
            let mesh = Mesh::of(object);
            ranges.push((indices.len() as u32, mesh.indices.len() as u32, vertices.len() as i32));
            vertices.extend(mesh.vertices);
            indices.extend(mesh.indices);
        }
        // Empty buffers are invalid.
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
        let instances = create_buffer(
            device,
            "places of objects",
            (size_of::<PomObject>() * objects.len().max(1)) as u64,
            wgpu::BufferUsages::STORAGE | wgpu::BufferUsages::COPY_DST,
        );
        let bindings = bindings(device, layout, frame, &instances, maps);
        Self { objects, ranges, vertices, indices, instances, bindings }
    }
}

fn bindings(
    device: &wgpu::Device,
    layout: &wgpu::BindGroupLayout,
    frame: &wgpu::Buffer,
    instances: &wgpu::Buffer,
    maps: &PomMaps,
) -> wgpu::BindGroup {
    let mut resources = vec![frame.as_entire_binding(), instances.as_entire_binding()];
    resources.extend(maps.resources());
    bind::bind(device, SHADERS.draw_pom.name, layout, &resources)
}
