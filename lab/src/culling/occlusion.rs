//! Every occlusion test against the visibility in f64 of [`super::reference`], over samples of
//! clumps and chunks.

use crate::culling::cases::{Absent, Case};
use crate::culling::chunks::chunks_of;
use crate::culling::clump_vertices::clump_vertices;
use crate::culling::clumps::{LEAST_M, exact_test, level_of, sample};
use crate::culling::reference::{Point, VisibilityReference, eye_of};
use crate::culling::scene::Scene;
use crate::gpu_probes::cpu_cull::noise_of;
use client::features::vegetation::SpeciesParams;
use client::features::vegetation::by_slot::BySlot;
use rayon::prelude::*;
use serde::Serialize;
use shaders::layout::{Culling, KIND_GRASS};
use shaders::twin::placement::{BLOCK_CELL_BITS, Clump};
use shaders::twin::raymarch_occlusion::{raymarch_occlusion, raymarch_occlusion_by_vertices};
use shaders::twin::surface::{Slots, Surface};
use shaders::twin::terrain_occlusion::is_occluded;
use shaders::twin::visibility::{
    BlockExtent, Extent, block_extent, block_is_seen, extent_of, slope_at, tip_occludee,
};
use std::cell::Cell;
use std::collections::BTreeMap;
use std::f64::consts::TAU;
use std::time::{Duration, Instant};
use terrain::Land;

/// One in so many of the chunks in view is sampled.
const EVERY_CHUNK: usize = 3;

/// Points of a ring.
const POINTS: u32 = 8;

/// Confusion counts of a test.
#[derive(Clone, Copy, Debug, Default, Serialize)]
pub struct Score {
    /// Visible clumps, blocks or chunks.
    pub visible: u64,
    /// Of these, culled.
    pub false_culls: u64,
    /// Occluded ones.
    pub hidden: u64,
    /// Of these, kept.
    pub kept: u64,
}

impl Score {
    pub fn count(&mut self, is_seen: bool, is_culled: bool) {
        if is_seen {
            self.visible += 1;
            self.false_culls += u64::from(is_culled);
        } else {
            self.hidden += 1;
            self.kept += u64::from(!is_culled);
        }
    }

    /// Adds the counts of another score.
    pub fn add(&mut self, other: &Self) {
        self.visible += other.visible;
        self.false_culls += other.false_culls;
        self.hidden += other.hidden;
        self.kept += other.kept;
    }

    /// Share of the occluded things that are kept.
    pub fn kept_share(&self) -> f64 {
        self.kept as f64 / (self.hidden as f64).max(1.0)
    }
}

/// Results of the tests of clumps in the scenes of one kind.
#[derive(Clone, Copy, Debug, Default, Serialize)]
pub struct Variation {
    pub scenes: u64,
    /// T4.
    pub hierarchical: Score,
    /// T2 and the march of T3, both counted in one score: the control.
    pub inexact: Score,
}

impl Variation {
    fn add(&mut self, other: &Self) {
        self.scenes += other.scenes;
        self.hierarchical.add(&other.hierarchical);
        self.inexact.add(&other.inexact);
    }
}

/// The kinds of a scene, as fields of [`Findings::variations`].
fn kinds_of(case: &Case, scene: &Scene) -> Vec<&'static str> {
    let levels = scene.levels_at_eye();
    let is_level_border = levels.iter().any(|level| *level != levels[0]);
    let kinds = [
        ("steep", case.is_steep()),
        ("absent_chunks", matches!(case.absent, Absent::Random { .. })),
        ("chunk_border", levels.len() > 1),
        ("level_border", is_level_border),
    ];
    kinds.into_iter().filter(|(_, is)| *is).map(|(kind, _)| kind).collect()
}

