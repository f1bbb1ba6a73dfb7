//! The filter of materials: most samples along the longer axis of a pixel's footprint, against a
//! supersampled picture: mean FLIP and time of a frame by the height of the camera.

use crate::curve::{Curve, Sheet};
use crate::flip::{self, PIXELS_PER_DEGREE};
use crate::pom::renderer::{PomRenderer, around};
use crate::stats::{interleaved, mean, ratios};
use crate::supersampled::{self, averaged};
use anyhow::{Context, Result, ensure};
use chart::{Panel, linear};
use client::frame::FrameData;
use client::gpu::Image;
use client::scene::Scene;
use client::scene::objects::{Mode, Object};
use client::settings::RenderSettings;
use glam::DVec3;

/// Size of the compared pictures, pixels, and the factor of supersampling.
const SIZE: (u32, u32) = (320, 180);
const FINER: u32 = 6;

/// Settings of the knob, and the one that the viewer starts with on a GPU.
const ANISOTROPIES: [u16; 5] = [1, 2, 4, 8, 16];
const SHIPPED: u16 = 8;

/// Camera above a flat floor, degrees, at a distance and from some bearings; the floor is a square
/// of this side with tiles of 5 m, all in metres.
const ELEVATIONS_DEG: [f64; 4] = [60.0, 25.0, 12.0, 6.0];
const BEARINGS_DEG: [f64; 3] = [0.0, 20.0, 45.0];
const DISTANCE_M: f64 = 20.0;
const SIDE_M: f32 = 400.0;
const TILE_M: f32 = 5.0;

/// Rounds of the interleaved timing; the median counts.
const ROUNDS: usize = 15;

struct Row {
    anisotropy: u16,
    /// By [`ELEVATIONS_DEG`].
    flips: Vec<f64>,
    time_ratio: f64,
}

/// Measures it; the world does not matter.
pub fn measure(_: u64) -> Result<Curve> {
    let open = |size, anisotropy| -> Result<PomRenderer> {
        let mut renderer = PomRenderer::filtered(Scene::Pom, size, anisotropy)
            .context("the filter of materials is measured on a GPU")?;
        renderer.set_objects(vec![Object::ground(Mode::Flat, DVec3::ZERO, SIDE_M, TILE_M)]);
        Ok(renderer)
    };
    let mut fine = open(supersampled::size(SIZE, FINER), 16)?;
    let mut renderers =
        ANISOTROPIES.map(|anisotropy| open(SIZE, anisotropy)).into_iter().collect::<Result<Vec<_>>>()?;

    let mut rows: Vec<Row> = ANISOTROPIES
        .map(|anisotropy| Row { anisotropy, flips: Vec::new(), time_ratio: 0.0 })
        .into_iter()
        .collect();
    for elevation_deg in ELEVATIONS_DEG {
        let mut sums = [0.0; ANISOTROPIES.len()];
        for bearing_deg in BEARINGS_DEG {
            let pose = around(elevation_deg, bearing_deg, DISTANCE_M);
            let picture = |renderer: &mut PomRenderer| -> Result<Image> {
                let frame = renderer.frame(pose, RenderSettings::default());
                renderer.draw(&frame)?;
                Ok(renderer.picture()?)
            };
            let reference = averaged(&picture(&mut fine)?, FINER);
            for (renderer, sum) in renderers.iter_mut().zip(&mut sums) {
                *sum += flip::mean(&reference, &picture(renderer)?, PIXELS_PER_DEGREE);
            }
        }
        for (row, sum) in rows.iter_mut().zip(sums) {
            row.flips.push(sum / BEARINGS_DEG.len() as f64);
        }
    }
    let lowest = around(ELEVATIONS_DEG[ELEVATIONS_DEG.len() - 1], BEARINGS_DEG[0], DISTANCE_M);
    let frame = renderers[0].frame(lowest, RenderSettings::default());
    for (row, time_ratio) in rows.iter_mut().zip(times(&mut renderers, &frame)?) {
        row.time_ratio = time_ratio;
    }
    let caption = format!(
        "a flat floor of cobblestones, {} x {} pixels of one sample, against {FINER} x {FINER} times as many \
         with an anisotropy of 16, mean of {} bearings; FLIP at {PIXELS_PER_DEGREE} pixels per degree; time \
         of a frame from the lowest camera over that with 1, median of {ROUNDS} interleaved rounds; {}.",
        SIZE.0,
        SIZE.1,
        BEARINGS_DEG.len(),
        fine.adapter()
    );
    sheet(caption, rows)
}

fn sheet(caption: String, rows: Vec<Row>) -> Result<Curve> {
    let mut sheet = Sheet::new("anisotropy", caption, rows);
    sheet.column("anisotropy", |row| f64::from(row.anisotropy));
    let names = ELEVATIONS_DEG.map(|elevation_deg| format!("mean FLIP from {elevation_deg} degrees"));
    sheet.columns(names, |row| [0, 1, 2, 3].map(|index| row.flips[index]));
    sheet.columns(["mean FLIP", "time ratio"], |row| [mean(row.flips.iter().copied()), row.time_ratio]);
    let flip = |anisotropy| {
        let row = sheet.rows.iter().find(|row| row.anisotropy == anisotropy);
        row.map(|row| mean(row.flips.iter().copied()))
    };
    ensure!(
        flip(1) > flip(SHIPPED),
        "pictures without anisotropy are as near to the supersampled ones as those with {SHIPPED}"
    );
    let name = |row: &Row| (row.anisotropy.to_string(), row.anisotropy == SHIPPED);
    let (time, flip) = (linear("time of a frame, ratio to 1"), linear("mean FLIP, 67 pixels per degree"));
    let panel = Panel::new("Sharpness of a floor", time, flip);
    let panels = vec![sheet.front(panel, "time ratio", "mean FLIP", name)];
    let title = "Filter of materials: cost and error (reference: a supersampled picture)";
    Ok(Curve { name: "anisotropy", title, tables: vec![sheet.into()], panels })
}

/// Times of a frame with each renderer over those with the first.
fn times(renderers: &mut [PomRenderer], frame: &FrameData) -> Result<Vec<f64>> {
    let count = renderers.len();
    Ok(ratios(&interleaved(ROUNDS, count, |knob| renderers[knob].draw(frame))?))
}
