//! Reliefs on the CPU: height maps as numbers, and what is precomputed from them. No GPU.

pub mod brick;
pub mod cones;
pub mod knobs;
pub mod map;

pub use knobs::ReliefKnobs;
pub use map::{HeightMap, MapError};
