//! The second oracle: samples of clumps and chunks, judged by every test and by sight over the
//! drawn triangles in f64.

use crate::culling::chunks::chunks_of;
use crate::culling::leaves::leaves_of;
use crate::culling::oracle::{Oracle, Point, eye_of};
use crate::culling::poses::Trial;
use crate::culling::scene::Scene;
use client::plants::Stand;
use client::plants::kept::{BySlot, blocks_of_patch, noise_of};
use rayon::prelude::*;
use serde::Serialize;
use shaders::layout::{Culling, KIND_GRASS};
use shaders::twin::march::{is_hidden_by_vertices, marched_is_hidden};
use shaders::twin::planting::{
    BLOCK_CELL_BITS, Clump, Extent, block_extent, clump_at, distance_squared, extent_of, may_be_in_view,
    slope_at, stands_at, tip_of,
};
use shaders::twin::sight::is_hidden;
use shaders::twin::surface::{Slots, Surface};
use std::cell::Cell;
use std::f64::consts::TAU;
use std::time::{Duration, Instant};
use terrain::Land;

/// Clumps of each kind that are judged in a scene.
pub const SAMPLE: usize = 500;

/// Of the chunks in view one in so many is judged.
const EVERY_CHUNK: usize = 3;

/// Points of a ring.
const POINTS: u32 = 8;

/// What is lower than this is not judged, metres: at the end of their range plants have sunk into
/// the ground, where they are neither seen nor hidden.
pub const LEAST_M: f64 = 0.1;

/// How a test did.
#[derive(Clone, Copy, Debug, Default, Serialize)]
pub struct Score {
    /// Things that are seen.
    pub visible: u64,
    /// Of these, left out.
    pub false_culls: u64,
    /// Things that are hidden.
    pub hidden: u64,
    /// Of these, kept.
    pub kept: u64,
}

impl Score {
    /// Counts one thing.
    pub fn count(&mut self, is_seen: bool, is_culled: bool) {
        if is_seen {
            self.visible += 1;
            self.false_culls += u64::from(is_culled);
        } else {
            self.hidden += 1;
            self.kept += u64::from(!is_culled);
        }
    }

    /// Counts all that another one has counted.
    pub fn add(&mut self, other: &Self) {
        self.visible += other.visible;
        self.false_culls += other.false_culls;
        self.hidden += other.hidden;
        self.kept += other.kept;
    }

    /// Hidden things that were kept, of all hidden ones.
    #[must_use]
    pub fn kept_share(&self) -> f64 {
        self.kept as f64 / (self.hidden as f64).max(1.0)
    }
}

/// What was found in all scenes.
#[derive(Clone, Debug, Default, Serialize)]
pub struct Findings {
    /// Scenes judged.
    pub scenes: u64,
    /// T2, step of 2 m.
    pub noise: Score,
    /// T3 as first published, step of 2 m.
    pub march: Score,
    /// The same with a step of half a metre.
    pub march_fine: Score,
    /// T3.
    pub exact: Score,
    /// T4.
    pub hierarchical: Score,
    /// T3 and T4 where any point of a clump's bound is in sight, not its top alone: the bound is
    /// what they promise.
    pub bound: Score,
    /// Grass alone by T4, trees alone by T4.
    pub grass: Score,
    /// See `grass`.
    pub trees: Score,
    /// Chunks of 128 m of grass by T4: kept if any clump of them is.
    pub chunks: Score,
    /// The same chunks: kept if any block of them is.
    pub chunks_by_blocks: Score,
    /// Chunks of trees likewise.
    pub tree_chunks: Score,
    /// See `tree_chunks`.
    pub tree_chunks_by_blocks: Score,
    /// Chunks by five points.
    pub five_points: Score,
    /// Reads of heights, bounds and tiles per ray: T3; a march in steps of half a metre.
    pub fetches_exact: f64,
    /// See `fetches_exact`.
    pub fetches_march: f64,
    /// Time of T3 over that of the march, the same rays one after the other.
    pub time_ratio: f64,
    /// Largest distance between a root and the drawn triangle under it, millimetres.
    pub root_mm: f64,
    #[serde(skip)]
    rays: u64,
    #[serde(skip)]
    times: [Duration; 2],
    /// The first few that were left out although they are seen, for people.
    pub culprits: Vec<String>,
}

