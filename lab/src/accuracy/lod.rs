//! Levels of detail: cost in triangles and time against screen-space error, by tolerance.

use crate::curve::{Curve, Sheet};
use crate::lod::frames;
use crate::lod::screen::{self, ScreenErrors, ViewCase};
use crate::places;
use crate::stats::median;
use crate::world_builder::WorldBuilder;
use anyhow::Result;
use chart::{Panel, linear, log};
use client::camera::Pose;
use client::frame::TRIANGLES_PER_INSTANCE;
use client::scene::Scene;
use terrain::Land;

/// Tolerances, pixels.
const TOLERANCES_PX: [f64; 9] = [0.25, 0.5, 0.75, 1.0, 1.5, 2.0, 4.0, 8.0, 16.0];

/// Tolerances from here on are timed: finer ones need more slots than the timed world has.
const TIMED_FROM_PX: f64 = 0.75;

/// Rounds of the timing and frames of a turn; the medians count.
const ROUNDS: usize = 3;
const FRAMES: usize = 5;

/// The tolerance that the viewer starts with, pixels.
const SHIPPED_PX: f64 = 2.0;

/// The tolerance that times are shares of, pixels.
const REFERENCE_PX: f64 = 1.0;

/// The poses that every tolerance is measured at: the 8 km view, a shore, mountains.
fn poses(land: &Land) -> Result<[Pose; 3]> {
    Ok([frames::CAMERA.parse()?, places::along_shore(land), places::over_mountains(land)])
}

struct Row {
    tolerance_px: f64,
    errors: ScreenErrors,
    triangles: f64,
    chunks: f64,
    time_ratio: f64,
}

/// Measures all tolerances. Without a GPU the column of times stays empty.
pub fn measure(world_seed: u64) -> Result<Curve> {
    let land = Land::new(world_seed);
    let times = times(land).inspect_err(|error| eprintln!("no times: {error:#}")).ok();
    let poses = poses(&land)?;
    let views = poses.len() as f64;
    let rows = TOLERANCES_PX.map(|tolerance_px| {
        let known = times.iter().flat_map(|times| &times.ratios).find(|known| known.0 == tolerance_px);
        let time_ratio = known.map_or(f64::NAN, |known| known.1);
        let errors = ScreenErrors::default();
        let mut row = Row { tolerance_px, errors, triangles: 0.0, chunks: 0.0, time_ratio };
        for pose in poses {
            let shot = ViewCase { pose, tolerance_px }.shot();
            let (world, selection) = screen::selected(&mut WorldBuilder::new(land), &shot);
            row.errors = row.errors.and(screen::measure(&land, &world, &selection, &shot));
            let instances = shot.frame(Scene::Island, &world, &selection).instances.len();
            row.triangles += instances as f64 * TRIANGLES_PER_INSTANCE as f64 / views;
            row.chunks += selection.drawn.len() as f64 / views;
        }
        Ok(row)
    });
    let caption = format!(
        "{} views of 8 km at 1920 x 1080: worst and RMS vertical error on screen over all vertices of \
         level 0 around the eye; triangles and chunks in sight, and drawn all round, mean of the \
         views; time of a frame of the first view from {TIMED_FROM_PX} px on, as a share of that at \
         {REFERENCE_PX} px before and after it, median of {ROUNDS} rounds of medians of {FRAMES} on \
         {}.",
        poses.len(),
        times.as_ref().map_or("no GPU", |times| times.adapter.as_str())
    );
    let mut sheet = Sheet::new("lod", caption, rows.into_iter().collect::<Result<_>>()?);
    sheet.columns(["tolerance, px", "max, px", "rms, px", "max, tolerances"], |row| {
        let (max_px, rms_px) = (row.errors.max_px(), row.errors.rms_px());
        [row.tolerance_px, max_px, rms_px, max_px / row.tolerance_px]
    });
    let work = ["triangles", "chunks", "time ratio"];
    sheet.columns(work, |row| [row.triangles, row.chunks, row.time_ratio]);

    let front = |title, x, y, error: &str, cost: &str| {
        let name = |row: &Row| (format!("{} px", row.tolerance_px), row.tolerance_px == SHIPPED_PX);
        sheet.front(Panel::new(title, x, y), error, cost, name)
    };
    let (by_max, by_rms) = (log("largest vertical error, px"), log("RMS vertical error, px"));
    let in_sight = log("triangles in sight");
    let on_screen =
        Panel::new("Error on screen against the tolerance", log("tolerance, px"), log("vertical error, px"));
    let mut panels = vec![
        sheet
            .lines(on_screen, "tolerance, px", [("largest", "max, px"), ("RMS", "rms, px")])
            .bound("the bar", TOLERANCES_PX.map(|tolerance| (tolerance, tolerance))),
        front("Triangles against the largest error", by_max, in_sight, "max, px", "triangles"),
        front("Triangles against the RMS error", by_rms, in_sight, "rms, px", "triangles"),
    ];
    if times.is_some() {
        let share = linear("time, share of that at 1 px");
        panels.push(front(
            "Time of a frame against the largest error",
            by_max,
            share,
            "max, px",
            "time ratio",
        ));
    }
    let title = "Levels of detail: cost against error";
    Ok(Curve { name: "lod", title, tables: vec![sheet.into()], panels })
}

/// Times of a frame.
struct Times {
    adapter: String,
    /// Tolerances, and their times over that of [`REFERENCE_PX`].
    ratios: Vec<(f64, f64)>,
}

/// Times tolerances, the reference before and after each of them, in several rounds: slow changes
/// of the machine's speed affect both, short ones a single round.
fn times(land: Land) -> Result<Times> {
    let timed: Vec<f64> =
        TOLERANCES_PX.into_iter().filter(|px| *px >= TIMED_FROM_PX && *px != REFERENCE_PX).collect();
    let turns: Vec<f64> = std::iter::repeat_n(&timed, ROUNDS)
        .flatten()
        .flat_map(|px| [REFERENCE_PX, *px])
        .chain([REFERENCE_PX])
        .collect();
    let frames = frames::measure(land, &turns, FRAMES)?;
    let median_of = |px: f64| {
        let turns = frames.rows.windows(3).filter(|turn| turn[1].tolerance_px == px);
        (px, median(turns.map(|turn| 2.0 * turn[1].frame_ms / (turn[0].frame_ms + turn[2].frame_ms))))
    };
    let ratios = timed.into_iter().map(median_of).chain([(REFERENCE_PX, 1.0)]).collect();
    Ok(Times { adapter: frames.adapter, ratios })
}
