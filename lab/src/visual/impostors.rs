//! Trees as impostors against their geometry, at the distance where one takes over from the other.

use super::views::MORNING;
use crate::flip::{self, PIXELS_PER_DEGREE};
use crate::headless_renderer::HeadlessRenderer;
use crate::lod::screen::{self, ViewCase};
use crate::sample::{self, unit, word};
use crate::supersampled::{self, averaged};
use crate::world_builder::WorldBuilder;
use client::camera::Pose;
use client::features::vegetation::{PlantShadows, VegetationSettings};
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
const BAND_END_RATIO: f64 = 1.4;

/// Pixels of such trees that a pose must have to count.
const LEAST_PIXELS: usize = 300;

/// View distance, metres, and slots of a world.
const VIEW_DISTANCE_M: u32 = 2_500;
const SLOTS: u32 = 4_000;

/// Stream of the poses.
const STREAM: u32 = 59;

/// Poses that are tried for one that counts.
const CANDIDATES_PER_POSE: u32 = 12;

/// Trees alone.
const TREES: VegetationSettings =
    VegetationSettings { density: 0, trees: 2, wind: 0.0, ..VegetationSettings::STANDARD };

/// No trees.
const BARE: VegetationSettings = VegetationSettings { trees: 0, ..TREES };

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
    /// Geometry against itself, turned by half a pixel: what shapes smaller than a pixel do alone.
    pub moved: f64,
    /// Impostors against geometry, with four samples a pixel.
    pub smooth: f64,
    /// Mean luminance of impostors over that of geometry where both show a tree, without shadows of
    /// trees: the light without the outlines.
    pub luminance: f64,
    /// Pixels of impostors over those of geometry: the outlines without the light.
    pub cover: f64,
    /// No trees against geometry: the control.
    pub without: f64,
}

/// Measures until `poses` poses have enough trees at that distance.
pub fn measure(land: &Land, poses: u32) -> Result<Impostors, GpuError> {
    let mut renderer = HeadlessRenderer::open(SIZE, SLOTS)?;
    let mut fine = HeadlessRenderer::open(supersampled::size(SIZE, 2), SLOTS)?;
    let mut builder = WorldBuilder::new(*land);
    let mut found = Impostors::default();
    let (mut light, mut light_of_geometry) = (0.0, 0.0);
    let mut covered = [0_usize; 2];
    for pose in candidates(land, poses * CANDIDATES_PER_POSE) {
        if found.poses >= poses as usize {
            break;
        }
        let at = |pose, plants| ViewParams {
            settings: RenderSettings { plants, ..settings() },
            ..view_params(pose)
        };
        let view = |plants| at(pose, plants);
        let (world, selection) = screen::selected(&mut builder, &view(TREES));
        builder.clear();
        renderer.upload_world(&world);
        let frame = |plants| view(plants).frame(Scene::Island, &world, &selection);
        let (far_frame, near_frame) = (frame(TREES), frame(geometry()));
        let band = band(&mut renderer, &far_frame, &near_frame)?;
        let both =
            shown(&mut renderer, &band, &[TREES, geometry(), BARE].map(|plants| frame(plain(plants))))?;
        if both.iter().filter(|[far, near]| far.is_some() || near.is_some()).count() < LEAST_PIXELS {
            continue;
        }
        fine.upload_world(&world);
        // In the middle of the picture a pixel is so wide.
        let half_px = f64::from(0.5 / near_frame.uniforms.pixels_per_radian).to_degrees();
        let aside = Pose { yaw_deg: pose.yaw_deg + half_px, ..pose };
        let moved = at(aside, geometry()).frame(Scene::Island, &world, &selection);
        let bare = frame(BARE);
        let [far, near, bare] =
            [renderer.picture(&far_frame)?, renderer.picture(&near_frame)?, renderer.picture(&bare)?];
        let moved = renderer.picture(&moved)?;
        let smooth = fine_flips(&mut fine, &far_frame, &near_frame)?;
        let [flips, control, shifted] =
            [&far, &bare, &moved].map(|picture| flip::map(&near, picture, PIXELS_PER_DEGREE));
        for (pixel, [of_far, of_near]) in both.into_iter().enumerate() {
            covered[0] += usize::from(of_far.is_some());
            covered[1] += usize::from(of_near.is_some());
            if let (Some(far), Some(near)) = (of_far, of_near) {
                light += far;
                light_of_geometry += near;
            }
            if of_far.is_some() || of_near.is_some() {
                found.flip += flips[pixel];
                found.without += control[pixel];
                found.moved += shifted[pixel];
                found.smooth += smooth[pixel];
                found.pixels += 1;
            }
        }
        found.picture += flips.iter().sum::<f64>() / flips.len() as f64;
        found.poses += 1;
    }
    let pixels = found.pixels.max(1) as f64;
    found.picture /= found.poses.max(1) as f64;
    found.flip /= pixels;
    found.without /= pixels;
    found.moved /= pixels;
    found.smooth /= pixels;
    found.luminance = light / light_of_geometry;
    found.cover = covered[0] as f64 / covered[1] as f64;
    Ok(found)
}

