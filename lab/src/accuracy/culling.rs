//! Culling: what every test of sight loses and keeps for what it reads, by the second oracle; steps
//! of the marches, frames that blocks stay, and what the ways of choosing cost in frames.

use super::Curve;
use crate::chart::{Choice, Panel, front, linear, log, measured};
use crate::culling::chunks::{ChunkVerdict, chunks_of};
use crate::culling::frames;
use crate::culling::leaves::leaves_of;
use crate::culling::oracle::{Oracle, eye_of};
use crate::culling::poses::{Place, Trial, seeded};
use crate::culling::scene::Scene;
use crate::culling::sight::{Counting, LEAST_M, Score, judged, level_of, sample};
use crate::table::Table;
use anyhow::{Result, ensure};
use client::plants::PlantKnobs;
use client::plants::kept::{BySlot, noise_of};
use client::world::stretch;
use rayon::prelude::*;
use shaders::layout::Culling;
use shaders::twin::march::{is_hidden_by_vertices, marched_is_hidden};
use shaders::twin::planting::tip_of;
use shaders::twin::surface::Surface;
use std::cell::Cell;
use std::collections::BTreeMap;
use std::time::{Duration, Instant};
use terrain::Land;

/// Poses of a kind of scene.
const POSES: usize = 10;

/// What grows: enough for a sample.
const PLANTS: PlantKnobs = PlantKnobs { density: 8, ..PlantKnobs::STANDARD };

/// Fine units in a metre.
const FINE: f64 = 4096.0;

/// Steps of the marches, metres.
const STEPS_M: [f64; 7] = [0.25, 0.5, 1.0, 2.0, 4.0, 8.0, 16.0];

/// Frames that a chunk stays after it was last found in sight.
const STAYS: [usize; 6] = [0, 1, 2, 4, 8, 16];

/// Frames of a walk, and their distance: a brisk walk at 6 frames a second, so that little stays as
/// it is.
const FRAMES: usize = 24;
const STRIDE_M: f64 = 0.5;

/// A kind of scene.
type Wanted = (&'static str, fn(&Trial) -> bool);

const SCENES: [Wanted; 6] = [
    ("valley", |trial| is_home(trial) && trial.place == Place::Valley),
    ("peak", |trial| is_home(trial) && trial.place == Place::Peak),
    ("open land", |trial| is_home(trial) && trial.place == Place::Land),
    ("stretched 1.8 times", |trial| trial.stretch == 461),
    ("stretched 4 times", |trial| trial.stretch == 1024),
    ("10^6 m from the origin", is_far),
];

fn is_far(trial: &Trial) -> bool {
    trial.shot.pose.position_m.x > 5e5
}

fn is_home(trial: &Trial) -> bool {
    trial.stretch == stretch::ONE && !is_far(trial)
}

/// A test of a clump.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Test {
    Noise(f64),
    March(f64),
    Exact,
}

/// How it did.
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

    /// What a logarithmic axis can show of the losses: of none, what may be there unseen with 95 %
    /// certainty (Hanley and Lippman-Hand, JAMA 249(13), 1983).
    fn shown_percent(&self) -> f64 {
        self.lost_percent().max(300.0 / self.score.visible as f64)
    }
}

fn tests() -> Vec<(String, Test)> {
    let noise = STEPS_M.map(|step| (format!("T2 {step} m"), Test::Noise(step)));
    let march = STEPS_M.map(|step| (format!("T3 march {step} m"), Test::March(step)));
    noise.into_iter().chain(march).chain([("T3 exact".to_owned(), Test::Exact)]).collect()
}