impl Findings {
    fn join(mut self, other: Self) -> Self {
        self.scenes += other.scenes;
        for (own, others) in [
            (&mut self.noise, &other.noise),
            (&mut self.march, &other.march),
            (&mut self.march_fine, &other.march_fine),
            (&mut self.exact, &other.exact),
            (&mut self.hierarchical, &other.hierarchical),
            (&mut self.bound, &other.bound),
            (&mut self.grass, &other.grass),
            (&mut self.trees, &other.trees),
            (&mut self.chunks, &other.chunks),
            (&mut self.chunks_by_blocks, &other.chunks_by_blocks),
            (&mut self.tree_chunks, &other.tree_chunks),
            (&mut self.tree_chunks_by_blocks, &other.tree_chunks_by_blocks),
            (&mut self.five_points, &other.five_points),
        ] {
            own.add(others);
        }
        self.fetches_exact += other.fetches_exact;
        self.fetches_march += other.fetches_march;
        self.root_mm = self.root_mm.max(other.root_mm);
        self.rays += other.rays;
        self.times = [self.times[0] + other.times[0], self.times[1] + other.times[1]];
        self.culprits.extend(other.culprits);
        self.culprits.truncate(8);
        self
    }
}

/// Judges all trials.
#[must_use]
pub fn judge(land: &Land, trials: &[Trial]) -> Findings {
    let found = trials
        .par_iter()
        .filter_map(|trial| Some(of_scene(&Scene::of(land, trial, 4000)?)))
        .reduce(Findings::default, Findings::join);
    let rays = (found.rays as f64).max(1.0);
    Findings {
        fetches_exact: found.fetches_exact / rays,
        fetches_march: found.fetches_march / rays,
        time_ratio: found.times[0].as_secs_f64() / found.times[1].as_secs_f64().max(1e-12),
        ..found
    }
}

/// Counts what a test reads.
#[derive(Debug)]
pub struct Counting<'a, S> {
    /// What is read.
    pub slots: &'a S,
    /// How often.
    pub reads: Cell<u64>,
}

impl<S: Slots> Slots for Counting<'_, S> {
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

/// Rings on the hull of all that a clump may take up, metres, as it is seen from an eye: what its
/// test promises. What follows the plane of the top does so up to a part of the radius; the rest
/// leans out of it by that much at most. Both are counted along the axis of the ground that the
/// line of sight crosses faster, as the test does.
fn hull_of(scene: &Scene, extent: &Extent, eye: Point) -> Vec<Point> {
    let corner = scene.plants.square.corner.map(|units| f64::from(units) / 256.0);
    let metres = |fine: i32| f64::from(fine) / 4096.0;
    let target = &extent.target;
    let (x, z) = (metres(target.x) + corner[0], metres(target.z) + corner[1]);
    let (radius, skirt, follow) = (metres(target.radius), metres(target.skirt), metres(target.follow));
    let rises = [target.east_rise, target.south_rise].map(|rise| f64::from(rise) / 16_384.0);
    let away = [x - eye[0], z - eye[2]];
    let main = usize::from(away[0].abs() < away[1].abs());
    let forward = away[main].signum();
    let drift = away[1 - main] / away[main].abs().max(1e-9);
    // Growth of the top behind the middle, beside it, and along the line of sight.
    let (ahead, tilt) = (rises[main] * forward, rises[1 - main]);
    let along = ahead + tilt * drift;
    let ring = |share: f64, beyond: f64| {
        let reach = share * radius + beyond * skirt;
        let planar = follow + beyond * (radius + skirt - follow);
        let lean = radius - follow;
        (0..POINTS).map(move |n| TAU * f64::from(n) / f64::from(POINTS)).map(move |angle| {
            let (behind, beside) = (reach * angle.cos(), reach * angle.sin());
            let foot = if along > 0.0 { (behind + lean).min(planar) } else { (behind - lean).max(-planar) };
            let plane = ahead * foot + tilt * (beside - drift * (behind - foot));
            let mut place = [x, z];
            place[main] += behind * forward;
            place[1 - main] += beside;
            [place[0], metres(target.top) - beyond * metres(target.fall) + plane, place[1]]
        })
    };
    ring(1.0, 0.0).chain(ring(0.5, 0.0)).chain(ring(1.0, 0.5)).chain(ring(1.0, 1.0)).collect()
}

