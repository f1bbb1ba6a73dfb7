//! Plants: what grows around the eye, and what of it is seen.
//!
//! [`square`] is the drawn land around the eye in the form in which sight is tested over it,
//! [`knobs`] what a person can choose, [`stand`] what the shaders are told, and [`kept`] the whole
//! choice once more on the CPU.

pub mod kept;
pub mod knobs;
pub mod square;
pub mod stand;

pub use knobs::{Cull, PlantKnobs};
pub use square::Square;
pub use stand::{PlantFrame, Stand};
