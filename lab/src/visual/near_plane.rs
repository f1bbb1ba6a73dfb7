//! Near-plane clipping for cameras that start below steep terrain. Land is drawn before magenta, as
//! in [`crate::cracks`], at every field of view and every vertical scale.

use crate::cracks::{LOWEST_M, count_gap_pixels};
use crate::headless_renderer::HeadlessRenderer;
use crate::sample::{self, unit, word};
use client::cache::{ChunkCache, vertical_scale};
use client::camera::{Pose, Projection};
use client::features::post::{PostSettings, Tone};
use client::frame::Background;
use client::gpu::GpuError;
use client::lod::{clearance, select};
use client::scene::Scene;
use client::settings::{Normals, RenderSettings, Show};
use client::view::ViewParams;
use rayon::prelude::*;
use serde::Serialize;
use terrain::constants::UNITS_PER_METRE;
use terrain::{Chunk, ChunkKey, Land, Position, lod};

use std::collections::BTreeMap;

/// Vertical fields of view, degrees, and sizes of the pictures.
const FIELDS_OF_VIEW: [(f64, (u32, u32)); 5] =
    [(30.0, (64, 36)), (60.0, (64, 36)), (90.0, (36, 64)), (120.0, (84, 36)), (170.0, (64, 36))];

/// Vertical scales of the land.
const SCALES: [f64; 3] = [1.0, 1.8, 4.0];

/// Stream of random numbers for the eyes.
const RANDOM_STREAM: u32 = 58;

/// Candidates for an eye; the steepest place is taken.
const CANDIDATES_PER_EYE: u32 = 24;

/// View distance, metres.
const VIEW_DISTANCE_M: u32 = 300;

/// Slots of a world.
const SLOTS: u32 = 2_048;

/// Counted pixels.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct NearPlaneClipping {
    /// Eyes.
    pub eyes: u32,
    /// Pictures: eyes x fields of view x scales.
    pub pictures: u32,
    /// Pixels whose view ray must have met land.
    pub pixels: u64,
    /// How many of them were magenta.
    pub magenta: u64,
    /// The same with eyes half a metre above the ground under them: the control.
    #[serde(rename = "magenta_before")]
    pub magenta_control: u64,
}

/// Measures so many eyes.
pub fn measure(land: &Land, eyes: u32) -> Result<NearPlaneClipping, GpuError> {
    let mut renderer = HeadlessRenderer::open(FIELDS_OF_VIEW[0].1, SLOTS)?;
    let mut found = NearPlaneClipping { eyes, ..NearPlaneClipping::default() };
    let places: Vec<(i32, i32)> =
        sample::land_points(land.world_seed(), eyes * CANDIDATES_PER_EYE, RANDOM_STREAM).collect();
    for (index, choice) in places.chunks_exact(CANDIDATES_PER_EYE as usize).enumerate() {
        let Some(eye) = steepest(land, choice, index as u32) else { continue };
        let mut generated = BTreeMap::new();
        for scale in SCALES {
            measure_eye(&mut renderer, land, &mut generated, eye, scale, &mut found)?;
        }
    }
    Ok(found)
}

/// An eye in the ground at the steepest of some places.
fn steepest(land: &Land, places: &[(i32, i32)], index: u32) -> Option<Pose> {
    let height = |x: i32, z: i32| Position::new(x, z).map_or(0, |place| land.height_at(place));
    let rise = |(x, z): &(i32, i32)| {
        let step = 2 * UNITS_PER_METRE;
        let here = height(*x, *z);
        height(x + step, *z).abs_diff(here).max(height(*x, z + step).abs_diff(here))
    };
    let (x, z) = *places.iter().filter(|(x, z)| height(*x, *z) > 0).max_by_key(|place| rise(place))?;
    // Every other eye on a vertex of level 0, the others anywhere.
    let step = 2 * UNITS_PER_METRE;
    let snap_every_other = |at: i32| if index.is_multiple_of(2) { at - at.rem_euclid(step) } else { at };
    let metres = |units: i32| f64::from(units) / f64::from(UNITS_PER_METRE);
    Some(Pose {
        position_m: [metres(snap_every_other(x)), -64.0, metres(snap_every_other(z))].into(),
        yaw_deg: 360.0 * unit(word(RANDOM_STREAM, index)),
        pitch_deg: [-60.0, -20.0, 0.0, 15.0][index as usize % 4],
    })
}

/// Counts the pixels of one eye in the land at one vertical scale.
fn measure_eye(
    renderer: &mut HeadlessRenderer,
    land: &Land,
    generated: &mut BTreeMap<ChunkKey, Chunk>,
    eye: Pose,
    scale: f64,
    found: &mut NearPlaneClipping,
) -> Result<(), GpuError> {
    let view = |pose, fov_deg, (width, height)| ViewParams {
        pose,
        projection: Projection { fov_deg, width, height },
        view_distance_m: VIEW_DISTANCE_M,
        tolerance_px: 2.0,
        time_s: 0.0,
        settings: RenderSettings {
            show: Show::Normals,
            normals: Normals::Mesh,
            post: PostSettings { tone: Tone::Filmic, ..PostSettings::default() },
            ..RenderSettings::default()
        },
    };
    let viewer = view(eye, FIELDS_OF_VIEW[1].0, FIELDS_OF_VIEW[1].1).viewer();
    let mut world = ChunkCache::new(renderer.slots());
    world.set_vertical_scale((scale * 256.0) as i32);
    let served = vertical_scale::served(&viewer, world.vertical_scale());
    let needed: Vec<ChunkKey> =
        lod::select(land, &served, usize::MAX).into_iter().map(|needed| needed.key).collect();
    let missing: Vec<ChunkKey> = needed.iter().copied().filter(|key| !generated.contains_key(key)).collect();
    generated.par_extend(missing.into_par_iter().map(|key| (key, land.chunk(key))));
    for key in needed {
        world.insert(generated[&key].clone());
    }
    let selection = select(&mut world, &viewer);
    renderer.upload_world(&world);
    let units = eye.eye().units;
    let before = eye.above(world.ground(units[0], units[2]));
    let after = clearance::raised(before, &world, &selection.drawn);
    for (fov_deg, size) in FIELDS_OF_VIEW {
        let mut magenta = [0; 2];
        for (pose, magenta) in [before, after].into_iter().zip(&mut magenta) {
            let params = view(pose, fov_deg, size);
            let mut frame = params.frame(Scene::Island, &world, &selection);
            frame.background = Background::Plain([1.0, 0.0, 1.0]);
            let picture = renderer.picture_of(&frame, size)?;
            let (pixels, cut) = count_gap_pixels(&params, &picture, scale * LOWEST_M);
            *magenta = cut;
            found.pixels += pixels;
        }
        found.pictures += 1;
        found.magenta_control += magenta[0];
        found.magenta += magenta[1];
    }
    Ok(())
}
