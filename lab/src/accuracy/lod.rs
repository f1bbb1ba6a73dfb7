//! Levels of detail: what the tolerance costs in triangles and time, and what error it leaves on screen.

use super::Curve;
use crate::chart::{Panel, front, log, measured, stated};
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
    let times = match frames::measure(land, &TOLERANCES_PX) {
        Ok(frames) => Some(frames),
        Err(error) => {
            eprintln!("no times: {error:#}");
            None
        }
    };
    let time_of = |tolerance_px: f64| {
        let row = times.as_ref()?.rows.iter().find(|row| row.tolerance_px == tolerance_px)?;
        Some(row.frame_ms)
    };
    let mut table = Table::new(
        "lod",
        format!(
            "{} views of 8 km at 1920 x 1080: worst and RMS vertical error on screen over all vertices of level 0 around the eye; triangles and chunks in sight, and drawn all round, mean of the views; time of a frame of the first view as a share of that at {REFERENCE_PX} px, median of {}.",
            CAMERAS.len(),
            frames::FRAMES
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
        let ratio = time_of(tolerance_px).zip(time_of(REFERENCE_PX)).map_or(f64::NAN, |(own, one)| own / one);
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
            series: front("tolerances from 0.25 to 16 px", &table.curve("max, px", "triangles")),
        },
        Panel {
            title: "Triangles against the RMS error",
            x: log("RMS vertical error, px"),
            y: log("triangles in sight"),
            series: front("tolerances from 0.25 to 16 px", &table.curve("rms, px", "triangles")),
        },
    ];
    let timed: Vec<_> =
        table.curve("max, px", "time ratio").into_iter().filter(|(_, ratio)| ratio.is_finite()).collect();
    if !timed.is_empty() {
        panels.push(Panel {
            title: "Time of a frame against the largest error",
            x: log("largest vertical error, px"),
            y: log("time, share of that at 1 px"),
            series: front("tolerances from 0.25 to 16 px", &timed),
        });
    }
    panels
}
