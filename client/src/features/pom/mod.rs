//! Parallax occlusion mapping: settings, height maps, relaxed cones, and their textures.

pub mod cone_bake;
pub mod cones;
pub mod height_map;
pub mod maps;
pub mod settings;
mod textures;

pub use height_map::{HeightMap, MapError};
pub use maps::PomMaps;
pub use settings::PomSettings;