/// Scores over all scenes.
#[derive(Clone, Debug, Default, Serialize)]
pub struct Findings {
    pub scenes: u64,
    /// Scenes without occlusion tests: the eye is below the drawn land, because finer chunks than
    /// the drawn ones say where the ground is, or no land is drawn at the eye. Land is not drawn
    /// from below and hides nothing there. These scenes count for false culls, not for what is
    /// kept.
    pub below_land: u64,
    /// By kind of scene: `steep` (pitches of no walk), `absent_chunks` (a random share of the
    /// chunks has not arrived), `chunk_border` and `level_border` (the eye is exactly on one).
    pub variations: BTreeMap<&'static str, Variation>,
    /// By test: `noise` (T2, step of 2 m), `march` (T3 by steps of 2 m along the ray),
    /// `march_fine` (step of half a metre), `exact` (T3), `hierarchical` (T4), `grass` and `trees`
    /// of it, `bound` (T4 where any point of a clump's bound is visible: the tests are conservative
    /// for the bound); `chunks` of 128 m of grass by T4 (kept if any clump of them is),
    /// `chunks_by_blocks` (kept if any block of them is), `tree_chunks` and `tree_chunks_by_blocks`
    /// likewise, all by `five_points`.
    #[serde(flatten)]
    pub scores: BTreeMap<&'static str, Score>,
    /// Reads of heights, bounds and tiles per ray: T3; a march in steps of half a metre.
    pub fetches_exact: f64,
    /// See `fetches_exact`.
    pub fetches_march: f64,
    /// Time of T3 over that of a march in steps of half a metre. Both take the same rays, in turns
    /// of 50.
    pub time_ratio: f64,
    /// Largest distance between a root and the drawn triangle under it, millimetres.
    pub root_mm: f64,
    #[serde(skip)]
    rays: u64,
    #[serde(skip)]
    times: [Duration; 2],
    /// The first clumps that T4 culls although a point of their bound is visible, for messages.
    pub violations: Vec<String>,
}

impl Findings {
    fn count(&mut self, test: &'static str, is_seen: bool, is_culled: bool) {
        self.scores.entry(test).or_default().count(is_seen, is_culled);
    }

    fn join(mut self, other: Self) -> Self {
        self.scenes += other.scenes;
        self.below_land += other.below_land;
        for (test, score) in &other.scores {
            self.scores.entry(test).or_default().add(score);
        }
        for (kind, variation) in &other.variations {
            self.variations.entry(kind).or_default().add(variation);
        }
        self.fetches_exact += other.fetches_exact;
        self.fetches_march += other.fetches_march;
        self.root_mm = self.root_mm.max(other.root_mm);
        self.rays += other.rays;
        self.times = [self.times[0] + other.times[0], self.times[1] + other.times[1]];
        self.violations.extend(other.violations);
        self.violations.truncate(8);
        self
    }
}

pub fn score(land: &Land, cases: &[Case]) -> Findings {
    let found = cases
        .par_iter()
        .filter_map(|case| {
            let scene = Scene::of(land, case, 4000)?;
            Some(of_scene(&scene, &kinds_of(case, &scene)))
        })
        .reduce(Findings::default, Findings::join);
    let rays = (found.rays as f64).max(1.0);
    Findings {
        fetches_exact: found.fetches_exact / rays,
        fetches_march: found.fetches_march / rays,
        time_ratio: found.times[0].as_secs_f64() / found.times[1].as_secs_f64().max(1e-12),
        ..found
    }
}

/// Counts reads.
#[derive(Debug)]
pub struct CountingSlots<'a, S> {
    pub slots: &'a S,
    pub reads: Cell<u64>,
}

impl<S: Slots> Slots for CountingSlots<'_, S> {
    fn height(&self, slot: u32, index: u32) -> i32 {
        self.note();
        self.slots.height(slot, index)
    }
    fn top(&self, slot: u32, texel: u32) -> i32 {
        self.note();
        self.slots.top(slot, texel)
    }
    fn bottom(&self, slot: u32, texel: u32) -> i32 {
        self.note();
        self.slots.bottom(slot, texel)
    }
    fn density(&self, slot: u32, word: u32) -> u32 {
        self.slots.density(slot, word)
    }
    fn note(&self) {
        self.reads.set(self.reads.get() + 1);
    }
}

