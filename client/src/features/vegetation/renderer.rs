//! Vegetation of a frame on the GPU: culling, then drawing. Created with the first frame that has
//! vegetation, so that other scenes have no cost.

use crate::features::terrain::pool::ChunkPool;
use crate::features::vegetation::draw::{ClumpPass, Species, VisibleClumps};
use crate::features::vegetation::far_tree_pass::FarTreePass;
use crate::features::vegetation::gpu_cull::{CullBuffers, CullPasses, CullStats, MAX_BLOCKS};
use crate::features::vegetation::prepare::PreparePass;
use crate::features::vegetation::species::{SpeciesParams, VegetationFrame};
use crate::features::vegetation::stats::StatsCopy;
use crate::features::vegetation::tree_cells::{TreeCells, TreeGroups, TreePasses};
use crate::gpu::buffer::create_buffer;
use crate::gpu::{Gpu, GpuError};
use shaders::layout::Field;
use shaders::twin::placement::BLOCK_CELL_BITS;

/// Capacity for clumps of a species in each level of detail: 154 MB. More are dropped, farthest
/// patches first, and counted.
pub const MAX_CLUMPS: [u32; 3] = [1 << 17, 1 << 19, 1 << 22];

/// Passes and buffers of all species.
#[derive(Debug)]
pub struct VegetationRenderer {
    passes: CullPasses,
    placing: TreePasses,
    species: Vec<SpeciesPass>,
    /// Built with the first frame that has far trees.
    far_trees: Option<FarTreePass>,
    /// Patches of far trees without room, of the last frame.
    far_patches_lost: u32,
    /// Frame number, from 1 on: the time stamp of visible blocks.
    frame: u32,
}

/// Passes and buffers of one species.
#[derive(Debug)]
struct SpeciesPass {
    species: Species,
    pass: ClumpPass,
    preparing: PreparePass,
    /// Draws ids; built on first use.
    id_pass: Option<ClumpPass>,
    buffers: SpeciesBuffers,
}

/// Recreated when the capacity grows. Pipelines are kept: some drivers take seconds to compile
/// them.
#[derive(Debug)]
struct SpeciesBuffers {
    culling: CullBuffers,
    clumps: VisibleClumps,
    bindings: wgpu::BindGroup,
    preparing: wgpu::BindGroup,
    /// For trees.
    placing: Option<TreeGroups>,
}

impl VegetationRenderer {
    /// A renderer without species.
    #[must_use]
    pub fn new(device: &wgpu::Device) -> Self {
        let passes = CullPasses::new(device);
        let placing = TreePasses::new(device, passes.land_layout());
        Self { passes, placing, species: Vec::new(), far_trees: None, far_patches_lost: 0, frame: 0 }
    }

