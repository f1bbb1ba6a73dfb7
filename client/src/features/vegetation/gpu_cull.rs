//! GPU culling of vegetation: block test, prefix sum, clump test, compaction. Nothing is read back
//! before the draw.

use crate::features::terrain::pool::ChunkPool;
use crate::features::vegetation::cull_pipelines::CullPipelines;
use crate::features::vegetation::draw::{Species, VisibleClumps};
use crate::features::vegetation::occlusion_grid::OcclusionGrid;
use crate::features::vegetation::species::VegetationFrame;
use crate::gpu::bind::{self, storage_entry};
use crate::gpu::buffer::create_buffer;
use crate::gpu::pipeline::{compute_pass, compute_pipelines};
use crate::gpu::{Gpu, GpuError};
use shaders::SHADERS;
use shaders::layout::{
    CLUMP_BYTES, Culling, GRID_NODES, INDIRECT_DRAWS, INDIRECT_STATS, INDIRECT_WORDS, LAST_SEEN_WORDS,
    MASK_BEGIN, MAX_OCCLUDER_CHUNKS, MAX_PATCHES, OccluderChunk, OcclusionNode, PATCH_BLOCK_COUNT,
    PREPARED_BYTES, PREPARED_HEAD, Planting, VISIBILITY_WORDS,
};
use std::ops::Range;
use wgpu::BufferUsages as Usage;

/// Most blocks of a species: all of all patches, so no setting needs more. Blocks without room
/// would be dropped, farthest patches first, and counted.
pub const MAX_BLOCKS: u32 = (MAX_PATCHES * PATCH_BLOCK_COUNT) as u32;

/// Counts of the last culling.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct CullStats {
    /// Blocks whose clumps were tested.
    pub blocks: u32,
    /// Blocks dropped for lack of capacity.
    pub blocks_lost: u32,
    /// Clumps drawn.
    pub clumps: u32,
    /// Clumps dropped for lack of capacity.
    pub clumps_lost: u32,
}

impl CullStats {
    /// The counts from the words that `scan_plants.wesl` writes.
    pub(super) fn of_words(words: &[u32]) -> Self {
        Self { blocks: words[0], blocks_lost: words[1], clumps: words[2], clumps_lost: words[3] }
    }

    /// The sum of both.
    #[must_use]
    pub fn with(self, other: Self) -> Self {
        Self {
            blocks: self.blocks + other.blocks,
            blocks_lost: self.blocks_lost + other.blocks_lost,
            clumps: self.clumps + other.clumps,
            clumps_lost: self.clumps_lost + other.clumps_lost,
        }
    }
}

/// The culling passes.
#[derive(Debug)]
pub struct CullPasses {
    methods: CullPipelines,
    scan_blocks: wgpu::ComputePipeline,
    scan_clumps: wgpu::ComputePipeline,
    land_layout: wgpu::BindGroupLayout,
    patches_layout: wgpu::BindGroupLayout,
    blocks_layout: wgpu::BindGroupLayout,
    clumps_layout: wgpu::BindGroupLayout,
    scan_layout: wgpu::BindGroupLayout,
    tiles: wgpu::Buffer,
    leaves: wgpu::Buffer,
    memory: wgpu::Buffer,
}

/// Culling buffers of one species.
#[derive(Debug)]
pub struct CullBuffers {
    culling: wgpu::Buffer,
    planting: wgpu::Buffer,
    patches: wgpu::Buffer,
    size: wgpu::Buffer,
    /// Visible clumps: `CLUMP_BYTES` each, each level of detail in its own region.
    pub clumps: wgpu::Buffer,
    /// What is prepared for each of them, `PREPARED_BYTES` each, in the same regions after
    /// `PREPARED_HEAD` of them.
    pub prepared: wgpu::Buffer,
    /// Arguments of the draws, from `INDIRECT_DRAWS` on.
    pub indirect: wgpu::Buffer,
    /// Capacity of each level of detail, clumps.
    pub capacity: [u32; 3],
    /// Capacity for visible blocks.
    pub blocks: u32,
    vertices: [u32; 3],
    land: wgpu::BindGroup,
    patched: wgpu::BindGroup,
    block_group: wgpu::BindGroup,
    clump_group: wgpu::BindGroup,
    scan: wgpu::BindGroup,
}

