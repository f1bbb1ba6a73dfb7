//! Occlusion culling of vegetation: false culls, false keeps and reads of every test against the
//! visibility in f64; steps of the marches, frames of temporal hysteresis, cost of the methods in
//! frames.

use crate::culling::cases::{Absent, Case, Site, seeded};
use crate::culling::chunks::{ChunkVerdict, chunks_of};
use crate::culling::clump_vertices::clump_vertices;
use crate::culling::clumps::{LEAST_M, exact_test, level_of, sample};
use crate::culling::frames;
use crate::culling::occlusion::{CountingSlots, Score};
use crate::culling::reference::{VisibilityReference, eye_of};
use crate::culling::scene::Scene;
use crate::curve::{Curve, Sheet, numbered};
use crate::gpu_probes::cpu_cull::noise_of;
use crate::table::Table;
use anyhow::{Result, ensure};
use chart::{Choice, Panel, linear, log};
use client::cache::vertical_scale;
use client::features::vegetation::by_slot::BySlot;
use client::features::vegetation::{Cull, SpeciesParams, VegetationSettings};
use rayon::prelude::*;
use shaders::layout::Culling;
use shaders::twin::placement::Clump;
use shaders::twin::raymarch_occlusion::{raymarch_occlusion, raymarch_occlusion_by_vertices};
use shaders::twin::surface::{Slots, Surface};
use shaders::twin::visibility::tip_occludee;
use std::cell::Cell;
use std::collections::BTreeMap;
use std::hint::black_box;
use std::time::{Duration, Instant};
use terrain::Land;

/// Poses of a kind of scene.
const POSES: usize = 10;

/// Enough plants for a sample.
const PLANTS: VegetationSettings = VegetationSettings { density: 8, ..VegetationSettings::STANDARD };

/// Fine units in a metre.
const FINE: f64 = 4096.0;

/// Steps of the marches, metres.
const STEPS_M: [f64; 7] = [0.25, 0.5, 1.0, 2.0, 4.0, 8.0, 16.0];

/// Frames for which a chunk of 128 m stays drawn after a test last kept it. The option
/// `--cull-stay` does that with blocks of plants, which are smaller.
const HYSTERESIS: [usize; 6] = [0, 1, 2, 4, 8, 16];

/// Frames of a walk, and the distance between two, m: large for a frame, so that visibility changes
/// often.
const FRAMES: usize = 24;
const STRIDE_M: f64 = 0.5;

type Kind = (&'static str, fn(&Case) -> bool);

const SCENES: [Kind; 6] = [
    ("valley", |case| is_home(case) && case.site == Site::Valley),
    ("peak", |case| is_home(case) && case.site == Site::Peak),
    ("open land", |case| is_home(case) && case.site == Site::Slope),
    ("stretched 1.8 times", |case| case.stretch == 461),
    ("stretched 4 times", |case| case.stretch == 1024),
    ("10^6 m from the origin", is_far),
];

fn is_far(case: &Case) -> bool {
    case.shot.pose.position_m.x > 5e5
}

fn is_home(case: &Case) -> bool {
    case.stretch == vertical_scale::ONE && !is_far(case)
}

/// Whether a case may be walked from: a level view of complete land.
fn is_walk(case: &Case) -> bool {
    is_home(case) && !case.is_steep() && case.absent == Absent::None
}

/// A test of a clump.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Test {
    Noise(f64),
    March(f64),
    Exact,
}

#[derive(Clone, Copy, Debug, Default)]
struct Outcome {
    score: Score,
    rays: u64,
    reads: u64,
    time: Duration,
}

impl Outcome {
    fn join(mut self, other: &Self) -> Self {
        self.score.add(&other.score);
        self.rays += other.rays;
        self.reads += other.reads;
        self.time += other.time;
        self
    }

    fn lost_percent(&self) -> f64 {
        100.0 * self.score.false_culls as f64 / self.score.visible as f64
    }

    fn kept_percent(&self) -> f64 {
        100.0 * self.score.kept_share()
    }

    fn reads_per_ray(&self) -> f64 {
        self.reads as f64 / self.rays as f64
    }

    fn ns_per_ray(&self) -> f64 {
        self.time.as_secs_f64() * 1e9 / self.rays as f64
    }

    /// Losses on a logarithmic axis: for none, the upper bound with 95 % confidence (Hanley and
    /// Lippman-Hand, JAMA 249(13), 1983).
    fn shown_percent(&self) -> f64 {
        self.lost_percent().max(300.0 / self.score.visible as f64)
    }
}

impl Test {
    const fn is_noise(&self) -> bool {
        matches!(self, Self::Noise(_))
    }

