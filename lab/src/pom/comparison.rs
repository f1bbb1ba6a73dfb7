//! Marches over the rays of one map and angle against the reference.

use super::bench::PomBench;
use super::maps::{Kind, SIDE};
use super::reference::{self, Contact, Ray};
use crate::sample::{unit, word};
use crate::stats::{quantiles, share_interval};
use anyhow::Result;
use client::features::pom::maps::PomMaps;
use client::features::pom::settings::{PomMethod, PomShadow};
use client::features::pom::{HeightMap, PomSettings};
use rayon::prelude::*;
use serde::Serialize;
use shaders::layout::{PomParams, PomProbe, PomResult};
use std::ops::Range;

/// Height of the reliefs, tiles.
pub const AMPLITUDE: f32 = 0.05;

/// A position farther from the reference, texels, belongs to another feature.
pub const WRONG_TEXELS: f64 = 4.0;

/// A ray that clears the height field by no more than this, of its height, is a tangent: rounding
/// decides the intersection.
pub const TANGENT: f64 = 1e-3;

/// Angles from the plane's normal, degrees.
pub const ANGLES_DEG: [f32; 6] = [0.0, 30.0, 60.0, 75.0, 85.0, 89.0];

/// Parameters of a tier: defaults but without shadows.
pub fn relief(method: PomMethod) -> PomParams {
    PomSettings { method, shadow: PomShadow::Off, ..PomSettings::default() }.layout()
}

/// The maps of [`Kind::ALL`] on the CPU and on a GPU.
pub struct Stage {
    /// On the CPU, in that order.
    pub maps: Vec<HeightMap>,
    /// On the GPU, a layer each.
    pub uploaded: PomMaps,
}

impl Stage {
    /// Uploads them, with or without cones.
    ///
    /// # Errors
    /// The GPU fails.
    pub fn new(bench: &PomBench, has_cones: bool) -> Result<Self> {
        let maps: Vec<HeightMap> = Kind::ALL.map(Kind::map).into();
        let uploaded = bench.upload(&maps, has_cones)?;
        Ok(Self { maps, uploaded })
    }
}

/// Rays of a batch: their probes stay far below the 128 MiB that WebGPU grants a binding.
pub const BATCH: u32 = 200_000;

/// Rays under one angle: positions and headings are random, and the same for every march.
pub fn probes(layer: usize, count: u32, angle_deg: f32, amplitude: f32) -> Vec<PomProbe> {
    probes_from(layer, 0..count, angle_deg, amplitude)
}

/// Some of the rays under one angle, by their numbers.
fn probes_from(layer: usize, rays: Range<u32>, angle_deg: f32, amplitude: f32) -> Vec<PomProbe> {
    let tilt = angle_deg.to_radians();
    let probe = |index: u32| {
        let share = |part: u32| unit(word(0x9e1f, 4 * index + part)) as f32;
        let heading = share(2) * std::f32::consts::TAU;
        let sun = share(3) * std::f32::consts::TAU;
        PomProbe {
            uv: [share(0), share(1)],
            amplitude,
            lod: 0,
            to_eye: [tilt.sin() * heading.cos(), tilt.sin() * heading.sin(), tilt.cos()],
            layer: layer as u32,
            to_sun: [0.8 * sun.cos(), 0.8 * sun.sin(), 0.6],
            reserved: 0,
        }
    };
    rays.map(probe).collect()
}

/// The rays of a map under an angle, with their reference intersections.
pub struct Condition {
    /// The map's place among [`Kind::ALL`].
    pub layer: usize,
    /// Angle from the plane's normal, degrees.
    pub angle_deg: f32,
    /// For the GPU.
    pub probes: Vec<PomProbe>,
    rays: Vec<Ray>,
    references: Vec<Contact>,
}

impl Condition {
    /// So many rays of it, with the relief's middle on the plane.
    pub fn new(stage: &Stage, layer: usize, angle_deg: f32, count: u32) -> Self {
        Self::of_rays(stage, layer, angle_deg, 0..count)
    }

    /// Some of its rays, by their numbers.
    fn of_rays(stage: &Stage, layer: usize, angle_deg: f32, numbers: Range<u32>) -> Self {
        let probes = probes_from(layer, numbers, angle_deg, AMPLITUDE);
        let rays = rays(&probes, PomSettings::default().pivot);
        let references = references(&stage.maps[layer], &rays);
        Self { layer, angle_deg, probes, rays, references }
    }

