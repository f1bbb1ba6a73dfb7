//! Frame times as ratios of interleaved frames: the defaults for software drivers, and everything
//! on, over frames with what the viewer drew before it had this look.

use crate::headless_renderer::HeadlessRenderer;
use crate::lod::screen::{self, ViewCase};
use crate::stats::{interleaved, quantiles, ratios};
use crate::world_builder::WorldBuilder;
use clap::Parser as _;
use client::features::vegetation::{PlantShadows, VegetationSettings};
use client::frame::FrameData;
use client::gpu::GpuError;
use client::native::args::Args;
use client::native::quality::{Preset, Quality};
use client::scene::Scene;
use client::settings::{Normals, RenderSettings};
use client::view::ViewParams;
use serde::Serialize;
use std::time::Duration;
use terrain::Land;

/// Picture size, pixels.
const SIZE: (u32, u32) = (640, 360);

/// Rounds, each of which draws every alternative once: of the defaults, where the second slowest is
/// the p99, and of frames that take seconds.
const ROUNDS: usize = 101;
const SLOW_ROUNDS: usize = 9;

/// Slots of a world.
const SLOTS: u32 = 6_000;

/// The figures.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct FrameTime {
    /// Whether the driver is software; on others the bars say nothing.
    pub is_software: bool,
    /// Median of default over bare frames of the same round.
    pub default_over_bare: f64,
    /// The p99 of default frames over that of bare ones.
    pub default_over_bare_p99: f64,
    /// Median of everything on over the earlier frame with plants of the same round.
    pub all_over_planted: f64,
    /// The slowest of the one over the slowest of the other.
    pub all_over_planted_slowest: f64,
}

/// One alternative: a renderer and its frame.
struct Alternative {
    renderer: HeadlessRenderer,
    frame: FrameData,
}

/// Measures the start view of the island.
pub fn measure(land: Land) -> Result<FrameTime, GpuError> {
    let mut all = Vec::new();
    for (preset, settings) in [earlier(0, 0), preset(Quality::Low), earlier(16, 2), preset(Quality::Medium)] {
        all.push(alternative(land, &preset, settings)?);
    }
    let is_software = all[0].renderer.is_software();
    let mut timed = |rounds, first: usize| {
        interleaved(rounds, 2, |index| {
            let Alternative { renderer, frame } = &mut all[first + index];
            renderer.draw(frame)
        })
    };
    let (defaults, whole) = (timed(ROUNDS, 0)?, timed(SLOW_ROUNDS, 2)?);
    let p99 = |times: &[Duration]| quantiles(times.iter().map(Duration::as_secs_f64), [0.99])[0];
    Ok(FrameTime {
        is_software,
        default_over_bare: ratios(&defaults)[1],
        default_over_bare_p99: p99(&defaults[1]) / p99(&defaults[0]),
        all_over_planted: ratios(&whole)[1],
        all_over_planted_slowest: p99(&whole[1]) / p99(&whole[0]),
    })
}

/// Settings of the viewer with a preset and one sample a pixel.
fn preset(quality: Quality) -> (Preset, RenderSettings) {
    let preset = Preset { samples: 1, ..Preset::of(quality, true) };
    let settings = Args::parse_from(["tombolo-view"]).render_settings(&preset);
    (preset, settings)
}

/// Settings of the viewer before: 8 km of land by the normals of its triangles, plants without
/// shadows up to 1,500 m, no bloom.
fn earlier(grass: u32, trees: u32) -> (Preset, RenderSettings) {
    let preset = Preset { view_distance_m: 8_000, ..Preset::of(Quality::Medium, true) };
    let plants = VegetationSettings {
        density: grass,
        trees,
        tree_range_m: 1500.0,
        impostors_from_m: VegetationSettings::MAX_RANGE_M,
        shadows: PlantShadows::Off,
        ..preset.plants_in(Scene::Island)
    };
    let mut settings = RenderSettings { tiling: preset.tiling, plants, ..RenderSettings::default() };
    settings.pom.method = preset.relief;
    settings.normals = Normals::Mesh;
    (preset, settings)
}

fn alternative(land: Land, preset: &Preset, settings: RenderSettings) -> Result<Alternative, GpuError> {
    let case = ViewCase { pose: Scene::Island.start_in(&land), tolerance_px: preset.tolerance_px };
    let view_distance_m = preset.view_distance_m;
    let view = ViewParams { view_distance_m, ..case.shot_of(SIZE, settings) };
    let mut renderer = HeadlessRenderer::open(SIZE, SLOTS)?;
    let (world, selection) = screen::selected(&mut WorldBuilder::new(land), &view);
    renderer.upload_world(&world);
    let frame = view.frame(Scene::Island, &world, &selection);
    // Finds all shadows, so that none is left for the frames that are timed.
    renderer.picture(&frame)?;
    Ok(Alternative { renderer, frame })
}