    const fn is_march(&self) -> bool {
        matches!(self, Self::March(_))
    }

    fn culls<S: Slots>(
        self,
        surface: &Surface<'_, S>,
        noise: &impl Fn(i32, i32) -> i32,
        species: &SpeciesParams,
        clump: &Clump,
    ) -> bool {
        let with = |step: f64| Culling { step: (step * FINE) as i32, ..species.culling };
        let tip = tip_occludee(&species.culling, &species.planting, clump);
        match self {
            Self::Noise(step) => raymarch_occlusion(noise, &with(step), &tip, 0),
            Self::March(step) => raymarch_occlusion_by_vertices(surface, &with(step), &tip),
            Self::Exact => exact_test(surface, species, clump).is_occluded,
        }
    }
}

fn tests() -> Vec<(String, Test)> {
    let noise = STEPS_M.map(|step| (format!("T2 {step} m"), Test::Noise(step)));
    let march = STEPS_M.map(|step| (format!("T3 march {step} m"), Test::March(step)));
    noise.into_iter().chain(march).chain([("T3 exact".to_owned(), Test::Exact)]).collect()
}

/// Results of a test in a kind of scene, both by number.
struct Row {
    scene: usize,
    test: usize,
    outcome: Outcome,
}

/// # Errors
/// There is no GPU, it failed, or a control loses nothing.
pub fn measure(world_seed: u64) -> Result<Curve> {
    let land = Land::new(world_seed);
    let all = seeded(&land, 240, PLANTS);
    let tests = tests();
    let mut rows = Vec::new();
    let mut totals = vec![Outcome::default(); tests.len()];
    for (scene, (_, is_wanted)) in SCENES.iter().enumerate() {
        let cases: Vec<&Case> = all.iter().filter(|case| is_wanted(case)).take(POSES).collect();
        for (test, outcome) in judge_all(&land, &cases, &tests).into_iter().enumerate() {
            totals[test] = totals[test].join(&outcome);
            rows.push(Row { scene, test, outcome });
        }
    }
    let results = || tests.iter().zip(&totals).map(|((name, test), outcome)| (name, test, outcome));
    for (name, is) in [("T2", Test::is_noise as fn(&Test) -> bool), ("T3 by marching", Test::is_march)] {
        let has_lost = |(_, test, outcome): (_, &Test, &Outcome)| is(test) && outcome.score.false_culls > 0;
        ensure!(results().any(has_lost), "{name} culls no visible plant: the reference cannot detect one");
    }
    let caption = format!(
        "clumps of grass and trees that stand in the view, judged by sight over the drawn triangles in f64; \
         scenes: {}; tests: {}; {POSES} poses a scene; time of one ray on one thread.",
        numbered(SCENES.map(|scene| scene.0), ", "),
        numbered(tests.iter().map(|test| &test.0), ", ")
    );
    let mut sheet = Sheet::new("culling", caption, rows);
    sheet.columns(["scene", "test"], |row| [row.scene, row.test].map(|number| number as f64));
    sheet.columns(["seen", "lost, % of seen", "hidden", "kept, % of hidden"], |Row { outcome, .. }| {
        let Score { visible, hidden, .. } = outcome.score;
        [visible as f64, outcome.lost_percent(), hidden as f64, outcome.kept_percent()]
    });
    let of_rays = |row: &Row| [row.outcome.reads_per_ray(), row.outcome.ns_per_ray()];
    sheet.columns(["reads a ray", "ns a ray"], of_rays);

    let choice = |(name, test, outcome): (&String, &Test, &Outcome)| Choice {
        name: name.clone(),
        at: (outcome.reads_per_ray(), outcome.shown_percent()),
        is_shipped: *test == Test::Exact,
    };
    let by_step = |is: fn(&Test) -> bool, value: fn(&Outcome) -> f64| {
        let values = results().filter(|(_, test, _)| is(test)).map(|(.., outcome)| value(outcome));
        STEPS_M.into_iter().zip(values).collect::<Vec<_>>()
    };
    let exact = totals.last().copied().unwrap_or_default();
    let level = |value: f64| STEPS_M.map(|step| (step, value));
    let hysteresis = hysteresis(&land, &all)?;
    let (costs, cost_panel) = costs(&land)?;
    let panels = vec![
        Panel::new(
            "Reads against losses (none lost: 3 / n of those seen)",
            log("reads a ray"),
            log("clumps lost, % of those seen"),
        )
        .front(&results().map(choice).collect::<Vec<_>>()),
        Panel::new("Step of the marches", log("step, metres"), linear("% of those seen, or of those hidden"))
            .line("T2: lost", by_step(Test::is_noise, Outcome::lost_percent))
            .line("T3 march: lost", by_step(Test::is_march, Outcome::lost_percent))
            .line("T2: hidden kept", by_step(Test::is_noise, Outcome::kept_percent))
            .line("T3 march: hidden kept", by_step(Test::is_march, Outcome::kept_percent))
            .line("T3 exact: lost", level(exact.lost_percent()))
            .line("T3 exact: hidden kept", level(exact.kept_percent())),
        hysteresis.lines(
            Panel::new("Frames that a chunk stays: a walk of 0.5 m a frame", linear("frames"), linear("%")),
            "frames",
            HYSTERESIS_CURVES,
        ),
        cost_panel,
    ];
    let tables = vec![sheet.into(), hysteresis.into(), costs];
    let title = "Occlusion tests: losses, keeps and cost (reference: the drawn triangles in f64)";
    Ok(Curve { name: "culling", title, tables, panels })
}

