//! Cracks between chunks.
//!
//! Terrain is drawn without sky and sea before a magenta background, a colour that terrain never
//! has. A view ray from above the terrain that passes below its lowest height well within the view
//! distance has hit it, so its pixel must not be magenta. The viewpoints include eyes on borders
//! and corners of chunks, level views along them, positions up to 4 * 10^6 m out, and views with
//! missing chunks.
//!
//! Control: the same poses with an injected fault ([`Fault`]) must show magenta.

use crate::headless_renderer::HeadlessRenderer;
use crate::sample::{self, unit, word};
use crate::world_builder::WorldBuilder;
use client::cache::ChunkCache;
use client::camera::{Pose, Projection};
use client::features::post::{PostSettings, Tone};
use client::frame::{Background, FrameData};
use client::gpu::{GpuError, Image};
use client::lod::{Selection, select};
use client::scene::Scene;
use client::settings::{RenderSettings, Show};
use client::view::ViewParams;
use serde::Serialize;
use shaders::layout::ChunkWords;
use terrain::constants::{CELLS, SEA_FLOOR_M, UNITS_PER_METRE, VERTICES};
use terrain::{ChunkKey, Land};

/// Picture size, pixels.
pub const SIZE: (u32, u32) = (256, 144);

/// View distance, metres: most borders between levels lie within it.
const VIEW_DISTANCE_M: u32 = 4_000;

/// Share of the view distance within which a ray must have met land; beyond, the land ends.
const SURE_SHARE: f64 = 0.9;

/// No land lies deeper, metres: fine octaves dip the floor of an island's shelf below that of the
/// open sea.
pub const LOWEST_M: f64 = (SEA_FLOOR_M + 23) as f64;

/// Least height of an eye over the drawn ground, metres: the near plane must not cut the ground
/// beside it.
const CLEARANCE_M: f64 = 2.0;

/// Slots of a world; more than any of these views needs.
const SLOTS: u32 = 4_096;

/// Viewpoints around one place, which share most of their chunks.
const PER_PLACE: u32 = 8;

/// A viewpoint, and the chunks received there.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Viewpoint {
    /// Eye and gaze. The eye is raised where the drawn ground is higher.
    pub pose: Pose,
    /// Tolerated screen error, pixels.
    pub tolerance_px: f64,
    /// Share of the chunks that have not arrived; those of the top level always have.
    pub lost: f64,
    /// Decides which chunks these are.
    pub salt: u32,
}

/// An injected fault.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Fault {
    /// Nothing.
    None,
    /// The third nearest chunk in sight is left out.
    ChunkLeftOut,
    /// Borders are neither morphed nor snapped.
    NoSeams,
}

/// Counted pixels.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct Count {
    /// Viewpoints.
    pub poses: usize,
    /// Viewpoints of which some chunks had not arrived.
    pub arriving: usize,
    /// Pixels whose view ray must have met land.
    pub pixels: u64,
    /// How many of them were magenta.
    pub magenta: u64,
    /// Chunks drawn, all viewpoints together.
    pub chunks: usize,
    /// The viewpoint with most magenta.
    #[serde(skip)]
    pub worst: Option<(u64, Viewpoint)>,
}

/// Seeded viewpoints: half on the home island, half on islands all over the world.
pub fn viewpoints(world_seed: u64, count: u32, stream: u32) -> Vec<Viewpoint> {
    let places = sample::land_points(world_seed, count.div_ceil(PER_PLACE), stream);
    let around = places.flat_map(|place| std::iter::repeat_n(place, PER_PLACE as usize));
    around.zip(0..count).map(|(place, index)| viewpoint(place, index, stream)).collect()
}

