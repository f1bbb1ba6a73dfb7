//! The automatic tier where it is not the traversal: rays that travel 0.6 to 3.9 texels, against
//! the reference in f64. Once they are steep over the finest level, once at 60 degrees over a
//! coarse one, as seen from afar.
//!
//! Every error is bounded by the travel, so it is stated in texels of the sampled level and not as
//! a share beyond some texels.

use crate::pom::bench::PomBench;
use crate::pom::comparison::{AMPLITUDE, Stage, probes, rays, references, relief};
use crate::pom::maps::{Kind, SIDE};
use crate::stats::{mean, quantiles};
use anyhow::Result;
use client::features::pom::PomSettings;
use client::features::pom::settings::PomMethod;
use serde::Serialize;
use shaders::layout::{PomParams, PomProbe, PomResult};

/// Travels, texels: within the range of one offset, then of a linear search, near its ends.
pub const TRAVELS: [f32; 6] = [0.6, 1.2, 1.9, 2.1, 3.0, 3.9];

/// Mip level of the coarse rays, and their angle from the plane's normal.
const COARSE_LOD: u32 = 3;
const COARSE_DEG: f32 = 60.0;

/// One map at one travel.
#[derive(Clone, Debug, Serialize)]
pub struct Travel {
    pub map: &'static str,
    pub lod: u32,
    /// How far the rays travel, texels of that level.
    pub texels: f32,
    /// The tier that the thresholds give: `offset` or `linear`.
    pub tier: &'static str,
    pub auto: TexelErrors,
    pub traversal: TexelErrors,
    /// A flat texture: the control.
    pub flat: TexelErrors,
    /// Share of the rays that the automatic tier and the traversal place differently.
    pub differing: f64,
}

/// Distances from the reference, texels of the sampled level.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct TexelErrors {
    pub mean: f64,
    pub p999: f64,
}

/// Marches over so many rays of each map, level and travel.
///
/// # Errors
/// The GPU failed.
pub fn measure(bench: &PomBench, stage: &Stage, count: u32) -> Result<Vec<Travel>> {
    let mut travels = Vec::new();
    for (layer, kind) in Kind::ALL.into_iter().enumerate() {
        for lod in [0, COARSE_LOD] {
            for texels in TRAVELS {
                travels.push(at_travel(bench, stage, (layer, kind.name()), (lod, texels), count)?);
            }
        }
    }
    Ok(travels)
}

/// Rays of a map that travel so many texels of a level.
fn probes_at(layer: usize, lod: u32, texels: f32, count: u32) -> Vec<PomProbe> {
    let side = (SIDE >> lod) as f32;
    if lod == 0 {
        return probes(layer, count, (texels / (AMPLITUDE * side)).atan().to_degrees(), AMPLITUDE);
    }
    let amplitude = texels / (side * COARSE_DEG.to_radians().tan());
    let probes = probes(layer, count, COARSE_DEG, amplitude);
    probes.into_iter().map(|probe| PomProbe { lod, ..probe }).collect()
}

fn at_travel(
    bench: &PomBench,
    stage: &Stage,
    (layer, map): (usize, &'static str),
    (lod, texels): (u32, f32),
    count: u32,
) -> Result<Travel> {
    let probes = probes_at(layer, lod, texels, count);
    let heights = (0..lod).fold(stage.maps[layer].clone(), |heights, _| heights.next_mip());
    let references = references(&heights, &rays(&probes, PomSettings::default().pivot));
    let run = |how: PomParams| Ok::<_, anyhow::Error>(bench.run(&stage.uploaded, &how, &probes, 1)?.0);
    let [auto, traversal, flat] = [PomMethod::Auto, PomMethod::MaxMip, PomMethod::Flat].map(relief).map(run);
    let (auto, traversal, flat) = (auto?, traversal?, flat?);
    let errors = |found: &[PomResult]| {
        let off = |(found, reference): (&PomResult, &crate::pom::reference::Contact)| {
            let apart = [0, 1].map(|axis| f64::from(found.uv[axis]) - reference.uv[axis]);
            apart[0].hypot(apart[1]) * heights.side() as f64
        };
        let offs: Vec<f64> = found.iter().zip(&references).map(off).collect();
        let [p999] = quantiles(offs.iter().copied(), [0.999]);
        TexelErrors { mean: mean(offs), p999 }
    };
    let differing = auto.iter().zip(&traversal).filter(|(one, other)| one.uv != other.uv).count();
    Ok(Travel {
        map,
        lod,
        texels,
        tier: tier_at(texels),
        auto: errors(&auto),
        traversal: errors(&traversal),
        flat: errors(&flat),
        differing: differing as f64 / probes.len().max(1) as f64,
    })
}

/// The automatic tier at a travel.
fn tier_at(texels: f32) -> &'static str {
    let [flat, offset, linear] = PomSettings::TRAVELS;
    match texels {
        texels if texels < flat => "flat",
        texels if texels < offset => "offset",
        texels if texels < linear => "linear",
        _ => "traversal",
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn no_travel_of_the_rows_is_the_traversal_and_both_other_tiers_are_there() {
        let tiers = TRAVELS.map(tier_at);
        assert_eq!(tiers, ["offset", "offset", "offset", "linear", "linear", "linear"]);
        assert_eq!((tier_at(0.4), tier_at(4.1)), ("flat", "traversal"));
    }

    #[test]
    fn the_automatic_tier_is_nearer_than_a_flat_texture_and_is_not_the_traversal() {
        let bench = match PomBench::open() {
            Ok(bench) => bench,
            Err(error) => {
                assert!(std::env::var_os("TOMBOLO_REQUIRE_GPU").is_none(), "a GPU is required: {error}");
                eprintln!("SKIPPED: {error}");
                return;
            }
        };
        let found = measure(&bench, &Stage::new(&bench, false).unwrap(), 2000).unwrap();
        assert_eq!(found.len(), 48);
        for travel in &found {
            assert!(travel.auto.mean < travel.flat.mean, "{travel:?}");
            assert!(travel.traversal.p999 < 0.01, "{travel:?}");
            assert!(travel.differing > 0.01, "the control: the tier is the traversal: {travel:?}");
            assert!(travel.flat.p999 > 0.1, "the control: {travel:?}");
        }
    }

    #[test]
    fn rays_travel_as_far_as_is_asked_for_at_both_levels() {
        for (lod, texels) in [(0, 0.6), (0, 3.9), (COARSE_LOD, 0.6), (COARSE_LOD, 3.9)] {
            for probe in probes_at(0, lod, texels, 5) {
                let [x, y, z] = probe.to_eye;
                let travel = x.hypot(y) / z * probe.amplitude * (SIDE >> lod) as f32;
                assert!((travel - texels).abs() < 1e-3, "{travel} {texels} at level {lod}");
            }
        }
    }
}
