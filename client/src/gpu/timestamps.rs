//! Timestamps of the GPU's clock. Only on devices opened with timestamp queries.

use crate::gpu::buffer::create_buffer;
use crate::gpu::device::{Gpu, GpuError};
use crate::gpu::readback::Readback;

/// A set of timestamps that each frame writes again.
#[derive(Debug)]
pub struct Timestamps {
    count: u32,
    queries: wgpu::QuerySet,
    resolved: wgpu::Buffer,
    readback: Readback,
}

/// Values of a set of timestamps.
#[derive(Clone, Debug)]
pub struct Ticks {
    ticks: Vec<u64>,
    period_ns: f64,
}

impl Timestamps {
    /// So many timestamps, if the device has timestamp queries.
    #[must_use]
    pub fn new(device: &wgpu::Device, label: &str, count: u32) -> Option<Self> {
        let bytes = u64::from(count) * 8;
        device.features().contains(wgpu::Features::TIMESTAMP_QUERY).then(|| Self {
            count,
            queries: device.create_query_set(&wgpu::QuerySetDescriptor {
                label: Some(label),
                ty: wgpu::QueryType::Timestamp,
                count,
            }),
            resolved: create_buffer(
                device,
                label,
                bytes,
                wgpu::BufferUsages::QUERY_RESOLVE | wgpu::BufferUsages::COPY_SRC,
            ),
            readback: Readback::new(device, label, bytes),
        })
    }

    /// Writes a timestamp after all earlier passes: an empty pass, because portable WebGPU has no
    /// timestamps outside of passes.
    pub fn mark(&self, encoder: &mut wgpu::CommandEncoder, index: u32) {
        drop(encoder.begin_compute_pass(&wgpu::ComputePassDescriptor {
            label: Some("timestamp"),
            timestamp_writes: Some(wgpu::ComputePassTimestampWrites {
                query_set: &self.queries,
                beginning_of_pass_write_index: Some(index),
                end_of_pass_write_index: None,
            }),
        }));
    }

    /// The timestamps `begin` and `begin + 1` at the begin and the end of a pass, for its
    /// descriptor.
    #[must_use]
    pub fn writes(&self, begin: u32) -> wgpu::RenderPassTimestampWrites<'_> {
        wgpu::RenderPassTimestampWrites {
            query_set: &self.queries,
            beginning_of_pass_write_index: Some(begin),
            end_of_pass_write_index: Some(begin + 1),
        }
    }

    /// Resolves the timestamps, after the passes of a frame.
    pub fn resolve(&self, encoder: &mut wgpu::CommandEncoder) {
        let bytes = u64::from(self.count) * 8;
        encoder.resolve_query_set(&self.queries, 0..self.count, &self.resolved, 0);
        self.readback.copy(encoder, &self.resolved, 0..bytes, 0);
    }

    /// The values of the last submitted frame; blocks until it is done.
    ///
    /// # Errors
    /// The GPU failed.
    pub fn read(&self, gpu: &Gpu) -> Result<Ticks, GpuError> {
        let period_ns = f64::from(gpu.queue.get_timestamp_period());
        let ticks = gpu.read(&self.readback, u64::from(self.count) * 8, bytemuck::pod_collect_to_vec)?;
        Ok(Ticks::new(ticks, period_ns))
    }
}

impl Ticks {
    /// Values of a clock with a period in nanoseconds.
    #[must_use]
    pub const fn new(ticks: Vec<u64>, period_ns: f64) -> Self {
        Self { ticks, period_ns }
    }

    /// Nanoseconds from one timestamp to another; 0 if the clock was reset between them.
    #[must_use]
    pub fn between_ns(&self, from: u32, to: u32) -> f64 {
        self.ticks[to as usize].saturating_sub(self.ticks[from as usize]) as f64 * self.period_ns
    }
}