/// Points on the bound of a clump as seen from an eye, metres, as the occlusion test defines it.
/// Within the `slope_radius` of an occludee the top follows the slope. The rest of its radius is
/// lean: a point is as high as the slope up to so much farther uphill, but not beyond the
/// `slope_radius`. Both are measured along the axis of the ground along which the clump is farther
/// away. `corner` is that of the grid, metres.
fn hull_of(corner: [f64; 2], extent: &Extent, eye: Point) -> Vec<Point> {
    let metres = |fine: i32| f64::from(fine) / 4096.0;
    let target = &extent.occludee;
    let (x, z) = (metres(target.x) + corner[0], metres(target.z) + corner[1]);
    let (radius, skirt, follow) = (metres(target.radius), metres(target.taper), metres(target.slope_radius));
    let rises = [target.slope_east, target.slope_south].map(|rise| f64::from(rise) / 16_384.0);
    let away = [x - eye[0], z - eye[2]];
    let main = usize::from(away[0].abs() < away[1].abs());
    let forward = away[main].signum();
    let drift = away[1 - main] / away[main].abs().max(1e-9);
    // Growth of the top behind the middle, beside it, and along the line of sight.
    let (ahead, tilt) = (rises[main] * forward, rises[1 - main]);
    let along = ahead + tilt * drift;
    let ring = |share: f64, beyond: f64| {
        let reach = share * radius + beyond * skirt;
        // Only a rim lies farther out in the plane.
        let planar = follow + if skirt > 0.0 { beyond * (radius + skirt - follow) } else { 0.0 };
        let lean = radius - follow;
        (0..POINTS).map(move |n| TAU * f64::from(n) / f64::from(POINTS)).map(move |angle| {
            let (behind, beside) = (reach * angle.cos(), reach * angle.sin());
            let foot = if along > 0.0 { (behind + lean).min(planar) } else { (behind - lean).max(-planar) };
            let plane = ahead * foot + tilt * (beside - drift * (behind - foot));
            let mut place = [x, z];
            place[main] += behind * forward;
            place[1 - main] += beside;
            [place[0], metres(target.top) - beyond * metres(target.taper_drop) + plane, place[1]]
        })
    };
    ring(1.0, 0.0).chain(ring(0.5, 0.0)).chain(ring(1.0, 0.5)).chain(ring(1.0, 1.0)).collect()
}

