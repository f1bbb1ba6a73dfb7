//! Trials: rays of one map and angle, marched in some way, against the truth.

use super::bench::ReliefBench;
use super::maps::{Kind, SIDE};
use super::truth::{self, Contact, Ray};
use crate::accuracy::errors::quantile;
use crate::sample::{unit, word};
use anyhow::Result;
use client::relief::knobs::{ReliefShadow, ReliefTier};
use client::relief::{HeightMap, ReliefKnobs};
use client::render::relief::ReliefMaps;
use rayon::prelude::*;
use serde::Serialize;
use shaders::layout::{Relief, ReliefFinding, ReliefProbe};

/// Height of the reliefs, tiles.
pub const AMPLITUDE: f32 = 0.05;

/// A place that is farther from the truth, texels, belongs to another feature.
pub const WRONG_TEXELS: f64 = 4.0;

/// A ray that clears the relief by no more than this, of its height, is a tangent: a rounding
/// decides what it hits.
pub const TANGENT: f64 = 1e-3;

/// Angles from the plane's normal, degrees.
pub const ANGLES_DEG: [f32; 6] = [0.0, 30.0, 60.0, 75.0, 85.0, 89.0];

/// How reliefs are marched by a tier, everything else at its default but for shadows, which a trial
/// asks for if it wants them.
#[must_use]
pub fn relief(tier: ReliefTier) -> Relief {
    ReliefKnobs { tier, shadow: ReliefShadow::Off, ..ReliefKnobs::default() }.layout()
}

/// The maps of [`Kind::ALL`] on the CPU and on a GPU.
pub struct Stage {
    /// On the CPU, in that order.
    pub maps: Vec<HeightMap>,
    /// On the GPU, a layer each.
    pub uploaded: ReliefMaps,
}

impl Stage {
    /// Makes them, with or without cones.
    #[must_use]
    pub fn new(bench: &ReliefBench, has_cones: bool) -> Self {
        let maps: Vec<HeightMap> = Kind::ALL.map(Kind::map).into();
        let uploaded = bench.upload(&maps, has_cones);
        Self { maps, uploaded }
    }
}

/// Rays under one angle: places and headings are random, and the same for every way of marching.
#[must_use]
pub fn probes(layer: usize, count: u32, angle_deg: f32, amplitude: f32) -> Vec<ReliefProbe> {
    let tilt = angle_deg.to_radians();
    let probe = |index: u32| {
        let share = |part: u32| unit(word(0x9e1f, 4 * index + part)) as f32;
        let heading = share(2) * std::f32::consts::TAU;
        let sun = share(3) * std::f32::consts::TAU;
        ReliefProbe {
            uv: [share(0), share(1)],
            amplitude,
            lod: 0,
            to_eye: [tilt.sin() * heading.cos(), tilt.sin() * heading.sin(), tilt.cos()],
            layer: layer as u32,
            to_sun: [0.8 * sun.cos(), 0.8 * sun.sin(), 0.6],
            reserved: 0,
        }
    };
    (0..count).map(probe).collect()
}

/// One condition of a trial: the rays of a map under an angle, and what they meet.
pub struct Condition {
    /// The map's place among [`Kind::ALL`].
    pub layer: usize,
    /// Angle from the plane's normal, degrees.
    pub angle_deg: f32,
    /// For the GPU.
    pub probes: Vec<ReliefProbe>,
    rays: Vec<Ray>,
    truths: Vec<Contact>,
}

impl Condition {
    /// So many rays of it, with the relief's middle on the plane.
    #[must_use]
    pub fn new(stage: &Stage, layer: usize, angle_deg: f32, count: u32) -> Self {
        let probes = probes(layer, count, angle_deg, AMPLITUDE);
        let rays = rays(&probes, ReliefKnobs::default().pivot);
        let truths = truths(&stage.maps[layer], &rays);
        Self { layer, angle_deg, probes, rays, truths }
    }

    /// How a way of marching does.
    ///
    /// # Errors
    /// The device fails.
    pub fn score(&self, bench: &ReliefBench, stage: &Stage, how: &Relief) -> Result<Score> {
        let (found, _) = bench.run(&stage.uploaded, how, &self.probes, 1)?;
        Ok(Score::of(&stage.maps[self.layer], &self.rays, &found, &self.truths))
    }
}