/// Measures it.
///
/// # Errors
/// There is no GPU or it failed, or a test that must lose something loses nothing.
pub fn measure(world_seed: u64) -> Result<Curve> {
    let land = Land::new(world_seed);
    let all = seeded(&land, 240, PLANTS);
    let tests = tests();
    let names = tests.iter().enumerate().map(|(index, (name, _))| format!("{index} {name}"));
    let kinds = SCENES.iter().enumerate().map(|(index, (name, _))| format!("{index} {name}"));
    let mut table = Table::new(
        "culling",
        format!(
            "clumps of grass and trees that stand in the view, judged by sight over the drawn triangles in f64; scenes: {}; tests: {}; {POSES} poses a scene; time of one ray \
             on one thread.",
            kinds.collect::<Vec<_>>().join(", "),
            names.collect::<Vec<_>>().join(", ")
        ),
        &[
            "scene",
            "test",
            "seen",
            "lost, % of seen",
            "hidden",
            "kept, % of hidden",
            "reads a ray",
            "ns a ray",
        ],
    );
    let mut totals = vec![Outcome::default(); tests.len()];
    for (scene, (_, is_wanted)) in SCENES.iter().enumerate() {
        let trials: Vec<&Trial> = all.iter().filter(|trial| is_wanted(trial)).take(POSES).collect();
        let outcomes = judge_all(&land, &trials, &tests);
        for (test, outcome) in outcomes.iter().enumerate() {
            table.push([
                scene as f64,
                test as f64,
                outcome.score.visible as f64,
                outcome.lost_percent(),
                outcome.score.hidden as f64,
                outcome.kept_percent(),
                outcome.reads_per_ray(),
                outcome.ns_per_ray(),
            ]);
            totals[test] = totals[test].join(outcome);
        }
    }
    let lost = |is: fn(&Test) -> bool| {
        tests
            .iter()
            .zip(&totals)
            .filter(|(test, _)| is(&test.1))
            .map(|(_, outcome)| outcome.score.false_culls)
            .max()
    };
    ensure!(
        lost(|test| matches!(test, Test::Noise(_))) > Some(0),
        "T2 loses nothing: the truth could not tell"
    );
    ensure!(
        lost(|test| matches!(test, Test::March(_))) > Some(0),
        "T3 by marching loses nothing: the truth could not tell"
    );

    let choices: Vec<Choice> = tests
        .iter()
        .zip(&totals)
        .map(|((name, test), outcome)| Choice {
            name: name.clone(),
            at: (outcome.reads_per_ray(), outcome.shown_percent()),
            is_shipped: *test == Test::Exact,
        })
        .collect();
    let by_step = |is: fn(&Test) -> bool, value: fn(&Outcome) -> f64| {
        let of = tests.iter().zip(&totals).filter(|((_, test), _)| is(test));
        STEPS_M.into_iter().zip(of.map(|(_, outcome)| value(outcome))).collect::<Vec<_>>()
    };
    let is_noise: fn(&Test) -> bool = |test| matches!(test, Test::Noise(_));
    let is_march: fn(&Test) -> bool = |test| matches!(test, Test::March(_));
    let exact = totals.last().copied().unwrap_or_default();
    let level = |value: f64| STEPS_M.map(|step| (step, value));
    let stays = stays(&land, &all)?;
    let costs = costs(&land)?;
    let panels = vec![
        Panel {
            title: "What a loss costs (none lost: 3 / n of those seen)",
            x: log("reads a ray"),
            y: log("clumps lost, % of those seen"),
            series: front(&choices),
        },
        Panel {
            title: "Step of the marches",
            x: log("step, metres"),
            y: linear("% of those seen, or of those hidden"),
            series: vec![
                measured("T2: lost", by_step(is_noise, Outcome::lost_percent)),
                measured("T3 march: lost", by_step(is_march, Outcome::lost_percent)),
                measured("T2: hidden kept", by_step(is_noise, Outcome::kept_percent)),
                measured("T3 march: hidden kept", by_step(is_march, Outcome::kept_percent)),
                measured("T3 exact: lost", level(exact.lost_percent())),
                measured("T3 exact: hidden kept", level(exact.kept_percent())),
            ],
        },
        Panel {
            title: "Frames that a chunk stays: a walk of 0.5 m a frame",
            x: linear("frames"),
            y: linear("%"),
            series: vec![
                measured(
                    "five points: seen chunks lost",
                    stays.curve("frames", "five points: lost, % of seen"),
                ),
                measured(
                    "five points: hidden chunks kept",
                    stays.curve("frames", "five points: kept, % of hidden"),
                ),
                measured(
                    "five points: changes, % of chunk-frames",
                    stays.curve("frames", "five points: changes, %"),
                ),
                measured("T4: seen chunks lost", stays.curve("frames", "T4: lost, % of seen")),
                measured("T4: hidden chunks kept", stays.curve("frames", "T4: kept, % of hidden")),
                measured("T4: changes, % of chunk-frames", stays.curve("frames", "T4: changes, %")),
            ],
        },
        Panel {
            title: "Ways of choosing in the valley scene",
            x: linear("clumps drawn"),
            y: linear("time of a frame over that of T1"),
            series: front(
                &frames::WAYS
                    .iter()
                    .zip(costs.curve("clumps", "frame ratio"))
                    .map(|((name, cull), at)| Choice {
                        name: (*name).to_owned(),
                        at,
                        is_shipped: *cull == client::plants::Cull::default(),
                    })
                    .collect::<Vec<_>>(),
            ),
        },
    ];
    Ok(Curve {
        name: "culling",
        title: "Tests of sight: what they lose, keep and cost (truth: the drawn triangles in f64)",
        tables: vec![table, stays, costs],
        panels,
    })
}