fn viewpoint((x, z): (i32, i32), index: u32, stream: u32) -> Viewpoint {
    let word = |part: u32| word(stream ^ 0x0c4a_c500, 16 * index + part);
    let unit = |part: u32| unit(word(part));
    let pick = |part: u32, choices: &[f64]| choices[word(part) as usize % choices.len()];
    let metres = |units: i32, part: u32| {
        let free = f64::from(units) / f64::from(UNITS_PER_METRE) + (unit(part) - 0.5) * 2_000.0;
        // Two eyes in three stand on a line between chunks of some level, or a hair's breadth
        // beside it.
        match word(part + 1) % 3 {
            0 => free,
            kind => {
                let side_m = 128.0 * f64::from(1 << (word(part + 2) % 5));
                (free / side_m).round() * side_m + f64::from(kind - 1) * (unit(part + 2) - 0.5) / 64.0
            }
        }
    };
    let (height_m, pitch_deg) = match index % 4 {
        0 => (2.0 + 6.0 * unit(6), -4.0 + 5.0 * unit(7)),
        1 => (10.0 + 60.0 * unit(6), -25.0 * unit(7)),
        2 => (100.0 + 500.0 * unit(6), -10.0 - 40.0 * unit(7)),
        _ => (600.0 + 1_400.0 * unit(6), -30.0 - 60.0 * unit(7)),
    };
    // Half of the gazes run along the borders and diagonals of the grid.
    let yaw_deg = if word(8) & 1 == 0 { 360.0 * unit(9) } else { 45.0 * f64::from(word(9) % 8) };
    let position_m = [metres(x, 0), height_m, metres(z, 3)].into();
    Viewpoint {
        pose: Pose { position_m, yaw_deg, pitch_deg }.clamped(),
        tolerance_px: pick(10, &[0.25, 0.5, 1.0, 2.0, 4.0, 8.0]),
        lost: pick(11, &[0.0, 0.0, 0.02, 0.1, 0.3]),
        salt: word(12),
    }
}

/// A renderer for all viewpoints.
pub fn renderer() -> Result<HeadlessRenderer, GpuError> {
    HeadlessRenderer::open(SIZE, SLOTS)
}

/// Draws every viewpoint and counts.
pub fn count(
    renderer: &mut HeadlessRenderer,
    land: Land,
    viewpoints: &[Viewpoint],
    fault: Fault,
) -> Result<Count, GpuError> {
    let mut builder = WorldBuilder::new(land);
    let mut count = Count::default();
    for (index, viewpoint) in viewpoints.iter().enumerate() {
        if index.is_multiple_of(PER_PLACE as usize) {
            builder.clear();
        }
        let (shot, frame) = viewpoint.frame(&mut builder, renderer, fault);
        let picture = renderer.picture(&frame)?;
        let (pixels, magenta) = count_gap_pixels(&shot, &picture, LOWEST_M);
        count.poses += 1;
        count.arriving += usize::from(viewpoint.lost > 0.0);
        count.chunks += frame.chunks;
        count.pixels += pixels;
        count.magenta += magenta;
        if magenta > count.worst.map_or(0, |(most, _)| most) {
            count.worst = Some((magenta, *viewpoint));
        }
    }
    Ok(count)
}

impl Viewpoint {
    /// How the picture is taken from a pose. Normals as colours: cheap, never without green, and
    /// never dissolved in haze.
    fn shot(&self, pose: Pose) -> ViewParams {
        ViewParams {
            pose,
            projection: Projection { fov_deg: 60.0, width: SIZE.0, height: SIZE.1 },
            view_distance_m: VIEW_DISTANCE_M,
            tolerance_px: self.tolerance_px,
            time_s: 0.0,
            // A curve that keeps the background without green.
            settings: RenderSettings {
                show: Show::Normals,
                post: PostSettings { tone: Tone::Filmic, ..PostSettings::default() },
                ..RenderSettings::default()
            },
        }
    }

    /// Selects chunks, uploads the world and builds the frame.
    fn frame(
        &self,
        builder: &mut WorldBuilder,
        renderer: &mut HeadlessRenderer,
        fault: Fault,
    ) -> (ViewParams, FrameData) {
        let mut shot = self.shot(self.pose);
        let viewer = shot.viewer();
        let has_arrived = |key: ChunkKey| {
            let place = [i32::from(key.level()), key.x(), key.z()];
            let salt = place.into_iter().fold(self.salt, |salt, part| word(salt, part as u32));
            key.level() == viewer.top_level() || unit(salt) >= self.lost
        };
        let mut world = builder.world(&viewer, renderer.slots(), has_arrived);
        let selection = select(&mut world, &viewer);
        let ground_m = drawn_ceiling(&world, &selection, self.pose);
        shot.pose.position_m.y = shot.pose.position_m.y.max(ground_m + CLEARANCE_M);
        renderer.upload_world(&world);
        let mut frame = shot.frame(Scene::Island, &world, &selection);
        frame.background = Background::Plain([1.0, 0.0, 1.0]);
        match fault {
            Fault::None => {}
            Fault::ChunkLeftOut => {
                let mut slots: Vec<u32> =
                    frame.instances.iter().map(|instance| instance.words.slot).collect();
                slots.dedup();
                let third = slots.get(2).or(slots.last()).copied();
                frame.instances.retain(|instance| Some(instance.words.slot) != third);
            }
            Fault::NoSeams => {
                for instance in &mut frame.instances {
                    // Decimated chunks stay so: three quarters of them would be missing altogether.
                    (instance.words.edges, instance.words.corners, instance.words.inside) =
                        (0, 0, instance.words.inside & ChunkWords::DECIMATED);
                }
            }
        }
        (shot, frame)
    }
}