/// Trees as geometry at every distance.
fn geometry() -> VegetationSettings {
    VegetationSettings { impostors_from_m: VegetationSettings::MAX_RANGE_M, ..TREES }
}

fn settings() -> RenderSettings {
    RenderSettings { sun: Some(MORNING), ..RenderSettings::default() }
}

fn view_params(pose: Pose) -> ViewParams {
    let params = ViewCase { pose, tolerance_px: 2.0 }.shot_of(SIZE, settings());
    ViewParams { view_distance_m: VIEW_DISTANCE_M, ..params }
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

/// Without shadows of trees.
fn plain(plants: VegetationSettings) -> VegetationSettings {
    VegetationSettings { shadows: PlantShadows::Off, ..plants }
}

/// FLIP of every pixel with four samples each; the renderer's pictures are twice as wide and high.
fn fine_flips(
    renderer: &mut HeadlessRenderer,
    far: &FrameData,
    near: &FrameData,
) -> Result<Vec<f64>, GpuError> {
    let pictures = [renderer.picture(far)?, renderer.picture(near)?];
    let [far, near] = [0, 1].map(|index: usize| averaged(&pictures[index], 2));
    Ok(flip::map(&near, &far, PIXELS_PER_DEGREE))
}

/// Of each pixel the luminance of the tree of the band that it shows, as an impostor and as
/// geometry: where pictures without shadows of trees differ from the one without trees.
fn shown(
    renderer: &mut HeadlessRenderer,
    band: &[bool],
    frames: &[FrameData; 3],
) -> Result<Vec<[Option<f64>; 2]>, GpuError> {
    let [far, near, bare] = [0, 1, 2].map(|index: usize| renderer.picture(&frames[index]));
    let (far, near, bare) = (far?, near?, bare?);
    let shows = |picture: &Image, pixel: usize| {
        let at = 4 * pixel..4 * pixel + 3;
        (band[pixel] && picture.rgba[at.clone()] != bare.rgba[at]).then(|| level(picture, pixel))
    };
    Ok((0..band.len()).map(|pixel| [&far, &near].map(|picture| shows(picture, pixel))).collect())
}

/// Whether a pixel may show a tree just beyond the switch, in either picture. IDs of geometry cover
/// its sprays without the gaps between their leaves.
fn band(renderer: &mut HeadlessRenderer, far: &FrameData, near: &FrameData) -> Result<Vec<bool>, GpuError> {
    let Some(trees) = far.plants.as_ref().and_then(|plants| plants.species.first()) else {
        return Ok(Vec::new());
    };
    let begin_m = f64::from(trees.field.lod_m[1]);
    let is_in_band = |[east, south]: [u32; 2]| {
        let away = |place: u32, eye: i32| {
            (f64::from(place & 0xff_ffff) - f64::from(eye)) / f64::from(FINE_PER_METRE)
        };
        let away_m = away(east, trees.culling.eye[0]).hypot(away(south, trees.culling.eye[2]));
        south != 0 && east >> 24 == KIND_TREES && (begin_m..BAND_END_RATIO * begin_m).contains(&away_m)
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
