//! The heights of all resident chunks on the GPU: one buffer of equal slots, allocated once.

use terrain::constants::VERTEX_COUNT;

const SLOT: u64 = 4 * VERTEX_COUNT as u64;

/// The pool.
#[derive(Debug)]
pub struct HeightPool {
    buffer: wgpu::Buffer,
    slots: u32,
}

impl HeightPool {
    /// Slots that one storage binding of this device can hold; a larger wish is cut to it.
    #[must_use]
    pub fn slots_within(limits: &wgpu::Limits, wished: u32) -> u32 {
        let bytes = limits.max_storage_buffer_binding_size.min(limits.max_buffer_size);
        wished.min(u32::try_from(bytes / SLOT).unwrap_or(u32::MAX)).max(1)
    }

    /// A pool of `slots` slots, see [`HeightPool::slots_within`].
    #[must_use]
    pub fn new(device: &wgpu::Device, slots: u32) -> Self {
        let buffer = device.create_buffer(&wgpu::BufferDescriptor {
            label: Some("chunk heights"),
            size: SLOT * u64::from(slots),
            usage: wgpu::BufferUsages::STORAGE | wgpu::BufferUsages::COPY_DST,
            mapped_at_creation: false,
        });
        Self { buffer, slots }
    }

    /// Fills a slot. A slot beyond the pool is ignored: it could only come from a pool of another size.
    pub fn upload(&self, queue: &wgpu::Queue, slot: u32, heights: &[i32; VERTEX_COUNT]) {
        if slot < self.slots {
            queue.write_buffer(&self.buffer, SLOT * u64::from(slot), bytemuck::cast_slice(heights));
        }
    }

    /// How many slots there are.
    #[must_use]
    pub fn slots(&self) -> u32 {
        self.slots
    }

    /// The buffer that `draw_terrain` reads.
    #[must_use]
    pub fn buffer(&self) -> &wgpu::Buffer {
        &self.buffer
    }
}