    /// Score of a march.
    pub fn score(&self, bench: &PomBench, stage: &Stage, how: &PomParams) -> Result<Score> {
        let (found, _) = bench.run(&stage.uploaded, how, &self.probes, 1)?;
        Ok(Score::of(&stage.maps[self.layer], &self.rays, &found, &self.references))
    }
}

/// Score of a march over so many rays of a map and angle, in batches of [`BATCH`].
pub fn score_in_batches(
    bench: &PomBench,
    stage: &Stage,
    (layer, angle_deg): (usize, f32),
    count: u32,
    how: &PomParams,
) -> Result<Score> {
    let mut errors = Errors::default();
    for first in (0..count).step_by(BATCH as usize) {
        let numbers = first..count.min(first + BATCH);
        let batch = Condition::of_rays(stage, layer, angle_deg, numbers);
        let (found, _) = bench.run(&stage.uploaded, how, &batch.probes, 1)?;
        errors.add(&stage.maps[layer], &batch.rays, &found, &batch.references);
    }
    Ok(errors.score())
}

/// The reference of rays over a map.
pub fn references(map: &HeightMap, rays: &[Ray]) -> Vec<Contact> {
    rays.par_iter().map(|ray| reference::contact(map, ray)).collect()
}

/// Rays as neighbouring pixels send them: a square of `side` by `side` places a texel apart, all
/// under one angle and heading.
pub fn bundle(layer: usize, side: u32, angle_deg: f32, amplitude: f32) -> Vec<PomProbe> {
    let mut probes = probes(layer, 1, angle_deg, amplitude);
    let first = probes.remove(0);
    let texel = |index: u32| index as f32 / SIDE as f32;
    let probe = |index: u32| PomProbe {
        uv: [first.uv[0] + texel(index % side), first.uv[1] + texel(index / side)],
        ..first
    };
    (0..side * side).map(probe).collect()
}

/// The rays of probes.
pub fn rays(probes: &[PomProbe], pivot: f32) -> Vec<Ray> {
    probes.iter().map(|probe| Ray::new(probe.uv, probe.to_eye, probe.amplitude, pivot)).collect()
}

/// Errors of a march against the reference.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct Score {
    /// Rays.
    pub rays: usize,
    /// Distance between places: half of all, 95 %, 99.9 % of all are below it, texels.
    pub texels: [f64; 3],
    /// Rays that are more than [`WRONG_TEXELS`] off.
    pub wrong_rays: usize,
    /// Their share.
    pub wrong: f64,
    /// Within which the true share lies with 95 % certainty, see [`share_interval`].
    pub wrong_interval: [f64; 2],
    /// Wrong rays of each batch: batches are independent.
    pub wrong_of_batches: Vec<usize>,
    /// The share without tangents.
    pub wrong_without_excuse: f64,
    /// The upper end of its interval.
    pub without_excuse_below: f64,
    /// 99.9 % of all places lie on the surface but for this, of the relief's height.
    pub residual: f64,
    /// Heights and bounds looked up, mean.
    pub fetches: f64,
    /// Results that are not finite.
    pub odd: usize,
}

impl Score {
    /// Compares.
    pub fn of(map: &HeightMap, rays: &[Ray], found: &[PomResult], references: &[Contact]) -> Self {
        let mut errors = Errors::default();
        errors.add(map, rays, found, references);
        errors.score()
    }
}

/// Errors of rays, batch by batch.
#[derive(Clone, Debug, Default)]
struct Errors {
    /// Distances between places, texels.
    texels: Vec<f64>,
    residuals: Vec<f64>,
    wrong_of_batches: Vec<usize>,
    tangents: usize,
    fetches: f64,
    odd: usize,
}

