//! `tombolo-lab lod`: levels of detail as drawn, against level 0.
//!
//! Screen error at every vertex of level 0 ([`screen`], on the drawn surface of `drawn`),
//! triangles (`triangles`), gaps ([`crate::cracks`]), popping (`popping`), draw calls, memory
//! and time (`frames`). `cargo xtask measure terrain` compares the figures with their bars;
//! here only a control that passes is an error.

mod bars;
pub(crate) mod drawn;
pub(crate) mod frames;
mod popping;
pub mod screen;
pub(crate) mod triangles;

use crate::cracks::{self, Fault};
use crate::report::publish;
use crate::world_builder::WorldBuilder;
use crate::{Outputs, note};
use anyhow::{Result, ensure};
use client::lod::select;
use client::settings::RenderSettings;
use client::view::ViewParams;
use screen::{ScreenErrors, ViewCase};
use serde::Serialize;
use terrain::Land;

/// The world that is measured.
const WORLD_SEED: u64 = 1;

/// Streams of the seeded poses.
const SCREEN_STREAM: u32 = 31;
const CRACKS_STREAM: u32 = 91;

/// Tolerances whose frame times are compared, pixels.
const TOLERANCES_PX: [f64; 3] = [1.0, 2.0, 4.0];

/// The control of the screen error chooses for so many tolerances.
const LOOSE: f64 = 4.0;

/// Options of `lod`.
#[derive(Clone, Debug, clap::Args)]
pub struct Options {
    /// Poses of the screen error, 1 to 10000
    #[arg(long, value_name = "N", default_value_t = 50,
          value_parser = clap::value_parser!(u32).range(1..=10_000))]
    pub poses: u32,
    /// Poses of the search for gaps, 1 to 10000
    #[arg(long, value_name = "N", default_value_t = 200,
          value_parser = clap::value_parser!(u32).range(1..=10_000))]
    pub views: u32,
    /// Frames of each flight, 2 to 10000
    #[arg(long, value_name = "N", default_value_t = 200,
          value_parser = clap::value_parser!(u32).range(2..=10_000))]
    pub frames: u32,
}

/// The result. Field names are a contract with scripts.
#[derive(Clone, Debug, Serialize)]
struct Report {
    screen: Screen,
    triangles: Vec<triangles::View>,
    cracks: Cracks,
    popping: Vec<popping::Outcome>,
    /// The same by light of the drawn triangles, without shadows of the land.
    popping_by_triangles: Vec<popping::Outcome>,
    frames: frames::Frames,
}

/// Screen error over all poses, in tolerances: 1 is all that is allowed.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Screen {
    /// Poses.
    pub poses: usize,
    /// Vertices of level 0 looked at.
    pub vertices: u64,
    /// The largest error, tolerances.
    pub max: f64,
    /// The largest inside chunks, and in their outermost cells.
    pub zones: [f64; 2],
    /// The worst vertex.
    pub worst: Option<screen::Worst>,
    /// Its camera.
    pub camera: String,
    /// The largest error of what is chosen for four tolerances: the control.
    pub max_when_loose: f64,
}

/// Gaps, and the faults that must show.
#[derive(Clone, Debug, PartialEq, Serialize)]
struct Cracks {
    whole: cracks::Count,
    chunk_left_out: cracks::Count,
    no_seams: cracks::Count,
}

/// Measures, prints and checks the controls.
///
/// # Errors
/// There is no GPU, it failed, a control holds, or a result cannot be written.
pub fn run(options: &Options, outputs: &Outputs) -> Result<()> {
    let land = Land::new(WORLD_SEED);
    note("screen error");
    let screen = screen_error(&land, &screen::view_cases(&land, options.poses, SCREEN_STREAM));
    note("triangles");
    let triangles = triangles::count(&land);
    note("popping");
    let mut renderer = popping::renderer()?;
    let mut fly = |settings| -> Result<Vec<_>, _> {
        let flights = popping::FLIGHTS.iter();
        flights.map(|flight| popping::fly(&mut renderer, land, flight, settings, options.frames)).collect()
    };
    let popping = fly(RenderSettings::default())?;
    let popping_by_triangles = fly(popping::by_triangles())?;
    drop(renderer);
    note("gaps");
    let cracks = gaps(land, options.views)?;
    note("frames");
    let frames = frames::measure(land, &TOLERANCES_PX, frames::FRAMES)?;
    let report = Report { screen, triangles, cracks, popping, popping_by_triangles, frames };
    publish(&report, bars::rows, bars::notes, "/frames/adapter", outputs)?;
    report.controls()
}

impl Report {
    /// Fails if a control passes. The one of morphs has a row of its own.
    fn controls(&self) -> Result<()> {
        ensure!(self.screen.max_when_loose > 1.0, "chunks chosen for {LOOSE} tolerances keep one");
        let Cracks { whole, chunk_left_out, no_seams } = &self.cracks;
        ensure!(whole.pixels > 0, "no pixel had to show land");
        ensure!(chunk_left_out.magenta > 0, "a chunk that was left out was not missed");
        ensure!(no_seams.magenta > 0, "borders that do not meet were not seen");
        let changes: u32 = self.popping.iter().map(|flight| flight.level_changes).sum();
        ensure!(changes > 0, "no level changed in any flight: let them take more frames");
        Ok(())
    }
}

/// Screen error over poses.
pub fn screen_error(land: &Land, cases: &[ViewCase]) -> Screen {
    let mut result = Screen {
        poses: cases.len(),
        vertices: 0,
        max: 0.0,
        zones: [0.0; 2],
        worst: None,
        camera: String::new(),
        max_when_loose: 0.0,
    };
    let mut builder = WorldBuilder::new(*land);
    for case in cases {
        let shot = case.shot();
        let (mut world, selection) = screen::selected(&mut builder, &shot);
        builder.clear();
        let seen = screen::measure(land, &world, &selection, &shot);
        let share = |pixels: f64| pixels / case.tolerance_px;
        if share(seen.max_px()) > result.max {
            (result.worst, result.camera) = (seen.worst, case.pose.to_string());
        }
        result.vertices += seen.vertices;
        result.max = result.max.max(share(seen.max_px()));
        result.zones = [0, 1].map(|zone| result.zones[zone].max(share(seen.worst_px[zone])));
        let loose = ViewParams { tolerance_px: LOOSE * case.tolerance_px, ..shot };
        let selection = select(&mut world, &loose.viewer());
        let control: ScreenErrors = screen::measure(land, &world, &selection, &loose);
        result.max_when_loose = result.max_when_loose.max(share(control.max_px()));
    }
    result
}

fn gaps(land: Land, views: u32) -> Result<Cracks> {
    let mut renderer = cracks::renderer()?;
    let viewpoints = cracks::viewpoints(land.world_seed(), views, CRACKS_STREAM);
    let mut count = |fault| cracks::count(&mut renderer, land, &viewpoints, fault);
    Ok(Cracks {
        whole: count(Fault::None)?,
        chunk_left_out: count(Fault::ChunkLeftOut)?,
        no_seams: count(Fault::NoSeams)?,
    })
}
