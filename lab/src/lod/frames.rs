//! Time of frames: on a GPU by timestamps per pass, on a software driver as ratios between
//! tolerances.

use super::screen::{self, Place};
use crate::scenery::Scenery;
use crate::studio::Studio;
use anyhow::{Context, Result};
use client::camera::{Lens, Pose};
use client::frame::FrameData;
use client::render::PassTimes;
use client::scene::Scene;
use client::world::World;
use serde::Serialize;
use terrain::Land;

/// The 8 km view.
pub const CAMERA: &str = super::triangles::CAMERAS[0];

/// Frames timed per tolerance of a record; the median counts.
pub const FRAMES: usize = 15;

/// Frames before the clock counts.
const WARM_UP: usize = 3;

/// Slots of a world.
const SLOTS: u32 = 7_000;

/// Picture size on a software driver, pixels: a ratio needs no large picture.
const SMALL: (u32, u32) = (640, 360);

/// What frames of the 8 km view take.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Frames {
    /// Name and backend of the GPU.
    pub adapter: String,
    /// Whether it is a processor that plays one.
    pub is_software: bool,
    /// Picture size, pixels.
    pub size: (u32, u32),
    /// Draw calls that the terrain of a frame took.
    pub terrain_draws: u32,
    /// Levels among the chunks of that frame.
    pub levels: usize,
    /// Bytes on the GPU per slot of a chunk.
    pub bytes_per_chunk: u64,
    /// One row per tolerance.
    pub rows: Vec<Row>,
}

/// One tolerance.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Row {
    /// Tolerated screen error, pixels.
    pub tolerance_px: f64,
    /// Triangles sent.
    pub triangles: u64,
    /// Median time until the GPU was done, as the program sees it, milliseconds.
    pub frame_ms: f64,
    /// Median times of the passes by the GPU's own clock, milliseconds; none if it has none.
    pub passes: Option<Passes>,
}

/// Times of the passes, milliseconds.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Passes {
    /// Land, sky and sea.
    pub light_ms: f64,
    /// Tone curve and encoding.
    pub tone_ms: f64,
    /// The whole frame.
    pub whole_ms: f64,
}

/// Times `timed` frames of the 8 km view at each of some tolerances: 1920 x 1080 on a GPU, smaller
/// on a processor.
///
/// # Errors
/// There is no GPU, it failed, or its clock stands still.
pub fn measure(land: Land, tolerances_px: &[f64], timed: usize) -> Result<Frames> {
    let mut studio = Studio::open_timed(SMALL, SLOTS)?;
    let is_software = studio.is_software();
    let mut size = SMALL;
    if !is_software {
        size = (screen::LENS.width, screen::LENS.height);
        studio = Studio::open_timed(size, SLOTS)?;
    }
    let mut frames = Frames {
        adapter: studio.adapter(),
        is_software,
        size,
        terrain_draws: 0,
        levels: 0,
        bytes_per_chunk: studio.bytes_per_chunk(),
        rows: Vec::new(),
    };
    let mut scenery = Scenery::new(land);
    for tolerance_px in tolerances_px {
        let (world, frame) = prepared(&mut scenery, &studio, *tolerance_px, size)?;
        let levels: std::collections::BTreeSet<u32> =
            frame.instances.iter().map(|instance| instance.place & 255).collect();
        studio.furnish(&world);
        // Finds all shadows once, so that none is left for the frames that are timed.
        studio.picture(&frame)?;
        let (mut milliseconds, mut light, mut tone, mut whole) = (vec![], vec![], vec![], vec![]);
        for index in 0..WARM_UP + timed {
            let taken = studio.draw(&frame)?;
            let passes = studio.pass_times()?;
            if index >= WARM_UP {
                milliseconds.push(taken.as_secs_f64() * 1e3);
                if let Some(PassTimes { light_ns, tone_ns, whole_ns }) = passes {
                    light.push(light_ns / 1e6);
                    tone.push(tone_ns / 1e6);
                    whole.push(whole_ns / 1e6);
                }
            }
        }
        // The largest number of any tolerance: more levels or chunks must not need more calls.
        frames.terrain_draws = frames.terrain_draws.max(studio.terrain_draws());
        frames.levels = frames.levels.max(levels.len());
        let passes = (light.len() == timed).then(|| -> Result<Passes> {
            let (light_ms, tone_ms, whole_ms) = (median(light)?, median(tone)?, median(whole)?);
            // A query set that is never written reads as zeros, and zero is no time.
            anyhow::ensure!(
                light_ms > 0.0 && tone_ms > 0.0 && whole_ms >= light_ms,
                "the GPU's clock stands still"
            );
            Ok(Passes { light_ms, tone_ms, whole_ms })
        });
        frames.rows.push(Row {
            tolerance_px: *tolerance_px,
            triangles: frame.instances.len() as u64 * client::frame::TRIANGLES_PER_INSTANCE,
            frame_ms: median(milliseconds)?,
            passes: passes.transpose()?,
        });
    }
    Ok(frames)
}

/// The frame of the 8 km view at a tolerance of the full picture, drawn at a size.
fn prepared(
    scenery: &mut Scenery,
    studio: &Studio,
    tolerance_px: f64,
    size: (u32, u32),
) -> Result<(World, FrameData)> {
    let pose: Pose = CAMERA.parse()?;
    // Chosen for the full picture, whatever the size that it is drawn at: the same triangles.
    let mut shot = Place { pose, tolerance_px }.shot();
    let (world, selection) = screen::selected(scenery, &shot);
    anyhow::ensure!(
        world.len() <= studio.slots() as usize,
        "{} chunks do not fit into the {} slots of this GPU: raise the tolerance",
        world.len(),
        studio.slots()
    );
    shot.lens = Lens { width: size.0, height: size.1, ..shot.lens };
    let frame = shot.frame(Scene::Island, &world, &selection);
    Ok((world, frame))
}

fn median(mut values: Vec<f64>) -> Result<f64> {
    values.sort_by(f64::total_cmp);
    values.get(values.len() / 2).copied().context("nothing was timed")
}
