//! Chunk generation on the GPU: heights and pyramids, bit-exact equal to the CPU.
//!
//! Owns one batch of buffers, allocated once. Depends on a device and a queue only.

use client::gpu::bind;
use client::gpu::buffer::create_buffer;
use client::gpu::pipeline::{compute_pass, compute_pipelines};
use client::gpu::readback::Readback;
use shaders::SHADERS;
use shaders::layout::{ChunkFill, FILL_NODES, FILL_WORKGROUP, World};
use terrain::constants::VERTEX_COUNT;
use terrain::pyramid::PYRAMID_TEXELS;
use terrain::{ChunkKey, Land};

const HEIGHT_BYTES: u64 = 4 * VERTEX_COUNT as u64;
const PYRAMID_BYTES: u64 = 4 * PYRAMID_TEXELS as u64;
/// Bytes of the base field's nodes of one chunk, two words each.
const NODE_BYTES: u64 = 8 * FILL_NODES as u64;
/// Bytes of one chunk that are read back: heights, maxima, minima.
const CHUNK_BYTES: u64 = HEIGHT_BYTES + 2 * PYRAMID_BYTES;

/// Most chunks of one batch, 24 MB; one chunk already fills most GPUs.
pub const MAX_BATCH: usize = 256;

/// Generates chunks of one world, at most a batch at a time.
#[derive(Debug)]
pub struct ChunkFiller {
    fill_nodes: wgpu::ComputePipeline,
    fill_heights: wgpu::ComputePipeline,
    fill_pyramids: wgpu::ComputePipeline,
    bindings: wgpu::BindGroup,
    chunks: wgpu::Buffer,
    heights: wgpu::Buffer,
    pyramids: wgpu::Buffer,
    /// All of a batch, packed for one copy to the CPU.
    readback: Readback,
    batch: usize,
}

/// A generated chunk, heights in units.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct FilledChunk {
    /// Which.
    pub key: ChunkKey,
    /// As [`terrain::Chunk::heights`].
    pub heights: Box<[i32; VERTEX_COUNT]>,
    /// All levels of the pyramid of upper bounds, base first, as [`terrain::Pyramid`] orders them.
    pub maxima: Box<[i32; PYRAMID_TEXELS]>,
    /// All levels of the pyramid of lower bounds.
    pub minima: Box<[i32; PYRAMID_TEXELS]>,
}

/// Why a batch failed.
#[derive(Debug, thiserror::Error)]
pub enum FillError {
    /// More keys than a batch holds.
    #[error("{keys} chunks asked for in one batch: at most {batch} fit, split them")]
    TooMany {
        /// Asked for.
        keys: usize,
        /// Allowed.
        batch: usize,
    },
    /// The device failed; its results are invalid.
    #[error("the GPU failed while filling chunks ({0}): update its driver, or generate on the CPU")]
    Device(String),
}

impl ChunkFiller {
    /// A filler for one world; `batch` is clamped to 1..=[`MAX_BATCH`].
    ///
    /// # Errors
    /// The device refuses the pipelines or the buffers.
    pub fn new(
        device: &wgpu::Device,
        queue: &wgpu::Queue,
        land: &Land,
        batch: usize,
    ) -> Result<Self, FillError> {
        let batch = batch.clamp(1, MAX_BATCH);
        let scope = device.push_error_scope(wgpu::ErrorFilter::Validation);
        let filler = Self::build(device, queue, land, batch);
        match pollster::block_on(scope.pop()) {
            Some(error) => Err(FillError::Device(one_line(&error.to_string()))),
            None => Ok(filler),
        }
    }

    fn build(device: &wgpu::Device, queue: &wgpu::Queue, land: &Land, batch: usize) -> Self {
        use wgpu::BufferUsages as Usage;
        let buffer = |label, size, usage| create_buffer(device, label, size, usage);
        let n = batch as u64;
        let world = buffer("world", size_of::<World>() as u64, Usage::STORAGE | Usage::COPY_DST);
        queue.write_buffer(&world, 0, bytemuck::bytes_of(&World::from(land.parameters())));
        let chunks =
            buffer("chunks to fill", size_of::<ChunkFill>() as u64 * n, Usage::STORAGE | Usage::COPY_DST);
        let nodes = buffer("filled nodes", NODE_BYTES * n, Usage::STORAGE);
        let heights = buffer("filled heights", HEIGHT_BYTES * n, Usage::STORAGE | Usage::COPY_SRC);
        let pyramids = buffer("filled pyramids", 2 * PYRAMID_BYTES * n, Usage::STORAGE | Usage::COPY_SRC);
        let readback = Readback::new(device, "filled chunks", CHUNK_BYTES * n);

        let shader = SHADERS.fill_chunks;
        let entries = [(0, true), (1, true), (2, false), (3, false), (4, false)]
            .map(|(binding, read_only)| bind::storage_entry(binding, wgpu::ShaderStages::COMPUTE, read_only));
        let group_layout = bind::layout(device, shader.name, &entries);
        let buffers = [&world, &chunks, &nodes, &heights, &pyramids];
        let bindings = bind::bind_buffers(device, shader.name, &group_layout, &buffers);
        let [fill_nodes, fill_heights, fill_pyramids] = compute_pipelines(
            device,
            &shader,
            &[&group_layout],
            ["fill_nodes", "fill_heights", "fill_pyramids"],
        );
        Self { fill_nodes, fill_heights, fill_pyramids, bindings, chunks, heights, pyramids, readback, batch }
    }

