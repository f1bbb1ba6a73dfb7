//! Replacing a device that was lost or ran out of memory.
//!
//! Everything on the GPU is a copy: chunks are in the chunk cache, the rest is computed at start.
//! So the owner of a renderer makes a new device, a new renderer and uploads the cache again.

use crate::gpu::device::{Gpu, GpuError};

/// Devices that are opened in place of failed ones, unless `STEADY_FRAMES` pass between two.
pub const MOST_REBUILDS: u32 = 3;

/// Frames after which the attempts count from zero again: the failure was not caused by what is
/// drawn.
const STEADY_FRAMES: u32 = 1000;

/// Counts attempts.
#[derive(Clone, Copy, Debug)]
pub struct Rebuilds {
    most: u32,
    attempts: u32,
    frames: u32,
    done: u32,
}

impl Rebuilds {
    /// At most `most` attempts in a row; 0 reports the first loss as an error.
    #[must_use]
    pub const fn new(most: u32) -> Self {
        Self { most, attempts: 0, frames: 0, done: 0 }
    }

    /// Rebuilds since the start.
    #[must_use]
    pub const fn done(&self) -> u32 {
        self.done
    }

    /// A frame was drawn.
    pub const fn frame_drawn(&mut self) {
        self.frames += 1;
        if self.frames >= STEADY_FRAMES {
            (self.frames, self.attempts) = (0, 0);
        }
    }

    /// Begins to replace a device after an error, which destroys it: the new one needs its memory.
    /// Returns the cause, for display.
    ///
    /// # Errors
    /// The error itself if the device is not lost; [`GpuError::LostAgain`] after the last attempt.
    pub fn begin(&mut self, gpu: &Gpu, error: GpuError) -> Result<String, GpuError> {
        let Some(cause) = gpu.loss() else { return Err(error) };
        if self.attempts == self.most {
            return Err(GpuError::LostAgain { attempts: self.attempts, cause });
        }
        gpu.device.destroy();
        // Resources of a destroyed device are freed by a poll.
        let _ = gpu.device.poll(wgpu::PollType::Poll);
        (self.attempts, self.frames, self.done) = (self.attempts + 1, 0, self.done + 1);
        Ok(cause)
    }
}
