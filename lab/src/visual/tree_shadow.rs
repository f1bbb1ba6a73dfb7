//! Shadows of trees: the share of wrong places near by and far away, and of wrong blocks where the
//! trees are not known one by one.

use crate::tree_shadow::{Wood, turned, wrong};
use client::features::vegetation::PlantShadows;
use client::gpu::{Gpu, GpuError};
use serde::Serialize;

/// Elevations of the sun, degrees.
const SUNS_DEG: [f32; 3] = [20.0, 35.0, 60.0];

/// The figures: the worst of all suns.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct TreeShadow {
    /// Share of wrong places.
    pub near: f64,
    /// Share of wrong places 600 m to 1,100 m away, in a picture of 1,080 lines.
    pub distant: f64,
    /// The same with the sun turned by 5 degrees, the least of all suns: the control.
    pub distant_control: f64,
    /// Share of wrong blocks of 30 m by the share of woods, as where crowns are narrower than 3
    /// pixels.
    pub far: f64,
    /// Largest difference of a block's mean.
    pub far_most: f64,
    /// Largest difference of the mean of all blocks.
    pub far_mean: f64,
    /// Share of wrong places with the sun turned by 5 degrees, the least of all suns: the control.
    pub control: f64,
    /// Share of wrong blocks without shadows: the control.
    pub far_control: f64,
}

/// Measures all suns.
pub fn measure() -> Result<TreeShadow, GpuError> {
    let mut worst = TreeShadow {
        near: 0.0,
        distant: 0.0,
        distant_control: 1.0,
        far: 0.0,
        far_most: 0.0,
        far_mean: 0.0,
        control: 1.0,
        far_control: 1.0,
    };
    for sun_deg in SUNS_DEG {
        let wood = Wood::open(Gpu::open_blocking()?, sun_deg, PlantShadows::On);
        let (found, trees) = (wood.found()?, wood.casters()?);
        let expected = wood.truth(&trees, wood.sun);
        let near: Vec<f32> = found.iter().map(|shade| shade.near).collect();
        let far: Vec<f32> = found.iter().map(|shade| shade.far).collect();
        let [far, blocks] = [&far, &expected].map(|values| wood.block_means(values));
        let most = far.iter().zip(&blocks).map(|(a, b)| f64::from((a - b).abs())).fold(0.0, f64::max);
        let [distant, distant_control] = distant(sun_deg)?;
        worst = TreeShadow {
            distant: worst.distant.max(distant),
            distant_control: worst.distant_control.min(distant_control),
            near: worst.near.max(wrong(&near, &expected)),
            far: worst.far.max(wrong(&far, &blocks)),
            far_most: worst.far_most.max(most),
            far_mean: worst.far_mean.max((mean(&far) - mean(&blocks)).abs()),
            control: worst.control.min(wrong(&near, &wood.truth(&trees, turned(wood.sun)))),
            far_control: worst.far_control.min(wrong(&vec![1.0; blocks.len()], &blocks)),
        };
    }
    Ok(worst)
}

/// Share of wrong places far away, and with the sun turned.
fn distant(sun_deg: f32) -> Result<[f64; 2], GpuError> {
    let wood = Wood::open_far(Gpu::open_blocking()?, sun_deg)?;
    let (found, trees) = (wood.found()?, wood.casters()?);
    let found: Vec<f32> = found.iter().map(|shade| shade.near).collect();
    Ok([wood.sun, turned(wood.sun)].map(|sun| wrong(&found, &wood.truth(&trees, sun))))
}

/// Mean of values.
fn mean(values: &[f32]) -> f64 {
    crate::stats::mean(values.iter().map(|value| f64::from(*value)))
}
