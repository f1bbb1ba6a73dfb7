//! Parallax occlusion in pictures: every method against displaced geometry by mean FLIP, from
//! several heights and distances; silhouettes and lines of intersection.
//!
//! Control: the flat plane must be farther from geometry than the exact march.

use crate::curve::{Curve, Sheet};
use crate::flip::{PIXELS_PER_DEGREE, mean};
use crate::pom::pictures::{self, Line, Silhouettes};
use crate::pom::renderer::{PomRenderer, around, plane};
use anyhow::{Result, ensure};
use chart::{Panel, linear, log};
use client::camera::Pose;
use client::features::pom::PomSettings;
use client::features::pom::settings::{PomMethod, Silhouette};
use client::gpu::Image;
use client::scene::Scene;
use client::scene::objects::Mode;
use client::settings::Show;

/// Size of the pictures, pixels.
const SIZE: (u32, u32) = (480, 270);
/// Camera above the plane, degrees.
const ELEVATIONS_DEG: [f64; 5] = [75.0, 45.0, 25.0, 12.0, 5.0];
/// Camera from the middle of the plane, metres; the plane has sides of 2.5 m, a texel of 9.8 mm and
/// a relief of 0.1 m.
const DISTANCES_M: [f64; 6] = [3.0, 6.0, 12.0, 24.0, 48.0, 96.0];
/// Elevation of the pictures from a distance.
const SLANT_DEG: f64 = 25.0;
/// Distance and bearing otherwise.
const NEAR_M: f64 = 3.5;
const BEARING_DEG: f64 = 20.0;

/// Methods; the last one is the default.
fn methods() -> [(&'static str, Mode, PomSettings); 7] {
    // With the same edges, so that the difference is what lies between them.
    let shell = PomSettings { silhouette: Silhouette::Shell, ..PomSettings::default() };
    let search =
        |steps| PomSettings { method: PomMethod::Linear, steps_min: steps, steps_max: steps, ..shell };
    [
        ("flat", Mode::Flat, shell),
        ("offset", Mode::Offset, shell),
        ("4 + secant", Mode::Settings, search(4)),
        ("16 + secant", Mode::Settings, search(16)),
        ("64 + secant", Mode::Settings, search(64)),
        ("pyramid", Mode::Settings, PomSettings { method: PomMethod::MaxMip, ..shell }),
        ("auto", Mode::Settings, shell),
    ]
}

/// The methods in the diagrams, by their place in [`methods`]: at most six lines can be
/// distinguished, and the last two coincide.
const SHOWN: [usize; 6] = [0, 1, 2, 3, 4, 6];

const EDGES: [&str; 5] = ["shell", "rectangle", "no silhouette", "own depth, px", "plane's depth, px"];

/// A camera parameter with a figure of each method.
struct Row<const N: usize> {
    camera: f64,
    figures: [f64; N],
}

/// Measures it; the world does not matter.
pub fn measure(_: u64) -> Result<Curve> {
    let mut renderer = PomRenderer::open(Scene::Pom, SIZE)?;
    let by_elevation =
        flips(&mut renderer, &ELEVATIONS_DEG, |elevation_deg| around(elevation_deg, BEARING_DEG, NEAR_M))?;
    let by_distance =
        flips(&mut renderer, &DISTANCES_M, |distance_m| around(SLANT_DEG, BEARING_DEG, distance_m))?;
    for row in &by_elevation {
        ensure!(
            row.figures[0] > row.figures[6],
            "a flat plane is as near to geometry as a marched one from {} degrees",
            row.camera
        );
    }
    let edges = ELEVATIONS_DEG.map(|elevation_deg| edges(&mut renderer, elevation_deg));
    let edges = edges.into_iter().collect::<Result<_>>()?;
    let caption = |from: String| {
        format!(
            "mean FLIP ({PIXELS_PER_DEGREE} pixels per degree) of a plane of cobblestones against displaced \
             geometry, {from}, {} x {} pixels",
            SIZE.0, SIZE.1
        )
    };
    const ELEVATION: &str = "camera above the plane, degrees";
    const DISTANCE: &str = "camera from the plane, metres";
    let names = methods().map(|(name, ..)| name);
    let elevation = sheet(("pom_flip", caption(format!("{NEAR_M} m away"))), ELEVATION, names, by_elevation);
    let from = format!("{SLANT_DEG} degrees above the plane");
    let distance = sheet(("pom_distance", caption(from)), DISTANCE, names, by_distance);
    let of_edges = format!(
        "what a plane covers over what displaced geometry covers, least of three bearings, and how far \
         the line in which a ball meets it is from geometry's, {} x {} pixels",
        SIZE.0, SIZE.1
    );
    let edge = sheet(("pom_edges", of_edges), ELEVATION, EDGES, edges);

    let flip = log("mean FLIP against geometry, 67 pixels per degree");
    let iou = linear("intersection over union with geometry");
    let px = log("p99 distance from the true line, pixels");
    let up = linear(ELEVATION);
    let shown = SHOWN.map(|index| (names[index], names[index]));
    let (covers, lines) = (&EDGES[..3], &EDGES[3..]);
    let of_edges = |title, y, shown: &[&'static str]| {
        edge.lines(Panel::new(title, up, y), ELEVATION, shown.iter().map(|name| (*name, *name)))
    };
    let by_distance = Panel::new("Image by distance, 25 degrees", log(DISTANCE), flip);
    let panels = vec![
        elevation.lines(Panel::new("Image by the height of the camera", up, flip), ELEVATION, shown),
        distance.lines(by_distance, DISTANCE, shown),
        of_edges("Edge of the relief", iou, covers),
        of_edges("Line in which an object meets the relief", px, lines),
    ];
    let tables = vec![elevation.into(), distance.into(), edge.into()];
    let title = "Parallax occlusion in pictures, against displaced geometry";
    Ok(Curve { name: "pom_pictures", title, tables, panels })
}

fn sheet<const N: usize>(
    (name, caption): (&'static str, String),
    camera: &str,
    figures: [&str; N],
    rows: Vec<Row<N>>,
) -> Sheet<Row<N>> {
    let mut sheet = Sheet::new(name, caption, rows);
    sheet.column(camera, |row| row.camera);
    sheet.columns(figures, |row| row.figures);
    sheet
}

/// Mean FLIP of each method against geometry, over one change of the camera.
fn flips(renderer: &mut PomRenderer, values: &[f64], pose: impl Fn(f64) -> Pose) -> Result<Vec<Row<7>>> {
    let row = |value: &f64| {
        let mut render = |mode, knobs| -> Result<Image> {
            renderer.shown(&[plane(mode)], pose(*value), knobs, Show::Image)?;
            Ok(renderer.picture()?)
        };
        let reference = render(Mode::Geometry, methods()[5].2)?;
        let mut figures = [0.0; 7];
        for ((_, mode, knobs), figure) in methods().into_iter().zip(&mut figures) {
            *figure = mean(&reference, &render(mode, knobs)?, PIXELS_PER_DEGREE);
        }
        Ok(Row { camera: *value, figures })
    };
    values.iter().map(row).collect()
}

/// Overlap of silhouettes and distance of lines of intersection, by [`EDGES`].
fn edges(renderer: &mut PomRenderer, elevation_deg: f64) -> Result<Row<5>> {
    let Silhouettes { shell, rectangle, flat, .. } = pictures::silhouettes(renderer, elevation_deg)?;
    let Line { with_depth, without_depth, .. } = pictures::line(renderer, elevation_deg)?;
    let figures = [shell, rectangle, flat, with_depth, without_depth];
    Ok(Row { camera: elevation_deg, figures })
}
