//! Data that the CPU hands to the shaders, byte for byte.
//!
//! Tests compare every offset with naga's reflection of the WGSL. Every public name of the parts is
//! re-exported here.

mod clipmap;
mod frame;
mod pom;
mod post;
mod probes;
mod shadow;
mod terrain;
mod vegetation;
mod water;

pub use clipmap::*;
pub use frame::*;
pub use pom::*;
pub use post::*;
pub use probes::*;
pub use shadow::*;
pub use terrain::*;
pub use vegetation::*;
pub use water::*;
