//! The chunks that are here: kept within a budget ([`resident`]), chosen for drawing
//! ([`mod@select`]) and joined without a gap ([`seams`]).
//!
//! Knows slots but no GPU, and time only as a frame number.

pub mod error;
pub mod resident;
pub mod seams;
pub mod select;
pub mod stretch;

pub use resident::{Arrival, Resident, World};
pub use seams::Drawn;
pub use select::{Fading, Selection, select, select_at};
