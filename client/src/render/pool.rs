//! What the GPU holds of all resident chunks: buffers of equal slots, allocated once.

use crate::render::{Gpu, GpuError};
use crate::world::Resident;
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
    clearances: wgpu::Buffer,
    slots: u32,
}

impl ChunkPool {
    /// Slots that one storage binding of this device can hold; a larger wish is cut to it.
    #[must_use]
    pub fn slots_within(limits: &wgpu::Limits, wished: u32) -> u32 {
        let bytes = limits.max_storage_buffer_binding_size.min(limits.max_buffer_size);
        wished.min(u32::try_from(bytes / HEIGHTS).unwrap_or(u32::MAX)).max(1)
    }

    /// A pool of `slots` slots, see [`ChunkPool::slots_within`].
    #[must_use]
    pub fn new(device: &wgpu::Device, slots: u32) -> Self {
        let buffer = |label, bytes, more| {
            device.create_buffer(&wgpu::BufferDescriptor {
                label: Some(label),
                size: bytes * u64::from(slots),
                usage: wgpu::BufferUsages::STORAGE | wgpu::BufferUsages::COPY_DST | more,
                mapped_at_creation: false,
            })
        };
        Self {
            heights: buffer("chunk heights", HEIGHTS, wgpu::BufferUsages::empty()),
            maxima: buffer("chunk maxima", MAXIMA, wgpu::BufferUsages::empty()),
            records: buffer("chunk records", RECORDS, wgpu::BufferUsages::empty()),
            // Read back by whoever compares shadows with their definition.
            clearances: buffer("chunk clearances", CLEARANCES, wgpu::BufferUsages::COPY_SRC),
            slots,
        }
    }

    /// How many slots there are.
    #[must_use]
    pub fn slots(&self) -> u32 {
        self.slots
    }

    /// Bytes of all buffers.
    #[must_use]
    pub fn bytes(&self) -> u64 {
        self.heights.size() + self.maxima.size() + self.records.size() + self.clearances.size()
    }

    /// Fills a chunk's slot; the sun shines on all of it until its shadow is found. A slot beyond
    /// the pool is ignored: it could only come from a pool of another size.
    pub fn upload(&self, queue: &wgpu::Queue, chunk: &Resident) {
        if chunk.slot < self.slots {
            let slot = u64::from(chunk.slot);
            queue.write_buffer(&self.heights, HEIGHTS * slot, bytemuck::cast_slice(&chunk.heights[..]));
            queue.write_buffer(&self.maxima, MAXIMA * slot, bytemuck::cast_slice(&chunk.maxima));
            queue.write_buffer(&self.records, RECORDS * slot, bytemuck::cast_slice(&record(chunk)));
            let clear = [CLEAR_WORD; CLEARANCE_WORDS];
            queue.write_buffer(&self.clearances, CLEARANCES * slot, bytemuck::cast_slice(&clear));
        }
    }

    /// A slot's clearances as bytes, row by row without padding: what shadows are compared by.
    /// Waits for the GPU.
    ///
    /// # Errors
    /// The device failed, or the pool has no such slot.
    pub fn read_clearances(&self, gpu: &Gpu, slot: u32) -> Result<Vec<u8>, GpuError> {
        let failed = |error: &dyn std::fmt::Display| GpuError::Fault(error.to_string());
        if slot >= self.slots {
            return Err(failed(&format!("slot {slot} of {} was read", self.slots)));
        }
        let landing = gpu.device.create_buffer(&wgpu::BufferDescriptor {
            label: Some("clearances of a slot"),
            size: CLEARANCES,
            usage: wgpu::BufferUsages::MAP_READ | wgpu::BufferUsages::COPY_DST,
            mapped_at_creation: false,
        });
        let mut encoder = gpu.device.create_command_encoder(&wgpu::CommandEncoderDescriptor::default());
        encoder.copy_buffer_to_buffer(
            &self.clearances,
            CLEARANCES * u64::from(slot),
            &landing,
            0,
            CLEARANCES,
        );
        gpu.queue.submit([encoder.finish()]);
        let slice = landing.slice(..);
        slice.map_async(wgpu::MapMode::Read, |_| ());
        gpu.wait()?;
        let bytes = slice.get_mapped_range().map_err(|error| failed(&error))?;
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

    /// How far the sun clears the horizon: [`CLEARANCE_WORDS`] words a slot.
    #[must_use]
    pub fn clearances(&self) -> &wgpu::Buffer {
        &self.clearances
    }
}

/// What a slot holds besides heights, tops and clearances.
fn record(chunk: &Resident) -> [u32; RECORD_WORDS] {
    std::array::from_fn(|word| match chunk.minima.get(word) {
        Some(bottom) => *bottom as u32,
        None => density_word(chunk, word - BLOCK_TEXELS),
    })
}

/// Four densities in the order of their places.
#[must_use]
pub fn density_word(chunk: &Resident, word: usize) -> u32 {
    u32::from_le_bytes(std::array::from_fn(|byte| chunk.grass.density[4 * word + byte]))
}