/// The level of detail in which a clump is drawn.
#[must_use]
pub fn level_of(stand: &Stand, clump: &Clump) -> u32 {
    let far = distance_squared(&stand.culling, clump.x, clump.y, clump.z);
    u32::from(far > stand.planting.detail[0]) + u32::from(far > stand.planting.detail[1])
}

fn of_scene(scene: &Scene) -> Findings {
    let mut found = Findings { scenes: 1, ..Findings::default() };
    let oracle = Oracle::new(&scene.world, &scene.drawn);
    let slots = BySlot::new(&scene.world);
    let square = &scene.plants.square;
    let surface = Surface { slots: &slots, tiles: &square.tiles, leaves: &square.leaves };
    let noise = noise_of(&scene.world, square);
    let eye = eye_of(&scene.shot.pose);
    for stand in &scene.plants.stands {
        let culling = &stand.culling;
        let fine = Culling { step: 2048, ..*culling };
        let sample = sample(&surface, stand);
        let mut hint_m = 0.0;
        for clump in &sample {
            let leaves = leaves_of(scene, &surface, stand, clump, level_of(stand, clump));
            if leaves.height_m < LEAST_M {
                continue;
            }
            let judged = judged(&surface, stand, clump);
            let is_seen = oracle.sees_any(eye, &leaves.points, &mut hint_m);
            let is_bound_seen =
                is_seen || oracle.sees_any(eye, &hull_of(scene, &judged.extent, eye), &mut hint_m);
            let corner = square.corner.map(|units| f64::from(units) / 256.0);
            let at = [clump.x, clump.z].map(|fine| f64::from(fine) / 4096.0);
            if let Some(height) = oracle.height(at[0] + corner[0], at[1] + corner[1]) {
                found.root_mm = found.root_mm.max((height - f64::from(clump.y) / 4096.0).abs() * 1e3);
            }
            let hierarchical = judged.is_hidden || block_of(&surface, stand, clump);
            let tip = tip_of(culling, &stand.planting, clump);
            found.noise.count(is_seen, marched_is_hidden(&noise, culling, &tip, 0));
            found.march.count(is_seen, is_hidden_by_vertices(&surface, culling, &tip));
            found.march_fine.count(is_seen, is_hidden_by_vertices(&surface, &fine, &tip));
            found.exact.count(is_seen, judged.is_hidden);
            found.hierarchical.count(is_seen, hierarchical);
            found.bound.count(is_bound_seen, hierarchical);
            let is_grass = stand.planting.kind == KIND_GRASS;
            if is_grass { &mut found.grass } else { &mut found.trees }.count(is_seen, hierarchical);
            if is_bound_seen && hierarchical {
                found.culprits.push(format!("{}: {clump:?}", scene.name));
            }
        }
        count_cost(&mut found, &surface, stand, &sample, &fine);
        let is_grass = stand.planting.kind == KIND_GRASS;
        for chunk in chunks_of(scene, &oracle, &surface, stand, EVERY_CHUNK) {
            let (by_clumps, by_blocks) = if is_grass {
                (&mut found.chunks, &mut found.chunks_by_blocks)
            } else {
                (&mut found.tree_chunks, &mut found.tree_chunks_by_blocks)
            };
            by_clumps.count(chunk.is_seen, !chunk.has_clump);
            by_blocks.count(chunk.is_seen, !chunk.has_block);
            found.five_points.count(chunk.is_seen, !chunk.has_point);
        }
    }
    found
}

/// What T3 says of a clump.
#[derive(Clone, Copy, Debug)]
pub struct Judged {
    /// What the clump takes up.
    pub extent: Extent,
    /// Whether all of that is hidden.
    pub is_hidden: bool,
}

