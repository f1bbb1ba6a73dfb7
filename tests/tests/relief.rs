//! Scenes of reliefs: what must be the same byte for byte, knobs and cameras at the ends of their
//! ranges, and edges and depths against displaced geometry.

use client::camera::Pose;
use client::headless::{self, HeadlessError, Options};
use client::looks::{Looks, Show};
use client::relief::ReliefKnobs;
use client::relief::knobs::{Heights, Horizon, LoopForm, Refine, ReliefShadow, ReliefTier, Silhouette};
use client::render::Picture;
use client::render::materials::{MATERIAL_TEXELS, OwnMaterial, OwnMaterials};
use client::render::scenes::relief::objects::{self, COMPARED, LAYER, Mode, Object, Shape};
use client::scene::Scene;
use lab::relief::pictures::{
    Light, RELIEF_M, ReliefStudio, SIDE_M, around, ball, cut_distance, line_distances, plane, quantile,
    silhouette_overlap,
};
use std::sync::Arc;
use std::time::Instant;

const SCENES: [Scene; 3] = [Scene::Pom, Scene::Brick, Scene::Spom];

/// A studio; none, visibly, where there is no adapter and none is required.
fn studio(scene: Scene, size: (u32, u32)) -> Option<ReliefStudio> {
    match ReliefStudio::open(scene, size) {
        Ok(studio) => Some(studio),
        Err(error) if !tests::gpu_is_required() => {
            eprintln!("SKIPPED: {error}");
            None
        }
        Err(error) => panic!("{error}"),
    }
}

fn drawn(options: &Options) -> Option<Picture> {
    match headless::render_local(options, Instant::now()) {
        Ok((picture, stats)) => {
            assert_eq!((stats.chunks_drawn, stats.bytes_received, stats.delivery), (0, 0, "none"));
            Some(picture)
        }
        Err(HeadlessError::Gpu(error)) if !tests::gpu_is_required() => {
            eprintln!("SKIPPED: {error}");
            None
        }
        Err(error) => panic!("{error}"),
    }
}

fn options(scene: Scene, relief: ReliefKnobs) -> Options {
    let mut options = Options { scene, pose: scene.start(), samples: 1, ..Options::default() };
    (options.lens.width, options.lens.height) = (160, 90);
    options.looks.relief = relief;
    options
}

fn knobs(tier: ReliefTier) -> ReliefKnobs {
    ReliefKnobs { tier, ..ReliefKnobs::default() }
}

/// Mean difference of two pictures, all channels, of 255.
fn apart(one: &Picture, other: &Picture) -> f64 {
    let sum: u64 = one.rgba.iter().zip(&other.rgba).map(|(a, b)| u64::from(a.abs_diff(*b))).sum();
    sum as f64 / one.rgba.len().max(1) as f64
}

const TIERS: [ReliefTier; 6] = [
    ReliefTier::Flat,
    ReliefTier::Offset,
    ReliefTier::Linear,
    ReliefTier::Cones,
    ReliefTier::Pyramid,
    ReliefTier::Auto,
];

#[test]
fn without_amplitude_every_tier_draws_the_flat_plane_byte_for_byte() {
    let Some(mut studio) = studio(Scene::Pom, (192, 108)) else { return };
    let pose = around(16.0, 20.0, 3.5);
    let mut of = |mode, relief| studio.shown(&[plane(mode)], pose, relief, Show::Picture).unwrap();
    for tier in TIERS {
        for silhouette in [Silhouette::None, Silhouette::Shell] {
            for (depth, tiling) in [(false, [1.0; 2]), (true, [1.0; 2]), (true, [3.0, 0.7])] {
                let none = ReliefKnobs { amplitude: 0.0, silhouette, depth, tiling, ..knobs(tier) };
                let flat = of(Mode::Flat, none);
                assert_eq!(of(Mode::Knobs, none).differing(&flat).count(), 0, "{none:?}");
            }
        }
        // The control: with its amplitude it is another picture, unless it is the flat tier.
        let changed = of(Mode::Knobs, knobs(tier)).differing(&of(Mode::Flat, knobs(tier))).count();
        assert_eq!(changed == 0, tier == ReliefTier::Flat, "{tier:?}: {changed} pixels");
    }
}

