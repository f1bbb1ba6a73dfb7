//! Cost of each culling method in frames of the valley scene: culling alone and the whole frame, in
//! one interleaved run.

use crate::culling::cases::Case;
use crate::culling::id_buffer::frame_of;
use crate::culling::scene::Scene;
use crate::headless_renderer::HeadlessRenderer;
use crate::stats::median_s;
use anyhow::{Context, Result};
use client::features::vegetation::{Cull, VegetationSettings};
use serde::Serialize;
use terrain::Land;

/// Size of the pictures, pixels.
const SIZE: (u32, u32) = (320, 180);

/// Interleaved rounds of a record; the median is kept.
pub const ROUNDS: u32 = 5;

/// Slots of the pool.
const SLOTS: u32 = 2000;

/// The methods; all are compared with the first, T1.
pub const WAYS: [(&str, Cull); 6] = [
    ("T1 frustum", Cull::Frustum),
    ("T0 distance", Cull::Distance),
    ("T2 noise", Cull::Noise),
    ("T3 march", Cull::March),
    ("T3 exact", Cull::Exact),
    ("T4 hierarchical", Cull::Hierarchical),
];

#[derive(Clone, Copy, Debug, Serialize)]
pub struct Cost {
    pub way: &'static str,
    pub clumps: u64,
    /// Time of culling over that of T1.
    pub choice_ratio: f64,
    /// Time of the frame over that of T1.
    pub frame_ratio: f64,
    /// Median time of culling, milliseconds.
    pub choice_ms: f64,
    /// Median time of the frame, milliseconds.
    pub frame_ms: f64,
}

#[derive(Clone, Debug, Serialize)]
pub struct Frames {
    pub adapter: String,
    pub is_software: bool,
    /// By method, T1 first.
    pub ways: Vec<Cost>,
}

/// Draws the scene `culling` at its start with each method in turns, so many rounds.
pub fn measure(land: &Land, plants: VegetationSettings, rounds: u32) -> Result<Frames> {
    let mut renderer = HeadlessRenderer::open(SIZE, SLOTS).context("frames need a GPU")?;
    let case = Case::at_start(client::scene::Scene::Culling, SIZE, plants);
    let scene = Scene::of(land, &case, renderer.slots()).context("nothing grows in the scene `culling`")?;
    renderer.upload_world(&scene.world);
    let frames: Vec<_> = WAYS.iter().map(|(_, cull)| frame_of(&scene, *cull)).collect();
    let mut clumps = Vec::new();
    for frame in &frames {
        // Compiles what is to be compiled, and finds the shadows.
        renderer.picture(frame)?;
        clumps.push(renderer.chosen()?.iter().map(|kind| u64::from(kind.stats.clumps)).sum::<u64>());
    }
    let mut times = [vec![Vec::new(); WAYS.len()], vec![Vec::new(); WAYS.len()]];
    for round in 0..rounds {
        for (index, frame) in frames.iter().enumerate() {
            // A march over the noise takes seconds: one round is enough.
            if round > 0 && WAYS[index].1 == Cull::Noise {
                continue;
            }
            times[0][index].push(renderer.choose(frame)?);
            times[1][index].push(renderer.draw(frame)?);
        }
    }
    let medians_ms = |times: Vec<Vec<_>>| times.iter().map(|times| 1e3 * median_s(times)).collect::<Vec<_>>();
    let [culling_ms, frame_ms] = times.map(medians_ms);
    let cost = |(index, (way, _)): (usize, &(&'static str, Cull))| Cost {
        way,
        clumps: clumps[index],
        choice_ratio: culling_ms[index] / culling_ms[0],
        frame_ratio: frame_ms[index] / frame_ms[0],
        choice_ms: culling_ms[index],
        frame_ms: frame_ms[index],
    };
    Ok(Frames {
        adapter: renderer.adapter(),
        is_software: renderer.is_software(),
        ways: WAYS.iter().enumerate().map(cost).collect(),
    })
}
