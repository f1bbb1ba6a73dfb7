//! Caches of encoded chunk frames: in [`memory`], and on [`disk`] over restarts; and of their
//! [`content_digests`].

pub mod content_digests;
pub mod disk;
pub mod memory;
