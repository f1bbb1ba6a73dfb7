//! Map tiles: shaded relief rendered from the chunks that the server sends, one tile per chunk key.
//!
//! [`elevation`] assembles heights and slopes from chunks, [`hillshade`] computes colours,
//! [`tiles`] renders and caches, [`turns`] gives client networks turns.

pub mod elevation;
pub mod hillshade;
pub mod tiles;
pub mod turns;

pub use tiles::Map;
