//! Marches over the rays of one map and angle against the reference.

use super::bench::PomBench;
use super::maps::{Kind, SIDE};
use super::reference::{self, Contact, Ray};
use crate::sample::{unit, word};
use crate::stats::quantiles;
use anyhow::Result;
use client::features::pom::maps::PomMaps;
use client::features::pom::settings::{PomMethod, PomShadow};
use client::features::pom::{HeightMap, PomSettings};
use rayon::prelude::*;
use serde::Serialize;
use shaders::layout::{PomParams, PomProbe, PomResult};

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
    pub fn new(bench: &PomBench, has_cones: bool) -> Self {
        let maps: Vec<HeightMap> = Kind::ALL.map(Kind::map).into();
        let uploaded = bench.upload(&maps, has_cones);
        Self { maps, uploaded }
    }
}

/// Rays under one angle: positions and headings are random, and the same for every march.
pub fn probes(layer: usize, count: u32, angle_deg: f32, amplitude: f32) -> Vec<PomProbe> {
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
    (0..count).map(probe).collect()
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
        let probes = probes(layer, count, angle_deg, AMPLITUDE);
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
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct Score {
    /// Rays.
    pub rays: usize,
    /// Distance between places: half of all, 95 %, 99.9 % of all are below it, texels.
    pub texels: [f64; 3],
    /// Share that is more than [`WRONG_TEXELS`] off.
    pub wrong: f64,
    /// The same without tangents.
    pub wrong_without_excuse: f64,
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
        let off = |(found, reference): (&PomResult, &Contact)| {
            let apart = [0, 1].map(|axis| f64::from(found.uv[axis]) - reference.uv[axis]);
            apart[0].hypot(apart[1]) * SIDE as f64
        };
        let offs: Vec<f64> = found.iter().zip(references).map(off).collect();
        // Not a number is wrong, too.
        let is_wrong = |off: f64| off.is_nan() || off > WRONG_TEXELS;
        let wrong = offs.iter().filter(|off| is_wrong(**off)).count();
        let excused = (0..found.len())
            .filter(|index| {
                is_wrong(offs[*index]) && is_tangent(map, &rays[*index], &found[*index], &references[*index])
            })
            .count();
        let count = found.len().max(1) as f64;
        let share = |part: usize| part as f64 / count;
        let [residual] = quantiles(found.iter().map(|found| f64::from(found.residual.abs())), [0.999]);
        Self {
            rays: found.len(),
            texels: quantiles(offs, [0.5, 0.95, 0.999]),
            wrong: share(wrong),
            wrong_without_excuse: share(wrong - excused),
            residual,
            fetches: found.iter().map(|found| f64::from(found.fetches)).sum::<f64>() / count,
            odd: found
                .iter()
                .filter(|found| !(found.uv[0] + found.uv[1] + found.height + found.sun).is_finite())
                .count(),
        }
    }
}

/// Whether rounding decided between the found intersection and the reference. Behind the reference:
/// the ray only grazes the surface there. Before it: the ray almost touches the surface.
fn is_tangent(map: &HeightMap, ray: &Ray, found: &PomResult, reference: &Contact) -> bool {
    let is_past = f64::from(found.height) < reference.height;
    TANGENT >= if is_past { reference::depth_after(map, ray, reference) } else { reference.clearance }
}