#[test]
fn a_relief_that_has_faded_is_the_flat_plane_byte_for_byte_and_one_that_never_does_is_not() {
    let Some(mut studio) = studio(Scene::Pom, (192, 108)) else { return };
    // The highest relief of the scene is less than 8 pixels high from here.
    let pose = around(20.0, 20.0, 4.5);
    let mut differing = |fade_px| {
        let relief = ReliefKnobs { fade_px, ..ReliefKnobs::default() };
        let mut of = |mode| studio.shown(&[plane(mode)], pose, relief, Show::Picture).unwrap();
        of(Mode::Knobs).differing(&of(Mode::Flat)).count()
    };
    assert_eq!(differing(16.0), 0);
    let whole = differing(0.0);
    assert!(whole > 500, "the control must fail: {whole}");
}

#[test]
fn a_loop_that_runs_to_its_end_draws_what_one_that_leaves_draws_byte_for_byte() {
    let Some(mut studio) = studio(Scene::Pom, (192, 108)) else { return };
    let pose = around(12.0, -35.0, 3.0);
    for refine in [Refine::None, Refine::Segment, Refine::Secant, Refine::Bisection] {
        for heights in [Heights::Exact, Heights::Sampler] {
            let exit = ReliefKnobs { refine, heights, ..knobs(ReliefTier::Linear) };
            let flag = ReliefKnobs { loop_form: LoopForm::Flag, ..exit };
            let mut of = |relief| studio.shown(&[plane(Mode::Knobs)], pose, relief, Show::Picture).unwrap();
            let (left, ran) = (of(exit), of(flag));
            assert_eq!(left.differing(&ran).count(), 0, "{refine:?} {heights:?}");
            // The control: another number of steps is another picture.
            let fewer = of(ReliefKnobs { steps_min: 2, steps_max: 3, ..exit });
            assert!(left.differing(&fewer).count() > 100, "{refine:?} {heights:?}");
        }
    }
}

/// Cameras that ask for what has no answer: straight down, along the plane, at its height, in the
/// relief, under it.
fn odd_poses() -> Vec<Pose> {
    let texts = [
        "0,3,0,0,-90",
        "0,0.005,3,0,-0.1",
        "0,0,3,0,0",
        "0,0.02,0,0,0",
        "0.3,0.03,0.2,45,-30",
        "0,-0.5,3,0,8",
        "0,-2,0,0,90",
    ];
    texts.iter().map(|text| text.parse().unwrap()).chain([around(0.1, 33.0, 3.0)]).collect()
}

#[test]
fn every_pixel_is_a_number_whatever_camera_amplitude_and_steps_are() {
    let Some(mut studio) = studio(Scene::Pom, (64, 36)) else { return };
    let silhouettes = [Silhouette::None, Silhouette::Rectangle, Silhouette::Horizon, Silhouette::Shell];
    let shadows = [ReliefShadow::Hard, ReliefShadow::Soft];
    let (mut index, mut seen) = (0, 0);
    for pose in odd_poses() {
        // Relative to a tile of 5 m, whose relief is 0.1 m.
        for amplitude in [1e-6, 0.05, 0.5, 10.0f32] {
            for steps in [1, 256] {
                for tier in [ReliefTier::Linear, ReliefTier::Auto, ReliefTier::Offset] {
                    let relief = ReliefKnobs {
                        amplitude,
                        steps_min: steps,
                        steps_max: steps,
                        silhouette: silhouettes[index % 4],
                        shadow: shadows[index % 2],
                        depth: index % 3 == 0,
                        pivot: [0.5, 0.0, 1.0][index % 3],
                        tiling: [[1.0, 1.0], [8.0, 0.25], [0.25, 8.0]][index / 3 % 3],
                        ..knobs(tier)
                    };
                    index += 1;
                    let mut everything = objects::of(Scene::Spom);
                    everything.extend([plane(Mode::Knobs), plane(Mode::Geometry)]);
                    let light = studio.shown(&everything, pose, relief, Show::Picture).unwrap();
                    assert_eq!(light.unlit(), 0, "{pose} {relief:?}");
                    seen += light.0.len();
                }
            }
        }
    }
    assert!(seen > 0);
    // The control: a sun that is no number is seen.
    let mut frame = studio.frame(around(30.0, 0.0, 3.0), Looks::default());
    frame.uniforms.sun = [f32::NAN; 3];
    assert!(studio.light(&frame).unwrap().unlit() > 100, "the control must fail");
}

