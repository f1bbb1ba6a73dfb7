//! GPU timestamps at the beginning and end of a frame's passes. Only on devices opened with
//! timestamp queries.

use crate::gpu::buffer::create_buffer;
use crate::gpu::device::{Gpu, GpuError};
use crate::gpu::readback::Readback;

/// Timed passes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum TimedPass {
    /// Land, sky and sea.
    Hdr,
    /// Tone curve, encoding, antialiasing and resampling.
    Tonemap,
}

/// Begin and end of each pass, then the begin of the frame.
const TIMESTAMPS: u32 = 5;
const FRAME_BEGIN: u32 = 4;
const BYTES: u64 = TIMESTAMPS as u64 * 8;

/// GPU times of a frame's passes, nanoseconds.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PassTimes {
    /// Land, sky and sea.
    pub hdr_ns: f64,
    /// Tone curve, encoding, antialiasing and resampling.
    pub tonemap_ns: f64,
    /// From the begin of the frame to the end of its last pass, untimed passes included.
    pub whole_ns: f64,
}

/// The timestamp queries of a frame.
#[derive(Debug)]
pub struct GpuTimer {
    queries: wgpu::QuerySet,
    resolved: wgpu::Buffer,
    readback: Readback,
}

impl GpuTimer {
    /// A timer, if the device has timestamp queries.
    #[must_use]
    pub fn new(device: &wgpu::Device) -> Option<Self> {
        if !device.features().contains(wgpu::Features::TIMESTAMP_QUERY) {
            return None;
        }
        Some(Self {
            queries: device.create_query_set(&wgpu::QuerySetDescriptor {
                label: Some("pass times"),
                ty: wgpu::QueryType::Timestamp,
                count: TIMESTAMPS,
            }),
            resolved: create_buffer(
                device,
                "pass times",
                BYTES,
                wgpu::BufferUsages::QUERY_RESOLVE | wgpu::BufferUsages::COPY_SRC,
            ),
            readback: Readback::new(device, "pass times, read back", BYTES),
        })
    }

    /// Records the begin of a frame, before its first pass.
    pub fn begin(&self, encoder: &mut wgpu::CommandEncoder) {
        // An empty pass: portable WebGPU has no timestamps outside of passes.
        drop(encoder.begin_compute_pass(&wgpu::ComputePassDescriptor {
            label: Some("frame begins"),
            timestamp_writes: Some(wgpu::ComputePassTimestampWrites {
                query_set: &self.queries,
                beginning_of_pass_write_index: Some(FRAME_BEGIN),
                end_of_pass_write_index: None,
            }),
        }));
    }

    /// The timestamp writes of a pass, for its descriptor.
    #[must_use]
    pub fn writes(&self, pass: TimedPass) -> wgpu::RenderPassTimestampWrites<'_> {
        let first = 2 * pass as u32;
        wgpu::RenderPassTimestampWrites {
            query_set: &self.queries,
            beginning_of_pass_write_index: Some(first),
            end_of_pass_write_index: Some(first + 1),
        }
    }

    /// [`GpuTimer::writes`] of one of several passes that are timed as one: the begin of the first
    /// and the end of the last. None for those between.
    #[must_use]
    pub fn part(
        &self,
        pass: TimedPass,
        begins: bool,
        ends: bool,
    ) -> Option<wgpu::RenderPassTimestampWrites<'_>> {
        let mut writes = self.writes(pass);
        writes.beginning_of_pass_write_index = writes.beginning_of_pass_write_index.filter(|_| begins);
        writes.end_of_pass_write_index = writes.end_of_pass_write_index.filter(|_| ends);
        (begins || ends).then_some(writes)
    }

    /// Resolves a frame's timestamps, after its passes.
    pub fn resolve(&self, encoder: &mut wgpu::CommandEncoder) {
        encoder.resolve_query_set(&self.queries, 0..TIMESTAMPS, &self.resolved, 0);
        self.readback.copy(encoder, &self.resolved, 0..BYTES, 0);
    }

    /// The times of the last submitted frame; blocks until it is done.
    ///
    /// # Errors
    /// The GPU failed.
    pub fn read(&self, gpu: &Gpu) -> Result<PassTimes, GpuError> {
        let period_ns = f64::from(gpu.queue.get_timestamp_period());
        gpu.read(&self.readback, BYTES, |bytes| {
            let ticks: &[u64] = bytemuck::cast_slice(bytes);
            // Saturates: a counter that was reset between two timestamps gives 0.
            let between = |from: usize, to: usize| ticks[to].saturating_sub(ticks[from]) as f64 * period_ns;
            let first = |pass: TimedPass| 2 * pass as usize;
            let span = |pass: TimedPass| between(first(pass), first(pass) + 1);
            PassTimes {
                hdr_ns: span(TimedPass::Hdr),
                tonemap_ns: span(TimedPass::Tonemap),
                whole_ns: between(FRAME_BEGIN as usize, first(TimedPass::Tonemap) + 1),
            }
        })
    }
}
