//! Settings of a run: the given options, and a preset for the others.

use super::args::Args;
use super::quality::{Preset, Quality};
use crate::features::materials::CustomMaterials;
use crate::gpu::rebuild::MOST_REBUILDS;
use crate::headless::Options;
use crate::scene::places::Place;
use crate::settings::RenderSettings;
use std::time::Duration;

/// Default of `--timeout`, seconds.
const TIMEOUT_S: u64 = 60;

/// Settings of a run: the given options, the preset for the others.
#[derive(Clone, Debug, PartialEq)]
pub struct Profile {
    /// View distance, metres.
    pub view_distance_m: u32,
    /// The view distance that the place of the start widened, metres.
    pub narrow_view_m: Option<u32>,
    /// Tolerated screen error, pixels.
    pub tolerance_px: f64,
    /// Samples per pixel.
    pub samples: u32,
    /// Anisotropy of the filter of materials.
    pub anisotropy: u16,
    /// Render settings.
    pub render: RenderSettings,
    /// One line for the user if the driver changed the start.
    pub notice: Option<String>,
}

impl Profile {
    /// Of options on a driver.
    #[must_use]
    pub fn of(args: &Args, is_software: bool) -> Self {
        let medium = Preset::of(Quality::Medium, false);
        let preset = Preset::of(args.quality, is_software);
        // Scenes without land compare methods: a preset would change what they show.
        let (samples, anisotropy) = (preset.samples, preset.anisotropy);
        let preset = if args.scene.is_local() { Preset { samples, anisotropy, ..medium } } else { preset };
        if args.quality != Quality::Auto || !is_software {
            return Self::of_preset(args, &preset);
        }
        // A picture waits for its samples; frames of a window do not.
        let samples = if args.shot.is_some() { 4 } else { preset.samples };
        let render_scale = if args.shot.is_some() { 1.0 } else { preset.render_scale };
        let bloom = if args.shot.is_some() { medium.bloom } else { preset.bloom };
        let low = Self::of_preset(args, &Preset { samples, render_scale, bloom, ..preset });
        let full = Self::of_preset(args, &Preset { samples, anisotropy, ..medium });
        let notice = (low != full).then(|| low.reduced());
        Self { notice, ..low }
    }

    /// Options of a headless run.
    #[must_use]
    pub fn headless_options(&self, args: &Args) -> Options {
        Options {
            scene: args.scene,
            pose: args.pose(),
            follows_world: args.follows_world(),
            projection: args.projection(),
            place: args.place,
            view_distance_m: self.view_distance_m,
            tolerance_px: self.tolerance_px,
            chunk_bytes: args.chunk_mb << 20,
            clipmap_texels: args.clipmap,
            samples: self.samples,
            anisotropy: self.anisotropy,
            frames: args.frames.unwrap_or(1),
            // Frames of a shot are 1/60 s apart, like their waves.
            orbit_step_deg: args.orbit.unwrap_or(0.0) / 60.0,
            time_s: args.time as f32,
            settings: self.render,
            vertical_scale: args.vertical_scale(),
            // Files are read by `native::textures`.
            materials: CustomMaterials::default(),
            timeout: Duration::from_secs(args.timeout.unwrap_or(TIMEOUT_S)),
            gpu_rebuilds: MOST_REBUILDS,
        }
    }

    fn of_preset(args: &Args, preset: &Preset) -> Self {
        let place_m = args.place.map_or(0, Place::view_distance_m);
        let plain_m = preset.view_distance_in(args.scene);
        let is_widened = args.view_distance.is_none() && place_m > plain_m;
        Self {
            view_distance_m: args.view_distance.unwrap_or(plain_m.max(place_m)),
            narrow_view_m: is_widened.then_some(plain_m),
            tolerance_px: args.tolerance.unwrap_or(preset.tolerance_px),
            samples: args.samples.unwrap_or(preset.samples),
            anisotropy: args.anisotropy.unwrap_or(preset.anisotropy),
            render: args.render_settings(preset),
            notice: None,
        }
    }

