//! Popping: picture changes by levels of detail alone, from frame to frame of a slow flight.
//!
//! Each pose is drawn twice: with its own selection, and with the one of a metre before. The two
//! pictures differ by levels and morphs alone. The same flight without morphing is the control; the
//! change by one frame of motion, with levels frozen, is the scale below which a change of level is
//! not visible.

use super::screen::ViewCase;
use crate::headless_renderer::HeadlessRenderer;
use crate::world_builder::WorldBuilder;
use client::cache::ChunkCache;
use client::camera::Pose;
use client::frame::FrameData;
use client::gpu::{GpuError, Image};
use client::lod::{Selection, select};
use client::scene::Scene;
use client::settings::{Normals, RenderSettings, Shadows};
use client::view::ViewParams;
use serde::Serialize;
use shaders::layout::{ChunkWords, TerrainInstance};
use shaders::twin::morph::MORPH_ONE;
use terrain::constants::UNITS_PER_METRE;
use terrain::lod::Viewer;
use terrain::{Land, Position};

/// Picture size, pixels.
pub const SIZE: (u32, u32) = (256, 144);

/// Metres between two frames.
const STEP_M: f64 = 1.0;

/// Tolerated screen error, pixels: small, because pictures this small hold few levels.
const TOLERANCE_PX: f64 = 0.5;

/// Slots of the world of a flight.
const SLOTS: u32 = 6_000;

/// Side of the blocks whose mean change is taken, pixels: a single pixel is not visible popping.
const BLOCK: u32 = 8;

#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Flight {
    pub name: &'static str,
    /// Where it begins; it goes where the gaze points, level.
    pub start: &'static str,
    /// Height over the highest ground on the way, metres.
    pub clearance_m: f64,
}

/// Low through hills, along a shore, and high towards the mountains.
pub const FLIGHTS: [Flight; 3] = [
    Flight { name: "low", start: "-2200,0,-900,70,-3", clearance_m: 4.0 },
    Flight { name: "shore", start: "-1500,0,1200,110,-6", clearance_m: 15.0 },
    Flight { name: "high", start: "600,0,2600,-20,-25", clearance_m: 400.0 },
];

/// How much pictures change from frame to frame, in steps of 8 bits.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct Change {
    /// The largest change of one channel of one pixel.
    pub max: u8,
    /// One pixel in a thousand changes more, in the worst frame.
    pub p999: u8,
    /// The largest mean over a block of 8 x 8 pixels, brightest channel.
    pub block: f64,
}

#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Outcome {
    pub flight: &'static str,
    pub frames: u32,
    /// Frames between which a chunk was split or merged.
    pub level_changes: u32,
    /// By levels and morphs.
    pub morphed: Change,
    /// By levels without morphing: the control.
    pub unmorphed: Change,
    /// By the motion of one frame with levels frozen.
    pub motion: Change,
    /// The frame of the largest change by levels and morphs.
    pub worst_frame: u32,
}

/// Light of the drawn triangles and nothing that no morph can change: shadows of the land are
/// traced chunk by chunk, over the vertices of the chunk's own level.
pub fn by_triangles() -> RenderSettings {
    RenderSettings { normals: Normals::Mesh, shadows: Shadows::Off, ..RenderSettings::default() }
}

/// A renderer for flights.
pub fn renderer() -> Result<HeadlessRenderer, GpuError> {
    HeadlessRenderer::open(SIZE, SLOTS)
}

pub fn fly(
    renderer: &mut HeadlessRenderer,
    land: Land,
    flight: &Flight,
    settings: RenderSettings,
    frames: u32,
) -> Result<Outcome, GpuError> {
    let shot = |frame| ViewParams { settings, ..flight.shot(&land, frame, frames) };
    let shots: Vec<ViewParams> = (0..=frames).map(shot).collect();
    let viewers: Vec<Viewer> = shots.iter().map(ViewParams::viewer).collect();
    let mut world = WorldBuilder::new(land).world_along(&viewers, renderer.slots());
    renderer.upload_world(&world);

    let mut outcome = Outcome {
        flight: flight.name,
        frames,
        level_changes: 0,
        morphed: Change::default(),
        unmorphed: Change::default(),
        motion: Change::default(),
        worst_frame: 0,
    };
    let mut last = select(&mut world, &viewers[0]);
    let mut last_picture = renderer.picture(&frame(&shots[0], &world, &last))?;
    for (index, (shot, viewer)) in shots.iter().zip(&viewers).enumerate().skip(1) {
        let chosen = select(&mut world, viewer);
        let (stale, fresh) = (frame(shot, &world, &last), frame(shot, &world, &chosen));
        let (before, after) = (renderer.picture(&stale)?, renderer.picture(&fresh)?);
        let change = Change::between(&before, &after);
        if change.block > outcome.morphed.block {
            outcome.worst_frame = index as u32;
        }
        outcome.morphed = outcome.morphed.or(change);
        outcome.motion = outcome.motion.or(Change::between(&last_picture, &before));
        // Without morphs nothing changes between two frames with the same chunks.
        if chosen.drawn.iter().map(|drawn| drawn.key).ne(last.drawn.iter().map(|drawn| drawn.key)) {
            outcome.level_changes += 1;
            let [before, after] = [stale, fresh].map(unmorphed);
            let change = Change::between(&renderer.picture(&before)?, &renderer.picture(&after)?);
            outcome.unmorphed = outcome.unmorphed.or(change);
        }
        (last, last_picture) = (chosen, after);
    }
    Ok(outcome)
}