#[test]
fn every_scene_is_drawn_by_every_knob_and_at_odd_numbers() {
    let odd = Horizon { strength: f32::NAN, height_bias: 9.0, safe_threshold: -1.0, falloff: f32::INFINITY };
    let rows = [
        ReliefKnobs::default(),
        ReliefKnobs {
            silhouette: Silhouette::Rectangle,
            shadow: ReliefShadow::Hard,
            ..knobs(ReliefTier::Linear)
        },
        ReliefKnobs {
            silhouette: Silhouette::Horizon,
            horizon: odd,
            depth: true,
            ..knobs(ReliefTier::Cones)
        },
        ReliefKnobs {
            silhouette: Silhouette::Shell,
            depth: true,
            amplitude: f32::NAN,
            ..knobs(ReliefTier::Pyramid)
        },
    ];
    for scene in SCENES {
        let Some(mut studio) = studio(scene, (160, 90)) else { return };
        let mut of = |relief, show| {
            let frame = studio.frame(scene.start(), Looks { relief, show, ..Looks::default() });
            let light = studio.light(&frame).unwrap();
            assert_eq!(light.unlit(), 0, "{scene:?} {show:?} {relief:?}");
            light
        };
        let standard = of(rows[0], Show::Picture);
        for relief in &rows[1..] {
            let changed = of(*relief, Show::Picture).differing(&standard).count();
            assert!(changed > 0, "{scene:?}: {relief:?} changes nothing");
        }
        for show in [Show::Error, Show::Normals, Show::Levels, Show::Wireframe] {
            assert!(of(rows[0], show).differing(&standard).count() > 1000, "{scene:?} {show:?}");
        }
    }
}

/// A set of one colour whose heights are stripes.
fn striped() -> OwnMaterials {
    let texel = |index: usize| shaders::layout::BakeTexel {
        albedo: [0.8, 0.05, 0.6],
        height: f32::from(u8::from(index % 64 < 32)),
        normal: [0.0; 2],
        roughness: 0.9,
        occlusion: 1.0,
    };
    let texels = (0..MATERIAL_TEXELS).map(texel).collect();
    let mut sets: [Option<OwnMaterial>; 7] = Default::default();
    sets[LAYER as usize] = Some(OwnMaterial { texels, normals_given: false, occlusion_given: false });
    Arc::new(sets)
}

#[test]
fn a_users_textures_cover_the_objects_of_every_scene() {
    for scene in SCENES {
        let base = options(scene, ReliefKnobs::default());
        let Some(own) = drawn(&Options { materials: striped(), ..base.clone() }) else { return };
        let Some(procedural) = drawn(&base) else { return };
        let pink = |picture: &Picture| {
            picture
                .rgba
                .chunks_exact(4)
                .filter(|pixel| {
                    pixel[0] > pixel[1].saturating_mul(2) && pixel[2] > pixel[1].saturating_mul(2)
                })
                .count()
        };
        assert!(
            pink(&own) > 200 && pink(&procedural) == 0,
            "{scene:?}: {}, {}",
            pink(&own),
            pink(&procedural)
        );
    }
}

