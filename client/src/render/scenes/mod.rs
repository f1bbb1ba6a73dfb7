//! Local scenes: pictures of one technique, complete in themselves. They need no server, no chunks
//! and no memory for any.
//!
//! Each scene is a file with a pass; this one only chooses.

pub mod relief;
pub mod water;

use crate::frame::FrameData;
use crate::relief::brick;
use crate::render::Gpu;
use crate::render::backdrop::BackdropPass;
use crate::render::materials::{Materials, OwnMaterials};
use crate::render::waves::WaveMap;
use crate::scene::Scene;
use relief::ReliefScene;
use relief::objects::LAYER;
use std::sync::Arc;
use water::WaterScene;

/// The materials of a scene: the user's, and bricks in the scene of bricks where the user has
/// brought no cobbles.
#[must_use]
pub fn materials(scene: Scene, own: &OwnMaterials) -> OwnMaterials {
    if scene != Scene::Brick || own[LAYER as usize].is_some() {
        return Arc::clone(own);
    }
    let mut sets = own.as_ref().clone();
    sets[LAYER as usize] = Some(brick::material());
    Arc::new(sets)
}

/// A local scene, ready to draw.
#[derive(Debug)]
pub enum LocalScene {
    /// Parallax of waves.
    Water(WaterScene),
    /// Parallax occlusion mapping.
    Relief(Box<ReliefScene>),
}

impl LocalScene {
    /// The scene, if it is a local one.
    #[must_use]
    pub fn new(
        scene: Scene,
        (device, queue): (&wgpu::Device, &wgpu::Queue),
        frame: &wgpu::Buffer,
        waves: &WaveMap,
        materials: &Materials,
        samples: u32,
    ) -> Option<Self> {
        match scene {
            Scene::Island | Scene::Grass | Scene::Culling => None,
            Scene::Water => Some(Self::Water(WaterScene::new(device, frame, waves, samples))),
            Scene::Pom | Scene::Brick | Scene::Spom => {
                let scene = ReliefScene::new(device, queue, frame, materials, scene, samples);
                Some(Self::Relief(Box::new(scene)))
            }
        }
    }

    /// Says what the next picture shows.
    pub fn prepare(&mut self, gpu: &Gpu, frame: &FrameData) {
        match self {
            Self::Water(_) => {}
            Self::Relief(scene) => scene.prepare(gpu, frame),
        }
    }

    /// Draws the whole picture.
    pub fn draw(&self, pass: &mut wgpu::RenderPass<'_>, materials: &Materials, sky: &BackdropPass) {
        match self {
            Self::Water(scene) => scene.draw(pass),
            Self::Relief(scene) => {
                scene.draw(pass, materials);
                sky.draw(pass);
            }
        }
    }
}