/// The truth of rays over a map.
#[must_use]
pub fn truths(map: &HeightMap, rays: &[Ray]) -> Vec<Contact> {
    rays.par_iter().map(|ray| truth::contact(map, ray)).collect()
}

/// Rays as neighbouring pixels send them: a square of `side` by `side` places a texel apart, all
/// under one angle and heading.
#[must_use]
pub fn bundle(layer: usize, side: u32, angle_deg: f32, amplitude: f32) -> Vec<ReliefProbe> {
    let mut probes = probes(layer, 1, angle_deg, amplitude);
    let first = probes.remove(0);
    let texel = |index: u32| index as f32 / SIDE as f32;
    let probe = |index: u32| ReliefProbe {
        uv: [first.uv[0] + texel(index % side), first.uv[1] + texel(index / side)],
        ..first
    };
    (0..side * side).map(probe).collect()
}

/// The rays of probes.
#[must_use]
pub fn rays(probes: &[ReliefProbe], pivot: f32) -> Vec<Ray> {
    probes.iter().map(|probe| Ray::new(probe.uv, probe.to_eye, probe.amplitude, pivot)).collect()
}

/// How far findings are from the truth.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct Score {
    /// Rays.
    pub rays: usize,
    /// Distance between places: half of all, 95 %, 99.9 % of all are below it, texels.
    pub texels: [f64; 3],
    /// Share that is more than [`WRONG_TEXELS`] off.
    pub wrong: f64,
    /// Share that is, and is no tangent.
    pub wrong_without_excuse: f64,
    /// 99.9 % of all places lie on the surface but for this, of the relief's height.
    pub residual: f64,
    /// Heights and bounds looked up, mean.
    pub fetches: f64,
    /// Findings with a number that is none.
    pub odd: usize,
}

impl Score {
    /// Compares.
    #[must_use]
    pub fn of(map: &HeightMap, rays: &[Ray], found: &[ReliefFinding], truths: &[Contact]) -> Self {
        let off = |(found, truth): (&ReliefFinding, &Contact)| {
            let apart = [0, 1].map(|axis| f64::from(found.uv[axis]) - truth.uv[axis]);
            apart[0].hypot(apart[1]) * SIDE as f64
        };
        let offs: Vec<f64> = found.iter().zip(truths).map(off).collect();
        // Not a number is wrong, too.
        let is_wrong = |off: f64| off.is_nan() || off > WRONG_TEXELS;
        let wrong = offs.iter().filter(|off| is_wrong(**off)).count();
        let excused = (0..found.len())
            .filter(|index| {
                is_wrong(offs[*index]) && is_tangent(map, &rays[*index], &found[*index], &truths[*index])
            })
            .count();
        let count = found.len().max(1) as f64;
        let share = |part: usize| part as f64 / count;
        let mut sorted = offs;
        sorted.sort_unstable_by(f64::total_cmp);
        let mut residuals: Vec<f64> = found.iter().map(|found| f64::from(found.residual.abs())).collect();
        residuals.sort_unstable_by(f64::total_cmp);
        Self {
            rays: found.len(),
            texels: [0.5, 0.95, 0.999].map(|q| quantile(&sorted, q)),
            wrong: share(wrong),
            wrong_without_excuse: share(wrong - excused),
            residual: quantile(&residuals, 0.999),
            fetches: found.iter().map(|found| f64::from(found.fetches)).sum::<f64>() / count,
            odd: found
                .iter()
                .filter(|found| !(found.uv[0] + found.uv[1] + found.height + found.sun).is_finite())
                .count(),
        }
    }
}

/// Whether a rounding decided between the place that was found and the true one. Past the true
/// contact: the ray only grazes the relief there and comes out again. Before it: the ray all but
/// touches the relief on its way.
fn is_tangent(map: &HeightMap, ray: &Ray, found: &ReliefFinding, truth: &Contact) -> bool {
    let is_past = f64::from(found.height) < truth.height;
    TANGENT >= if is_past { truth::depth_after(map, ray, truth) } else { truth.clearance }
}