#[test]
fn a_shell_has_the_silhouette_of_displaced_geometry_and_a_flat_plane_has_not() {
    let Some(mut studio) = studio(Scene::Pom, (480, 270)) else { return };
    for elevation_deg in [16.0, 5.0] {
        let mut overlap = |mode, silhouette, tier| {
            let knobs = ReliefKnobs { silhouette, ..knobs(tier) };
            silhouette_overlap(&mut studio, mode, knobs, elevation_deg).unwrap()
        };
        for tier in [ReliefTier::Auto, ReliefTier::Pyramid, ReliefTier::Linear] {
            let own = overlap(Mode::Knobs, Silhouette::Shell, tier);
            println!("{tier:?} at {elevation_deg} degrees: shell {own:.4}");
            assert!(own >= 0.98, "{tier:?} at {elevation_deg} degrees: {own}");
        }
        let flat = overlap(Mode::Flat, Silhouette::Shell, ReliefTier::Auto);
        let rectangle = overlap(Mode::Knobs, Silhouette::Rectangle, ReliefTier::Auto);
        println!("at {elevation_deg} degrees: flat {flat:.4}, rectangle {rectangle:.4}");
        assert!(flat < 0.98, "the control must fail: {flat} at {elevation_deg} degrees");
    }
}

#[test]
fn an_eye_inside_a_shell_still_sees_the_relief() {
    let Some(mut studio) = studio(Scene::Pom, (96, 54)) else { return };
    // The relief reaches from 0.05 m below the plane to 0.05 m above it, times the amplitude.
    let shell = ReliefKnobs { silhouette: Silhouette::Shell, amplitude: 16.0, ..knobs(ReliefTier::Pyramid) };
    for height_m in [0.4, 1.2] {
        let pose: Pose = format!("0,{height_m},0.5,0,-60").parse().unwrap();
        let seen = studio.cover(&[plane(Mode::Knobs)], pose, shell).unwrap().count();
        assert!(seen > 96 * 54 / 2, "{seen} pixels from {height_m} m");
    }
}

#[test]
fn objects_are_cut_by_the_depth_of_the_relief_where_displaced_geometry_cuts_them() {
    let Some(mut studio) = studio(Scene::Pom, (480, 270)) else { return };
    for elevation_deg in [16.0, 40.0] {
        let mut distance = |depth, silhouette| {
            let knobs = ReliefKnobs { depth, silhouette, ..knobs(ReliefTier::Pyramid) };
            cut_distance(&mut studio, knobs, elevation_deg).unwrap()
        };
        let (own, length) = distance(true, Silhouette::Shell);
        let (shallow, _) = distance(false, Silhouette::None);
        println!("{elevation_deg} degrees: with depth {own:.2} px, without {shallow:.2} px, {length} pixels");
        assert!(length > 50, "{length}");
        assert!(own <= 1.0, "p99 at {elevation_deg} degrees: {own} px");
        assert!(shallow > 1.0, "the control must fail: {shallow} px");
    }
}

#[test]
fn the_exact_walk_and_displaced_geometry_look_alike_and_flat_and_one_offset_do_not() {
    let Some(mut studio) = studio(Scene::Pom, (320, 180)) else { return };
    let pose = around(25.0, 10.0, 3.0);
    let mut of = |mode| {
        let relief = ReliefKnobs { silhouette: Silhouette::Shell, ..knobs(ReliefTier::Pyramid) };
        let light = studio.shown(&[plane(mode)], pose, relief, Show::Picture).unwrap();
        assert_eq!(light.unlit(), 0);
        studio.picture().unwrap()
    };
    let truth = of(Mode::Geometry);
    let [own, flat, offset] = [Mode::Knobs, Mode::Flat, Mode::Offset].map(|mode| apart(&of(mode), &truth));
    println!("mean difference to geometry: walk {own:.2}, flat {flat:.2}, offset {offset:.2}");
    assert!(own < 0.35 * flat && own < 0.35 * offset, "{own} against {flat} and {offset}");
}

