//! A device that is lost while it draws is replaced: the picture is the same to the byte.

use client::camera::Projection;
use client::gpu::{Gpu, GpuError};
use client::headless::{self, HeadlessError, Options};
use client::stream::{ChunkStream, LocalStream, StreamEvent, Traffic};
use protocol::Delivery;
use protocol::view::View;
use std::time::Instant;
use terrain::ChunkKey;

/// Local land, during which a device is destroyed: at so many polls after the view was settled.
struct LosesDevice {
    land: LocalStream,
    device: wgpu::Device,
    is_settled: bool,
    /// Polls until the device is destroyed; none after that.
    polls: Option<u32>,
}

impl ChunkStream for LosesDevice {
    fn poll(&mut self) -> Option<StreamEvent> {
        let event = self.land.poll();
        self.is_settled |= matches!(event, Some(StreamEvent::Settled { .. }));
        if self.is_settled && event.is_none() {
            match self.polls {
                Some(0) => {
                    self.device.destroy();
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

fn draw(gpu: &Gpu, options: &Options, polls: Option<u32>) -> Result<(Vec<u8>, u32), HeadlessError> {
    let stream =
        LosesDevice { land: LocalStream::new(1), device: gpu.device.clone(), is_settled: false, polls };
    let drawn = headless::render_on(gpu, options, stream, Instant::now(), |_| {});
    drawn.map(|(image, stats)| (image.rgba, stats.gpu_rebuilds))
}

#[test]
fn the_picture_after_a_lost_device_equals_the_one_before() {
    let Some(gpu) = open() else { return };
    let (expected, rebuilds) = draw(&gpu, &options(), None).unwrap();
    assert_eq!(rebuilds, 0);
    assert!(expected.iter().any(|byte| *byte != expected[0]), "the picture shows something");
    // In a warm-up frame, and in the last one.
    for polls in [2, 6] {
        let gpu = Gpu::open_blocking().unwrap();
        let (after, rebuilds) = draw(&gpu, &options(), Some(polls)).unwrap();
        assert_eq!(rebuilds, 1, "after {polls} polls");
        assert!(after == expected, "after {polls} polls the picture differs");
        assert!(gpu.loss().is_some());
        // The control: without a rebuild there is no picture.
        let gpu = Gpu::open_blocking().unwrap();
        let without = draw(&gpu, &Options { gpu_rebuilds: 0, ..options() }, Some(polls));
        let reason = without.expect_err("a destroyed device draws nothing").to_string();
        assert!(reason.contains("lost") && reason.contains("--chunk-mb"), "{reason}");
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
    gpu.device.destroy();
    assert!(gpu.loss().is_some());
}
