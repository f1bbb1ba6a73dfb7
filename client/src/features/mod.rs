//! Rendering features. Each folder holds a feature's settings, its CPU half and its GPU passes.

pub mod atmosphere;
pub mod materials;
pub mod pom;
pub mod post;
pub mod terrain;
pub mod terrain_clipmap;
pub mod terrain_shadow;
pub mod vegetation;
pub mod water;