    /// Settings of a software driver.
    fn reduced(&self) -> String {
        let plants = &self.render.plants;
        format!(
            "software driver: starts with --quality low ({} m, {} px, grass {}, trees {}, scale {}); \
             --quality medium draws everything",
            self.view_distance_m,
            self.tolerance_px,
            plants.density,
            plants.trees,
            self.render.post.render_scale
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::features::pom::settings::PomMethod;
    use crate::features::water::WaterTier;
    use crate::scene::Scene;
    use crate::settings::Tiling;
    use clap::Parser as _;

    fn profile(line: &str, is_software: bool) -> Profile {
        let words = std::iter::once("tombolo-view").chain(line.split_whitespace());
        Profile::of(&Args::try_parse_from(words).unwrap(), is_software)
    }

    #[test]
    fn the_island_starts_with_plants_and_the_archipelago_in_view() {
        let start = profile("", false);
        assert_eq!((start.view_distance_m, start.tolerance_px, start.samples), (20_000, 2.0, 4));
        assert_eq!((start.render.plants.density, start.render.plants.trees), (24, 2));
        assert_eq!(start.anisotropy, 8);
        assert_eq!((start.render.tiling, start.notice), (Tiling::Hex, None));
        assert_eq!(start.render, profile("--quality medium", true).render, "auto is medium on a GPU");
    }

    #[test]
    fn a_software_driver_starts_with_less_and_says_so() {
        let (window, shot) = (profile("", true), profile("--shot a.png", true));
        let low = profile("--quality low", false);
        assert_eq!((&window.render, window.view_distance_m), (&low.render, low.view_distance_m));
        assert_eq!((window.samples, shot.samples, low.samples), (1, 4, 1));
        assert_eq!((window.anisotropy, shot.anisotropy, low.anisotropy), (1, 1, 1));
        let line = window.notice.unwrap();
        assert!(
            line.contains("software driver") && line.contains("8000 m") && !line.contains('\n'),
            "{line}"
        );
        assert_eq!((low.notice, profile("", false).notice), (None, None), "as requested");
        let (wall, full) = (profile("--scene brick", true), profile("--scene brick", false));
        let render = RenderSettings { post: wall.render.post, ..full.render };
        assert_eq!((wall.notice, wall.render), (None, render), "a scene of methods keeps them");
    }

    #[test]
    fn an_option_that_is_given_wins_over_every_preset() {
        let given = "--view-distance 5000 --tolerance 3 --samples 4 --anisotropy 3 --tiling off \
                     --relief linear --grass 3 --grass-range 99 --trees 4 --tree-range 700 \
                     --render-scale 1 --bloom 0.5 --water march";
        for quality in ["auto", "low", "medium", "high"] {
            for is_software in [false, true] {
                let got = profile(&format!("--quality {quality} {}", given.replace('\\', "")), is_software);
                assert_eq!((got.view_distance_m, got.tolerance_px), (5000, 3.0));
                assert_eq!((got.samples, got.anisotropy), (4, 3));
                assert_eq!((got.render.tiling, got.render.pom.method), (Tiling::Off, PomMethod::Linear));
                let plants = got.render.plants;
                assert_eq!((plants.density, plants.range_m, plants.trees), (3, 99.0, 4));
                assert_eq!((got.render.post.bloom, got.render.water), (0.5, WaterTier::March));
                assert_eq!(got.notice, None, "{quality}: nothing was changed");
            }
        }
    }

    #[test]
    fn presets_grow_and_scenes_keep_their_own_plants() {
        let [low, medium, high] = [Quality::Low, Quality::Medium, Quality::High].map(|quality| {
            let software = Preset::of(quality, true);
            assert_eq!(software, Preset { anisotropy: 1, ..Preset::of(quality, false) });
            Preset::of(quality, false)
        });
        for (less, more) in [(low, medium), (medium, high)] {
            assert!(less.tolerance_px > more.tolerance_px && less.view_distance_m < more.view_distance_m);
            assert!(less.grass < more.grass && less.trees < more.trees && less.samples <= more.samples);
            assert!(less.anisotropy <= more.anisotropy);
            assert!(less.bloom <= more.bloom && less.water as u32 <= more.water as u32);
        }
        assert_eq!(medium.plants_in(Scene::Grass), Scene::Grass.plants());
        assert_eq!(high.plants_in(Scene::Culling), Scene::Culling.plants());
        assert_eq!(low.plants_in(Scene::Grass).density, 8);
        assert!(!medium.plants_in(Scene::Brick).any());
        assert_eq!(
            (medium.view_distance_in(Scene::Grass), high.view_distance_in(Scene::Culling)),
            (8000, 8000)
        );
    }
}
