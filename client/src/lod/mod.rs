//! Level of detail: chunk selection ([`mod@select`]), geometric error on screen ([`error`]) and
//! geomorphing without cracks ([`geomorph`]).

pub mod error;
pub mod geomorph;
pub mod select;

pub use geomorph::{Drawn, Fading};
pub use select::{Selection, select, select_at};
