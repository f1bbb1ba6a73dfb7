//! Terrain clipmap: heights, slopes and sky visibility of the land around the eye, apart from its
//! geometry.
//!
//! | file | job |
//! | --- | --- |
//! | [`window`] | which tiles a level holds around an eye |
//! | [`heights`] | heights of the land that tiles are made from |
//! | [`sky_visibility`] | horizons around the texels of a tile |
//! | [`schedule`] | which tile to fill next |
//! | [`textures`] | the textures, and their parameters for the shaders |
//!
//! A clipmap (Tanner, Migdal, Jones, "The Clipmap: A Virtual Mipmap", SIGGRAPH 1998) is a nest of
//! square textures around the eye, each with twice the spacing of the one before. It is addressed
//! toroidally (Asirvatham and Hoppe, "Terrain Rendering Using GPU-Based Geometry Clipmaps", GPU
//! Gems 2, 2005): when the eye moves, only new tiles are filled. Light does not depend on the drawn
//! levels of detail then, nor on their borders. Tiles come from the land of the world's seed by the
//! same integers as chunks, so a tile depends on its key alone.

pub mod heights;
pub mod schedule;
pub mod sky_visibility;
pub mod textures;
pub mod window;

pub use textures::{ClipmapLand, TerrainClipmap};
pub use window::ClipmapSize;