fn judge_all(land: &Land, trials: &[&Trial], tests: &[(String, Test)]) -> Vec<Outcome> {
    let none = || vec![Outcome::default(); tests.len()];
    trials
        .par_iter()
        .filter_map(|trial| Some(judge(&Scene::of(land, trial, 4000)?, tests)))
        .reduce(none, |one, other| one.iter().zip(&other).map(|(one, other)| one.join(other)).collect())
}

fn judge(scene: &Scene, tests: &[(String, Test)]) -> Vec<Outcome> {
    let oracle = Oracle::new(&scene.world, &scene.drawn);
    let slots = BySlot::new(&scene.world);
    let square = &scene.plants.square;
    let surface = Surface { slots: &slots, tiles: &square.tiles, leaves: &square.leaves };
    let noise = noise_of(&scene.world, square);
    let counting = Counting { slots: &slots, reads: Cell::new(0) };
    let counted = Surface { slots: &counting, tiles: &square.tiles, leaves: &square.leaves };
    let counted_noise = |x: i32, z: i32| {
        counting.reads.set(counting.reads.get() + 1);
        noise(x, z)
    };
    let mut outcomes = vec![Outcome::default(); tests.len()];
    for stand in &scene.plants.stands {
        let clumps = sample(&surface, stand);
        let mut hint_m = 0.0;
        let seen: Vec<Option<bool>> = clumps
            .iter()
            .map(|clump| {
                let leaves = leaves_of(scene, &surface, stand, clump, level_of(stand, clump));
                (leaves.height_m >= LEAST_M)
                    .then(|| oracle.sees_any(eye_of(&scene.shot.pose), &leaves.points, &mut hint_m))
            })
            .collect();
        for ((_, test), outcome) in tests.iter().zip(&mut outcomes) {
            let begun = Instant::now();
            let culled: Vec<bool> = clumps
                .iter()
                .map(|clump| {
                    let tip = || tip_of(&stand.culling, &stand.planting, clump);
                    let with = |step: f64| Culling { step: (step * FINE) as i32, ..stand.culling };
                    match *test {
                        Test::Noise(step) => marched_is_hidden(&noise, &with(step), &tip(), 0),
                        Test::March(step) => is_hidden_by_vertices(&surface, &with(step), &tip()),
                        Test::Exact => judged(&surface, stand, clump).is_hidden,
                    }
                })
                .collect();
            outcome.time += begun.elapsed();
            outcome.rays += clumps.len() as u64;
            for (seen, culled) in seen.iter().zip(culled) {
                if let Some(is_seen) = seen {
                    outcome.score.count(*is_seen, stand.culling.sees_land != 0 && culled);
                }
            }
            counting.reads.set(0);
            for clump in &clumps {
                let tip = tip_of(&stand.culling, &stand.planting, clump);
                let with = |step: f64| Culling { step: (step * FINE) as i32, ..stand.culling };
                match *test {
                    Test::Noise(step) => drop(marched_is_hidden(&counted_noise, &with(step), &tip, 0)),
                    Test::March(step) => drop(is_hidden_by_vertices(&counted, &with(step), &tip)),
                    Test::Exact => drop(judged(&counted, stand, clump)),
                }
            }
            outcome.reads += counting.reads.get();
        }
    }
    outcomes
}

