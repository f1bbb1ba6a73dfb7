//! GPU buffers of all resident chunks: equal slots, allocated once.

use crate::cache::Resident;
use crate::gpu::buffer::create_buffer;
use crate::gpu::{Gpu, GpuError};
use shaders::layout::{BLOCK_TEXELS, CLEAR_WORD, CLEARANCE_WORDS, RECORD_WORDS};
use terrain::constants::{VERTEX_COUNT, VERTICES};

/// Bytes of a slot's heights, the largest of its parts.
const HEIGHTS: u64 = 4 * VERTEX_COUNT as u64;
const MAXIMA: u64 = 4 * BLOCK_TEXELS as u64;
const RECORDS: u64 = 4 * RECORD_WORDS as u64;
const CLEARANCES: u64 = 4 * CLEARANCE_WORDS as u64;

/// The pool.
#[derive(Debug)]
pub struct ChunkPool {
    heights: wgpu::Buffer,
    maxima: wgpu::Buffer,
    records: wgpu::Buffer,
    sun_clearances: wgpu::Buffer,
    slots: u32,
}

impl ChunkPool {
    /// Slots that fit one storage binding of this device, at most `requested`.
    #[must_use]
    pub fn slots_within(limits: &wgpu::Limits, requested: u32) -> u32 {
        let bytes = limits.max_storage_buffer_binding_size.min(limits.max_buffer_size);
        requested.min(u32::try_from(bytes / HEIGHTS).unwrap_or(u32::MAX)).max(1)
    }

    /// A pool of `slots` slots, see [`ChunkPool::slots_within`].
    #[must_use]
    pub fn new(device: &wgpu::Device, slots: u32) -> Self {
        let buffer = |label, bytes, more| {
            create_buffer(
                device,
                label,
                bytes * u64::from(slots),
                wgpu::BufferUsages::STORAGE | wgpu::BufferUsages::COPY_DST | more,
            )
        };
        Self {
            heights: buffer("chunk heights", HEIGHTS, wgpu::BufferUsages::empty()),
            maxima: buffer("chunk maxima", MAXIMA, wgpu::BufferUsages::empty()),
            records: buffer("chunk records", RECORDS, wgpu::BufferUsages::empty()),
            // Read back by tests of the shadows.
            sun_clearances: buffer("chunk sun clearances", CLEARANCES, wgpu::BufferUsages::COPY_SRC),
            slots,
        }
    }

    /// Number of slots.
    #[must_use]
    pub fn slots(&self) -> u32 {
        self.slots
    }

    /// Bytes of all buffers.
    #[must_use]
    pub fn bytes(&self) -> u64 {
        self.heights.size() + self.maxima.size() + self.records.size() + self.sun_clearances.size()
    }

    /// Uploads a chunk to its slot, fully lit until its shadow is traced. Slots beyond the pool are
    /// ignored.
    pub fn upload(&self, queue: &wgpu::Queue, chunk: &Resident) {
        if chunk.slot < self.slots {
            let slot = u64::from(chunk.slot);
            queue.write_buffer(&self.heights, HEIGHTS * slot, bytemuck::cast_slice(&chunk.heights[..]));
            queue.write_buffer(&self.maxima, MAXIMA * slot, bytemuck::cast_slice(&chunk.maxima));
            queue.write_buffer(&self.records, RECORDS * slot, bytemuck::cast_slice(&record(chunk)));
            let clear = [CLEAR_WORD; CLEARANCE_WORDS];
            queue.write_buffer(&self.sun_clearances, CLEARANCES * slot, bytemuck::cast_slice(&clear));
        }
    }

    /// Sun clearances of a slot as bytes, row by row without padding; for tests. Waits for the GPU.
    ///
    /// # Errors
    /// The device failed, or the pool has no such slot.
    pub fn read_sun_clearances(&self, gpu: &Gpu, slot: u32) -> Result<Vec<u8>, GpuError> {
        if slot >= self.slots {
            return Err(GpuError::Fault(format!("slot {slot} of {} was read", self.slots)));
        }
        let start = CLEARANCES * u64::from(slot);
        let bytes = gpu.read_buffer(&self.sun_clearances, start..start + CLEARANCES)?;
        let rows = bytes.chunks_exact(CLEARANCE_WORDS * 4 / VERTICES);
        Ok(rows.flat_map(|row| row[..VERTICES].iter().copied()).collect())
    }

    /// Heights in units: `VERTEX_COUNT` words a slot.
    #[must_use]
    pub fn heights(&self) -> &wgpu::Buffer {
        &self.heights
    }

    /// Upper bounds in units: [`BLOCK_TEXELS`] words a slot.
    #[must_use]
    pub fn maxima(&self) -> &wgpu::Buffer {
        &self.maxima
    }

    /// Lower bounds and densities of plants: [`RECORD_WORDS`] words a slot.
    #[must_use]
    pub fn records(&self) -> &wgpu::Buffer {
        &self.records
    }

    /// Sun clearance above the horizon: [`CLEARANCE_WORDS`] words a slot.
    #[must_use]
    pub fn sun_clearances(&self) -> &wgpu::Buffer {
        &self.sun_clearances
    }
}

/// Lower bounds and vegetation densities of a slot.
fn record(chunk: &Resident) -> [u32; RECORD_WORDS] {
    std::array::from_fn(|word| match chunk.minima.get(word) {
        Some(bottom) => *bottom as u32,
        None => chunk.density_word(word - BLOCK_TEXELS),
    })
}
