//! Frame times: GPU timestamps per pass, on a software driver ratios between tolerances.

use super::screen::{self, ViewCase};
use crate::headless_renderer::HeadlessRenderer;
use crate::stats::median;
use crate::world_builder::WorldBuilder;
use anyhow::Result;
use client::cache::ChunkCache;
use client::camera::{Pose, Projection};
use client::frame::FrameData;
use client::gpu::PassTimes;
use client::scene::Scene;
use serde::Serialize;
use terrain::Land;

/// The 8 km view.
pub const CAMERA: &str = super::triangles::EIGHT_KM;

/// Frames timed per tolerance of a record; the median counts.
pub const FRAMES: usize = 15;

/// Frames before the timed ones.
const WARM_UP: usize = 3;

/// Slots of a world.
const SLOTS: u32 = 7_000;

const TIMED: wgpu::Features = wgpu::Features::TIMESTAMP_QUERY;

/// Picture size on a software driver, pixels: a ratio needs no large picture.
const SMALL: (u32, u32) = (640, 360);

/// Times of frames of the 8 km view.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Frames {
    /// Name and backend of the GPU.
    pub adapter: String,
    /// Whether it is a software rasteriser.
    pub is_software: bool,
    pub size: (u32, u32),
    /// Draw calls that the terrain of a frame took.
    pub terrain_draws: u32,
    /// Levels among the chunks of that frame.
    pub levels: usize,
    /// Bytes on the GPU per slot of a chunk.
    pub bytes_per_chunk: u64,
    pub rows: Vec<Row>,
}

/// One tolerance.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Row {
    /// Tolerated screen error, pixels.
    pub tolerance_px: f64,
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
pub fn measure(land: Land, tolerances_px: &[f64], timed: usize) -> Result<Frames> {
    let mut renderer = HeadlessRenderer::open_with(SMALL, SLOTS, TIMED)?;
    let is_software = renderer.is_software();
    let mut size = SMALL;
    if !is_software {
        size = (screen::LENS.width, screen::LENS.height);
        renderer = HeadlessRenderer::open_with(size, SLOTS, TIMED)?;
    }
    let mut frames = Frames {
        adapter: renderer.adapter(),
        is_software,
        size,
        terrain_draws: 0,
        levels: 0,
        bytes_per_chunk: renderer.bytes_per_chunk(),
        rows: Vec::new(),
    };
    let mut builder = WorldBuilder::new(land);
    for tolerance_px in tolerances_px {
        let (world, frame) = prepared(&mut builder, &renderer, *tolerance_px, size)?;
        let levels: std::collections::BTreeSet<u32> =
            frame.instances.iter().map(|instance| instance.words.place & 255).collect();
        renderer.upload_world(&world);
        // Finds all shadows once, so that none is left for the frames that are timed.
        renderer.picture(&frame)?;
        let (mut milliseconds, mut light, mut tone, mut whole) = (vec![], vec![], vec![], vec![]);
        for index in 0..WARM_UP + timed {
            let taken = renderer.draw(&frame)?;
            let passes = renderer.pass_times()?;
            if index >= WARM_UP {
                milliseconds.push(taken.as_secs_f64() * 1e3);
                if let Some(PassTimes { hdr_ns, tonemap_ns, whole_ns }) = passes {
                    light.push(hdr_ns / 1e6);
                    tone.push(tonemap_ns / 1e6);
                    whole.push(whole_ns / 1e6);
                }
            }
        }
        // The largest number of any tolerance: more levels or chunks must not need more calls.
        frames.terrain_draws = frames.terrain_draws.max(renderer.terrain_draws());
        frames.levels = frames.levels.max(levels.len());
        let passes = (light.len() == timed).then(|| -> Result<Passes> {
            let (light_ms, tone_ms, whole_ms) = (median(light), median(tone), median(whole));
            // A query set that is never written reads as zeros, and zero is no time.
            anyhow::ensure!(
                light_ms > 0.0 && tone_ms > 0.0 && whole_ms >= light_ms,
                "the GPU's timestamps do not advance"
            );
            Ok(Passes { light_ms, tone_ms, whole_ms })
        });
        frames.rows.push(Row {
            tolerance_px: *tolerance_px,
            triangles: frame.instances.len() as u64 * client::frame::TRIANGLES_PER_INSTANCE,
            frame_ms: median(milliseconds),
            passes: passes.transpose()?,
        });
    }
    Ok(frames)
}

/// The frame of the 8 km view at a tolerance of the full picture, drawn at a size.
fn prepared(
    builder: &mut WorldBuilder,
    renderer: &HeadlessRenderer,
    tolerance_px: f64,
    size: (u32, u32),
) -> Result<(ChunkCache, FrameData)> {
    let pose: Pose = CAMERA.parse()?;
    // Selected for the full picture at every size: the same triangles.
    let mut shot = ViewCase { pose, tolerance_px }.shot();
    let (world, selection) = screen::selected(builder, &shot);
    anyhow::ensure!(
        world.len() <= renderer.slots() as usize,
        "{} chunks do not fit into the {} slots of this GPU: raise the tolerance",
        world.len(),
        renderer.slots()
    );
    shot.projection = Projection { width: size.0, height: size.1, ..shot.projection };
    let frame = shot.frame(Scene::Island, &world, &selection);
    Ok((world, frame))
}
