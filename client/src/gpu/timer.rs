//! GPU times of a frame's passes.

use crate::gpu::device::{Gpu, GpuError};
use crate::gpu::timestamps::Timestamps;

/// Timed passes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum TimedPass {
    /// Land, plants, sky and sea.
    Hdr,
    /// Tone curve, encoding, antialiasing and resampling.
    Tonemap,
}

/// Begin and end of each pass, then the begin of the frame.
const TIMESTAMPS: u32 = 5;
const FRAME_BEGIN: u32 = 4;

/// GPU times of a frame's passes, nanoseconds.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PassTimes {
    /// Land, plants, sky and sea.
    pub hdr_ns: f64,
    /// Tone curve, encoding, antialiasing and resampling.
    pub tonemap_ns: f64,
    /// From the begin of the frame to the end of its last pass, untimed passes included.
    pub whole_ns: f64,
}

/// The timestamps of a frame.
#[derive(Debug)]
pub struct GpuTimer(Timestamps);

impl GpuTimer {
    /// A timer, if the device has timestamp queries.
    #[must_use]
    pub fn new(device: &wgpu::Device) -> Option<Self> {
        Timestamps::new(device, "pass times", TIMESTAMPS).map(Self)
    }

    /// Records the begin of a frame, before its first pass.
    pub fn begin(&self, encoder: &mut wgpu::CommandEncoder) {
        self.0.mark(encoder, FRAME_BEGIN);
    }

    /// The timestamp writes of a pass, for its descriptor.
    #[must_use]
    pub fn writes(&self, pass: TimedPass) -> wgpu::RenderPassTimestampWrites<'_> {
        self.0.writes(2 * pass as u32)
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
        self.0.resolve(encoder);
    }

    /// The times of the last submitted frame; blocks until it is done.
    ///
    /// # Errors
    /// The GPU failed.
    pub fn read(&self, gpu: &Gpu) -> Result<PassTimes, GpuError> {
        let ticks = self.0.read(gpu)?;
        let [hdr, tonemap] = [TimedPass::Hdr, TimedPass::Tonemap].map(|pass| 2 * pass as u32);
        Ok(PassTimes {
            hdr_ns: ticks.between_ns(hdr, hdr + 1),
            tonemap_ns: ticks.between_ns(tonemap, tonemap + 1),
            whole_ns: ticks.between_ns(FRAME_BEGIN, tonemap + 1),
        })
    }
}
