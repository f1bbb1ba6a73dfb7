//! The GPU device and what all passes share: pipelines, bind groups, buffers, render targets,
//! timestamps, read-back.

pub mod bind;
pub mod buffer;
pub mod device;
pub mod offscreen;
pub mod pipeline;
pub mod readback;
pub mod rebuild;
pub mod surface;
pub mod targets;
pub mod timer;
pub mod timestamps;

pub use device::{Gpu, GpuError, instance};
pub use offscreen::{Image, OffscreenTarget};
pub use timer::PassTimes;