#[test]
fn every_scene_bakes_cones_when_they_are_asked_for() {
    for scene in SCENES {
        let Some(mut studio) = studio(scene, (192, 108)) else { return };
        // The view of levels has a colour for each tier.
        let mut of = |tier| {
            let looks = Looks { relief: knobs(tier), show: Show::Levels, ..Looks::default() };
            studio.light(&studio.frame(scene.start(), looks)).unwrap()
        };
        let walk = of(ReliefTier::Pyramid);
        assert!(of(ReliefTier::Cones).differing(&walk).count() > 500, "{scene:?} has no cones");
        assert_eq!(
            of(ReliefTier::Pyramid).differing(&walk).count(),
            0,
            "{scene:?}: cones have changed the walk"
        );
    }
}

#[test]
fn cones_of_a_scene_find_what_the_exact_walk_finds_and_one_offset_does_not() {
    let Some(mut studio) = studio(Scene::Pom, (320, 180)) else { return };
    // Of the finest mip level, and of coarser ones.
    for distance_m in [3.0, 8.0] {
        let mut of = |tier| {
            let relief = ReliefKnobs { fade_px: 0.0, ..knobs(tier) };
            studio
                .shown(&[plane(Mode::Knobs)], around(25.0, 10.0, distance_m), relief, Show::Normals)
                .unwrap();
            studio.picture().unwrap()
        };
        let [walk, cones, offset] = [ReliefTier::Pyramid, ReliefTier::Cones, ReliefTier::Offset].map(&mut of);
        let (own, control) = (apart(&cones, &walk), apart(&offset, &walk));
        println!(
            "{distance_m} m: normals of cones {own:.4} off those of the walk, of one offset {control:.4}"
        );
        assert!(own < 0.25 * control, "{own} against {control} from {distance_m} m");
    }
}

/// Rows of what is seen, bit for bit, by objects and knobs.
fn of_all(studio: &mut ReliefStudio, objects: &[Object], tiling: [f32; 2], show: Show) -> Light {
    let relief =
        ReliefKnobs { tiling, silhouette: Silhouette::Shell, depth: true, ..knobs(ReliefTier::Pyramid) };
    studio.shown(objects, around(30.0, 20.0, 5.0), relief, show).unwrap()
}

#[test]
fn a_material_tiled_twice_is_one_of_tiles_half_as_large_byte_for_byte() {
    let Some(mut studio) = studio(Scene::Pom, (192, 108)) else { return };
    // In sight one after another.
    let position_m = plane(Mode::Knobs).position_m;
    let solids = objects::of(Scene::Spom).into_iter().map(|object| vec![Object { position_m, ..object }]);
    let shapes = COMPARED.map(|mode| vec![plane(mode)]).into_iter().chain(solids);
    for whole in shapes.filter(|objects| objects[0].mode != Mode::Plain) {
        let halved = [Object { tile_m: 0.5 * whole[0].tile_m, ..whole[0] }];
        for show in [Show::Picture, Show::Wireframe] {
            let tiled = of_all(&mut studio, &whole, [2.0; 2], show);
            assert_eq!(
                tiled.differing(&of_all(&mut studio, &halved, [1.0; 2], show)).count(),
                0,
                "{whole:?}"
            );
            for tiling in [[1.0, 1.0], [2.0, 1.0], [1.0, 2.0]] {
                let control = of_all(&mut studio, &whole, tiling, show).differing(&tiled).count();
                let is_seen = show == Show::Picture || whole[0].mode == Mode::Geometry;
                assert!(!is_seen || control > 300, "{tiling:?} {whole:?}: {control}");
            }
        }
    }
}

