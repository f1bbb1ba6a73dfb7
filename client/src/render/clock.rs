//! The GPU's own clock: when the passes of a frame began and ended. Only where the device was
//! opened with timestamp queries.

use crate::render::gpu::{Gpu, GpuError};
use std::sync::mpsc;

/// Passes that are timed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum TimedPass {
    /// Land, sky and sea.
    Light,
    /// Tone curve and encoding.
    Tone,
}

/// Beginning and end of each pass, and the beginning of the frame behind them.
const TIMESTAMPS: u32 = 5;
const FRAME_BEGAN: u32 = 4;
const BYTES: u64 = TIMESTAMPS as u64 * 8;

/// How long the passes of a frame took by the GPU's clock, nanoseconds.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PassTimes {
    /// Land, sky and sea.
    pub light_ns: f64,
    /// Tone curve and encoding.
    pub tone_ns: f64,
    /// From the beginning of the frame to the end of its last pass, passes that are not timed by
    /// themselves included.
    pub whole_ns: f64,
}

/// The clock.
#[derive(Debug)]
pub struct PassClock {
    queries: wgpu::QuerySet,
    resolved: wgpu::Buffer,
    landing: wgpu::Buffer,
}

impl PassClock {
    /// A clock, if the device has one.
    #[must_use]
    pub fn new(device: &wgpu::Device) -> Option<Self> {
        if !device.features().contains(wgpu::Features::TIMESTAMP_QUERY) {
            return None;
        }
        let buffer = |label, usage| {
            device.create_buffer(&wgpu::BufferDescriptor {
                label: Some(label),
                size: BYTES,
                usage,
                mapped_at_creation: false,
            })
        };
        use wgpu::BufferUsages as Usage;
        Some(Self {
            queries: device.create_query_set(&wgpu::QuerySetDescriptor {
                label: Some("pass times"),
                ty: wgpu::QueryType::Timestamp,
                count: TIMESTAMPS,
            }),
            resolved: buffer("pass times", Usage::QUERY_RESOLVE | Usage::COPY_SRC),
            landing: buffer("pass times, read back", Usage::COPY_DST | Usage::MAP_READ),
        })
    }

    /// Records the beginning of a frame, before its first pass.
    pub fn begin(&self, encoder: &mut wgpu::CommandEncoder) {
        // A pass that does nothing: timestamps outside of passes are no part of portable WebGPU.
        drop(encoder.begin_compute_pass(&wgpu::ComputePassDescriptor {
            label: Some("frame begins"),
            timestamp_writes: Some(wgpu::ComputePassTimestampWrites {
                query_set: &self.queries,
                beginning_of_pass_write_index: Some(FRAME_BEGAN),
                end_of_pass_write_index: None,
            }),
        }));
    }

    /// What a pass has to be begun with.
    #[must_use]
    pub fn writes(&self, pass: TimedPass) -> wgpu::RenderPassTimestampWrites<'_> {
        let first = 2 * pass as u32;
        wgpu::RenderPassTimestampWrites {
            query_set: &self.queries,
            beginning_of_pass_write_index: Some(first),
            end_of_pass_write_index: Some(first + 1),
        }
    }

    /// Records the collection of a frame's times, after its passes.
    pub fn collect(&self, encoder: &mut wgpu::CommandEncoder) {
        encoder.resolve_query_set(&self.queries, 0..TIMESTAMPS, &self.resolved, 0);
        encoder.copy_buffer_to_buffer(&self.resolved, 0, &self.landing, 0, BYTES);
    }

    /// The times of the latest frame that was submitted; blocks until it is done.
    ///
    /// # Errors
    /// The GPU failed.
    pub fn read(&self, gpu: &Gpu) -> Result<PassTimes, GpuError> {
        let fault = |cause: &dyn std::fmt::Display| GpuError::Fault(format!("read-back failed: {cause}"));
        let (told, tell) = mpsc::channel();
        self.landing.map_async(wgpu::MapMode::Read, .., move |outcome| {
            // Nobody listens only if the wait below failed first.
            let _ = told.send(outcome);
        });
        gpu.wait()?;
        tell.recv().map_err(|error| fault(&error))?.map_err(|error| fault(&error))?;
        let view = self.landing.get_mapped_range(..).map_err(|error| fault(&error))?;
        let ticks: &[u64] = bytemuck::cast_slice(&view);
        let period_ns = f64::from(gpu.queue.get_timestamp_period());
        // A clock that was reset in between would run backwards; that is no time.
        let between = |from: usize, to: usize| ticks[to].saturating_sub(ticks[from]) as f64 * period_ns;
        let first = |pass: TimedPass| 2 * pass as usize;
        let span = |pass: TimedPass| between(first(pass), first(pass) + 1);
        let times = PassTimes {
            light_ns: span(TimedPass::Light),
            tone_ns: span(TimedPass::Tone),
            whole_ns: between(FRAME_BEGAN as usize, first(TimedPass::Tone) + 1),
        };
        drop(view);
        self.landing.unmap();
        Ok(times)
    }
}