    /// Capacity of a batch.
    #[must_use]
    pub const fn batch(&self) -> usize {
        self.batch
    }

    /// Generates chunks and reads them back, in the order of `keys`. Blocks until the GPU is done.
    ///
    /// # Errors
    /// More keys than [`ChunkFiller::batch`], or a device that fails.
    pub fn fill(
        &self,
        device: &wgpu::Device,
        queue: &wgpu::Queue,
        keys: &[ChunkKey],
    ) -> Result<Vec<FilledChunk>, FillError> {
        if keys.is_empty() {
            return Ok(Vec::new());
        }
        let mut encoder = self.record(device, queue, keys)?;
        let n = keys.len() as u64;
        self.readback.copy(&mut encoder, &self.heights, 0..HEIGHT_BYTES * n, 0);
        self.readback.copy(&mut encoder, &self.pyramids, 0..2 * PYRAMID_BYTES * n, HEIGHT_BYTES * n);
        queue.submit([encoder.finish()]);
        self.read(device, keys)
    }

    /// Generates chunks without reading them back, to time the generation. Blocks until the GPU is
    /// done.
    ///
    /// # Errors
    /// As [`ChunkFiller::fill`].
    pub fn fill_in_place(
        &self,
        device: &wgpu::Device,
        queue: &wgpu::Queue,
        keys: &[ChunkKey],
    ) -> Result<(), FillError> {
        let encoder = self.record(device, queue, keys)?;
        queue.submit([encoder.finish()]);
        wait(device)
    }

    fn record(
        &self,
        device: &wgpu::Device,
        queue: &wgpu::Queue,
        keys: &[ChunkKey],
    ) -> Result<wgpu::CommandEncoder, FillError> {
        if keys.len() > self.batch {
            return Err(FillError::TooMany { keys: keys.len(), batch: self.batch });
        }
        let fills: Vec<ChunkFill> = keys.iter().map(|key| ChunkFill::from(*key)).collect();
        queue.write_buffer(&self.chunks, 0, bytemuck::cast_slice(&fills));
        let mut encoder =
            device.create_command_encoder(&wgpu::CommandEncoderDescriptor { label: Some("fill chunks") });
        let n = keys.len() as u32;
        let mut pass = compute_pass(&mut encoder, "fill chunks");
        pass.set_bind_group(0, &self.bindings, &[]);
        pass.set_pipeline(&self.fill_nodes);
        pass.dispatch_workgroups((FILL_NODES as u32).div_ceil(FILL_WORKGROUP), n, 1);
        pass.set_pipeline(&self.fill_heights);
        pass.dispatch_workgroups((VERTEX_COUNT as u32).div_ceil(FILL_WORKGROUP), n, 1);
        pass.set_pipeline(&self.fill_pyramids);
        pass.dispatch_workgroups(n, 1, 1);
        drop(pass);
        Ok(encoder)
    }

    /// Reads a submitted batch back and splits it into chunks.
    fn read(&self, device: &wgpu::Device, keys: &[ChunkKey]) -> Result<Vec<FilledChunk>, FillError> {
        let pending = self.readback.start(CHUNK_BYTES * keys.len() as u64);
        wait(device)?;
        let filled = pending.result(|bytes| {
            let words: &[i32] = bytemuck::cast_slice(bytes);
            let (heights, pyramids) = words.split_at(keys.len() * VERTEX_COUNT);
            let pyramids = pyramids.chunks_exact(2 * PYRAMID_TEXELS);
            let filled = keys.iter().zip(heights.chunks_exact(VERTEX_COUNT)).zip(pyramids);
            filled
                .map(|((key, heights), pyramids)| {
                    let (maxima, minima) = pyramids.split_at(PYRAMID_TEXELS);
                    FilledChunk {
                        key: *key,
                        heights: boxed(heights),
                        maxima: boxed(maxima),
                        minima: boxed(minima),
                    }
                })
                .collect()
        });
        filled.map_err(|error| FillError::Device(one_line(&error.to_string())))
    }
}

/// Waits until all submitted work is done.
fn wait(device: &wgpu::Device) -> Result<(), FillError> {
    let waited = device.poll(wgpu::PollType::wait_indefinitely());
    waited.map(|_| ()).map_err(|error| FillError::Device(one_line(&error.to_string())))
}

fn boxed<const N: usize>(words: &[i32]) -> Box<[i32; N]> {
    let words: Box<[i32]> = words.into();
    words.try_into().expect("the slice was cut to this length")
}

/// A driver's message as one line.
fn one_line(text: &str) -> String {
    text.lines().map(str::trim).filter(|line| !line.is_empty()).take(3).collect::<Vec<_>>().join("; ")
}
