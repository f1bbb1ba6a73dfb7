//! The passes that choose plants: blocks, clumps, and the sums between, all on the GPU; nothing
//! comes back before the draw.

use crate::plants::{PlantFrame, Square};
use crate::render::grass::{KeptClumps, Plant};
use crate::render::pipeline::{compute_pipelines, storage_entry, uniform_entry};
use crate::render::pool::ChunkPool;
use crate::render::{Gpu, GpuError};
use shaders::SHADERS;
use shaders::layout::{
    CLUMP_BYTES, Culling, Leaf, MAX_LEAVES, MAX_PATCHES, MEMORY_WORDS, PATCH_BLOCK_COUNT, Planting,
    SQUARE_NODES, TALLY_DRAWS, TALLY_TOLD, TALLY_WORDS, Tile, VERDICT_WORDS,
};
use std::ops::Range;
use wgpu::BufferUsages as Usage;

/// Words of the choice before its blocks.
const CHOSEN: usize = 1280;

/// Blocks of a kind that there is room for. More are left out, farthest first, and counted.
pub const MAX_BLOCKS: usize = 32_768;

/// What the choice came to.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Told {
    /// Blocks whose clumps were looked at.
    pub blocks: u32,
    /// Blocks left out for want of room.
    pub blocks_lost: u32,
    /// Clumps drawn.
    pub clumps: u32,
    /// Clumps left out for want of room.
    pub clumps_lost: u32,
}

impl Told {
    /// Both together.
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

/// The passes.
#[derive(Debug)]
pub struct CullPasses {
    blocks: wgpu::ComputePipeline,
    judge: wgpu::ComputePipeline,
    write: wgpu::ComputePipeline,
    order_blocks: wgpu::ComputePipeline,
    order_clumps: wgpu::ComputePipeline,
    land_layout: wgpu::BindGroupLayout,
    patches_layout: wgpu::BindGroupLayout,
    blocks_layout: wgpu::BindGroupLayout,
    clumps_layout: wgpu::BindGroupLayout,
    order_layout: wgpu::BindGroupLayout,
    tiles: wgpu::Buffer,
    leaves: wgpu::Buffer,
    memory: wgpu::Buffer,
}

/// Buffers of one kind of plants.
#[derive(Debug)]
pub struct Chosen {
    culling: wgpu::Buffer,
    planting: wgpu::Buffer,
    patches: wgpu::Buffer,
    size: wgpu::Buffer,
    /// Kept clumps: `CLUMP_BYTES` each, each level of detail in a region of its own.
    pub clumps: wgpu::Buffer,
    /// Arguments of the draws, from `TALLY_DRAWS` on.
    pub tally: wgpu::Buffer,
    /// Clumps that each level of detail has room for.
    pub room: [u32; 3],
    vertices: [u32; 3],
    land: wgpu::BindGroup,
    patched: wgpu::BindGroup,
    kept_blocks: wgpu::BindGroup,
    kept_clumps: wgpu::BindGroup,
    order: wgpu::BindGroup,
}

impl CullPasses {
    /// The passes, and the square that all kinds share.
    #[must_use]
    pub fn new(device: &wgpu::Device) -> Self {
        let compute = wgpu::ShaderStages::COMPUTE;
        let uniform = |binding| wgpu::BindGroupLayoutEntry { visibility: compute, ..uniform_entry(binding) };
        let layout = |label, entries: &[wgpu::BindGroupLayoutEntry]| {
            device.create_bind_group_layout(&wgpu::BindGroupLayoutDescriptor { label: Some(label), entries })
        };
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
            layout("choice of blocks", &[storage_entry(0, compute, false), storage_entry(1, compute, false)]);
        let clumps_layout = layout(
            "choice of clumps",
            &[
                storage_entry(0, compute, true),
                storage_entry(1, compute, false),
                storage_entry(2, compute, false),
            ],
        );
        let order_layout = layout(
            "order of plants",
            &[
                uniform(0),
                uniform(1),
                storage_entry(2, compute, false),
                storage_entry(3, compute, false),
                storage_entry(4, compute, false),
            ],
        );
        let [blocks] = compute_pipelines(
            device,
            &SHADERS.cull_blocks,
            &[&patches_layout, &blocks_layout],
            ["cull_blocks"],
        );
        let [judge, write] = compute_pipelines(
            device,
            &SHADERS.cull_clumps,
            &[&land_layout, &clumps_layout],
            ["judge_clumps", "write_clumps"],
        );
        let [order_blocks, order_clumps] = compute_pipelines(
            device,
            &SHADERS.order_plants,
            &[&order_layout],
            ["order_blocks", "order_clumps"],
        );
        let storage = |label, size: usize| buffer(device, label, size, Usage::STORAGE | Usage::COPY_DST);
        Self {
            blocks,
            judge,
            write,
            order_blocks,
            order_clumps,
            land_layout,
            patches_layout,
            blocks_layout,
            clumps_layout,
            order_layout,
            tiles: storage("tiles", SQUARE_NODES * size_of::<Tile>()),
            leaves: storage("leaves", MAX_LEAVES * size_of::<Leaf>()),
            memory: storage("memory of blocks", 4 * MEMORY_WORDS),
        }
    }

