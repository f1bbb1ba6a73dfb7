//! Trees as impostors against their geometry, at the distance where one takes over from the other.

use super::views::MORNING;
use crate::flip::{self, PIXELS_PER_DEGREE};
use crate::headless_renderer::HeadlessRenderer;
use crate::lod::screen;
use crate::sample::{self, unit, word};
use crate::world_builder::WorldBuilder;
use client::camera::{Pose, Projection};
use client::features::vegetation::VegetationSettings;
use client::frame::FrameData;
use client::gpu::{GpuError, Image};
use client::scene::Scene;
use client::settings::RenderSettings;
use client::view::ViewParams;
use serde::Serialize;
use shaders::layout::{FINE_PER_METRE, KIND_TREES};
use terrain::constants::UNITS_PER_METRE;
use terrain::{Land, Position};

/// Picture size, pixels.
const SIZE: (u32, u32) = (640, 360);

/// Trees count from the switch distance on up to so many times of it.
const BAND: f64 = 1.4;

/// Pixels of such trees that a pose must have to count.
const LEAST_PIXELS: usize = 300;

/// View distance, metres, and slots of a world.
const VIEW_DISTANCE_M: u32 = 2_500;
const SLOTS: u32 = 4_000;

/// Stream of the poses.
const STREAM: u32 = 59;

/// Poses that are tried for one that counts.
const TRIED: u32 = 12;

/// Trees alone.
const TREES: VegetationSettings =
    VegetationSettings { density: 0, trees: 2, wind: 0.0, ..VegetationSettings::STANDARD };

/// Mean FLIP over the pixels of trees just beyond the switch.
#[derive(Clone, Copy, Debug, Default, Serialize)]
pub struct Impostors {
    /// Poses that count.
    pub poses: usize,
    /// Pixels of such trees.
    pub pixels: usize,
    /// Impostors against geometry.
    pub flip: f64,
    /// The same over the whole picture.
    pub picture: f64,
    /// Mean luminance of impostors over that of geometry.
    pub luminance: f64,
    /// No trees against geometry: the control.
    pub without: f64,
}

/// Measures until `poses` poses have enough trees at that distance.
pub fn measure(land: &Land, poses: u32) -> Result<Impostors, GpuError> {
    let mut renderer = HeadlessRenderer::open(SIZE, SLOTS)?;
    let mut builder = WorldBuilder::new(*land);
    let mut found = Impostors::default();
    let (mut light, mut light_of_geometry) = (0.0, 0.0);
    for pose in candidates(land, poses * TRIED) {
        if found.poses >= poses as usize {
            break;
        }
        let view = |plants| ViewParams { settings: RenderSettings { plants, ..settings() }, ..shot(pose) };
        let (world, selection) = screen::selected(&mut builder, &view(TREES));
        builder.clear();
        renderer.upload_world(&world);
        let frame = |plants| view(plants).frame(Scene::Island, &world, &selection);
        let (far, near) = (frame(TREES), frame(geometry()));
        let mask = mask(&mut renderer, &far, &near)?;
        if mask.iter().filter(|is| **is).count() < LEAST_PIXELS {
            continue;
        }
        let bare = frame(VegetationSettings { trees: 0, ..TREES });
        let [far, near, bare] = [renderer.picture(&far)?, renderer.picture(&near)?, renderer.picture(&bare)?];
        let [flips, control] = [&far, &bare].map(|picture| flip::map(&near, picture, PIXELS_PER_DEGREE));
        for pixel in mask.iter().enumerate().filter_map(|(pixel, is)| is.then_some(pixel)) {
            found.flip += flips[pixel];
            found.without += control[pixel];
            light += level(&far, pixel);
            light_of_geometry += level(&near, pixel);
            found.pixels += 1;
        }
        found.picture += flips.iter().sum::<f64>() / flips.len() as f64;
        found.poses += 1;
    }
    let pixels = found.pixels.max(1) as f64;
    found.picture /= found.poses.max(1) as f64;
    found.flip /= pixels;
    found.without /= pixels;
    found.luminance = light / light_of_geometry;
    Ok(found)
}

/// Trees as geometry at every distance.
fn geometry() -> VegetationSettings {
    VegetationSettings { impostors_from_m: VegetationSettings::MAX_RANGE_M, ..TREES }
}

fn settings() -> RenderSettings {
    RenderSettings { sun: Some(MORNING), ..RenderSettings::default() }
}

fn shot(pose: Pose) -> ViewParams {
    ViewParams {
        pose,
        projection: Projection { fov_deg: 60.0, width: SIZE.0, height: SIZE.1 },
        view_distance_m: VIEW_DISTANCE_M,
        tolerance_px: 2.0,
        time_s: 0.0,
        settings: settings(),
    }
}

/// Seeded eyes a little above the land.
fn candidates(land: &Land, count: u32) -> impl Iterator<Item = Pose> {
    let metres = |units: i32| f64::from(units) / f64::from(UNITS_PER_METRE);
    let ground = |x, z| Position::new(x, z).map_or(0, |place| land.height_at(place));
    let points: Vec<(i32, i32)> = sample::land_points(land.world_seed(), count, STREAM).collect();
    points.into_iter().zip(0..).map(move |((x, z), index)| {
        let unit = |part: u32| unit(word(STREAM ^ 0x1f, 4 * index + part));
        let above_m = 4.0 + 60.0 * unit(0) * unit(0);
        let up_m = metres(ground(x, z)).max(0.0) + above_m;
        Pose { position_m: [metres(x), up_m, metres(z)].into(), yaw_deg: 360.0 * unit(1), pitch_deg: -6.0 }
    })
}

/// The pixels of trees just beyond the switch, in either picture.
fn mask(renderer: &mut HeadlessRenderer, far: &FrameData, near: &FrameData) -> Result<Vec<bool>, GpuError> {
    let Some(trees) = far.plants.as_ref().and_then(|plants| plants.species.first()) else {
        return Ok(Vec::new());
    };
    let begin_m = f64::from(trees.field.lod_m[1]);
    let is_in_band = |[east, south]: [u32; 2]| {
        let away = |place: u32, eye: i32| {
            (f64::from(place & 0xff_ffff) - f64::from(eye)) / f64::from(FINE_PER_METRE)
        };
        let away_m = away(east, trees.culling.eye[0]).hypot(away(south, trees.culling.eye[2]));
        south != 0 && east >> 24 == KIND_TREES && (begin_m..BAND * begin_m).contains(&away_m)
    };
    let mut pixels = vec![false; (SIZE.0 * SIZE.1) as usize];
    for frame in [far, near] {
        renderer.choose(frame)?;
        for (is, id) in pixels.iter_mut().zip(renderer.id_buffer(frame, SIZE)?) {
            *is |= is_in_band(id);
        }
    }
    Ok(pixels)
}

/// Sum of the channels of a pixel, linear by a square.
fn level(picture: &Image, pixel: usize) -> f64 {
    picture.rgba[4 * pixel..4 * pixel + 3].iter().map(|channel| (f64::from(*channel) / 255.0).powi(2)).sum()
}