impl CullPasses {
    /// The passes, and the occlusion grid that all species share.
    #[must_use]
    pub fn new(device: &wgpu::Device) -> Self {
        let compute = wgpu::ShaderStages::COMPUTE;
        let uniform = bind::compute_uniform_entry;
        let layout = |label, entries: &[wgpu::BindGroupLayoutEntry]| bind::layout(device, label, entries);
        let land = [
            uniform(0),
            uniform(1),
            storage_entry(2, compute, true),
            storage_entry(3, compute, true),
            storage_entry(4, compute, true),
            storage_entry(5, compute, true),
            storage_entry(6, compute, true),
        ];
        let with_patches: Vec<_> = land.iter().copied().chain([uniform(7)]).collect();
        let land_layout = layout("land around the eye", &land);
        let patches_layout = layout("land and patches", &with_patches);
        let blocks_layout =
            layout("block culling", &[storage_entry(0, compute, false), storage_entry(1, compute, false)]);
        let clumps_layout =
            layout("clump culling", &[storage_entry(0, compute, false), storage_entry(1, compute, false)]);
        let scan_layout = layout(
            "plant scan",
            &[uniform(0), uniform(1), storage_entry(2, compute, false), storage_entry(3, compute, false)],
        );
        let [scan_blocks, scan_clumps] =
            compute_pipelines(device, &SHADERS.scan_plants, &[&scan_layout], ["scan_blocks", "scan_clumps"]);
        let storage = |label, size: usize| buffer(device, label, size, Usage::STORAGE | Usage::COPY_DST);
        Self {
            methods: CullPipelines::default(),
            scan_blocks,
            scan_clumps,
            land_layout,
            patches_layout,
            blocks_layout,
            clumps_layout,
            scan_layout,
            tiles: storage("tiles", GRID_NODES * size_of::<OcclusionNode>()),
            leaves: storage("leaves", MAX_OCCLUDER_CHUNKS * size_of::<OccluderChunk>()),
            memory: storage("last seen frames", 4 * LAST_SEEN_WORDS),
        }
    }

    /// Buffers of a species with this capacity for blocks, and for clumps in each level of detail;
    /// `vertices` is the vertex count of one clump.
    #[must_use]
    pub fn create_buffers(
        &self,
        device: &wgpu::Device,
        pool: &ChunkPool,
        (blocks, capacity): (u32, [u32; 3]),
        vertices: [u32; 3],
    ) -> CullBuffers {
        let uniform = |label, size: usize| buffer(device, label, size, Usage::UNIFORM | Usage::COPY_DST);
        let storage =
            |label, size: usize, more| buffer(device, label, size, Usage::STORAGE | Usage::COPY_DST | more);
        let culling = uniform("culling", size_of::<Culling>());
        let planting = uniform("planting", size_of::<Planting>());
        let patches = uniform("patches", 4 * MAX_PATCHES);
        let size = uniform("number of patches", 16);
        // Lists of visible blocks, then their visibility masks.
        let cull_words = MASK_BEGIN + VISIBILITY_WORDS * blocks.min(MAX_BLOCKS) as usize;
        let visible_blocks = storage("visible blocks and masks", 4 * cull_words, Usage::empty());
        let all: usize = capacity.iter().map(|room| *room as usize).sum();
        let clumps = storage("visible clumps", CLUMP_BYTES * all, Usage::VERTEX | Usage::COPY_SRC);
        let prepared = storage("prepared clumps", PREPARED_BYTES * (PREPARED_HEAD + all), Usage::VERTEX);
        let indirect = storage("indirect arguments", 4 * INDIRECT_WORDS, Usage::INDIRECT | Usage::COPY_SRC);
        let group =
            |label, layout, buffers: &[&wgpu::Buffer]| bind::bind_buffers(device, label, layout, buffers);
        let land = [
            &culling,
            &planting,
            pool.heights(),
            pool.maxima(),
            pool.records(),
            &self.tiles,
            &self.leaves,
            &patches,
        ];
        CullBuffers {
            land: group("land around the eye", &self.land_layout, &land[..7]),
            patched: group("land and patches", &self.patches_layout, &land),
            block_group: group("block culling", &self.blocks_layout, &[&visible_blocks, &self.memory]),
            clump_group: group("clump culling", &self.clumps_layout, &[&visible_blocks, &clumps]),
            scan: group("plant scan", &self.scan_layout, &[&planting, &size, &visible_blocks, &indirect]),
            culling,
            planting,
            patches,
            size,
            clumps,
            prepared,
            indirect,
            capacity,
            blocks: blocks.min(MAX_BLOCKS),
            vertices,
        }
    }

