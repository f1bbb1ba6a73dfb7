//! Screen-space error of the drawn terrain against level 0, in pixels, at every level-0 vertex.
//!
//! Edges of drawn triangles run along edges of the level-0 mesh, so the distance of the two
//! surfaces is largest at a vertex; except for triangles along a coarser neighbour, whose corners
//! are moved.

use super::drawn::DrawnChunk;
use crate::sample::{self, unit, word};
use crate::world_builder::WorldBuilder;
use client::cache::ChunkCache;
use client::camera::{Pose, Projection};
use client::lod::Selection;
use client::settings::RenderSettings;
use client::view::ViewParams;
use rayon::prelude::*;
use serde::Serialize;
use terrain::constants::{CELLS, UNITS_PER_METRE};
use terrain::land::SEA_FLOOR;
use terrain::{ChunkKey, Grid, Land};

/// The view of the bar of screen error.
pub const LENS: Projection = Projection { fov_deg: 60.0, width: 1920, height: 1080 };

/// Its view distance, metres.
pub const VIEW_DISTANCE_M: u32 = 8_000;

/// Rows of vertices whose reference is computed at a time.
const ROWS: usize = 64;

/// Errors of a set of vertices.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct ScreenErrors {
    /// Vertices.
    pub vertices: u64,
    /// Sum of squared errors, square pixels.
    pub squares: f64,
    /// Largest error, pixels: inside chunks, and in their outermost cells, where they blend into
    /// what their neighbours draw.
    pub worst_px: [f64; 2],
    /// The worst vertex of all.
    pub worst: Option<Worst>,
}

/// A vertex with a large error.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Worst {
    /// Level of the drawn chunk.
    pub level: u8,
    /// Where it is, metres east and south.
    pub place_m: [f64; 2],
    /// Cells from the nearest border of the chunk.
    pub cells_from_border: usize,
    /// How far the drawn surface is from the vertex, metres.
    pub error_m: f64,
    /// Distance from the eye, metres.
    pub distance_m: f64,
    /// The error on screen, pixels.
    pub error_px: f64,
}

impl ScreenErrors {
    /// The largest error, pixels.
    pub fn max_px(&self) -> f64 {
        self.worst_px.into_iter().fold(0.0, f64::max)
    }

    /// Root of the mean square, pixels.
    pub fn rms_px(&self) -> f64 {
        (self.squares / self.vertices.max(1) as f64).sqrt()
    }

    /// Both together.
    pub fn and(self, other: Self) -> Self {
        let worse = |own: Option<Worst>, other: Option<Worst>| match (own, other) {
            (Some(own), Some(other)) if own.error_px >= other.error_px => Some(own),
            (own, other) => other.or(own),
        };
        Self {
            vertices: self.vertices + other.vertices,
            squares: self.squares + other.squares,
            worst_px: [0, 1].map(|zone| self.worst_px[zone].max(other.worst_px[zone])),
            worst: worse(self.worst, other.worst),
        }
    }
}

/// A pose with a tolerance.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ViewCase {
    /// Eye and gaze.
    pub pose: Pose,
    /// Tolerated screen error, pixels.
    pub tolerance_px: f64,
}

impl ViewCase {
    /// How the picture is taken.
    pub fn shot(&self) -> ViewParams {
        ViewParams {
            pose: self.pose,
            projection: LENS,
            view_distance_m: VIEW_DISTANCE_M,
            tolerance_px: self.tolerance_px,
            time_s: 0.0,
            settings: RenderSettings::default(),
        }
    }

    /// The same as a picture of a size and by settings.
    pub fn shot_of(&self, (width, height): (u32, u32), settings: RenderSettings) -> ViewParams {
        ViewParams { projection: Projection { width, height, ..LENS }, settings, ..self.shot() }
    }
}

/// Seeded poses: over land, coasts and rims, half of them on islands all over the world, from eye
/// level to 2 km.
pub fn view_cases(land: &Land, count: u32, stream: u32) -> Vec<ViewCase> {
    let points = sample::land_points(land.world_seed(), count, stream);
    let place = |((x, z), index): ((i32, i32), u32)| {
        let unit = |part: u32| unit(word(stream ^ 0x50_6f5e, 8 * index + part));
        let ground_m = f64::from(ground(land, x, z)) / f64::from(UNITS_PER_METRE);
        let height_m = match index % 5 {
            0 | 1 => 1.7 + 4.0 * unit(0),
            2 => 10.0 + 60.0 * unit(0),
            3 => 100.0 + 400.0 * unit(0),
            _ => 500.0 + 1_500.0 * unit(0),
        };
        let metres = |units: i32| f64::from(units) / f64::from(UNITS_PER_METRE);
        let position_m = [metres(x), ground_m.max(0.0) + height_m, metres(z)].into();
        let pose = Pose { position_m, yaw_deg: 360.0 * unit(1), pitch_deg: -20.0 * unit(2) }.clamped();
        ViewCase { pose, tolerance_px: [0.5, 1.0, 2.0, 4.0][index as usize % 4] }
    };
    points.zip(0..).map(place).collect()
}

