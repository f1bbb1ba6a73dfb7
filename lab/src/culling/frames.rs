//! What each way of choosing plants costs in frames of the valley scene: choice alone and whole
//! picture, one interleaved run.

use crate::culling::names::frame_of;
use crate::culling::poses::{LENS, Place, Trial};
use crate::culling::scene::Scene;
use crate::studio::Studio;
use anyhow::{Context, Result};
use client::camera::Lens;
use client::frame::Shot;
use client::looks::Looks;
use client::plants::{Cull, PlantKnobs};
use client::world::stretch;
use serde::Serialize;
use std::time::Duration;
use terrain::Land;

/// Size of the pictures, pixels.
const SIZE: (u32, u32) = (320, 180);

/// Interleaved rounds; the median is kept.
const ROUNDS: usize = 5;

/// Slots of the pool.
const SLOTS: u32 = 2000;

/// The ways in their order, T1 first because all are compared with it.
pub const WAYS: [(&str, Cull); 6] = [
    ("T1 frustum", Cull::Frustum),
    ("T0 distance", Cull::Distance),
    ("T2 noise", Cull::Noise),
    ("T3 march", Cull::March),
    ("T3 exact", Cull::Exact),
    ("T4 hierarchical", Cull::Hierarchical),
];

/// Cost of one way.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct Cost {
    /// Name of the way.
    pub way: &'static str,
    /// Clumps drawn.
    pub clumps: u64,
    /// Time of the choice over that of T1.
    pub choice_ratio: f64,
    /// Time of the frame over that of T1.
    pub frame_ratio: f64,
    /// Median time of the choice, milliseconds.
    pub choice_ms: f64,
    /// Median time of the frame, milliseconds.
    pub frame_ms: f64,
}

/// What the frames came to.
#[derive(Clone, Debug, Serialize)]
pub struct Frames {
    /// Who drew.
    pub adapter: String,
    /// Whether that is a processor that plays a GPU.
    pub is_software: bool,
    /// By way, T1 first.
    pub ways: Vec<Cost>,
}

/// Draws the scene `culling` as it starts, with some plants, by each way.
///
/// # Errors
/// There is no GPU, or it failed.
pub fn measure(land: &Land, plants: PlantKnobs) -> Result<Frames> {
    let mut studio = Studio::open(SIZE, SLOTS).context("frames need a GPU")?;
    let start = client::scene::Scene::Culling;
    let trial = Trial {
        name: "the scene `culling`".into(),
        place: Place::Valley,
        shot: Shot {
            pose: start.start(),
            lens: Lens { width: SIZE.0, height: SIZE.1, ..LENS },
            view_distance_m: 2600,
            tolerance_px: 2.0,
            time_s: 0.0,
            looks: Looks { plants, ..Looks::default() },
        },
        stretch: (start.vertical_scale() * f64::from(stretch::ONE)).round() as i32,
    };
    let scene = Scene::of(land, &trial, studio.slots()).context("nothing grows in the scene `culling`")?;
    studio.furnish(&scene.world);
    let frames: Vec<_> = WAYS.iter().map(|(_, cull)| frame_of(&scene, *cull)).collect();
    let mut clumps = Vec::new();
    for frame in &frames {
        // Compiles what is to be compiled, and finds the shadows.
        studio.picture(frame)?;
        clumps.push(studio.chosen()?.iter().map(|kind| u64::from(kind.told.clumps)).sum::<u64>());
    }
    let mut times = [vec![Vec::new(); WAYS.len()], vec![Vec::new(); WAYS.len()]];
    for round in 0..ROUNDS {
        for (index, frame) in frames.iter().enumerate() {
            // A march over the noise takes seconds: once shows by how much.
            if round > 0 && WAYS[index].1 == Cull::Noise {
                continue;
            }
            times[0][index].push(studio.choose(frame)?);
            times[1][index].push(studio.draw(frame)?);
        }
    }
    let [choices, whole] = times.each_ref().map(|times| over_first(times));
    let cost = |(index, (way, _)): (usize, &(&'static str, Cull))| Cost {
        way,
        clumps: clumps[index],
        choice_ratio: choices[index],
        frame_ratio: whole[index],
        choice_ms: median_ms(&times[0][index]),
        frame_ms: median_ms(&times[1][index]),
    };
    Ok(Frames {
        adapter: studio.adapter(),
        is_software: studio.is_software(),
        ways: WAYS.iter().enumerate().map(cost).collect(),
    })
}

/// Medians over that of the first way.
fn over_first(times: &[Vec<Duration>]) -> Vec<f64> {
    let first = median_ms(&times[0]);
    times.iter().map(|times| median_ms(times) / first).collect()
}

fn median_ms(times: &[Duration]) -> f64 {
    let mut sorted = times.to_vec();
    sorted.sort_unstable();
    sorted.get(sorted.len() / 2).map_or(f64::NAN, |time| time.as_secs_f64() * 1e3)
}
