//! Map tiles: shaded relief rendered from the chunks that the server sends, one tile per chunk key.
//!
//! [`elevation`] assembles heights and slopes from chunks, [`hillshade`] computes colours,
//! [`tiles`] renders and caches.

pub mod elevation;
pub mod hillshade;
pub mod tiles;

pub use tiles::Map;