    /// Records the culling of a frame's vegetation, to be submitted before or with its drawing.
    pub fn cull(
        &mut self,
        gpu: &Gpu,
        uniforms: &wgpu::Buffer,
        (pool, trees): (&ChunkPool, &TreeCells),
        samples: u32,
        plants: &VegetationFrame,
        encoder: &mut wgpu::CommandEncoder,
    ) {
        self.frame = self.frame.wrapping_add(1).max(1);
        self.passes.prepare(&gpu.queue, &plants.grid);
        for params in &plants.species {
            let species =
                if params.field.kind == Species::Grass.kind() { Species::Grass } else { Species::Tree };
            let (blocks, needed) = (block_capacity(params), clump_capacity(params));
            let buffers = |pass: &ClumpPass, preparing: &PreparePass, capacity| {
                let made = (species, pass, preparing);
                SpeciesBuffers::new(
                    &gpu.device,
                    (&self.passes, &self.placing),
                    uniforms,
                    (pool, trees),
                    made,
                    capacity,
                )
            };
            if let Some(existing) = self.species.iter_mut().find(|pass| pass.species == species) {
                let old = (existing.buffers.culling.blocks, existing.buffers.culling.capacity);
                // Grown to a power of two, so that a range that is dragged does not make new
                // buffers in every frame.
                let grown = |needed: u32, old: u32, most: u32| match needed > old {
                    true => needed.next_power_of_two().min(most).max(needed),
                    false => old,
                };
                let clumps =
                    std::array::from_fn(|level| grown(needed[level], old.1[level], MAX_CLUMPS[level]));
                let capacity = (grown(blocks, old.0, MAX_BLOCKS), clumps);
                if capacity != old {
                    existing.buffers = buffers(&existing.pass, &existing.preparing, capacity);
                }
            } else {
                let pass = ClumpPass::new(&gpu.device, species, samples);
                let preparing = PreparePass::new(&gpu.device, species);
                let buffers = buffers(&pass, &preparing, (blocks, needed));
                self.species.push(SpeciesPass { species, pass, preparing, id_pass: None, buffers });
            }
        }
        for pass in &self.species {
            let index = plants.species.iter().position(|params| params.field.kind == pass.species.kind());
            let index = index.unwrap_or(plants.species.len());
            if let Some(params) = plants.species.get(index) {
                let field = bytemuck::bytes_of(&params.field);
                gpu.queue.write_buffer(&pass.buffers.clumps.field, 0, field);
            }
            self.passes.record(gpu, plants, index, self.frame, &pass.buffers.culling, encoder);
            if pass.species == Species::Tree {
                let side = plants.species.get(index).map(|params| params.field.tree_grid_cells);
                let groups = pass.buffers.placing.as_ref().zip(side);
                self.placing.record(pass.buffers.culling.land(), groups, trees, encoder);
            }
        }
        let far = plants.far_trees.as_ref();
        if far.is_some() && self.far_trees.is_none() {
            self.far_trees = Some(FarTreePass::new(&gpu.device, uniforms, pool, samples));
        }
        if let Some(pass) = &self.far_trees {
            pass.record(&gpu.queue, far, encoder);
        }
        self.far_patches_lost = far.map_or(0, |far| far.patches_lost);
        // Grass reads the cells of trees, so all trees are placed before anything is prepared.
        for SpeciesPass { preparing, buffers, .. } in &self.species {
            preparing.record(&buffers.preparing, &buffers.clumps, encoder);
        }
    }

    /// Draws the visible grass: before the land, whose fragments take longer.
    pub fn draw_grass(&self, pass: &mut wgpu::RenderPass<'_>) {
        self.draw_species(Species::Grass, pass);
    }

    /// Draws the visible trees: after the land, which hides most of the far ones before they are
    /// shaded.
    pub fn draw_trees(&self, pass: &mut wgpu::RenderPass<'_>) {
        self.draw_species(Species::Tree, pass);
        if let Some(far_trees) = &self.far_trees {
            far_trees.draw(pass);
        }
    }

    fn draw_species(&self, species: Species, pass: &mut wgpu::RenderPass<'_>) {
        for drawn in self.species.iter().filter(|drawn| drawn.species == species) {
            drawn.pass.draw(pass, &drawn.buffers.bindings, &drawn.buffers.clumps);
        }
    }

    /// Draws the ids of the visible clumps, one sample per pixel; for checks.
    pub fn draw_ids(&mut self, gpu: &Gpu, pass: &mut wgpu::RenderPass<'_>) {
        for SpeciesPass { species, id_pass, buffers, .. } in &mut self.species {
            let id_pass = id_pass.get_or_insert_with(|| ClumpPass::ids(&gpu.device, *species));
            id_pass.draw(pass, &buffers.bindings, &buffers.clumps);
        }
    }

    /// Records a copy of the counts of the last culling, to be read some frames later.
    #[must_use]
    pub fn copy_stats(&self, device: &wgpu::Device, encoder: &mut wgpu::CommandEncoder) -> StatsCopy {
        let arguments: Vec<_> = self.species.iter().map(|pass| pass.buffers.culling.arguments()).collect();
        let far = self.far_trees.as_ref().map(FarTreePass::state);
        StatsCopy::record(device, encoder, &arguments, far, self.far_patches_lost)
    }

