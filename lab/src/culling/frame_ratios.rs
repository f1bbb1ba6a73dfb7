//! Time of a frame with T4 over that with T1 at many poses, and of T1 over itself: what the machine
//! scatters.

use crate::culling::cases::{Case, Site};
use crate::culling::id_buffer::frame_of;
use crate::culling::scene::Scene;
use crate::headless_renderer::HeadlessRenderer;
use crate::stats::{interleaved, quantiles, ratios};
use anyhow::{Context, Result};
use client::features::vegetation::Cull;
use client::frame::FrameData;
use serde::Serialize;
use terrain::Land;

/// Size of the pictures, pixels: that of the valley scene's frames.
const SIZE: (u32, u32) = (320, 180);

/// Interleaved rounds of a pose; the median of their ratios counts.
const ROUNDS: usize = 3;

/// Slots of the pool.
const SLOTS: u32 = 2000;

/// Distributions over poses.
#[derive(Clone, Debug, Serialize)]
pub struct FrameRatios {
    pub adapter: String,
    pub is_software: bool,
    /// Of all poses.
    pub all: Distribution,
    /// Of those on the ground of a valley.
    pub valleys: Distribution,
    /// T1 over T1: the scatter of the machine.
    pub repeated: Distribution,
}

/// A distribution of ratios.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Distribution {
    pub poses: usize,
    pub p50: f64,
    pub p99: f64,
    pub max: f64,
}

impl Distribution {
    /// Of ratios in any order; no numbers if there are none.
    fn of(ratios: Vec<f64>) -> Self {
        let poses = ratios.len();
        let [p50, p99, max] = quantiles(ratios, [0.5, 0.99, 1.0]);
        Self { poses, p50, p99, max }
    }
}

/// Draws each case with both methods in turns. Shadows are not traced.
///
/// # Errors
/// There is no GPU, or it failed.
pub fn measure(land: &Land, cases: &[Case]) -> Result<FrameRatios> {
    let mut renderer = HeadlessRenderer::open(SIZE, SLOTS).context("frames need a GPU")?;
    let (mut all, mut valleys, mut repeated) = (Vec::new(), Vec::new(), Vec::new());
    for case in cases {
        let Some(scene) = Scene::of(land, case, renderer.slots()) else { continue };
        renderer.upload_world(&scene.world);
        let frames = [Cull::Frustum, Cull::Hierarchical].map(|cull| frame_of(&scene, cull));
        let [t4, again] = ratios_of(&mut renderer, &frames).with_context(|| format!("pose {}", case.name))?;
        all.push(t4);
        repeated.push(again);
        if case.site == Site::Valley {
            valleys.push(t4);
        }
    }
    Ok(FrameRatios {
        adapter: renderer.adapter(),
        is_software: renderer.is_software(),
        all: Distribution::of(all),
        valleys: Distribution::of(valleys),
        repeated: Distribution::of(repeated),
    })
}

/// Time with T4, and with T1 once more, over that with T1.
fn ratios_of(renderer: &mut HeadlessRenderer, [t1, t4]: &[FrameData; 2]) -> Result<[f64; 2]> {
    let ways = [t1, t4, t1];
    // Buffers grow and pipelines compile in the first frames.
    for frame in [t1, t4] {
        renderer.draw(frame)?;
    }
    let ratios = ratios(&interleaved(ROUNDS, ways.len(), |index| renderer.draw(ways[index]))?);
    Ok([ratios[1], ratios[2]])
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_distribution_has_nearest_ranks_and_of_nothing_it_has_no_numbers() {
        let found = Distribution::of((1..=300).rev().map(f64::from).collect());
        assert_eq!(found, Distribution { poses: 300, p50: 150.0, p99: 297.0, max: 300.0 });
        assert!(Distribution::of(Vec::new()).p99.is_nan());
    }
}
