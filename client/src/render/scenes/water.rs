//! The scene of the water: one bay, three panels. Left the plain parallax of a fixed view, in the
//! middle the chosen tier, right the marched truth, by the same camera at the same moment.

use crate::render::water::WaterPass;
use crate::render::waves::WaveMap;

/// The scene.
#[derive(Debug)]
pub struct WaterScene {
    bay: WaterPass,
}

impl WaterScene {
    /// The scene over baked waves.
    #[must_use]
    pub fn new(device: &wgpu::Device, frame: &wgpu::Buffer, waves: &WaveMap, samples: u32) -> Self {
        Self { bay: WaterPass::bay(device, frame, waves, samples) }
    }

    /// Draws all panels.
    pub fn draw(&self, pass: &mut wgpu::RenderPass<'_>) {
        self.bay.draw(pass);
    }
}
