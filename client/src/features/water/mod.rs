//! Water: wave settings, the baked wave map, and the passes that draw the sea.

pub mod draw;
pub mod settings;
pub mod waves;

pub use draw::WaterPass;
pub use settings::{WaterTier, WaveSettings};
pub use waves::WaveMap;