fn judge_all(land: &Land, cases: &[&Case], tests: &[(String, Test)]) -> Vec<Outcome> {
    let none = || vec![Outcome::default(); tests.len()];
    cases
        .par_iter()
        .filter_map(|case| Some(judge(&Scene::of(land, case, 4000)?, tests)))
        .reduce(none, |one, other| one.iter().zip(&other).map(|(one, other)| one.join(other)).collect())
}

fn judge(scene: &Scene, tests: &[(String, Test)]) -> Vec<Outcome> {
    let reference = VisibilityReference::new(&scene.world, &scene.drawn);
    let slots = BySlot::new(&scene.world);
    let square = &scene.plants.grid;
    let surface = Surface { slots: &slots, nodes: &square.nodes, chunks: &square.chunks };
    let noise = noise_of(&scene.world, square);
    let counting = CountingSlots { slots: &slots, reads: Cell::new(0) };
    let counted = Surface { slots: &counting, nodes: &square.nodes, chunks: &square.chunks };
    let counted_noise = |x: i32, z: i32| {
        counting.reads.set(counting.reads.get() + 1);
        noise(x, z)
    };
    let mut outcomes = vec![Outcome::default(); tests.len()];
    for species in &scene.plants.species {
        let clumps = sample(&surface, species);
        let mut hint_m = 0.0;
        let seen: Vec<Option<bool>> = clumps
            .iter()
            .map(|clump| {
                let vertices = clump_vertices(scene, &surface, species, clump, level_of(species, clump));
                (vertices.height_m >= LEAST_M)
                    .then(|| reference.sees_any(eye_of(&scene.shot.pose), &vertices.points, &mut hint_m))
            })
            .collect();
        for ((_, test), outcome) in tests.iter().zip(&mut outcomes) {
            let begun = Instant::now();
            let culled: Vec<bool> =
                clumps.iter().map(|clump| test.culls(&surface, &noise, species, clump)).collect();
            outcome.time += begun.elapsed();
            outcome.rays += clumps.len() as u64;
            for (seen, culled) in seen.iter().zip(culled) {
                if let Some(is_seen) = seen {
                    outcome.score.count(*is_seen, species.culling.occlusion_enabled != 0 && culled);
                }
            }
            counting.reads.set(0);
            for clump in &clumps {
                black_box(test.culls(&counted, &counted_noise, species, clump));
            }
            outcome.reads += counting.reads.get();
        }
    }
    outcomes
}

/// Losses, keeps and changes, %, of the test by five points and of T4 by frames of hysteresis.
struct Hysteresis {
    frames: usize,
    tests: [[f64; 3]; 2],
}

/// Curves of the hysteresis, with their columns.
const HYSTERESIS_CURVES: [(&str, &str); 6] = [
    ("five points: seen chunks lost", "five points: lost, % of seen"),
    ("five points: hidden chunks kept", "five points: kept, % of hidden"),
    ("five points: changes, % of chunk-frames", "five points: changes, %"),
    ("T4: seen chunks lost", "T4: lost, % of seen"),
    ("T4: hidden chunks kept", "T4: kept, % of hidden"),
    ("T4: changes, % of chunk-frames", "T4: changes, %"),
];