    /// Buffers for a kind of which so many clumps are kept in each level of detail; `vertices` is
    /// what one of them is drawn with.
    #[must_use]
    pub fn room_for(
        &self,
        device: &wgpu::Device,
        pool: &ChunkPool,
        room: [u32; 3],
        vertices: [u32; 3],
    ) -> Chosen {
        let uniform = |label, size: usize| buffer(device, label, size, Usage::UNIFORM | Usage::COPY_DST);
        let storage =
            |label, size: usize, more| buffer(device, label, size, Usage::STORAGE | Usage::COPY_DST | more);
        let culling = uniform("culling", size_of::<Culling>());
        let planting = uniform("planting", size_of::<Planting>());
        let patches = uniform("patches", 4 * MAX_PATCHES);
        let size = uniform("number of patches", 16);
        let choice = storage("kept blocks", 4 * (CHOSEN + MAX_PATCHES * PATCH_BLOCK_COUNT), Usage::empty());
        let verdicts = storage("verdicts", 4 * VERDICT_WORDS * MAX_BLOCKS, Usage::empty());
        let all: usize = room.iter().map(|room| *room as usize).sum();
        let clumps = storage("kept clumps", CLUMP_BYTES * all, Usage::VERTEX | Usage::COPY_SRC);
        let tally = storage("tally of plants", 4 * TALLY_WORDS, Usage::INDIRECT | Usage::COPY_SRC);
        let group = |label, layout: &wgpu::BindGroupLayout, buffers: &[&wgpu::Buffer]| {
            let entries: Vec<_> = buffers
                .iter()
                .enumerate()
                .map(|(binding, buffer)| wgpu::BindGroupEntry {
                    binding: binding as u32,
                    resource: buffer.as_entire_binding(),
                })
                .collect();
            device.create_bind_group(&wgpu::BindGroupDescriptor {
                label: Some(label),
                layout,
                entries: &entries,
            })
        };
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
        Chosen {
            land: group("land around the eye", &self.land_layout, &land[..7]),
            patched: group("land and patches", &self.patches_layout, &land),
            kept_blocks: group("choice of blocks", &self.blocks_layout, &[&choice, &self.memory]),
            kept_clumps: group("choice of clumps", &self.clumps_layout, &[&choice, &verdicts, &clumps]),
            order: group(
                "order of plants",
                &self.order_layout,
                &[&planting, &size, &choice, &verdicts, &tally],
            ),
            culling,
            planting,
            patches,
            size,
            clumps,
            tally,
            room,
            vertices,
        }
    }

    /// The [`Tile`]s of the square, for the passes that draw what was chosen.
    #[must_use]
    pub fn tiles(&self) -> &wgpu::Buffer {
        &self.tiles
    }

    /// The [`Leaf`]s under them.
    #[must_use]
    pub fn leaves(&self) -> &wgpu::Buffer {
        &self.leaves
    }

    /// Tells the GPU of the land around the eye.
    pub fn prepare(&self, queue: &wgpu::Queue, square: &Square) {
        queue.write_buffer(&self.tiles, 0, bytemuck::cast_slice(&square.tiles));
        let leaves = &square.leaves[..square.leaves.len().min(MAX_LEAVES)];
        queue.write_buffer(&self.leaves, 0, bytemuck::cast_slice(leaves));
    }

    /// Records the choice of a kind of plants; `index` says which stand of the frame it is.
    pub fn record(
        &self,
        queue: &wgpu::Queue,
        plants: &PlantFrame,
        index: usize,
        frame: u32,
        chosen: &Chosen,
        encoder: &mut wgpu::CommandEncoder,
    ) {
        let Some(stand) = plants.stands.get(index) else {
            // Nothing of this kind: nothing is drawn.
            encoder.clear_buffer(&chosen.tally, 0, None);
            return;
        };
        let patches = &stand.patches[..stand.patches.len().min(MAX_PATCHES)];
        let packed: Vec<u32> =
            patches.iter().map(|[column, row]| *column as u32 | (*row as u32) << 16).collect();
        let [near, middle, far] = chosen.room;
        let vertices = chosen.vertices;
        let planting = Planting {
            vertices: [vertices[0], vertices[1], vertices[2], 0],
            room: [near, middle, far, MAX_BLOCKS as u32],
            ..stand.planting
        };
        queue.write_buffer(&chosen.culling, 0, bytemuck::bytes_of(&Culling { frame, ..stand.culling }));
        queue.write_buffer(&chosen.planting, 0, bytemuck::bytes_of(&planting));
        queue.write_buffer(&chosen.patches, 0, bytemuck::cast_slice(&packed));
        queue.write_buffer(&chosen.size, 0, bytemuck::bytes_of(&[packed.len() as u32, 0, 0, 0]));
        let mut pass = encoder.begin_compute_pass(&wgpu::ComputePassDescriptor {
            label: Some("choose plants"),
            timestamp_writes: None,
        });
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
                    Size::PerBlock => pass.dispatch_workgroups_indirect(&chosen.tally, 0),
                }
            };
        let of_clumps = [Some(&chosen.land), Some(&chosen.kept_clumps)];
        if !packed.is_empty() {
            let of_blocks = [Some(&chosen.patched), Some(&chosen.kept_blocks)];
            one(&self.blocks, of_blocks, Size::Groups(packed.len() as u32));
        }
        one(&self.order_blocks, [Some(&chosen.order), None], Size::Groups(1));
        one(&self.judge, of_clumps, Size::PerBlock);
        one(&self.order_clumps, [Some(&chosen.order), None], Size::Groups(1));
        one(&self.write, of_clumps, Size::PerBlock);
    }
}