fn of_scene(scene: &Scene, kinds: &[&'static str]) -> Findings {
    let mut found = Findings { scenes: 1, ..Findings::default() };
    let mut clumps = Variation { scenes: 1, ..Variation::default() };
    let reference = VisibilityReference::new(&scene.world, &scene.drawn);
    let slots = BySlot::new(&scene.world);
    let square = &scene.plants.grid;
    let surface = Surface { slots: &slots, nodes: &square.nodes, chunks: &square.chunks };
    let noise = noise_of(&scene.world, square);
    let corner = square.corner.map(|units| f64::from(units) / 256.0);
    let eye = eye_of(&scene.shot.pose);
    let is_untested = scene.plants.species.iter().any(|species| species.culling.occlusion_enabled == 0);
    found.below_land = is_untested.into();
    for species in &scene.plants.species {
        let culling = &species.culling;
        let fine = Culling { step: 2048, ..*culling };
        let is_grass = species.planting.kind == KIND_GRASS;
        let sample = sample(&surface, species);
        let mut hint_m = 0.0;
        for clump in &sample {
            let vertices = clump_vertices(scene, &surface, species, clump, level_of(species, clump));
            if vertices.height_m < LEAST_M {
                continue;
            }
            let exact = exact_test(&surface, species, clump);
            let is_seen = reference.sees_any(eye, &vertices.points, &mut hint_m);
            let is_bound_seen =
                is_seen || reference.sees_any(eye, &hull_of(corner, &exact.extent, eye), &mut hint_m);
            let at = [clump.x, clump.z].map(|fine| f64::from(fine) / 4096.0);
            if let Some(height) = reference.height(at[0] + corner[0], at[1] + corner[1]) {
                found.root_mm = found.root_mm.max((height - f64::from(clump.y) / 4096.0).abs() * 1e3);
            }
            let hierarchical = exact.is_occluded || is_block_culled(&surface, species, clump);
            let tip = tip_occludee(culling, &species.planting, clump);
            let inexact = [
                raymarch_occlusion(&noise, culling, &tip, 0),
                raymarch_occlusion_by_vertices(&surface, culling, &tip),
            ];
            for (test, is_culled) in ["noise", "march"].into_iter().zip(inexact) {
                found.count(test, is_seen, is_culled);
                clumps.inexact.count(is_seen, is_culled);
            }
            clumps.hierarchical.count(is_seen, hierarchical);
            found.count("march_fine", is_seen, raymarch_occlusion_by_vertices(&surface, &fine, &tip));
            found.count("exact", is_seen, exact.is_occluded);
            found.count("hierarchical", is_seen, hierarchical);
            found.count("bound", is_bound_seen, hierarchical);
            found.count(if is_grass { "grass" } else { "trees" }, is_seen, hierarchical);
            if is_bound_seen && hierarchical {
                found.violations.push(format!("{}: {clump:?}", scene.name));
            }
        }
        count_cost(&mut found, &surface, species, &sample, &fine);
        let by =
            if is_grass { ["chunks", "chunks_by_blocks"] } else { ["tree_chunks", "tree_chunks_by_blocks"] };
        for chunk in chunks_of(scene, &reference, &surface, species, EVERY_CHUNK) {
            let keeps = [chunk.has_clump, chunk.has_block, chunk.has_point];
            for (test, is_kept) in by.into_iter().chain(["five_points"]).zip(keeps) {
                found.count(test, chunk.is_seen, !is_kept);
            }
        }
    }
    if is_untested {
        for score in found.scores.values_mut().chain([&mut clumps.hierarchical, &mut clumps.inexact]) {
            (score.hidden, score.kept) = (0, 0);
        }
    }
    found.variations = kinds.iter().map(|kind| (*kind, clumps)).collect();
    found
}

/// Whether T4 culls the block of a clump.
fn is_block_culled<S: Slots>(surface: &Surface<'_, S>, species: &SpeciesParams, clump: &Clump) -> bool {
    let (culling, planting) = (&species.culling, &species.planting);
    let bits = planting.cell_bits + BLOCK_CELL_BITS;
    let (column, row) = (clump.x >> bits, clump.z >> bits);
    let block = block_extent(surface, culling, planting, bits, column, row);
    let is_hidden = |block: BlockExtent| !block_is_seen(surface, culling, planting, column, row, &block);
    culling.occlusion_enabled != 0 && block.is_none_or(is_hidden)
}

/// Adds reads and times of T3 and of a march in steps of half a metre for the same rays.
fn count_cost<S: Slots>(
    found: &mut Findings,
    surface: &Surface<'_, S>,
    species: &SpeciesParams,
    sample: &[Clump],
    fine: &Culling,
) {
    let extents: Vec<Extent> = sample
        .iter()
        .map(|clump| {
            extent_of(&species.culling, &species.planting, clump, slope_at(surface, clump.x, clump.z))
        })
        .collect();
    let counting = CountingSlots { slots: surface.slots, reads: Cell::new(0) };
    let counted = Surface { slots: &counting, nodes: surface.nodes, chunks: surface.chunks };
    for extent in &extents {
        let _ = is_occluded(&counted, fine.eye, &extent.occludee, fine.start);
    }
    found.fetches_exact += counting.reads.replace(0) as f64;
    for extent in &extents {
        let _ = raymarch_occlusion_by_vertices(&counted, fine, &extent.occludee);
    }
    found.fetches_march += counting.reads.get() as f64;
    found.rays += extents.len() as u64;
    for part in extents.chunks(50) {
        let begun = Instant::now();
        let exact = part.iter().filter(|extent| is_occluded(surface, fine.eye, &extent.occludee, fine.start));
        let some = std::hint::black_box(exact.count());
        let between = Instant::now();
        let march = part
            .iter()
            .filter(|extent| raymarch_occlusion_by_vertices(surface, fine, &extent.occludee))
            .count();
        std::hint::black_box((some, march));
        found.times[0] += between - begun;
        found.times[1] += between.elapsed();
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use shaders::twin::terrain_occlusion::Occludee;

    #[test]
    fn only_the_rim_of_a_bound_lies_farther_out_in_its_plane() {
        let of = |taper| {
            let (x, z, top) = (80 << 12, 40 << 12, 4 << 12);
            let (slope_east, slope_south, taper_drop) = (7839, 8071, taper / 2);
            let (radius, slope_radius) = (1076, 259);
            let occludee =
                Occludee { x, top, z, radius, slope_radius, taper, taper_drop, slope_east, slope_south };
            hull_of([0.0, 0.0], &Extent { occludee, bottom: 0 }, [0.0, 5.0, 0.0])
        };
        let highest = |points: &[Point]| points.iter().map(|point| point[1]).fold(f64::MIN, f64::max);
        let (plain, rimmed) = (of(0), of(4096));
        let at_radius = |points: &[Point]| points[..POINTS as usize].to_vec();
        assert_eq!(
            plain[3 * POINTS as usize..],
            at_radius(&plain)[..],
            "the outermost ring is that of the radius"
        );
        assert!(highest(&rimmed) > highest(&at_radius(&rimmed)), "a rim reaches higher (control)");
    }
}