/// No drawn ground near an eye is higher than this, metres: the highest of its cell and the cells
/// around, of the drawn chunk and of its parent, between which a morph moves it.
fn drawn_ceiling(world: &ChunkCache, selection: &Selection, pose: Pose) -> f64 {
    let [x, _, z] = pose.eye().units;
    let over = |key: ChunkKey| {
        let chunk = world.get(key)?;
        let (x0, z0) = key.origin();
        let cell = |value: i32, low: i32| {
            ((i64::from(value) - i64::from(low)) / i64::from(key.spacing())).clamp(0, CELLS as i64 - 1)
                as usize
        };
        let span = |cell: usize| cell.saturating_sub(1)..=(cell + 2).min(CELLS);
        let (columns, rows) = (span(cell(x, x0)), span(cell(z, z0)));
        rows.flat_map(|row| columns.clone().map(move |column| chunk.heights[row * VERTICES + column])).max()
    };
    // On a border the eye touches up to four chunks; a metre to either side finds them all.
    let reach = UNITS_PER_METRE;
    let touched = |key: &ChunkKey| {
        let (x0, z0) = key.origin();
        let near = |value: i32, low: i32| {
            let from = i64::from(value) - i64::from(low);
            (-i64::from(reach)..=i64::from(key.side()) + i64::from(reach)).contains(&from)
        };
        near(x, x0) && near(z, z0)
    };
    let keys = selection.drawn.iter().map(|drawn| drawn.key).filter(touched);
    let highest = keys.flat_map(|key| [Some(key), key.parent()]).flatten().filter_map(over).max();
    f64::from(highest.unwrap_or(0)) / f64::from(UNITS_PER_METRE)
}

/// Pixels that must show land, and how many of them show the backdrop. No land lies deeper than
/// `lowest_m` below the sea.
pub fn count_gap_pixels(shot: &ViewParams, picture: &Image, lowest_m: f64) -> (u64, u64) {
    let (pose, projection) = (&shot.pose, &shot.projection);
    let (half_height, aspect) = (projection.half_height(), projection.aspect());
    let drop_m = pose.position_m.y + lowest_m;
    let reach_m = SURE_SHARE * f64::from(shot.view_distance_m);
    let (mut pixels, mut magenta) = (0, 0);
    for (index, rgba) in picture.rgba.chunks_exact(4).enumerate() {
        let (column, row) = (index as u32 % picture.width, index as u32 / picture.width);
        let right = (2.0 * f64::from(column) + 1.0) / f64::from(picture.width) - 1.0;
        let up = 1.0 - (2.0 * f64::from(row) + 1.0) / f64::from(picture.height);
        let ray =
            pose.forward() + pose.right() * (right * half_height * aspect) + pose.up() * (up * half_height);
        if ray.y < 0.0 && ray.x.hypot(ray.z) * drop_m < reach_m * -ray.y {
            pixels += 1;
            magenta += u64::from(is_magenta(rgba));
        }
    }
    (pixels, magenta)
}

/// Whether a pixel is the backdrop. Dither adds half a step, and no normal of the land is without
/// green.
fn is_magenta(rgba: &[u8]) -> bool {
    rgba[0] > 128 && rgba[1] < 3 && rgba[2] > 128
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn viewpoints_are_near_and_far_low_and_high_and_on_borders() {
        let all = viewpoints(1, 400, 7);
        let share = |is: fn(&Viewpoint) -> bool| all.iter().filter(|viewpoint| is(viewpoint)).count();
        let on_a_corner =
            |one: &Viewpoint| one.pose.position_m.x % 128.0 == 0.0 && one.pose.position_m.z % 128.0 == 0.0;
        assert!(share(|one| one.pose.position_m.abs().max_element() > 1e6) > 60);
        assert!(share(|one| one.pose.position_m.abs().max_element() < 7e3) > 100);
        assert!(share(on_a_corner) > 20 && share(|one| one.lost > 0.0) > 100);
        assert!(
            share(|one| one.pose.position_m.y < 10.0) > 80 && share(|one| one.pose.pitch_deg > -4.0) > 80
        );
        assert_eq!(viewpoints(1, 40, 7), all[..40], "the same again");
    }
}