    /// The nodes of the occlusion grid.
    #[must_use]
    pub fn tiles(&self) -> &wgpu::Buffer {
        &self.tiles
    }

    /// The occluder chunks of the grid.
    #[must_use]
    pub fn leaves(&self) -> &wgpu::Buffer {
        &self.leaves
    }

    /// Layout of [`CullBuffers::land`].
    #[must_use]
    pub fn land_layout(&self) -> &wgpu::BindGroupLayout {
        &self.land_layout
    }

    /// Uploads the occlusion grid.
    pub fn prepare(&self, queue: &wgpu::Queue, grid: &OcclusionGrid) {
        queue.write_buffer(&self.tiles, 0, bytemuck::cast_slice(&grid.nodes));
        let leaves = &grid.chunks[..grid.chunks.len().min(MAX_OCCLUDER_CHUNKS)];
        queue.write_buffer(&self.leaves, 0, bytemuck::cast_slice(leaves));
    }

    /// Records the culling of a species; `index` is its index in the frame. Builds the pipelines of
    /// its method on first use.
    pub fn record(
        &mut self,
        gpu: &Gpu,
        plants: &VegetationFrame,
        index: usize,
        frame: u32,
        buffers: &CullBuffers,
        encoder: &mut wgpu::CommandEncoder,
    ) {
        let Some(species) = plants.species.get(index) else {
            // The species is absent: nothing is drawn.
            encoder.clear_buffer(&buffers.indirect, 0, None);
            return;
        };
        let queue = &gpu.queue;
        let (land, clumps) = (&self.land_layout, &self.clumps_layout);
        let blocks = [&self.patches_layout, &self.blocks_layout];
        let view = (&species.culling, &species.planting);
        let method = self.methods.of(&gpu.device, view, &blocks, &[land, clumps]);
        let patches = &species.patches[..species.patches.len().min(MAX_PATCHES)];
        let packed: Vec<u32> =
            patches.iter().map(|[column, row]| *column as u32 | (*row as u32) << 16).collect();
        let [near, middle, far] = buffers.capacity;
        let vertices = buffers.vertices;
        let planting = Planting {
            vertices: [vertices[0], vertices[1], vertices[2], 0],
            room: [near, middle, far, buffers.blocks],
            ..species.planting
        };
        queue.write_buffer(&buffers.culling, 0, bytemuck::bytes_of(&Culling { frame, ..species.culling }));
        queue.write_buffer(&buffers.planting, 0, bytemuck::bytes_of(&planting));
        queue.write_buffer(&buffers.patches, 0, bytemuck::cast_slice(&packed));
        queue.write_buffer(&buffers.size, 0, bytemuck::bytes_of(&[packed.len() as u32, 0, 0, 0]));
        let mut pass = compute_pass(encoder, "cull plants");
        let mut one =
            |pipeline: &wgpu::ComputePipeline, groups: [Option<&wgpu::BindGroup>; 2], size: Size| {
                pass.set_pipeline(pipeline);
                for (index, group) in groups.into_iter().enumerate() {
                    if let Some(group) = group {
                        pass.set_bind_group(index as u32, group, &[]);
                    }
                }
                match size {
                    Size::Groups(groups) => pass.dispatch_workgroups(groups, 1, 1),
                    Size::PerBlock => pass.dispatch_workgroups_indirect(&buffers.indirect, 0),
                }
            };
        let of_clumps = [Some(&buffers.land), Some(&buffers.clump_group)];
        if !packed.is_empty() {
            let of_blocks = [Some(&buffers.patched), Some(&buffers.block_group)];
            one(&method.blocks, of_blocks, Size::Groups(packed.len() as u32));
        }
        one(&self.scan_blocks, [Some(&buffers.scan), None], Size::Groups(1));
        one(&method.test, of_clumps, Size::PerBlock);
        one(&self.scan_clumps, [Some(&buffers.scan), None], Size::Groups(1));
        one(&method.write, of_clumps, Size::PerBlock);
    }
}

