//! Local scenes: pictures of one technique, complete in themselves. They need no server, no chunks and no memory for any.
//!
//! Each scene is a file with a pass; this one only chooses.

pub mod water;

use crate::render::waves::WaveMap;
use crate::scene::Scene;
use water::WaterScene;

/// A local scene, ready to draw.
#[derive(Debug)]
pub enum LocalScene {
    /// Parallax of waves.
    Water(WaterScene),
}

impl LocalScene {
    /// The scene, if it is a local one.
    #[must_use]
    pub fn new(
        scene: Scene,
        device: &wgpu::Device,
        frame: &wgpu::Buffer,
        waves: &WaveMap,
        samples: u32,
    ) -> Option<Self> {
        match scene {
            Scene::Island => None,
            Scene::Water => Some(Self::Water(WaterScene::new(device, frame, waves, samples))),
        }
    }

    /// Draws the whole picture.
    pub fn draw(&self, pass: &mut wgpu::RenderPass<'_>) {
        match self {
            Self::Water(scene) => scene.draw(pass),
        }
    }
}
