//! Light across borders of chunks: how much neighbouring pixels on both sides of a border differ,
//! over what they differ on both sides of the middle lines of chunks, which are no borders of
//! anything and lie at the same distances.

use super::views::{DrawOptions, SIZE, Views, is_one_surface};
use client::gpu::GpuError;
use client::settings::{Normals, Show};
use serde::Serialize;

/// The share of pairs that may differ more than the figure.
const TAIL: f64 = 0.001;

/// Contrast at borders by source of normals.
#[derive(Clone, Debug, Serialize)]
pub struct Borders {
    /// Normals of the land.
    pub land: BorderContrast,
    /// Normals of the drawn triangles.
    pub mesh: BorderContrast,
    /// Normals of the land, and one side of each border with more light: the control.
    pub planted: BorderContrast,
}

/// Differences of neighbouring pixels: of the larger light less the smaller one over their sum.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct BorderContrast {
    /// Pairs across borders.
    pub pairs: usize,
    /// One in a thousand pairs across a border differs more.
    pub across: f64,
    /// One in a thousand pairs across a middle line differs more.
    pub inside: f64,
    /// `across / inside`.
    pub ratio: f64,
    /// The same of the medians.
    pub median_ratio: f64,
    /// What the median across borders has more than that inside, as a share of the light. The tail
    /// is made of edges of shadows, so that it shows large jumps alone; this shows a small one that
    /// most pairs have.
    pub median_excess: f64,
}

/// By how much more light one side of a border has in the controls of the tail and of the median.
const PLANTED: [f64; 2] = [2.0, 0.02];

/// Measures all poses.
pub fn measure(views: &mut Views) -> Result<Borders, GpuError> {
    let [land, tail, median] = contrasts(views, Normals::Land, [0.0, PLANTED[0], PLANTED[1]])?;
    let [mesh] = contrasts(views, Normals::Mesh, [0.0])?;
    let planted =
        BorderContrast { median_ratio: median.median_ratio, median_excess: median.median_excess, ..tail };
    Ok(Borders { land, mesh, planted })
}

/// The jumps with each change of the light on one side of borders.
fn contrasts<const N: usize>(
    views: &mut Views,
    normals: Normals,
    planted: [f64; N],
) -> Result<[BorderContrast; N], GpuError> {
    let mut across = [const { Vec::new() }; N];
    let mut inside = Vec::new();
    for case in views.cases.clone() {
        let chunks = views.light(&case, DrawOptions { show: Show::Chunks, normals, ..DrawOptions::IMAGE })?;
        let light = views.light(&case, DrawOptions { show: Show::Light, normals, ..DrawOptions::IMAGE })?;
        for (here, next) in pairs() {
            let [far, near] = [here, next].map(|pixel| -chunks[pixel][3]);
            if !is_one_surface(far, near) {
                continue;
            }
            let lights = [here, next].map(|pixel| f64::from(light[pixel][..3].iter().sum::<f32>()));
            let [here, next] = [here, next].map(|pixel| chunks[pixel]);
            if here[..2] != next[..2] {
                for (across, planted) in across.iter_mut().zip(planted) {
                    across.push(difference(lights[0] * (1.0 + planted), lights[1]));
                }
            } else if here[2] != next[2] {
                inside.push(difference(lights[0], lights[1]));
            }
        }
    }
    inside.sort_unstable_by(f64::total_cmp);
    Ok(across.map(|mut across| {
        across.sort_unstable_by(f64::total_cmp);
        let [tails, medians] = [TAIL, 0.5].map(|share| [&across, &inside].map(|all| tail(all, share)));
        BorderContrast {
            pairs: across.len(),
            across: tails[0],
            inside: tails[1],
            ratio: tails[0] / tails[1],
            median_ratio: medians[0] / medians[1],
            // A difference is over the sum of two lights.
            median_excess: 2.0 * (medians[0] - medians[1]),
        }
    }))
}

/// The larger light less the smaller one over their sum.
fn difference(one: f64, other: f64) -> f64 {
    (one - other).abs() / (one + other).max(1e-9)
}

/// Neighbouring pixels, beside and below.
fn pairs() -> impl Iterator<Item = (usize, usize)> {
    let (width, height) = (SIZE.0 as usize, SIZE.1 as usize);
    let at = move |x: usize, y: usize| y * width + x;
    let beside = (0..height).flat_map(move |y| (1..width).map(move |x| (at(x - 1, y), at(x, y))));
    let below = (1..height).flat_map(move |y| (0..width).map(move |x| (at(x, y - 1), at(x, y))));
    beside.chain(below)
}

/// The value that the largest `share` of sorted differences exceed.
fn tail(differences: &[f64], share: f64) -> f64 {
    let last = differences.len().saturating_sub(1);
    let index = last - (last as f64 * share) as usize;
    differences.get(index).copied().unwrap_or(f64::NAN)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn one_in_a_thousand_exceeds_the_tail() {
        let differences: Vec<_> = (0..=10_000).map(f64::from).collect();
        assert_eq!(tail(&differences, TAIL), 9_990.0);
        assert_eq!(tail(&differences, 0.5), 5_000.0);
        assert!(tail(&[], TAIL).is_nan());
    }

    #[test]
    fn every_pixel_has_its_neighbours_once() {
        let (width, height) = (SIZE.0 as usize, SIZE.1 as usize);
        assert_eq!(pairs().count(), (width - 1) * height + width * (height - 1));
        assert!(pairs().all(|(here, next)| next == here + 1 || next == here + width));
    }
}