    /// Counts of all species of the last submitted culling. Waits for the GPU.
    ///
    /// # Errors
    /// The GPU failed.
    #[cfg(not(target_arch = "wasm32"))]
    pub fn read_stats(&self, gpu: &Gpu) -> Result<CullStats, GpuError> {
        let mut encoder = gpu.device.create_command_encoder(&wgpu::CommandEncoderDescriptor::default());
        let copy = self.copy_stats(&gpu.device, &mut encoder);
        gpu.queue.submit([encoder.finish()]);
        let read = copy.start();
        gpu.wait()?;
        Ok(read.result()?)
    }

    /// The buffers of each species, for checks.
    pub fn buffers(&self) -> impl Iterator<Item = (&VisibleClumps, &CullBuffers)> {
        self.species.iter().map(|pass| (&pass.buffers.clumps, &pass.buffers.culling))
    }
}

impl SpeciesBuffers {
    fn new(
        device: &wgpu::Device,
        (passes, placing): (&CullPasses, &TreePasses),
        uniforms: &wgpu::Buffer,
        (pool, trees): (&ChunkPool, &TreeCells),
        (species, pass, preparing): (Species, &ClumpPass, &PreparePass),
        capacity: (u32, [u32; 3]),
    ) -> Self {
        let mut vertices = [0; 3];
        for (own, given) in vertices.iter_mut().zip(species.vertices()) {
            *own = *given;
        }
        let culling = passes.create_buffers(device, pool, capacity, vertices);
        let field = create_buffer(
            device,
            "field",
            size_of::<Field>() as u64,
            wgpu::BufferUsages::UNIFORM | wgpu::BufferUsages::COPY_DST,
        );
        let clumps = culling.visible_clumps(species, field, passes);
        let bindings = pass.bind(device, uniforms, &clumps);
        let preparing = preparing.bind(device, uniforms, pool, trees, &clumps);
        let is_tree = species == Species::Tree;
        let placing = is_tree.then(|| placing.bind(device, uniforms, &clumps.field, trees));
        Self { culling, clumps, bindings, preparing, placing }
    }
}

/// Blocks of a species that may be within its range: all whose nearest point is, in any direction.
fn block_capacity(params: &SpeciesParams) -> u32 {
    let cell_m = f64::from(1u32 << params.planting.cell_bits) / 4096.0;
    let side_m = cell_m * f64::from(1u32 << BLOCK_CELL_BITS);
    // A block whose nearest point is in range lies wholly within its diagonal of it.
    let reach = f64::from(params.field.range_m) / side_m + std::f64::consts::SQRT_2;
    ((std::f64::consts::PI * reach * reach).ceil() as u32).min(MAX_BLOCKS)
}

/// Clumps of a species that may be in each level of detail around the eye: its highest density
/// everywhere plus a tenth, at most [`MAX_CLUMPS`].
fn clump_capacity(params: &SpeciesParams) -> [u32; 3] {
    let field = &params.field;
    let cell_m = f64::from(1u32 << params.planting.cell_bits) / 4096.0;
    let per_m2 = f64::from(params.planting.per_cell) / (cell_m * cell_m);
    let (thin, range) = (f64::from(field.thin_from_m), f64::from(field.range_m));
    // Clumps within a distance: all up to `thin`, beyond it a share that falls with the distance,
    // plus those that are narrowing before removal: an eighth more, and one rank of 256.
    let within = |distance: f64| {
        let distance = distance.min(range);
        let near = distance.min(thin);
        let far = (distance - thin).max(0.0);
        let ring = distance * distance - near * near;
        per_m2 * std::f64::consts::PI * (near * near + 1.125 * 2.0 * thin * far + ring / 256.0)
    };
    let ends = [f64::from(field.lod_m[0]), f64::from(field.lod_m[1]), range];
    let begins = [0.0, ends[0], ends[1]];
    std::array::from_fn(|level| {
        let needed = 1.1 * (within(ends[level]) - within(begins[level])).max(0.0) + 1024.0;
        (needed as u32).min(MAX_CLUMPS[level])
    })
}
