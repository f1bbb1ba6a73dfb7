//! The shipped marches against the reference, on this machine's GPU. `cargo xtask measure pom` runs
//! the same with more rays.

use clap::ValueEnum as _;
use client::features::pom::cones::relaxed_cones;
use client::features::pom::settings::{Heights, LoopForm, PomMethod, PomShadow, Refine};
use client::features::pom::{HeightMap, PomSettings};
use lab::pom::bench::PomBench;
use lab::pom::comparison::{
    AMPLITUDE, ANGLES_DEG, Condition, Score, Stage, probes, rays, references, relief,
};
use lab::pom::maps::Kind;
use shaders::layout::{PomParams, PomProbe};

/// The bench; none, visibly, where there is no adapter and none is required.
fn bench() -> Option<PomBench> {
    match PomBench::open() {
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
fn the_max_mip_traversal_misses_only_tangents() {
    let Some(bench) = bench() else { return };
    let stage = Stage::new(&bench, false).unwrap();
    let linear = PomParams { steps_min: 64, steps_max: 64, ..relief(PomMethod::Linear) };
    for (layer, kind) in Kind::ALL.into_iter().enumerate() {
        for angle in ANGLES_DEG {
            let condition = Condition::new(&stage, layer, angle, RAYS);
            for tier in [PomMethod::MaxMip, PomMethod::Auto] {
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
    let stage = Stage::new(&bench, false).unwrap();
    for refine in [Refine::None, Refine::Segment, Refine::Secant, Refine::Bisection] {
        for (layer, angle) in [(0, 60.0), (1, 75.0), (2, 85.0), (3, 30.0)] {
            let probes = probes(layer, RAYS, angle, AMPLITUDE);
            let places = |form: LoopForm| -> Vec<[u32; 3]> {
                let how =
                    PomParams { refine: refine as u32, loop_form: form as u32, ..relief(PomMethod::Linear) };
                let (found, _) = bench.run(&stage.uploaded, &how, &probes, 1).unwrap();
                found.iter().map(|found| [found.uv[0], found.uv[1], found.height].map(f32::to_bits)).collect()
            };
            assert_eq!(places(LoopForm::Exit), places(LoopForm::Flag), "{refine:?}");
        }
    }
}

/// The largest difference between two lists of cones, over the greater of both.
fn apart(one: &[f32], other: &[f32]) -> f32 {
    assert_eq!(one.len(), other.len());
    one.iter().zip(other).map(|(a, b)| (a - b).abs() / a.max(*b).max(1e-9)).fold(0.0, f32::max)
}

#[test]
fn cones_of_the_gpu_equal_those_of_the_cpu_at_every_level() {
    let Some(bench) = bench() else { return };
    // A map of bricks, each cone of which holds for a block of four texels, and one of hills, each
    // of which holds for one.
    let maps = [Kind::Brick.map(), Kind::Fbm.map().next_mip().next_mip()];
    for (map, block) in maps.into_iter().zip([2, 1]) {
        let uploaded = bench.upload(std::slice::from_ref(&map), true).unwrap();
        let (mut reduced, mut compared) = (map, 0);
        // The CPU takes half a minute for the largest level.
        for level in 0..uploaded.cones().mip_level_count() {
            if reduced.side() <= 128 {
                let baked = bench.cones(&uploaded, level).unwrap();
                let own = relaxed_cones(&reduced, block);
                // A GPU may round a division by 2.5 units in the last place.
                assert!(apart(&baked, &own) < 1e-6, "level {level}: {}", apart(&baked, &own));
            }
            // A map of bricks ends as an even one, whose cones are as wide as can be either way.
            if (64..=128).contains(&reduced.side()) {
                let baked = bench.cones(&uploaded, level).unwrap();
                let negative = reduced.heights().iter().map(|height| 1.0 - height).collect();
                let control = relaxed_cones(&HeightMap::new(reduced.side(), negative).unwrap(), block);
                assert!(apart(&baked, &control) > 0.01, "the control must fail at level {level}");
                compared += 1;
            }
            reduced = reduced.next_mip();
        }
        assert_eq!(compared, 2, "levels");
    }
}

#[test]
fn cones_miss_less_than_as_many_uniform_steps() {
    let Some(bench) = bench() else { return };
    let (stage, bare) = (Stage::new(&bench, true).unwrap(), Stage::new(&bench, false).unwrap());
    // 16 steps into the relief and 8 halvings.
    let even = PomParams {
        steps_min: 16,
        steps_max: 16,
        refine: Refine::Bisection as u32,
        refinements: 8,
        ..relief(PomMethod::Linear)
    };
    for angle in [60.0, 75.0] {
        let condition = Condition::new(&stage, 1, angle, RAYS);
        let score = |stage: &Stage, how: &PomParams| condition.score(&bench, stage, how).unwrap();
        let (cones, even) = (score(&stage, &relief(PomMethod::Cones)), score(&stage, &even));
        let control = score(&bare, &relief(PomMethod::Cones));
        println!("bricks at {angle} degrees: cones {cones:?}, even steps {even:?}");
        assert!(cones.odd == 0 && cones.wrong < 0.02 && 2.0 * cones.wrong < even.wrong, "{cones:?} {even:?}");
        assert!(control.wrong > 10.0 * cones.wrong, "the control must fail: {control:?}");
    }
}

#[test]
fn cones_of_a_mip_level_are_found_over_its_own_heights() {
    let Some(bench) = bench() else { return };
    let stage = Stage::new(&bench, true).unwrap();
    // Ridges of a texel: of level 0, their cones are so narrow that 16 steps lead nowhere.
    let (layer, lod) = (3, 3);
    let coarse = (0..lod).fold(stage.maps[layer].clone(), |map, _| map.next_mip());
    let wrong = |lod: u32, map: &HeightMap| {
        let probes: Vec<PomProbe> =
            probes(layer, RAYS, 75.0, AMPLITUDE).into_iter().map(|probe| PomProbe { lod, ..probe }).collect();
        let rays = rays(&probes, 0.5);
        let (found, _) = bench.run(&stage.uploaded, &relief(PomMethod::Cones), &probes, 1).unwrap();
        Score::of(map, &rays, &found, &references(map, &rays)).wrong
    };
    let (own, control) = (wrong(lod, &coarse), wrong(0, &stage.maps[layer]));
    println!("ridges: {own} wrong at level {lod}, {control} at level 0");
    assert!(own < 0.03, "{own}");
    assert!(control > 0.1, "the control must fail: {control}");
}

/// Rays with everything that is odd about them.
fn odd_rays(layer: u32) -> Vec<PomProbe> {
    let mut rays = Vec::new();
    for amplitude in [0.0, 1e-6, 0.05, 0.5, 10.0] {
        for angle_deg in [0.0f32, 60.0, 89.9, 90.0, 120.0] {
            for origin in [0.0, 1e3, 1e6] {
                for (east, south) in [(1.0, 0.0), (0.0, -1.0), (0.6, 0.8), (-3.0, 0.5)] {
                    let (sin, cos) = angle_deg.to_radians().sin_cos();
                    // At a right angle, exactly: the sine of a rounded angle leaves a rest.
                    let up = if angle_deg == 90.0 { 0.0 } else { cos };
                    rays.push(PomProbe {
                        uv: [origin + 0.37, origin + 0.61],
                        amplitude,
                        lod: 0,
                        to_eye: [sin * east, sin * south, up],
                        layer,
                        to_sun: [east * up, south * up, sin],
                        reserved: 0,
                    });
                }
            }
        }
    }
    rays
}

#[test]
fn extreme_rays_over_extreme_maps_end_at_finite_places() {
    let Some(bench) = bench() else { return };
    let map = |side: usize, height: fn(f64, f64) -> f64| HeightMap::of(side, height).unwrap();
    let checkers =
        |u: f64, v: f64| f64::from(u8::from(((u * 32.0) as u32 + (v * 32.0) as u32).is_multiple_of(2)));
    let spike = |u: f64, v: f64| f64::from(u8::from((u * 32.0) as u32 == 12 && (v * 32.0) as u32 == 20));
    let arrays = [
        vec![map(1, |_, _| 0.3)],
        vec![map(2, |u, _| u)],
        vec![
            map(32, |_, _| 0.0),
            map(32, |_, _| 1.0),
            map(32, |_, _| 0.5),
            map(32, checkers),
            map(32, spike),
        ],
    ];
    for maps in arrays {
        let uploaded = bench.upload(&maps, true).unwrap();
        for layer in 0..maps.len() as u32 {
            let rays = odd_rays(layer);
            for tier in PomMethod::value_variants() {
                for steps in [1, 256] {
                    for (heights, shadow) in
                        [(Heights::Exact, PomShadow::Hard), (Heights::Sampler, PomShadow::Soft)]
                    {
                        let knobs = PomSettings {
                            method: *tier,
                            steps_min: steps,
                            steps_max: steps,
                            heights,
                            shadow,
                            ..PomSettings::default()
                        };
                        let (found, _) = bench.run(&uploaded, &knobs.layout(), &rays, 1).unwrap();
                        for (ray, found) in rays.iter().zip(&found) {
                            let numbers = [found.uv[0], found.uv[1], found.height, found.residual, found.sun];
                            let what = format!("{knobs:?} {ray:?} {found:?}");
                            assert!(numbers.iter().all(|number| number.is_finite()), "{what}");
                            assert!(
                                (0.0..=1.0).contains(&found.height) && (0.0..=1.0).contains(&found.sun),
                                "{what}"
                            );
                            assert!(found.fetches <= 5 * 8192, "{what}");
                            let goes_nowhere =
                                ray.amplitude == 0.0 || ray.to_eye[2] <= 0.0 || *tier == PomMethod::Flat;
                            assert!(!goes_nowhere || found.uv == ray.uv, "{what}");
                        }
                    }
                }
            }
        }
    }
}

#[test]
fn a_constant_map_is_met_where_its_plane_is() {
    let Some(bench) = bench() else { return };
    for height in [0.0f32, 0.25, 1.0] {
        let map = HeightMap::new(16, vec![height; 256]).unwrap();
        let uploaded = bench.upload(&[map], false).unwrap();
        let rays = probes(0, 500, 75.0, AMPLITUDE);
        for tier in [PomMethod::Offset, PomMethod::Linear, PomMethod::MaxMip, PomMethod::Auto] {
            let (found, _) = bench.run(&uploaded, &relief(tier), &rays, 1).unwrap();
            for (ray, found) in rays.iter().zip(&found) {
                let expected = [0, 1].map(|axis| {
                    ray.uv[axis] + (height - 0.5) * ray.amplitude * ray.to_eye[axis] / ray.to_eye[2]
                });
                let off = (found.uv[0] - expected[0]).hypot(found.uv[1] - expected[1]);
                assert!(
                    off < 1e-5 && (found.height - height).abs() < 1e-5,
                    "{tier:?} {height} {ray:?} {found:?}"
                );
            }
        }
    }
}

#[test]
fn the_largest_map_is_walked_like_a_small_one() {
    let Some(bench) = bench() else { return };
    let side = client::features::pom::height_map::LARGEST_SIDE;
    let wave = |u: f64| 0.5 + 0.5 * (std::f64::consts::TAU * u).sin();
    let map = HeightMap::of(side, |u, v| wave(8.0 * u) * wave(8.0 * v)).unwrap();
    let uploaded = bench.upload(std::slice::from_ref(&map), false).unwrap();
    let probes = probes(0, 500, 80.0, AMPLITUDE);
    let rays = rays(&probes, 0.5);
    let references = references(&map, &rays);
    let (found, _) = bench.run(&uploaded, &relief(PomMethod::MaxMip), &probes, 1).unwrap();
    let score = Score::of(&map, &rays, &found, &references);
    assert!(score.wrong == 0.0 && score.odd == 0 && score.residual < 1.0 / 1024.0, "{score:?}");
}

#[test]
fn far_tiles_stretched_and_mirrored_ones_are_marched_as_exactly() {
    let Some(bench) = bench() else { return };
    let stage = Stage::new(&bench, false).unwrap();
    for (stretch, origin) in [([2.0, 1.0], 0.0), ([-1.0, 0.25], 0.0), ([1.0, 1.0], 1e3), ([1.0, -1.0], -1e3)]
    {
        for layer in 0..Kind::ALL.len() {
            let mut probes = probes(layer, 2_000, 75.0, AMPLITUDE);
            for probe in &mut probes {
                for axis in [0, 1] {
                    probe.to_eye[axis] *= stretch[axis];
                    probe.uv[axis] += origin;
                }
            }
            let (map, rays) = (&stage.maps[layer], rays(&probes, 0.5));
            let references = references(map, &rays);
            let (found, _) = bench.run(&stage.uploaded, &relief(PomMethod::MaxMip), &probes, 1).unwrap();
            let score = Score::of(map, &rays, &found, &references);
            // A place a thousand tiles out is a multiple of a 32nd texel.
            assert!(score.wrong <= 2e-3 && score.texels[1] < 0.1, "{stretch:?} {origin} {score:?}");
        }
    }
}
