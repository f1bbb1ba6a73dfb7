//! A device that is lost, or out of memory, while it draws is replaced: the picture is the same to
//! the byte.

use client::camera::Projection;
use client::gpu::{Gpu, GpuError};
use client::headless::{self, HeadlessError, Options};
use client::stream::{ChunkStream, LocalStream, StreamEvent, Traffic};
use protocol::Delivery;
use protocol::view::View;
use std::time::Instant;
use terrain::ChunkKey;

/// How a device is lost.
#[derive(Clone, Copy, Debug)]
enum Loss {
    Destroyed,
    OutOfMemory,
}

impl Loss {
    const ALL: [Self; 2] = [Self::Destroyed, Self::OutOfMemory];

    fn cause(self, device: &wgpu::Device) {
        match self {
            Self::Destroyed => device.destroy(),
            Self::OutOfMemory => exhaust(device),
        }
    }

    /// A word of its message.
    const fn word(self) -> &'static str {
        match self {
            Self::Destroyed => "lost",
            Self::OutOfMemory => "Memory",
        }
    }
}

/// Allocates more than any address space, in textures within the limits of a device: the first one
/// of 256 GiB fails, unless the system grants memory that it does not have.
fn exhaust(device: &wgpu::Device) {
    let descriptor = wgpu::TextureDescriptor {
        label: Some("all of the memory"),
        size: wgpu::Extent3d { width: 8192, height: 8192, depth_or_array_layers: 256 },
        mip_level_count: 1,
        sample_count: 1,
        dimension: wgpu::TextureDimension::D2,
        format: wgpu::TextureFormat::Rgba32Float,
        usage: wgpu::TextureUsages::COPY_DST,
        view_formats: &[],
    };
    let textures: Vec<_> = (0..1000).map(|_| device.create_texture(&descriptor)).collect();
    drop(textures);
}

/// Local land, during which a device is lost: at so many polls after the view was settled.
struct LosesDevice {
    land: LocalStream,
    device: wgpu::Device,
    loss: Loss,
    is_settled: bool,
    /// Polls until the device is lost; none after that.
    polls: Option<u32>,
}

impl ChunkStream for LosesDevice {
    fn poll(&mut self) -> Option<StreamEvent> {
        let event = self.land.poll();
        self.is_settled |= matches!(event, Some(StreamEvent::Settled { .. }));
        if self.is_settled && event.is_none() {
            match self.polls {
                Some(0) => {
                    self.loss.cause(&self.device);
                    self.polls = None;
                }
                Some(left) => self.polls = Some(left - 1),
                None => {}
            }
        }
        event
    }

    fn set_view(&mut self, view: View) {
        self.land.set_view(view);
    }

    fn release(&mut self, keys: &[ChunkKey]) {
        self.land.release(keys);
    }

    fn holding(&mut self, keys: &[ChunkKey]) {
        self.land.holding(keys);
    }

    fn delivery(&self) -> Delivery {
        self.land.delivery()
    }

    fn traffic(&self) -> Traffic {
        self.land.traffic()
    }
}

fn options() -> Options {
    Options {
        projection: Projection { fov_deg: 60.0, width: 160, height: 90 },
        view_distance_m: 1500,
        tolerance_px: 4.0,
        samples: 1,
        frames: 3,
        ..Options::default()
    }
}

/// A GPU, unless there is none and none is required.
fn open() -> Option<Gpu> {
    match Gpu::open_blocking() {
        Ok(gpu) => Some(gpu),
        Err(error @ GpuError::NoAdapter(_)) if std::env::var_os("TOMBOLO_REQUIRE_GPU").is_none() => {
            eprintln!("SKIPPED: {error}");
            None
        }
        Err(error) => panic!("{error}"),
    }
}

/// Draws a picture, during which the device may be lost: the picture, and how often a device was
/// opened again.
fn draw(
    gpu: &Gpu,
    options: &Options,
    loss: Loss,
    polls: Option<u32>,
) -> Result<(Vec<u8>, u32), HeadlessError> {
    let (land, device) = (LocalStream::new(1), gpu.device.clone());
    let stream = LosesDevice { land, device, loss, is_settled: false, polls };
    let drawn = headless::render_on(gpu, options, stream, Instant::now(), |_| {});
    drawn.map(|(image, stats)| (image.rgba, stats.gpu_rebuilds))
}

#[test]
fn the_picture_after_a_lost_device_equals_the_one_before() {
    let Some(gpu) = open() else { return };
    let (expected, rebuilds) = draw(&gpu, &options(), Loss::Destroyed, None).unwrap();
    assert_eq!(rebuilds, 0);
    assert!(expected.iter().any(|byte| *byte != expected[0]), "the picture shows something");
    for loss in Loss::ALL {
        // In a warm-up frame, and in the last one.
        for polls in [2, 6] {
            let gpu = Gpu::open_blocking().unwrap();
            let (after, rebuilds) = draw(&gpu, &options(), loss, Some(polls)).unwrap();
            assert_eq!(rebuilds, 1, "{loss:?} after {polls} polls");
            assert!(after == expected, "{loss:?} after {polls} polls: the picture differs");
            assert!(gpu.loss().is_some());
            // The control: without a rebuild there is no picture.
            let gpu = Gpu::open_blocking().unwrap();
            let without = draw(&gpu, &Options { gpu_rebuilds: 0, ..options() }, loss, Some(polls));
            let reason = without.expect_err("a lost device draws nothing").to_string();
            assert!(reason.contains(loss.word()) && reason.contains("--chunk-mb"), "{reason}");
        }
    }
}

#[test]
fn memory_that_is_exhausted_counts_as_a_loss_and_a_wrong_call_does_not() {
    let Some(gpu) = open() else { return };
    assert_eq!(gpu.loss(), None);
    // A buffer beyond the limits of the device is a validation error.
    let size = gpu.device.limits().max_buffer_size + 4;
    let descriptor = wgpu::BufferDescriptor {
        label: Some("too large"),
        size,
        usage: wgpu::BufferUsages::COPY_DST,
        mapped_at_creation: false,
    };
    drop(gpu.device.create_buffer(&descriptor));
    assert!(gpu.check().is_err() && gpu.loss().is_none());
    exhaust(&gpu.device);
    assert!(gpu.loss().is_some_and(|cause| cause.contains("Memory")), "{:?}", gpu.loss());
}
