//! Parallax occlusion in pictures: every way of marching beside displaced geometry by mean FLIP,
//! from several heights and distances; edges and lines of intersection.
//!
//! A flat plane must be farther from geometry than the exact march, or the measurement is refused.

use super::Curve;
use crate::chart::{Panel, linear, log, measured};
use crate::flip::{PIXELS_PER_DEGREE, mean};
use crate::relief::pictures::{ReliefStudio, around, cut_distance, plane, silhouette_overlap};
use crate::table::Table;
use anyhow::{Result, ensure};
use client::camera::Pose;
use client::looks::Show;
use client::relief::ReliefKnobs;
use client::relief::knobs::{ReliefTier, Silhouette};
use client::render::Picture;
use client::render::scenes::relief::objects::Mode;
use client::scene::Scene;

/// Size of the pictures, pixels.
const SIZE: (u32, u32) = (480, 270);
/// Camera above the plane, degrees.
const ELEVATIONS_DEG: [f64; 5] = [75.0, 45.0, 25.0, 12.0, 5.0];
/// Camera from the middle of the plane, metres; the plane has sides of 2.5 m, a texel of 9.8 mm and
/// a relief of 0.1 m.
const DISTANCES_M: [f64; 6] = [3.0, 6.0, 12.0, 24.0, 48.0, 96.0];
/// Elevation of the pictures from a distance.
const SLANT_DEG: f64 = 25.0;
/// Where the camera stands otherwise.
const NEAR_M: f64 = 3.5;
const BEARING_DEG: f64 = 20.0;

/// Ways of drawing; the last one is the default.
fn ways() -> [(&'static str, Mode, ReliefKnobs); 7] {
    // With the same edges, so that the difference is what lies between them.
    let shell = ReliefKnobs { silhouette: Silhouette::Shell, ..ReliefKnobs::default() };
    let search =
        |steps| ReliefKnobs { tier: ReliefTier::Linear, steps_min: steps, steps_max: steps, ..shell };
    [
        ("flat", Mode::Flat, shell),
        ("offset", Mode::Offset, shell),
        ("4 + secant", Mode::Knobs, search(4)),
        ("16 + secant", Mode::Knobs, search(16)),
        ("64 + secant", Mode::Knobs, search(64)),
        ("pyramid", Mode::Knobs, ReliefKnobs { tier: ReliefTier::Pyramid, ..shell }),
        ("auto", Mode::Knobs, shell),
    ]
}

/// The ways in the diagrams, by their place in [`ways`]: at most six lines can be told apart, and
/// the last two coincide.
const SHOWN: [usize; 6] = [0, 1, 2, 3, 4, 6];

/// Measures it; the world does not matter.
///
/// # Errors
/// There is no GPU, it failed, or a flat plane looks as right as the exact march.
pub fn measure(_: u64) -> Result<Curve> {
    let mut studio = ReliefStudio::open(Scene::Pom, SIZE)?;
    let by_elevation = flips(
        &mut studio,
        ("pom_flip", "camera above the plane, degrees", &ELEVATIONS_DEG),
        &format!("{NEAR_M} m away"),
        |elevation_deg| around(elevation_deg, BEARING_DEG, NEAR_M),
    )?;
    let by_distance = flips(
        &mut studio,
        ("pom_distance", "camera from the plane, metres", &DISTANCES_M),
        &format!("{SLANT_DEG} degrees above the plane"),
        |distance_m| around(SLANT_DEG, BEARING_DEG, distance_m),
    )?;
    for row in &by_elevation.rows {
        ensure!(row[1] > row[7], "a flat plane looks as right as a marched one from {} degrees", row[0]);
    }
    let edges = edges(&mut studio)?;
    let lines = |table: &Table| {
        let ways = ways();
        let x = table.columns[0].clone();
        SHOWN.map(|index| measured(ways[index].0, table.curve(&x, ways[index].0))).to_vec()
    };
    let of_edges = |names: &[&str]| {
        names
            .iter()
            .map(|name| measured(*name, edges.curve("camera above the plane, degrees", name)))
            .collect::<Vec<_>>()
    };
    let up = linear("camera above the plane, degrees");
    let flip = "mean FLIP against geometry, 67 pixels per degree";
    let panels = vec![
        Panel {
            title: "Picture by the height of the camera",
            x: up,
            y: log(flip),
            series: lines(&by_elevation),
        },
        Panel {
            title: "Picture by distance, 25 degrees",
            x: log("camera from the plane, metres"),
            y: log(flip),
            series: lines(&by_distance),
        },
        Panel {
            title: "Edge of the relief",
            x: up,
            y: linear("intersection over union with geometry"),
            series: of_edges(&["shell", "rectangle", "no silhouette"]),
        },
        Panel {
            title: "Line in which an object meets the relief",
            x: up,
            y: log("p99 distance from the true line, pixels"),
            series: of_edges(&["own depth, px", "plane's depth, px"]),
        },
    ];
    Ok(Curve {
        name: "pom_pictures",
        title: "Parallax occlusion in pictures, against displaced geometry",
        tables: vec![by_elevation, by_distance, edges],
        panels,
    })
}

/// Mean FLIP of each way against geometry, over one change of the camera.
fn flips(
    studio: &mut ReliefStudio,
    (name, column, values): (&'static str, &str, &[f64]),
    from: &str,
    pose: impl Fn(f64) -> Pose,
) -> Result<Table> {
    let mut columns = vec![column];
    columns.extend(ways().map(|(name, ..)| name));
    let caption = format!(
        "mean FLIP ({PIXELS_PER_DEGREE} pixels per degree) of a plane of cobblestones against displaced geometry, {from}, {} x {} pixels",
        SIZE.0, SIZE.1
    );
    let mut table = Table::new(name, caption, &columns);
    for value in values {
        let mut of = |mode, knobs| -> Result<Picture> {
            studio.shown(&[plane(mode)], pose(*value), knobs, Show::Picture)?;
            Ok(studio.picture()?)
        };
        let truth = of(Mode::Geometry, ways()[5].2)?;
        let mut row = vec![*value];
        for (_, mode, knobs) in ways() {
            row.push(mean(&truth, &of(mode, knobs)?, PIXELS_PER_DEGREE));
        }
        table.push(row);
    }
    Ok(table)
}

/// Edges and lines of intersection by elevation.
fn edges(studio: &mut ReliefStudio) -> Result<Table> {
    let mut table = Table::new(
        "pom_edges",
        format!(
            "what a plane covers over what displaced geometry covers, least of three bearings, and how far the line in which a ball meets it is from geometry's, {} x {} pixels",
            SIZE.0, SIZE.1
        ),
        &[
            "camera above the plane, degrees",
            "shell",
            "rectangle",
            "no silhouette",
            "own depth, px",
            "plane's depth, px",
        ],
    );
    let exact = ways()[5].2;
    for elevation_deg in ELEVATIONS_DEG {
        let mut row = vec![elevation_deg];
        for (mode, silhouette) in [
            (Mode::Knobs, Silhouette::Shell),
            (Mode::Knobs, Silhouette::Rectangle),
            (Mode::Flat, Silhouette::None),
        ] {
            row.push(silhouette_overlap(studio, mode, ReliefKnobs { silhouette, ..exact }, elevation_deg)?);
        }
        for (depth, silhouette) in [(true, Silhouette::Shell), (false, Silhouette::None)] {
            row.push(cut_distance(studio, ReliefKnobs { depth, silhouette, ..exact }, elevation_deg)?.0);
        }
        table.push(row);
    }
    Ok(table)
}
