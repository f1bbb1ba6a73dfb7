//! Level of detail: chunk selection ([`mod@select`]), geometric error on screen ([`error`]),
//! geomorphing without cracks ([`geomorph`]) and the eye's distance from what is drawn
//! ([`clearance`]).

pub mod clearance;
pub mod error;
pub mod geomorph;
pub mod select;

pub use geomorph::{Drawn, Fading};
pub use select::{Selection, select, select_at};
