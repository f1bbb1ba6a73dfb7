//! The water scene: one bay in three panels by the same camera at the same time. Left plain
//! parallax mapping of a fixed view, in the middle the selected tier, right the ray-marched
//! reference.

use crate::features::water::draw::WaterPass;
use crate::features::water::waves::WaveMap;

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
        self.bay.draw(pass, false);
    }
}
