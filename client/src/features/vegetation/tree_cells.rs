//! The trees around the eye, cell by cell: written once a frame, read by all that trees shade.

use crate::gpu::bind::{self, storage_entry};
use crate::gpu::buffer::create_buffer;
use crate::gpu::pipeline::{compute_pass, compute_pipelines, compute_pipelines_with};
use shaders::SHADERS;
use shaders::layout::{KIND_TREES, TREE_CELL_BYTES, TREE_LIGHT_BYTES, TREE_MARK_BYTES};

/// Cells of a workgroup.
const WORKGROUP: u32 = 64;

/// Buffers of the cells, 12.4 MB; zeros, for no trees, until they are written.
#[derive(Debug)]
pub struct TreeCells {
    cells: wgpu::Buffer,
    marks: wgpu::Buffer,
    lights: wgpu::Buffer,
}

impl TreeCells {
    /// Buffers without trees.
    #[must_use]
    pub fn new(device: &wgpu::Device) -> Self {
        let usage = wgpu::BufferUsages::STORAGE | wgpu::BufferUsages::COPY_DST | wgpu::BufferUsages::COPY_SRC;
        let buffer = |label, bytes: usize| create_buffer(device, label, bytes as u64, usage);
        Self {
            cells: buffer("tree cells", TREE_CELL_BYTES),
            marks: buffer("tree marks", TREE_MARK_BYTES),
            lights: buffer("tree lights", TREE_LIGHT_BYTES),
        }
    }

    /// The trees; `shared/tree_cells.wesl` documents their words.
    #[must_use]
    pub fn cells(&self) -> &wgpu::Buffer {
        &self.cells
    }

    /// Shadow search distance of each cell.
    #[must_use]
    pub fn marks(&self) -> &wgpu::Buffer {
        &self.marks
    }

    /// Light of each tree.
    #[must_use]
    pub fn lights(&self) -> &wgpu::Buffer {
        &self.lights
    }

    /// Records that there are no trees.
    pub fn clear(&self, encoder: &mut wgpu::CommandEncoder) {
        encoder.clear_buffer(&self.cells, 0, Some(16));
    }
}

/// The passes that write the cells.
#[derive(Debug)]
pub struct TreePasses {
    place: wgpu::ComputePipeline,
    mark: wgpu::ComputePipeline,
    light: wgpu::ComputePipeline,
    placing_layout: wgpu::BindGroupLayout,
    light_layout: wgpu::BindGroupLayout,
}

/// Bind groups of [`TreePasses`].
#[derive(Debug)]
pub struct TreeGroups {
    placing: wgpu::BindGroup,
    light: wgpu::BindGroup,
}

impl TreePasses {
    /// The passes over places whose group 0 has the layout `land`.
    #[must_use]
    pub fn new(device: &wgpu::Device, land: &wgpu::BindGroupLayout) -> Self {
        let compute = wgpu::ShaderStages::COMPUTE;
        let uniform = bind::compute_uniform_entry;
        let placing =
            [uniform(0), uniform(1), storage_entry(2, compute, false), storage_entry(3, compute, false)];
        let placing_layout = bind::layout(device, "tree placing", &placing);
        let light = [
            uniform(0),
            storage_entry(8, compute, true),
            storage_entry(9, compute, true),
            storage_entry(10, compute, false),
        ];
        let light_layout = bind::layout(device, "tree light", &light);
        let [place, mark] = compute_pipelines_with(
            device,
            &SHADERS.place_trees,
            &[land, &placing_layout],
            ["place", "mark"],
            &[("KIND", f64::from(KIND_TREES))],
        );
        let [light] = compute_pipelines(device, &SHADERS.light_trees, &[&light_layout], ["light_trees"]);
        Self { place, mark, light, placing_layout, light_layout }
    }

    /// The bind groups for a frame's uniforms and the field of its trees.
    #[must_use]
    pub fn bind(
        &self,
        device: &wgpu::Device,
        uniforms: &wgpu::Buffer,
        field: &wgpu::Buffer,
        trees: &TreeCells,
    ) -> TreeGroups {
        let placing = [uniforms, field, &trees.cells, &trees.marks];
        let light = [(0, uniforms), (8, &trees.cells), (9, &trees.marks), (10, &trees.lights)];
        TreeGroups {
            placing: bind::bind_buffers(device, "tree placing", &self.placing_layout, &placing),
            light: bind::bind_numbered(device, "tree light", &self.light_layout, &light),
        }
    }

    /// Records the writing of the cells, after the culling of the trees. `groups` are the bind
    /// groups and the number of cells along a side of the grid; none clears the trees.
    pub fn record(
        &self,
        land: &wgpu::BindGroup,
        groups: Option<(&TreeGroups, u32)>,
        trees: &TreeCells,
        encoder: &mut wgpu::CommandEncoder,
    ) {
        let Some((groups, side)) = groups else {
            trees.clear(encoder);
            return;
        };
        // The side is a multiple of 8, so the cells are a multiple of the workgroup.
        let cells = side * side;
        let mut pass = compute_pass(encoder, "place trees");
        pass.set_bind_group(0, land, &[]);
        pass.set_bind_group(1, &groups.placing, &[]);
        for pipeline in [&self.place, &self.mark] {
            pass.set_pipeline(pipeline);
            pass.dispatch_workgroups(cells / WORKGROUP, 1, 1);
        }
        drop(pass);
        let mut pass = compute_pass(encoder, "light trees");
        pass.set_bind_group(0, &groups.light, &[]);
        pass.set_pipeline(&self.light);
        pass.dispatch_workgroups(cells / WORKGROUP, 1, 1);
    }
}
