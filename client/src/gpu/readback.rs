//! Read-back: copies from the GPU to the CPU.
//!
//! Three steps: record a copy into a staging buffer, [`Readback::start`] the mapping after the
//! submission, then [`PendingRead::poll`] until [`PendingRead::result`] has the bytes. Work without
//! a result for the CPU is polled as [`PendingWork`]. A browser cannot block: frames of a window
//! poll, and only pictures and measurements wait ([`Gpu::read`], [`Gpu::wait`]).

use crate::gpu::buffer::create_buffer;
use crate::gpu::device::{Gpu, GpuError};
use std::ops::Range;
use std::sync::mpsc;

type MapOutcome = Result<(), wgpu::BufferAsyncError>;

/// A staging buffer. Reusable: one read at a time.
#[derive(Debug)]
pub struct Readback {
    staging: wgpu::Buffer,
}

/// A mapping in progress.
#[derive(Debug)]
pub struct PendingRead {
    staging: wgpu::Buffer,
    bytes: u64,
    outcome: mpsc::Receiver<MapOutcome>,
    is_ready: bool,
}

/// Why a read failed: the device is lost, or the result was taken before the mapping was done.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("read-back failed: {0}")]
pub struct ReadbackError(String);

impl From<ReadbackError> for GpuError {
    fn from(error: ReadbackError) -> Self {
        Self::Fault(error.to_string())
    }
}

impl Readback {
    /// A staging buffer of `bytes` bytes.
    #[must_use]
    pub fn new(device: &wgpu::Device, label: &str, bytes: u64) -> Self {
        let staging =
            create_buffer(device, label, bytes, wgpu::BufferUsages::MAP_READ | wgpu::BufferUsages::COPY_DST);
        Self { staging }
    }

    /// The destination of copy commands.
    #[must_use]
    pub fn staging(&self) -> &wgpu::Buffer {
        &self.staging
    }

    /// Records a copy of a range of `source` to the byte `at` of the staging buffer.
    pub fn copy(
        &self,
        encoder: &mut wgpu::CommandEncoder,
        source: &wgpu::Buffer,
        range: Range<u64>,
        at: u64,
    ) {
        encoder.copy_buffer_to_buffer(source, range.start, &self.staging, at, range.end - range.start);
    }

    /// Starts mapping the first `bytes` bytes (at least 1), after the copies were submitted.
    #[must_use]
    pub fn start(&self, bytes: u64) -> PendingRead {
        let (sender, outcome) = mpsc::channel();
        self.staging.map_async(wgpu::MapMode::Read, ..bytes, move |mapped| {
            // The receiver is gone if the read was abandoned.
            let _ = sender.send(mapped);
        });
        PendingRead { staging: self.staging.clone(), bytes, outcome, is_ready: false }
    }
}

impl PendingRead {
    /// Whether the result can be taken. Never blocks.
    ///
    /// # Errors
    /// The mapping failed.
    pub fn poll(&mut self, device: &wgpu::Device) -> Result<bool, ReadbackError> {
        let polled = device.poll(wgpu::PollType::Poll);
        polled.map_err(|error| ReadbackError(error.to_string()))?;
        self.receive()
    }

    fn receive(&mut self) -> Result<bool, ReadbackError> {
        if !self.is_ready {
            match self.outcome.try_recv() {
                Ok(mapped) => mapped.map_err(|error| ReadbackError(error.to_string()))?,
                Err(mpsc::TryRecvError::Empty) => return Ok(false),
                Err(error) => return Err(ReadbackError(error.to_string())),
            }
            self.is_ready = true;
        }
        Ok(true)
    }

    /// Reads the mapped bytes and unmaps the staging buffer.
    ///
    /// # Errors
    /// The mapping failed or is not done.
    pub fn result<T>(mut self, read: impl FnOnce(&[u8]) -> T) -> Result<T, ReadbackError> {
        if !self.receive()? {
            return Err(ReadbackError("the buffer is not mapped yet".to_owned()));
        }
        let staging = &self.staging;
        let view =
            staging.get_mapped_range(..self.bytes).map_err(|error| ReadbackError(error.to_string()))?;
        let value = read(&view);
        drop(view);
        staging.unmap();
        Ok(value)
    }
}

/// Work that was submitted and is polled for its end.
#[derive(Debug)]
pub struct PendingWork {
    outcome: mpsc::Receiver<()>,
    is_done: bool,
}

impl PendingWork {
    /// Everything that was submitted so far.
    #[must_use]
    pub fn start(queue: &wgpu::Queue) -> Self {
        let (sender, outcome) = mpsc::channel();
        queue.on_submitted_work_done(move || {
            // The receiver is gone if the work was abandoned.
            let _ = sender.send(());
        });
        Self { outcome, is_done: false }
    }

    /// Whether the work is done. Never blocks.
    ///
    /// # Errors
    /// The device is lost.
    pub fn poll(&mut self, device: &wgpu::Device) -> Result<bool, ReadbackError> {
        let polled = device.poll(wgpu::PollType::Poll);
        polled.map_err(|error| ReadbackError(error.to_string()))?;
        if !self.is_done {
            match self.outcome.try_recv() {
                Ok(()) => self.is_done = true,
                Err(mpsc::TryRecvError::Empty) => {}
                Err(error) => return Err(ReadbackError(error.to_string())),
            }
        }
        Ok(self.is_done)
    }
}

#[cfg(not(target_arch = "wasm32"))]
impl Gpu {
    /// Starts a read of submitted copies, waits for the GPU and reads the bytes.
    ///
    /// # Errors
    /// The GPU failed.
    pub fn read<T>(
        &self,
        readback: &Readback,
        bytes: u64,
        read: impl FnOnce(&[u8]) -> T,
    ) -> Result<T, GpuError> {
        let pending = readback.start(bytes);
        self.wait()?;
        Ok(pending.result(read)?)
    }

    /// Copies a range of a buffer to the CPU: submits the copy and waits for the GPU.
    ///
    /// # Errors
    /// The GPU failed.
    pub fn read_buffer(&self, source: &wgpu::Buffer, range: Range<u64>) -> Result<Vec<u8>, GpuError> {
        let bytes = range.end - range.start;
        // WebGPU does not map empty ranges.
        if bytes == 0 {
            return Ok(Vec::new());
        }
        let readback = Readback::new(&self.device, "read-back", bytes);
        let mut encoder = self.device.create_command_encoder(&wgpu::CommandEncoderDescriptor::default());
        readback.copy(&mut encoder, source, range, 0);
        self.queue.submit([encoder.finish()]);
        self.read(&readback, bytes, <[u8]>::to_vec)
    }
}
