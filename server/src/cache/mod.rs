//! Caches of encoded chunk frames: in [`memory`], and on [`disk`] over restarts.

pub mod disk;
pub mod memory;
