//! Headless rendering in suites. Without a GPU adapter a test is skipped with a line on standard
//! error, unless an adapter is required.

use client::camera::{Pose, Projection};
use client::gpu::{Gpu, GpuError, Image};
use client::headless::{self, HeadlessError, Options};
use client::settings::RenderSettings;
use client::stats::Stats;
use client::stream::ChunkStream;
use client::view::ViewParams;
use std::time::Instant;

/// Whether a missing GPU adapter is a failure instead of a skip. Continuous integration installs a
/// software driver and sets `TOMBOLO_REQUIRE_GPU`, so that no picture goes untested there.
#[must_use]
pub fn gpu_is_required() -> bool {
    std::env::var_os("TOMBOLO_REQUIRE_GPU").is_some()
}

/// The result of opening a GPU; none, with a line on standard error, if there is no adapter and
/// none is required.
///
/// # Panics
/// Any other error, and a missing adapter where one is required.
#[must_use]
pub fn gpu_or_skip<T>(opened: Result<T, GpuError>) -> Option<T> {
    match opened {
        Ok(gpu) => Some(gpu),
        Err(error @ GpuError::NoAdapter(_)) if !gpu_is_required() => {
            eprintln!("SKIPPED: {error}");
            None
        }
        Err(error) => panic!("{error}"),
    }
}

/// A GPU with default options; see [`gpu_or_skip`].
#[must_use]
pub fn open_gpu_or_skip() -> Option<Gpu> {
    gpu_or_skip(Gpu::open_blocking())
}

/// Renders the last frame of a source; see [`gpu_or_skip`].
///
/// # Panics
/// See [`gpu_or_skip`].
#[must_use]
pub fn render_or_skip(feed: impl ChunkStream, options: &Options) -> Option<(Image, Stats)> {
    rendered_or_skip(headless::render(options, feed, Instant::now(), |_| {}))
}

/// The result of a headless rendering; see [`gpu_or_skip`].
///
/// # Panics
/// See [`gpu_or_skip`].
#[must_use]
pub fn rendered_or_skip<T>(rendered: Result<T, HeadlessError>) -> Option<T> {
    match rendered {
        Ok(rendered) => Some(rendered),
        Err(HeadlessError::Gpu(error)) => gpu_or_skip(Err(error)),
        Err(error) => panic!("{error}"),
    }
}

/// The view of a camera (`X,Y,Z,YAW,PITCH`) with a field of view of 60 degrees and default
/// settings.
///
/// # Panics
/// The camera cannot be parsed.
#[must_use]
pub fn view_at(
    camera: &str,
    (width, height): (u32, u32),
    view_distance_m: u32,
    tolerance_px: f64,
) -> ViewParams {
    ViewParams {
        pose: pose(camera),
        projection: Projection { fov_deg: 60.0, width, height },
        view_distance_m,
        tolerance_px,
        time_s: 0.0,
        settings: RenderSettings::default(),
    }
}

/// Options of a headless picture from a camera, with one sample per pixel: the positions of further
/// samples depend on the driver.
///
/// # Panics
/// The camera cannot be parsed.
#[must_use]
pub fn options_at(camera: &str, (width, height): (u32, u32)) -> Options {
    let projection = Projection { width, height, fov_deg: 60.0 };
    Options { pose: pose(camera), projection, samples: 1, ..Options::default() }
}

fn pose(camera: &str) -> Pose {
    camera.parse().unwrap_or_else(|_| panic!("camera `{camera}`"))
}