/// Chunks along walks, each kept for some frames after a test last kept it.
fn hysteresis(land: &Land, all: &[Case]) -> Result<Sheet<Hysteresis>> {
    let walks: Vec<&Case> = [Site::Valley, Site::Slope]
        .into_iter()
        .filter_map(|site| all.iter().find(|case| is_walk(case) && case.site == site))
        .collect();
    let sparse = VegetationSettings { density: 1, trees: 0, range_m: 200.0, ..PLANTS };
    // Of each walk, of each frame: the chunks in view by position in the world.
    let seen: Vec<Vec<BTreeMap<[i32; 2], ChunkVerdict>>> = walks
        .iter()
        .map(|walk| (0..FRAMES).into_par_iter().map(|frame| chunks(land, walk, frame, sparse)).collect())
        .collect();
    let figures = |stay: usize, is_kept: fn(&ChunkVerdict) -> bool| {
        let (mut score, mut changes, mut pairs) = (Score::default(), 0, 0);
        for frames in &seen {
            let kept = |frame: usize, at: &[i32; 2]| {
                (frame.saturating_sub(stay)..=frame).any(|frame| frames[frame].get(at).is_some_and(is_kept))
            };
            for (frame, chunks) in frames.iter().enumerate() {
                for (at, chunk) in chunks {
                    score.count(chunk.is_seen, !kept(frame, at));
                    if frame > 0 && frames[frame - 1].contains_key(at) {
                        pairs += 1;
                        changes += u32::from(kept(frame, at) != kept(frame - 1, at));
                    }
                }
            }
        }
        let lost = score.false_culls as f64 / score.visible as f64;
        [lost, score.kept_share(), f64::from(changes) / f64::from(pairs.max(1))].map(|share| 100.0 * share)
    };
    let row = |frames| Hysteresis {
        frames,
        tests: [figures(frames, |chunk| chunk.has_point), figures(frames, |chunk| chunk.has_clump)],
    };
    let rows = HYSTERESIS.map(row).into();
    let caption = format!(
        "chunks of 128 m in view on {} walks of {FRAMES} frames, {STRIDE_M} m apart, each kept for \
         some frames after a test last kept it; a change is a chunk in view that is kept in one of two \
         neighbouring frames and left out in the other.",
        walks.len()
    );
    let mut sheet = Sheet::new("culling_stay", caption, rows);
    ensure!(sheet.rows.iter().all(|row: &Hysteresis| row.tests[1][0] == 0.0), "T4 lost a visible chunk");
    sheet.column("frames", |row| row.frames as f64);
    let columns = HYSTERESIS_CURVES.map(|(_, column)| column);
    sheet.columns(columns, |row| std::array::from_fn(|index| row.tests[index / 3][index % 3]));
    Ok(sheet)
}

fn chunks(
    land: &Land,
    walk: &Case,
    frame: usize,
    plants: VegetationSettings,
) -> BTreeMap<[i32; 2], ChunkVerdict> {
    let mut case = walk.clone();
    let forward = case.shot.pose.forward();
    case.shot.pose.position_m += glam::DVec3::new(forward.x, 0.0, forward.z) * (STRIDE_M * frame as f64);
    case.shot.settings.plants = plants;
    let Some(scene) = Scene::of(land, &case, 4000) else { return BTreeMap::new() };
    let reference = VisibilityReference::new(&scene.world, &scene.drawn);
    let slots = BySlot::new(&scene.world);
    let square = &scene.plants.grid;
    let surface = Surface { slots: &slots, nodes: &square.nodes, chunks: &square.chunks };
    let of_species = |species| chunks_of(&scene, &reference, &surface, species, 1);
    let tile = 128 * terrain::constants::UNITS_PER_METRE;
    let place = |at: [i32; 2]| [0, 1].map(|axis| square.corner[axis] + at[axis] * tile);
    scene.plants.species.iter().flat_map(of_species).map(|chunk| (place(chunk.at), chunk)).collect()
}

/// Cost of the methods in the valley scene.
fn costs(land: &Land) -> Result<(Table, Panel)> {
    let frames = frames::measure(land, client::scene::Scene::Culling.plants(), frames::ROUNDS)?;
    let caption = format!(
        "the scene `culling` as it starts, 320 x 180 pixels, medians of interleaved rounds on {}; ways: {}.",
        frames.adapter,
        numbered(frames.ways.iter().map(|cost| cost.way), ", ")
    );
    let mut sheet = Sheet::new("culling_ways", caption, frames.ways.into_iter().enumerate().collect());
    let names = ["way", "clumps", "choice, ms", "frame, ms", "choice ratio", "frame ratio"];
    sheet.columns(names, |(way, cost): &(usize, frames::Cost)| {
        let ratios = (cost.choice_ratio, cost.frame_ratio);
        [*way as f64, cost.clumps as f64, cost.choice_ms, cost.frame_ms, ratios.0, ratios.1]
    });
    let (x, y) = (linear("clumps drawn"), linear("time of a frame over that of T1"));
    let panel = Panel::new("Methods in the valley scene", x, y);
    let panel = sheet.front(panel, "clumps", "frame ratio", |row| {
        (row.1.way.to_owned(), frames::WAYS[row.0].1 == Cull::default())
    });
    Ok((sheet.into(), panel))
}