impl Errors {
    fn add(&mut self, map: &HeightMap, rays: &[Ray], found: &[PomResult], references: &[Contact]) {
        let off = |(found, reference): (&PomResult, &Contact)| {
            let apart = [0, 1].map(|axis| f64::from(found.uv[axis]) - reference.uv[axis]);
            apart[0].hypot(apart[1]) * SIDE as f64
        };
        let offs: Vec<f64> = found.iter().zip(references).map(off).collect();
        // Not a number is wrong, too.
        let is_wrong = |index: &usize| offs[*index].is_nan() || offs[*index] > WRONG_TEXELS;
        let wrong: Vec<usize> = (0..offs.len()).filter(is_wrong).collect();
        let tangents = wrong
            .par_iter()
            .filter(|index| is_tangent(map, &rays[**index], &found[**index], &references[**index]))
            .count();
        self.tangents += tangents;
        self.wrong_of_batches.push(wrong.len());
        self.texels.extend(offs);
        self.residuals.extend(found.iter().map(|found| f64::from(found.residual.abs())));
        self.fetches += found.iter().map(|found| f64::from(found.fetches)).sum::<f64>();
        let is_odd = |found: &&PomResult| !(found.uv[0] + found.uv[1] + found.height + found.sun).is_finite();
        self.odd += found.iter().filter(is_odd).count();
    }

    fn score(self) -> Score {
        let rays = self.texels.len();
        let share = |part: usize| part as f64 / rays.max(1) as f64;
        let wrong: usize = self.wrong_of_batches.iter().sum();
        let without_excuse = wrong - self.tangents;
        let [residual] = quantiles(self.residuals, [0.999]);
        Score {
            rays,
            texels: quantiles(self.texels, [0.5, 0.95, 0.999]),
            wrong_rays: wrong,
            wrong: share(wrong),
            wrong_interval: share_interval(wrong as u64, rays as u64),
            wrong_of_batches: self.wrong_of_batches,
            wrong_without_excuse: share(without_excuse),
            without_excuse_below: share_interval(without_excuse as u64, rays as u64)[1],
            residual,
            fetches: self.fetches / rays.max(1) as f64,
            odd: self.odd,
        }
    }
}

/// Whether rounding decided between the found intersection and the reference. Behind the reference:
/// the ray only grazes the surface there. Before it: the ray almost touches the surface.
fn is_tangent(map: &HeightMap, ray: &Ray, found: &PomResult, reference: &Contact) -> bool {
    let is_past = f64::from(found.height) < reference.height;
    TANGENT >= if is_past { reference::depth_after(map, ray, reference) } else { reference.clearance }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::pom::maps::Kind;
    use bytemuck::Zeroable as _;

    #[test]
    fn rays_have_numbers_and_batches_of_them_are_the_whole() {
        let all = probes(1, 100, 60.0, AMPLITUDE);
        let parts = [0..30, 30..100].map(|numbers| probes_from(1, numbers, 60.0, AMPLITUDE)).concat();
        assert_eq!(bytemuck::cast_slice::<_, u8>(&all), bytemuck::cast_slice::<_, u8>(&parts));
        assert_ne!(all[0].uv, all[30].uv, "the control: batches are other rays");
    }

    #[test]
    fn errors_of_batches_are_those_of_all_their_rays() {
        let map = Kind::Fbm.map();
        let probes = probes(0, 100, 60.0, AMPLITUDE);
        let rays = rays(&probes, 0.5);
        let references = references(&map, &rays);
        let mut found: Vec<PomResult> = references
            .iter()
            .map(|contact| PomResult {
                uv: contact.uv.map(|at| at as f32),
                height: contact.height as f32,
                fetches: 3,
                ..PomResult::zeroed()
            })
            .collect();
        // Far off, before and behind the contact, and no tangent: the ray is above the surface by
        // more, and goes into it deeper.
        for found in &mut found[..7] {
            found.uv[0] += 8.0 / SIDE as f32;
        }
        let mut errors = Errors::default();
        for part in [0..30, 30..100] {
            errors.add(&map, &rays[part.clone()], &found[part.clone()], &references[part]);
        }
        let score = errors.score();
        assert_eq!((score.rays, score.wrong_rays, &score.wrong_of_batches[..]), (100, 7, &[7, 0][..]));
        assert!((score.texels[1] - 8.0).abs() < 0.01 && score.fetches == 3.0 && score.odd == 0);
        assert!(score.wrong_interval[0] < 0.07 && score.wrong_interval[1] > 0.07);
        let whole = Score::of(&map, &rays, &found, &references);
        assert_eq!(Score { wrong_of_batches: vec![7, 0], ..whole }, score);
    }
}