impl Flight {
    fn shot(&self, land: &Land, frame: u32, frames: u32) -> ViewParams {
        let mut pose: Pose = self.start.parse().expect("the flights of this module begin at poses");
        let (sin, cos) = pose.yaw_deg.to_radians().sin_cos();
        let at = |frame: u32| {
            let way_m = STEP_M * f64::from(frame);
            [pose.position_m.x + sin * way_m, pose.position_m.z - cos * way_m]
        };
        let ground_m = |[x, z]: [f64; 2]| {
            let units = |metres: f64| (metres * f64::from(UNITS_PER_METRE)) as i32;
            let height = Position::new(units(x), units(z)).map_or(0, |place| land.height_at(place));
            f64::from(height) / f64::from(UNITS_PER_METRE)
        };
        let highest_m = (0..=frames).map(|frame| ground_m(at(frame))).fold(0.0, f64::max);
        let [x, z] = at(frame);
        pose.position_m = [x, highest_m + self.clearance_m, z].into();
        ViewCase { pose, tolerance_px: TOLERANCE_PX }.shot_of(SIZE, RenderSettings::default())
    }
}

fn frame(shot: &ViewParams, world: &ChunkCache, selection: &Selection) -> FrameData {
    shot.frame(Scene::Island, world, selection)
}

/// The same frame without morphs, still without gaps: borders that are entirely the parent's stay
/// so on both sides.
fn unmorphed(mut frame: FrameData) -> FrameData {
    let only_whole =
        |word: u32| u32::from_le_bytes(word.to_le_bytes().map(|m| if m == MORPH_ONE { m } else { 0 }));
    // A decimated chunk has no vertices to be anything but its parent with.
    let is_decimated = |instance: &TerrainInstance| instance.words.inside & ChunkWords::DECIMATED != 0;
    for instance in frame.instances.iter_mut().filter(|instance| !is_decimated(instance)) {
        let words = &mut instance.words;
        words.edges = only_whole(words.edges);
        words.corners = only_whole(words.corners);
        words.inside &= !255;
    }
    frame
}

impl Change {
    /// Between two pictures of one size.
    pub fn between(one: &Image, other: &Image) -> Self {
        let changes: Vec<u8> = one
            .rgba
            .chunks_exact(4)
            .zip(other.rgba.chunks_exact(4))
            .map(|(a, b)| (0..3).map(|channel| a[channel].abs_diff(b[channel])).max().unwrap_or(0))
            .collect();
        let (columns, rows) = (one.width / BLOCK, one.height / BLOCK);
        let block_sum = |block: u32| {
            let (x, z) = (block % columns * BLOCK, block / columns * BLOCK);
            let inside = (0..BLOCK).flat_map(|row| (0..BLOCK).map(move |column| (x + column, z + row)));
            inside.map(|(x, z)| u32::from(changes[(z * one.width + x) as usize])).sum::<u32>()
        };
        let block = (0..columns * rows).map(block_sum).max().unwrap_or(0);
        let mut sorted = changes;
        sorted.sort_unstable();
        let last = sorted.len().saturating_sub(1);
        Self {
            max: sorted[last],
            p999: sorted[last - sorted.len() / 1_000],
            block: f64::from(block) / f64::from(BLOCK * BLOCK),
        }
    }

    /// The larger of each figure.
    pub fn or(self, other: Self) -> Self {
        Self {
            max: self.max.max(other.max),
            p999: self.p999.max(other.p999),
            block: self.block.max(other.block),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn picture(value: impl Fn(u32, u32) -> u8) -> Image {
        let (width, height) = (64, 32);
        let rgba = (0..width * height).flat_map(|index| [0, value(index % width, index / width), 0, 255]);
        Image { width, height, rgba: rgba.collect() }
    }

    #[test]
    fn a_patch_counts_more_than_one_pixel_and_equal_pictures_are_0() {
        let still = picture(|_, _| 7);
        assert_eq!(Change::between(&still, &still), Change::default());
        let odd = Change::between(&still, &picture(|x, z| if (x, z) == (5, 5) { 107 } else { 7 }));
        let patch = Change::between(&still, &picture(|x, z| if x < 8 && z < 8 { 17 } else { 7 }));
        assert_eq!((odd.max, patch.max), (100, 10));
        assert!(odd.block < 2.0 && patch.block == 10.0);
        assert_eq!((odd.p999, patch.p999), (0, 10));
    }
}
