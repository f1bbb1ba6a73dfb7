//! The chunks that are here: kept within a budget ([`resident`]) and chosen for drawing ([`mod@select`]).
//!
//! Knows slots but no GPU, and time only as a frame number.

pub mod resident;
pub mod select;

pub use resident::{Arrival, Resident, World};
pub use select::{Selection, select};
