//! Light across borders of chunks: how much neighbouring pixels on both sides of a border differ,
//! over what they differ on both sides of the middle lines of chunks, which are no borders of
//! anything and lie at the same distances.

use super::views::{SIZE, Shot, Views, is_one_surface};
use client::gpu::GpuError;
use client::settings::{Normals, Show};
use serde::Serialize;

/// The share of pairs that may differ more than the figure.
const TAIL: f64 = 0.001;

/// The figure with both sources of normals.
#[derive(Clone, Debug, Serialize)]
pub struct Borders {
    /// Normals of the land.
    pub land: Jump,
    /// Normals of the drawn triangles: the control.
    pub mesh: Jump,
}

/// Differences of neighbouring pixels: of the larger light less the smaller one over their sum.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct Jump {
    /// Pairs across borders.
    pub pairs: usize,
    /// One in a thousand pairs across a border differs more.
    pub across: f64,
    /// One in a thousand pairs across a middle line differs more.
    pub inside: f64,
    /// `across / inside`.
    pub ratio: f64,
}

/// Measures all poses.
pub fn measure(views: &mut Views) -> Result<Borders, GpuError> {
    Ok(Borders { land: jump(views, Normals::Land)?, mesh: jump(views, Normals::Mesh)? })
}

fn jump(views: &mut Views, normals: Normals) -> Result<Jump, GpuError> {
    let (mut across, mut inside) = (Vec::new(), Vec::new());
    for case in views.cases.clone() {
        let chunks = views.light(&case, Shot { show: Show::Chunks, normals, ..Shot::IMAGE })?;
        let light = views.light(&case, Shot { show: Show::Light, normals, ..Shot::IMAGE })?;
        for (here, next) in pairs() {
            let [far, near] = [here, next].map(|pixel| -chunks[pixel][3]);
            if !is_one_surface(far, near) {
                continue;
            }
            let [one, other] = [here, next].map(|pixel| f64::from(light[pixel][..3].iter().sum::<f32>()));
            let difference = (one - other).abs() / (one + other).max(1e-9);
            let [here, next] = [here, next].map(|pixel| chunks[pixel]);
            if here[..2] != next[..2] {
                across.push(difference);
            } else if here[2] != next[2] {
                inside.push(difference);
            }
        }
    }
    let pairs = across.len();
    let (across, inside) = (tail(across), tail(inside));
    Ok(Jump { pairs, across, inside, ratio: across / inside })
}

/// Neighbouring pixels, beside and below.
fn pairs() -> impl Iterator<Item = (usize, usize)> {
    let (width, height) = (SIZE.0 as usize, SIZE.1 as usize);
    let at = move |x: usize, y: usize| y * width + x;
    let beside = (0..height).flat_map(move |y| (1..width).map(move |x| (at(x - 1, y), at(x, y))));
    let below = (1..height).flat_map(move |y| (0..width).map(move |x| (at(x, y - 1), at(x, y))));
    beside.chain(below)
}

/// The value that the largest [`TAIL`] of the differences exceed.
fn tail(mut differences: Vec<f64>) -> f64 {
    differences.sort_unstable_by(f64::total_cmp);
    let last = differences.len().saturating_sub(1);
    let index = last - (last as f64 * TAIL) as usize;
    differences.get(index).copied().unwrap_or(f64::NAN)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn one_in_a_thousand_exceeds_the_tail() {
        let differences = (0..=10_000).map(f64::from).collect();
        assert_eq!(tail(differences), 9_990.0);
        assert!(tail(Vec::new()).is_nan());
    }

    #[test]
    fn every_pixel_has_its_neighbours_once() {
        let (width, height) = (SIZE.0 as usize, SIZE.1 as usize);
        assert_eq!(pairs().count(), (width - 1) * height + width * (height - 1));
        assert!(pairs().all(|(here, next)| next == here + 1 || next == here + width));
    }
}
