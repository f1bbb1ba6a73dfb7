//! Everything after the HDR pass: automatic exposure, bloom, tone curve, antialiasing, resampling.

pub mod antialias;
pub mod bloom;
pub mod chain;
pub mod exposure;
pub mod resample;
pub mod settings;
pub mod target;
pub mod tonemap;

pub use chain::{PostFrame, PostPasses};
pub use settings::{Antialias, PostSettings, Tone};
