//! The shipped marches against the truth, on this machine's GPU. `cargo xtask measure pom` asks the same with more rays.

use client::relief::knobs::{LoopForm, Refine, ReliefTier};
use lab::relief::bench::ReliefBench;
use lab::relief::maps::Kind;
use lab::relief::trial::{AMPLITUDE, ANGLES_DEG, Condition, Stage, probes, relief};
use shaders::layout::Relief;

/// The bench; none, visibly, where there is no adapter and none is required.
fn bench() -> Option<ReliefBench> {
    match ReliefBench::open() {
        Ok(bench) => Some(bench),
        Err(error) => {
            assert!(std::env::var_os("TOMBOLO_REQUIRE_GPU").is_none(), "a GPU is required: {error}");
            eprintln!("SKIPPED: {error}");
            None
        }
    }
}

const RAYS: u32 = 4_000;

#[test]
fn the_walk_over_the_pyramid_misses_nothing_but_tangents_and_a_linear_search_does() {
    let Some(bench) = bench() else { return };
    let stage = Stage::new(&bench, false);
    let linear = Relief { steps_min: 64, steps_max: 64, ..relief(ReliefTier::Linear) };
    for (layer, kind) in Kind::ALL.into_iter().enumerate() {
        for angle in ANGLES_DEG {
            let condition = Condition::new(&stage, layer, angle, RAYS);
            for tier in [ReliefTier::Pyramid, ReliefTier::Auto] {
                let score = condition.score(&bench, &stage, &relief(tier)).unwrap();
                let what = format!("{tier:?} over {} at {angle} degrees: {score:?}", kind.name());
                assert!(score.wrong <= 5e-4 && score.wrong_without_excuse == 0.0, "{what}");
                assert!(score.residual <= 1.0 / 1024.0 && score.odd == 0, "{what}");
            }
        }
        let control = Condition::new(&stage, layer, 85.0, RAYS).score(&bench, &stage, &linear).unwrap();
        assert!(control.wrong > 0.005, "64 steps over {}: {control:?}", kind.name());
    }
}

#[test]
fn both_loop_forms_find_the_same_to_the_last_bit() {
    let Some(bench) = bench() else { return };
    let stage = Stage::new(&bench, false);
    for refine in [Refine::None, Refine::Segment, Refine::Secant, Refine::Bisection] {
        for (layer, angle) in [(0, 60.0), (1, 75.0), (2, 85.0), (3, 30.0)] {
            let probes = probes(layer, RAYS, angle, AMPLITUDE);
            let places = |form: LoopForm| -> Vec<[u32; 3]> {
                let how =
                    Relief { refine: refine as u32, loop_form: form as u32, ..relief(ReliefTier::Linear) };
                let (found, _) = bench.run(&stage.uploaded, &how, &probes, 1).unwrap();
                found.iter().map(|found| [found.uv[0], found.uv[1], found.height].map(f32::to_bits)).collect()
            };
            assert_eq!(places(LoopForm::Exit), places(LoopForm::Flag), "{refine:?}");
        }
    }
}