fn ground(land: &Land, x: i32, z: i32) -> i32 {
    terrain::Position::new(x, z).map_or(0, |place| land.height_at(place))
}

/// Measures what a selection draws, all round the eye and within the view distance.
///
/// # Panics
/// If the selection draws a chunk that is not in the world.
pub fn measure(land: &Land, world: &ChunkCache, selection: &Selection, shot: &ViewParams) -> ScreenErrors {
    let chunks: Vec<DrawnChunk> = selection
        .drawn
        .iter()
        .map(|drawn| DrawnChunk::new(world, drawn).expect("a selection draws what is here"))
        .collect();
    let strips: Vec<(&DrawnChunk, usize)> = chunks
        .iter()
        .filter(|chunk| !is_open_sea(land, chunk))
        .flat_map(|chunk| (0..CELLS << chunk.key().level()).step_by(ROWS).map(move |row| (chunk, row)))
        .collect();
    strips
        .par_iter()
        .map(|(chunk, row)| strip(land, chunk, *row, shot))
        .reduce(ScreenErrors::default, ScreenErrors::and)
}

/// Whether a chunk is flat and truly so: nothing is to be measured there.
fn is_open_sea(land: &Land, chunk: &DrawnChunk) -> bool {
    let (x, z) = chunk.key().origin();
    land.archipelago().is_open_sea(x, z, chunk.key().side()) && chunk.is_flat_at(SEA_FLOOR)
}

/// Rows `first` to `first + ROWS` of the level-0 vertices under a chunk, the last one included: the
/// neighbour draws it too.
fn strip(land: &Land, chunk: &DrawnChunk, first: usize, shot: &ViewParams) -> ScreenErrors {
    let key: ChunkKey = chunk.key();
    let level = key.level();
    let columns = (CELLS << level) + 1;
    let (x0, z0) = key.origin();
    let step = 1 << terrain::constants::SPACING_BITS;
    let grid =
        Grid::new(x0, z0 + first as i32 * step, 0, columns, ROWS + 1).expect("a chunk lies in the world");
    let mut reference = vec![0; grid.vertex_count()];
    land.heights(&grid, &mut reference);

    let unit_m = 1.0 / f64::from(UNITS_PER_METRE);
    let eye = shot.pose.position_m;
    let reach_squared = f64::from(shot.view_distance_m).powi(2);
    // The exact number, not the rounded one that clients send to servers.
    let pixels_squared = (f64::from(shot.projection.height) / (2.0 * shot.projection.half_height())).powi(2);
    let scale = unit_m / f64::from(1 << level);
    let mut seen = ScreenErrors::default();
    let mut worst = [(0.0, 0, 0); 2];
    for row in 0..=ROWS {
        let south = f64::from(z0 + (first + row) as i32 * step) * unit_m - eye.z;
        for column in 0..columns {
            let east = f64::from(x0 + column as i32 * step) * unit_m - eye.x;
            let flat = east * east + south * south;
            if flat > reach_squared {
                continue;
            }
            let exact_m = f64::from(reference[row * columns + column]) * unit_m;
            let error_m = chunk.height_scaled(column, first + row) * scale - exact_m;
            let up = exact_m - eye.y;
            let error = error_m * error_m * pixels_squared / (flat + up * up).max(1e-6);
            seen.vertices += 1;
            seen.squares += error;
            let zone = &mut worst[zone(cells_from_border(level, column, first + row))];
            if error > zone.0 {
                *zone = (error, column, first + row);
            }
        }
    }
    seen.worst_px = worst.map(|(error, ..)| error.sqrt());
    let (error, column, row) = worst.into_iter().fold((0.0, 0, 0), |a, b| if b.0 > a.0 { b } else { a });
    if error > 0.0 {
        let place = [x0 + column as i32 * step, z0 + row as i32 * step].map(|v| f64::from(v) * unit_m);
        let exact_m = f64::from(reference[(row - first) * columns + column]) * unit_m;
        let error_m = (chunk.height_scaled(column, row) * scale - exact_m).abs();
        seen.worst = Some(Worst {
            level,
            place_m: place,
            cells_from_border: cells_from_border(level, column, row),
            error_m,
            distance_m: error_m * pixels_squared.sqrt() / error.sqrt(),
            error_px: error.sqrt(),
        });
    }
    seen
}

fn cells_from_border(level: u8, column: usize, row: usize) -> usize {
    let side = CELLS << level;
    let nearest = column.min(row).min(side - column).min(side - row);
    nearest.div_ceil(1 << level)
}

/// 0 inside, 1 in the outermost cells.
fn zone(cells_from_border: usize) -> usize {
    usize::from(cells_from_border <= 1)
}

/// The selection of a view from all chunks that a server sends for it.
pub fn selected(builder: &mut WorldBuilder, shot: &ViewParams) -> (ChunkCache, Selection) {
    let viewer = shot.viewer();
    let mut world = builder.world(&viewer, u32::from(u16::MAX), |_| true);
    let selection = client::lod::select(&mut world, &viewer);
    (world, selection)
}