/// Chunks along walks, each kept for some frames after a test last kept it.
fn stays(land: &Land, all: &[Trial]) -> Result<Table> {
    let walks: Vec<&Trial> = [Place::Valley, Place::Land]
        .into_iter()
        .filter_map(|place| all.iter().find(|trial| is_home(trial) && trial.place == place))
        .collect();
    let sparse = PlantKnobs { density: 1, trees: 0, range_m: 200.0, ..PLANTS };
    // Of each walk, of each frame: what is in view, by its place in the world.
    let seen: Vec<Vec<BTreeMap<[i32; 2], ChunkVerdict>>> = walks
        .iter()
        .map(|walk| (0..FRAMES).into_par_iter().map(|frame| chunks(land, walk, frame, sparse)).collect())
        .collect();
    let mut table = Table::new(
        "culling_stay",
        format!(
            "chunks of 128 m in view on {} walks of {FRAMES} frames, {STRIDE_M} m apart, each kept for some frames after a test last kept it; a change is a chunk in view that is kept \
             in one of two neighbouring frames and left out in the other.",
            walks.len()
        ),
        &[
            "frames",
            "five points: lost, % of seen",
            "five points: kept, % of hidden",
            "five points: changes, %",
            "T4: lost, % of seen",
            "T4: kept, % of hidden",
            "T4: changes, %",
        ],
    );
    for stay in STAYS {
        let mut row = vec![stay as f64];
        for is_kept in [|chunk: &ChunkVerdict| chunk.has_point, |chunk: &ChunkVerdict| chunk.has_clump] {
            let (mut score, mut changes, mut pairs) = (Score::default(), 0, 0);
            for frames in &seen {
                let kept = |frame: usize, at: &[i32; 2]| {
                    (frame.saturating_sub(stay)..=frame)
                        .any(|frame| frames[frame].get(at).is_some_and(is_kept))
                };
                for (frame, chunks) in frames.iter().enumerate() {
                    for (at, chunk) in chunks {
                        score.count(chunk.is_seen, !kept(frame, at));
                        if frame > 0 && frames[frame - 1].contains_key(at) {
                            pairs += 1;
                            changes += usize::from(kept(frame, at) != kept(frame - 1, at));
                        }
                    }
                }
            }
            row.extend([
                100.0 * score.false_culls as f64 / score.visible as f64,
                100.0 * score.kept_share(),
                100.0 * changes as f64 / f64::from(pairs.max(1) as u32),
            ]);
        }
        table.push(row);
    }
    ensure!(table.rows.iter().all(|row| row[4] == 0.0), "T4 lost a chunk that is seen");
    Ok(table)
}

fn chunks(land: &Land, walk: &Trial, frame: usize, plants: PlantKnobs) -> BTreeMap<[i32; 2], ChunkVerdict> {
    let mut trial = walk.clone();
    let forward = trial.shot.pose.forward();
    trial.shot.pose.position_m += glam::DVec3::new(forward.x, 0.0, forward.z) * (STRIDE_M * frame as f64);
    trial.shot.looks.plants = plants;
    let Some(scene) = Scene::of(land, &trial, 4000) else { return BTreeMap::new() };
    let oracle = Oracle::new(&scene.world, &scene.drawn);
    let slots = BySlot::new(&scene.world);
    let square = &scene.plants.square;
    let surface = Surface { slots: &slots, tiles: &square.tiles, leaves: &square.leaves };
    let of_stand = |stand| chunks_of(&scene, &oracle, &surface, stand, 1);
    let tile = 128 * terrain::constants::UNITS_PER_METRE;
    let place = |at: [i32; 2]| [0, 1].map(|axis| square.corner[axis] + at[axis] * tile);
    scene.plants.stands.iter().flat_map(of_stand).map(|chunk| (place(chunk.at), chunk)).collect()
}

/// What the ways cost in the valley scene.
fn costs(land: &Land) -> Result<Table> {
    let frames = frames::measure(land, client::scene::Scene::Culling.plants())?;
    let ways = frames.ways.iter().enumerate().map(|(index, cost)| format!("{index} {}", cost.way));
    let mut table = Table::new(
        "culling_ways",
        format!(
            "the scene `culling` as it starts, 320 x 180 pixels, medians of interleaved rounds on {}; ways: {}.",
            frames.adapter,
            ways.collect::<Vec<_>>().join(", ")
        ),
        &["way", "clumps", "choice, ms", "frame, ms", "choice ratio", "frame ratio"],
    );
    for (index, cost) in frames.ways.iter().enumerate() {
        table.push([
            index as f64,
            cost.clumps as f64,
            cost.choice_ms,
            cost.frame_ms,
            cost.choice_ratio,
            cost.frame_ratio,
        ]);
    }
    Ok(table)
}
