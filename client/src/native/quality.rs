//! `--quality`: presets over the options that trade speed for accuracy. An option that is given
//! wins over them.

use crate::features::pom::settings::PomMethod;
use crate::features::post::PostSettings;
use crate::features::vegetation::{Cull, VegetationSettings};
use crate::features::water::WaterTier;
use crate::scene::Scene;
use crate::settings::Tiling;
use clap::ValueEnum;

/// A preset.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, ValueEnum)]
pub enum Quality {
    /// Medium, on a software driver low
    #[default]
    Auto,
    /// For software drivers: nearer and coarser land, sparse plants, half the width and height
    Low,
    /// Full detail; the default on a GPU
    Medium,
    /// Finer land, farther view, denser plants
    High,
}

/// Settings of a preset.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Preset {
    /// Tolerated screen error, pixels.
    pub tolerance_px: f64,
    /// View distance of the island scene, metres. The other scenes with land have
    /// [`Preset::NEAR_M`] at most.
    pub view_distance_m: u32,
    /// Samples per pixel.
    pub samples: u32,
    /// Anisotropy of the filter of materials; none on a software driver, where it takes most of
    /// the time of a frame with four samples a pixel.
    pub anisotropy: u16,
    /// Method against visible repetition of materials.
    pub tiling: Tiling,
    /// Parallax method of materials.
    pub relief: PomMethod,
    /// Clumps of grass on 2 x 2 m, of the island scene.
    pub grass: u32,
    /// Range of grass, metres, of the island scene.
    pub grass_range_m: f32,
    /// Trees on 8 x 8 m, of the island scene.
    pub trees: u32,
    /// Range of trees, metres, of the island scene; woods beyond it are a canopy on the land.
    pub tree_range_m: f32,
    /// Up to here each tree is culled by itself, metres.
    pub single_trees_m: f32,
    /// From here on a tree is an impostor, metres. Half of the pixels, half of the distance: the
    /// tree is as large on screen.
    pub impostors_from_m: f32,
    /// Visibility test of plants, of the island scene. Where few plants are tested, a test for what
    /// the land hides takes longer than drawing what it would drop.
    pub cull: Cull,
    /// Rendered size over the size of the window. A shot of a software driver has its own size.
    pub render_scale: f32,
    /// Share of the light that scatters in the lens, of scenes with land. A shot of a software
    /// driver has that of `medium`.
    pub bloom: f32,
    /// Parallax method of waves.
    pub water: WaterTier,
    /// Whether scenes with plants of their own get no more than these.
    pub limits_plants: bool,
}

impl Preset {
    /// View distance of scenes that start on the ground, metres.
    pub const NEAR_M: u32 = 8000;

    /// Of a quality; `auto` and the anisotropy depend on whether the driver is software.
    #[must_use]
    pub fn of(quality: Quality, is_software: bool) -> Self {
        let medium = Self {
            tolerance_px: 2.0,
            view_distance_m: 20_000,
            samples: 4,
            anisotropy: if is_software { 1 } else { 8 },
            tiling: Tiling::Hex,
            relief: PomMethod::Auto,
            grass: 24,
            grass_range_m: 260.0,
            trees: 2,
            tree_range_m: 8000.0,
            single_trees_m: 1500.0,
            impostors_from_m: 220.0,
            cull: Cull::Hierarchical,
            render_scale: 1.0,
            bloom: PostSettings::STANDARD_BLOOM,
            water: WaterTier::default(),
            limits_plants: false,
        };
        let low = Self {
            tolerance_px: 4.0,
            view_distance_m: 8000,
            samples: 1,
            anisotropy: 1,
            tiling: Tiling::TwoScale,
            relief: PomMethod::Offset,
            grass: 8,
            grass_range_m: 80.0,
            trees: 1,
            tree_range_m: 1500.0,
            single_trees_m: 250.0,
            impostors_from_m: 110.0,
            cull: Cull::Frustum,
            render_scale: 0.5,
            bloom: 0.0,
            water: WaterTier::Offset,
            limits_plants: true,
        };
        match quality {
            Quality::Auto if is_software => low,
            Quality::Low => low,
            Quality::Auto | Quality::Medium => medium,
            Quality::High => Self {
                tolerance_px: 1.0,
                view_distance_m: 32_000,
                grass: 32,
                grass_range_m: 400.0,
                trees: 3,
                ..medium
            },
        }
    }

    /// View distance in a scene, metres.
    #[must_use]
    pub fn view_distance_in(&self, scene: Scene) -> u32 {
        if scene == Scene::Island { self.view_distance_m } else { self.view_distance_m.min(Self::NEAR_M) }
    }

    /// Plants of a scene. The scenes `grass` and `culling` have their own, which only a preset with
    /// fewer reduces; scenes without land have none.
    #[must_use]
    pub fn plants_in(&self, scene: Scene) -> VegetationSettings {
        let own = scene.plants();
        match scene {
            Scene::Island => VegetationSettings {
                density: self.grass,
                range_m: self.grass_range_m,
                trees: self.trees,
                tree_range_m: self.tree_range_m,
                single_trees_m: self.single_trees_m,
                impostors_from_m: self.impostors_from_m,
                cull: self.cull,
                ..VegetationSettings::STANDARD
            },
            _ if self.limits_plants => VegetationSettings {
                density: own.density.min(self.grass),
                range_m: own.range_m.min(self.grass_range_m),
                single_trees_m: own.single_trees_m.min(self.single_trees_m),
                impostors_from_m: own.impostors_from_m.min(self.impostors_from_m),
                ..own
            },
            _ => own,
        }
    }
}
