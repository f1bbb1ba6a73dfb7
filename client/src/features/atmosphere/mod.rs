//! Atmosphere: light of sun and sky, aerial perspective, the sky background.

pub mod background;
pub mod integrate;

pub use background::SkyPass;
pub use integrate::AtmospherePass;