#[test]
fn tiling_leaves_metres_of_height_as_they_are() {
    let Some(mut studio) = studio(Scene::Pom, (192, 108)) else { return };
    // Seen from twice as far, everything twice as large is the same picture; its material is tiled
    // half as often, and its relief is twice as high.
    let mut of = |scale: f32, relief_m: f32, tiling: f32, mode| {
        let shape = Shape::Plane { width_m: SIDE_M * scale, height_m: SIDE_M * scale };
        let object = Object { shape, relief_m, ..plane(mode) };
        let relief = ReliefKnobs {
            tiling: [tiling; 2],
            fade_px: 0.0,
            silhouette: Silhouette::Shell,
            ..knobs(ReliefTier::Pyramid)
        };
        studio.shown(&[object], around(25.0, 10.0, 3.0 * f64::from(scale)), relief, Show::Normals).unwrap();
        studio.picture().unwrap()
    };
    // The sky depends on the height of the eye, a little.
    let differing = |one: &Picture, other: &Picture| {
        let pixels = one.rgba.chunks_exact(4).zip(other.rgba.chunks_exact(4));
        pixels.filter(|(a, b)| a.iter().zip(*b).any(|(a, b)| a.abs_diff(*b) > 4)).count()
    };
    for mode in [Mode::Knobs, Mode::Geometry] {
        let small = of(1.0, RELIEF_M, 2.0, mode);
        let same = differing(&of(2.0, 2.0 * RELIEF_M, 1.0, mode), &small);
        let control = differing(&of(2.0, RELIEF_M, 1.0, mode), &small);
        println!("{mode:?}: {same} pixels differ, {control} of a relief half as high");
        assert!(same <= 192 * 108 / 500 && control > 1_000, "{mode:?}: {same}, {control}");
    }
}

#[test]
fn a_tiled_march_meets_displaced_geometry_in_outline_light_and_depth() {
    let Some(mut studio) = studio(Scene::Pom, (320, 180)) else { return };
    // Tiles half as long along u as along v, and a vertex for every texel of both.
    let shape = Shape::Plane { width_m: 0.5 * SIDE_M, height_m: SIDE_M };
    let object = |mode| Object { shape, ..plane(mode) };
    let relief = ReliefKnobs {
        tiling: [2.0, 1.0],
        silhouette: Silhouette::Shell,
        depth: true,
        ..knobs(ReliefTier::Pyramid)
    };
    let pose = around(16.0, 30.0, 2.6);
    let mut cover = |mode| studio.cover(&[object(mode)], pose, relief).unwrap();
    let truth = cover(Mode::Geometry);
    let (own, flat) = (cover(Mode::Knobs).overlap(&truth), cover(Mode::Flat).overlap(&truth));
    println!("overlap: marched {own:.4}, flat {flat:.4}");
    assert!(own >= 0.98 && flat < 0.98, "{own}, the control must fail: {flat}");

    let pose = around(25.0, 10.0, 2.0);
    let mut of = |mode, tiling| {
        studio.shown(&[object(mode)], pose, ReliefKnobs { tiling, ..relief }, Show::Picture).unwrap();
        studio.picture().unwrap()
    };
    let truth = of(Mode::Geometry, relief.tiling);
    let own = apart(&of(Mode::Knobs, relief.tiling), &truth);
    let control = apart(&of(Mode::Knobs, [1.0, 2.0]), &truth);
    println!("mean difference to geometry: {own:.2}, of another tiling {control:.2}");
    assert!(own < 0.35 * control, "{own} against {control}");

    let ball = Object { shape: Shape::Capsule { radius_m: 0.35, half_length_m: 0.0 }, ..ball() };
    let mut line = |mode, depth| {
        let knobs = ReliefKnobs { depth, ..relief };
        studio.cut_line(&object(mode), &ball, pose, knobs).unwrap()
    };
    let truth = line(Mode::Geometry, true);
    let mut off = |depth| quantile(&line_distances(&line(Mode::Knobs, depth), &truth), 0.99);
    let (own, control) = (off(true), off(false));
    println!("line in which a ball is cut: {own} px off, without depth {control} px, {} pixels", truth.len());
    assert!(own <= 1.0 && control > 1.0 && truth.len() > 30, "{own}, the control must fail: {control}");
}

#[test]
fn light_that_differs_is_seen_to_differ() {
    let one = Light(vec![[1, 2, 3, 4]; 4]);
    let mut other = one.clone();
    assert_eq!(one.differing(&other).count(), 0);
    other.0[2][1] = 9;
    assert_eq!(one.differing(&other).count(), 1);
}