/// How much is dispatched.
#[derive(Clone, Copy)]
enum Size {
    /// So many workgroups.
    Groups(u32),
    /// One for each kept block, as the GPU counted them.
    PerBlock,
}

impl Chosen {
    /// What the pass that draws `plant` reads of the choice; `field` is the buffer of its uniforms.
    #[must_use]
    pub fn kept(&self, plant: Plant, field: wgpu::Buffer, passes: &CullPasses) -> KeptClumps {
        let [near, middle, far] = self.room;
        KeptClumps {
            plant,
            field,
            tiles: passes.tiles().clone(),
            leaves: passes.leaves().clone(),
            clumps: self.clumps.clone(),
            regions: vec![0..near, near..near + middle, near + middle..near + middle + far],
            arguments: self.tally.clone(),
            arguments_at: 4 * TALLY_DRAWS as u64,
        }
    }

    /// What the last submitted choice came to. Waits for the GPU.
    ///
    /// # Errors
    /// The GPU failed.
    pub fn told(&self, gpu: &Gpu) -> Result<Told, GpuError> {
        let words = read_words(gpu, &self.tally, 0..TALLY_WORDS)?;
        let told = &words[TALLY_TOLD..];
        Ok(Told { blocks: told[0], blocks_lost: told[1], clumps: told[2], clumps_lost: told[3] })
    }

    /// The clumps that the last submitted choice kept: four words each, by level of detail. Waits
    /// for the GPU; for checks.
    ///
    /// # Errors
    /// The GPU failed.
    pub fn read(&self, gpu: &Gpu) -> Result<[Vec<[u32; 4]>; 3], GpuError> {
        let tally = read_words(gpu, &self.tally, 0..TALLY_WORDS)?;
        let mut begin = 0;
        let mut clumps = [const { Vec::new() }; 3];
        for (level, (clumps, room)) in clumps.iter_mut().zip(self.room).enumerate() {
            let count = tally[TALLY_DRAWS + 4 * level + 1] as usize;
            let words = read_words(gpu, &self.clumps, 4 * begin..4 * (begin + count))?;
            clumps.extend(words.chunks_exact(4).map(|four| [four[0], four[1], four[2], four[3]]));
            begin += room as usize;
        }
        Ok(clumps)
    }
}

fn buffer(device: &wgpu::Device, label: &str, size: usize, usage: Usage) -> wgpu::Buffer {
    device.create_buffer(&wgpu::BufferDescriptor {
        label: Some(label),
        size: size.max(16) as u64,
        usage,
        mapped_at_creation: false,
    })
}

fn read_words(gpu: &Gpu, buffer: &wgpu::Buffer, words: Range<usize>) -> Result<Vec<u32>, GpuError> {
    let failed = |error: &dyn std::fmt::Display| GpuError::Fault(error.to_string());
    let size = 4 * words.len() as u64;
    // Nothing cannot be mapped.
    if size == 0 {
        return Ok(Vec::new());
    }
    let landing = gpu.device.create_buffer(&wgpu::BufferDescriptor {
        label: Some("plants on the CPU"),
        size,
        usage: Usage::MAP_READ | Usage::COPY_DST,
        mapped_at_creation: false,
    });
    let mut encoder = gpu.device.create_command_encoder(&wgpu::CommandEncoderDescriptor::default());
    encoder.copy_buffer_to_buffer(buffer, 4 * words.start as u64, &landing, 0, size);
    gpu.queue.submit([encoder.finish()]);
    let slice = landing.slice(..);
    slice.map_async(wgpu::MapMode::Read, |_| ());
    gpu.wait()?;
    let bytes = slice.get_mapped_range().map_err(|error| failed(&error))?;
    Ok(bytes.chunks_exact(4).map(|four| u32::from_le_bytes([four[0], four[1], four[2], four[3]])).collect())
}
