//! Local scenes: one rendering technique each. They need no server and no chunks.
//!
//! Each scene has its own file; this one dispatches.

pub mod brick;
pub mod meshes;
pub mod pom;
pub mod water;

use crate::features::atmosphere::SkyPass;
use crate::features::materials::{CustomMaterials, Materials};
use crate::features::water::waves::WaveMap;
use crate::frame::FrameData;
use crate::gpu::{Gpu, GpuError};
use crate::scene::Scene;
use crate::scene::objects::LAYER;
use pom::PomScene;
use std::sync::Arc;
use water::WaterScene;

/// Materials of a scene: custom ones, and in the brick scene bricks unless there is a custom set in
/// their place.
#[must_use]
pub fn materials(scene: Scene, custom: &CustomMaterials) -> CustomMaterials {
    if scene != Scene::Brick || custom[LAYER as usize].is_some() {
        return Arc::clone(custom);
    }
    let mut sets = custom.as_ref().clone();
    sets[LAYER as usize] = Some(brick::material());
    Arc::new(sets)
}

/// A local scene, ready to draw.
#[derive(Debug)]
pub enum LocalScene {
    /// Parallax of waves.
    Water(WaterScene),
    /// Parallax occlusion mapping.
    Pom(Box<PomScene>),
}

impl LocalScene {
    /// The scene, if it is a local one.
    #[must_use]
    pub fn new(
        scene: Scene,
        device: &wgpu::Device,
        frame: &wgpu::Buffer,
        waves: &WaveMap,
        materials: &Materials,
        samples: u32,
    ) -> Option<Self> {
        match scene {
            Scene::Island | Scene::Grass | Scene::Culling => None,
            Scene::Water => Some(Self::Water(WaterScene::new(device, frame, waves, samples))),
            Scene::Pom | Scene::Brick | Scene::Spom => {
                let scene = PomScene::new(device, frame, materials, scene, samples);
                Some(Self::Pom(Box::new(scene)))
            }
        }
    }

    /// Continues to bake what a frame needs, without waiting. Returns whether all is there; until
    /// then something inexact is drawn.
    ///
    /// # Errors
    /// The device is lost.
    pub fn bake(&mut self, gpu: &Gpu, frame: &FrameData) -> Result<bool, GpuError> {
        match self {
            Self::Water(_) => Ok(true),
            Self::Pom(scene) => scene.bake(gpu, frame),
        }
    }

    /// Prepares the next frame.
    pub fn prepare(&mut self, gpu: &Gpu, frame: &FrameData) {
        match self {
            Self::Water(_) => {}
            Self::Pom(scene) => scene.prepare(gpu, frame),
        }
    }

    /// Draws the whole image.
    pub fn draw(&self, pass: &mut wgpu::RenderPass<'_>, materials: &Materials, sky: &SkyPass) {
        match self {
            Self::Water(scene) => scene.draw(pass),
            Self::Pom(scene) => {
                scene.draw(pass, materials);
                sky.draw(pass);
            }
        }
    }
}
