//! Levels of detail: what the tolerance costs in triangles and time, and what error it leaves on
//! screen.

use super::Curve;
use crate::chart::{Choice, Panel, Series, front, linear, log, measured, stated};
use crate::lod::frames;
use crate::lod::screen::{self, Place, Seen};
use crate::scenery::Scenery;
use crate::table::Table;
use anyhow::Result;
use client::frame::TRIANGLES_PER_INSTANCE;
use client::scene::Scene;
use terrain::Land;

/// Tolerances, pixels.
const TOLERANCES_PX: [f64; 9] = [0.25, 0.5, 0.75, 1.0, 1.5, 2.0, 4.0, 8.0, 16.0];

/// Tolerances from here on are timed: what a finer one needs does not fit into the slots of the
/// timed world.
const TIMED_FROM_PX: f64 = 0.75;

/// Rounds of the timing and frames of a turn; the medians count.
const ROUNDS: usize = 3;
const FRAMES: usize = 5;

/// The tolerance that the viewer starts with, pixels.
const SHIPPED_PX: f64 = 2.0;

/// The tolerance that times are shares of, pixels.
const REFERENCE_PX: f64 = 1.0;

/// The poses that every tolerance is measured at: the 8 km view, a shore, a summit.
const CAMERAS: [&str; 3] = [frames::CAMERA, "4700,25,500,-60,-8", "300,420,900,20,-12"];

/// Measures all tolerances. Without a GPU the column of times stays empty.
///
/// # Errors
/// The GPU failed.
pub fn measure(world_seed: u64) -> Result<Curve> {
    let land = Land::new(world_seed);
    let times = match times(land) {
        Ok(times) => Some(times),
        Err(error) => {
            eprintln!("no times: {error:#}");
            None
        }
    };
    let mut table = Table::new(
        "lod",
        format!(
            "{} views of 8 km at 1920 x 1080: worst and RMS vertical error on screen over all vertices of level 0 around the eye; triangles and chunks in sight, and drawn all round, mean of the views; time of a frame of the first view from {TIMED_FROM_PX} px on, as a share of that at {REFERENCE_PX} px before and after it, median of {ROUNDS} rounds of medians of {} on {}.",
            CAMERAS.len(),
            FRAMES,
            times.as_ref().map_or("no GPU", |times| times.adapter.as_str())
        ),
        &["tolerance, px", "max, px", "rms, px", "max, tolerances", "triangles", "chunks", "time ratio"],
    );
    for tolerance_px in TOLERANCES_PX {
        let (mut seen, mut in_sight, mut chunks) = (Seen::default(), 0, 0);
        for camera in CAMERAS {
            let shot = Place { pose: camera.parse()?, tolerance_px }.shot();
            let (world, selection) = screen::selected(&mut Scenery::new(land), &shot);
            seen = seen.and(screen::measure(&land, &world, &selection, &shot));
            in_sight += shot.frame(Scene::Island, &world, &selection).instances.len();
            chunks += selection.drawn.len();
        }
        let views = CAMERAS.len() as f64;
        let known = times.iter().flat_map(|times| &times.ratios).find(|known| known.0 == tolerance_px);
        let ratio = known.map_or(f64::NAN, |known| known.1);
        table.push([
            tolerance_px,
            seen.max_px(),
            seen.rms_px(),
            seen.max_px() / tolerance_px,
            in_sight as f64 * TRIANGLES_PER_INSTANCE as f64 / views,
            chunks as f64 / views,
            ratio,
        ]);
    }
    let panels = panels(&table);
    Ok(Curve {
        name: "lod",
        title: "Levels of detail: cost against what is left of the error",
        tables: vec![table],
        panels,
    })
}

/// Times of a frame.
struct Times {
    adapter: String,
    /// Tolerances, and their times over that of [`REFERENCE_PX`].
    ratios: Vec<(f64, f64)>,
}

/// Times tolerances, the reference before and after each of them, in several rounds: what slows the
/// machine for longer than a turn slows both, and what slows it for shorter spoils one round.
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
        let mut ratios: Vec<f64> =
            turns.map(|turn| 2.0 * turn[1].frame_ms / (turn[0].frame_ms + turn[2].frame_ms)).collect();
        ratios.sort_unstable_by(f64::total_cmp);
        (px, ratios.get(ratios.len() / 2).copied().unwrap_or(f64::NAN))
    };
    let ratios = timed.into_iter().map(median_of).chain([(REFERENCE_PX, 1.0)]).collect();
    Ok(Times { adapter: frames.adapter, ratios })
}

/// What tolerances cost, `cost`, against the error that they leave, `error`.
fn trade(table: &Table, error: &str, cost: &str) -> Vec<Series> {
    let points = table.curve(error, cost).into_iter().zip(TOLERANCES_PX);
    let choice = |(at, tolerance_px)| Choice {
        name: format!("{tolerance_px} px"),
        at,
        is_shipped: tolerance_px == SHIPPED_PX,
    };
    front(&points.map(choice).collect::<Vec<_>>())
}

fn panels(table: &Table) -> Vec<Panel> {
    let mut panels = vec![
        Panel {
            title: "Error on screen against the tolerance",
            x: log("tolerance, px"),
            y: log("vertical error, px"),
            series: vec![
                measured("largest", table.curve("tolerance, px", "max, px")),
                measured("RMS", table.curve("tolerance, px", "rms, px")),
                stated("the promise", TOLERANCES_PX.map(|tolerance| (tolerance, tolerance))),
            ],
        },
        Panel {
            title: "Triangles against the largest error",
            x: log("largest vertical error, px"),
            y: log("triangles in sight"),
            series: trade(table, "max, px", "triangles"),
        },
        Panel {
            title: "Triangles against the RMS error",
            x: log("RMS vertical error, px"),
            y: log("triangles in sight"),
            series: trade(table, "rms, px", "triangles"),
        },
    ];
    if table.curve("max, px", "time ratio").iter().any(|(_, ratio)| ratio.is_finite()) {
        panels.push(Panel {
            title: "Time of a frame against the largest error",
            x: log("largest vertical error, px"),
            y: linear("time, share of that at 1 px"),
            series: trade(table, "max, px", "time ratio"),
        });
    }
    panels
}