/// Size of a dispatch.
#[derive(Clone, Copy)]
enum Size {
    /// A number of workgroups.
    Groups(u32),
    /// One for each visible block, as counted on the GPU.
    PerBlock,
}

impl CullBuffers {
    /// The view, the species and the drawn land, as group 0 of the passes over places.
    #[must_use]
    pub fn land(&self) -> &wgpu::BindGroup {
        &self.land
    }

    /// Input of the draw pass; `field` is the buffer of its uniforms.
    #[must_use]
    pub fn visible_clumps(
        &self,
        species: Species,
        field: wgpu::Buffer,
        passes: &CullPasses,
    ) -> VisibleClumps {
        let [near, middle, far] = self.capacity;
        VisibleClumps {
            species,
            field,
            tiles: passes.tiles().clone(),
            leaves: passes.leaves().clone(),
            clumps: self.clumps.clone(),
            prepared: self.prepared.clone(),
            regions: vec![0..near, near..near + middle, near + middle..near + middle + far],
            arguments: self.indirect.clone(),
            arguments_at: 4 * INDIRECT_DRAWS as u64,
        }
    }

    /// The arguments of indirect draws and dispatches, and the counts.
    pub(super) fn arguments(&self) -> &wgpu::Buffer {
        &self.indirect
    }

    /// Counts of the last submitted culling. Waits for the GPU; for checks.
    ///
    /// # Errors
    /// The GPU failed.
    pub fn read_stats(&self, gpu: &Gpu) -> Result<CullStats, GpuError> {
        let words = read_words(gpu, &self.indirect, INDIRECT_STATS..INDIRECT_STATS + 4)?;
        Ok(CullStats::of_words(&words))
    }

    /// Visible clumps of the last submitted culling: four words each, by level of detail. Waits for
    /// the GPU; for checks.
    ///
    /// # Errors
    /// The GPU failed.
    pub fn read(&self, gpu: &Gpu) -> Result<[Vec<[u32; 4]>; 3], GpuError> {
        let indirect = read_words(gpu, &self.indirect, 0..INDIRECT_WORDS)?;
        let mut begin = 0;
        let mut clumps = [const { Vec::new() }; 3];
        for (level, (clumps, capacity)) in clumps.iter_mut().zip(self.capacity).enumerate() {
            let count = indirect[INDIRECT_DRAWS + 4 * level + 1] as usize;
            let words = read_words(gpu, &self.clumps, 4 * begin..4 * (begin + count))?;
            clumps.extend(words.chunks_exact(4).map(|four| [four[0], four[1], four[2], four[3]]));
            begin += capacity as usize;
        }
        Ok(clumps)
    }
}

fn buffer(device: &wgpu::Device, label: &str, size: usize, usage: Usage) -> wgpu::Buffer {
    create_buffer(device, label, size.max(16) as u64, usage)
}

fn read_words(gpu: &Gpu, buffer: &wgpu::Buffer, words: Range<usize>) -> Result<Vec<u32>, GpuError> {
    let bytes = gpu.read_buffer(buffer, 4 * words.start as u64..4 * words.end as u64)?;
    Ok(bytes.chunks_exact(4).map(|four| u32::from_le_bytes([four[0], four[1], four[2], four[3]])).collect())
}