/// Asks T3 about a clump.
#[must_use]
pub fn judged<S: Slots>(surface: &Surface<'_, S>, stand: &Stand, clump: &Clump) -> Judged {
    let culling = &stand.culling;
    let extent = extent_of(culling, &stand.planting, clump, slope_at(surface, clump.x, clump.z));
    let is_hidden = culling.sees_land != 0 && is_hidden(surface, culling.eye, &extent.target, culling.start);
    Judged { extent, is_hidden }
}

/// Whether T4 hides the whole block that a clump stands in.
fn block_of<S: Slots>(surface: &Surface<'_, S>, stand: &Stand, clump: &Clump) -> bool {
    let (culling, planting) = (&stand.culling, &stand.planting);
    let bits = planting.cell_bits + BLOCK_CELL_BITS;
    let (column, row) = (clump.x >> bits, clump.z >> bits);
    let block = block_extent(surface, culling, planting, column, row);
    let hides = |block: Extent| is_hidden(surface, culling.eye, &block.target, culling.start);
    culling.sees_land != 0 && block.is_none_or(hides)
}

/// Clumps of a stand inside the view, evenly from all of its blocks; at most [`SAMPLE`].
#[must_use]
pub fn sample<S: Slots>(surface: &Surface<'_, S>, stand: &Stand) -> Vec<Clump> {
    let blocks: Vec<[i32; 2]> = stand.patches.iter().copied().flat_map(blocks_of_patch).collect();
    let mut found = Vec::new();
    // A stride that shares no factor with the blocks of a patch or with the cells of a block.
    let stride = (blocks.len() / (30 * SAMPLE)).max(1) | 1;
    for (n, block) in blocks.iter().step_by(stride).enumerate() {
        let lane = (n * 7) as u32 % (16 * stand.planting.per_cell);
        let (cell, index) = ((lane % 16) as i32, lane / 16);
        let (column, row) = (block[0] * 4 + cell % 4, block[1] * 4 + cell / 4);
        let clump = clump_at(surface, &stand.planting, column, row, index);
        let Some(clump) = clump.filter(|clump| is_judged(stand, clump)) else { continue };
        let extent = extent_of(&stand.culling, &stand.planting, &clump, slope_at(surface, clump.x, clump.z));
        if may_be_in_view(&stand.culling, &extent) {
            found.push(clump);
        }
    }
    let every = (found.len() / SAMPLE).max(1);
    let mut found: Vec<Clump> = found.into_iter().step_by(every).collect();
    found.truncate(SAMPLE);
    found
}

/// Whether thinning leaves a clump standing.
#[must_use]
pub fn is_judged(stand: &Stand, clump: &Clump) -> bool {
    let far = distance_squared(&stand.culling, clump.x, clump.y, clump.z);
    stands_at(&stand.planting, clump, far)
}

/// What T3 and the fine march read and take for the same rays.
fn count_cost<S: Slots>(
    found: &mut Findings,
    surface: &Surface<'_, S>,
    stand: &Stand,
    sample: &[Clump],
    fine: &Culling,
) {
    let extents: Vec<Extent> = sample
        .iter()
        .map(|clump| extent_of(&stand.culling, &stand.planting, clump, slope_at(surface, clump.x, clump.z)))
        .collect();
    let counting = Counting { slots: surface.slots, reads: Cell::new(0) };
    let counted = Surface { slots: &counting, tiles: surface.tiles, leaves: surface.leaves };
    for extent in &extents {
        let _ = is_hidden(&counted, fine.eye, &extent.target, fine.start);
    }
    found.fetches_exact += counting.reads.replace(0) as f64;
    for extent in &extents {
        let _ = is_hidden_by_vertices(&counted, fine, &extent.target);
    }
    found.fetches_march += counting.reads.get() as f64;
    found.rays += extents.len() as u64;
    for part in extents.chunks(50) {
        let begun = Instant::now();
        let exact = part.iter().filter(|extent| is_hidden(surface, fine.eye, &extent.target, fine.start));
        let some = std::hint::black_box(exact.count());
        let between = Instant::now();
        let march = part.iter().filter(|extent| is_hidden_by_vertices(surface, fine, &extent.target)).count();
        std::hint::black_box((some, march));
        found.times[0] += between - begun;
        found.times[1] += between.elapsed();
    }
}
