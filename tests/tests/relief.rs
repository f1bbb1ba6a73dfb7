//! Parallax scenes: identities byte for byte, extreme settings and cameras, and outlines and depths
//! against displaced geometry.

use client::camera::Pose;
use client::features::materials::{CustomMaterial, CustomMaterials, MATERIAL_TEXELS};
use client::features::pom::PomSettings;
use client::features::pom::settings::{Heights, Horizon, LoopForm, PomMethod, PomShadow, Refine, Silhouette};
use client::features::post::Tone;
use client::gpu::Image;
use client::headless::{self, Options};
use client::scene::Scene;
use client::scene::objects;
use client::scene::objects::{COMPARED, LAYER, Mode, Object, Shape};
use client::settings::{RenderSettings, Show};
use lab::pom::renderer::{
    Light, PomRenderer, RELIEF_M, SIDE_M, around, ball, cut_distance, line_distances, plane,
    silhouette_overlap,
};
use lab::stats::quantile;
use std::sync::Arc;
use std::time::Instant;

const SCENES: [Scene; 3] = [Scene::Pom, Scene::Brick, Scene::Spom];

fn renderer(scene: Scene, size: (u32, u32)) -> Option<PomRenderer> {
    tests::gpu_or_skip(PomRenderer::open(scene, size))
}

fn drawn(options: &Options) -> Option<Image> {
    let rendered = headless::render_local(options, Instant::now());
    let (picture, stats) = tests::rendering::rendered_or_skip(rendered)?;
    assert_eq!((stats.chunks_drawn, stats.bytes_received, stats.delivery), (0, 0, "none"));
    Some(picture)
}

fn options(scene: Scene, relief: PomSettings) -> Options {
    let mut options = Options { scene, pose: scene.start(), samples: 1, ..Options::default() };
    (options.projection.width, options.projection.height) = (160, 90);
    options.settings.pom = relief;
    options
}

fn pom_settings(method: PomMethod) -> PomSettings {
    PomSettings { method, ..PomSettings::default() }
}

/// Mean difference of two pictures, all channels, of 255.
fn apart(one: &Image, other: &Image) -> f64 {
    let sum: u64 = one.rgba.iter().zip(&other.rgba).map(|(a, b)| u64::from(a.abs_diff(*b))).sum();
    sum as f64 / one.rgba.len().max(1) as f64
}

const TIERS: [PomMethod; 6] = [
    PomMethod::Flat,
    PomMethod::Offset,
    PomMethod::Linear,
    PomMethod::Cones,
    PomMethod::MaxMip,
    PomMethod::Auto,
];

#[test]
fn without_amplitude_every_tier_draws_the_flat_plane_byte_for_byte() {
    let Some(mut renderer) = renderer(Scene::Pom, (192, 108)) else { return };
    let pose = around(16.0, 20.0, 3.5);
    let mut of = |mode, relief| renderer.shown(&[plane(mode)], pose, relief, Show::Image).unwrap();
    for tier in TIERS {
        for silhouette in [Silhouette::None, Silhouette::Shell] {
            for (depth, tiling) in [(false, [1.0; 2]), (true, [1.0; 2]), (true, [3.0, 0.7])] {
                let none = PomSettings { amplitude: 0.0, silhouette, depth, tiling, ..pom_settings(tier) };
                let flat = of(Mode::Flat, none);
                assert_eq!(of(Mode::Settings, none).differing(&flat).count(), 0, "{none:?}");
            }
        }
        // Control: with its amplitude it is another picture, unless it is the flat tier.
        let changed =
            of(Mode::Settings, pom_settings(tier)).differing(&of(Mode::Flat, pom_settings(tier))).count();
        assert_eq!(changed == 0, tier == PomMethod::Flat, "{tier:?}: {changed} pixels");
    }
}

#[test]
fn a_faded_relief_equals_the_flat_plane_byte_for_byte() {
    let Some(mut renderer) = renderer(Scene::Pom, (192, 108)) else { return };
    // The highest relief of the scene is less than 8 pixels high from here.
    let pose = around(20.0, 20.0, 4.5);
    let mut differing = |fade_px| {
        let relief = PomSettings { fade_px, ..PomSettings::default() };
        let mut of = |mode| renderer.shown(&[plane(mode)], pose, relief, Show::Image).unwrap();
        of(Mode::Settings).differing(&of(Mode::Flat)).count()
    };
    assert_eq!(differing(16.0), 0);
    let whole = differing(0.0);
    assert!(whole > 500, "the control must fail: {whole}");
}

#[test]
fn a_loop_with_a_flag_equals_one_with_an_early_exit() {
    let Some(mut renderer) = renderer(Scene::Pom, (192, 108)) else { return };
    let pose = around(12.0, -35.0, 3.0);
    for refine in [Refine::None, Refine::Segment, Refine::Secant, Refine::Bisection] {
        for heights in [Heights::Exact, Heights::Sampler] {
            let exit = PomSettings { refine, heights, ..pom_settings(PomMethod::Linear) };
            let flag = PomSettings { loop_form: LoopForm::Flag, ..exit };
            let mut of =
                |relief| renderer.shown(&[plane(Mode::Settings)], pose, relief, Show::Image).unwrap();
            let (left, ran) = (of(exit), of(flag));
            assert_eq!(left.differing(&ran).count(), 0, "{refine:?} {heights:?}");
            // Control: another number of steps is another picture.
            let fewer = of(PomSettings { steps_min: 2, steps_max: 3, ..exit });
            assert!(left.differing(&fewer).count() > 100, "{refine:?} {heights:?}");
        }
    }
}

/// Degenerate cameras: straight down, along the plane, at its height, in the relief, under it.
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
fn light_is_finite_for_every_camera_amplitude_and_step_count() {
    let Some(mut renderer) = renderer(Scene::Pom, (64, 36)) else { return };
    let silhouettes = [Silhouette::None, Silhouette::Rectangle, Silhouette::Horizon, Silhouette::Shell];
    let shadows = [PomShadow::Hard, PomShadow::Soft];
    let (mut index, mut seen) = (0, 0);
    for pose in odd_poses() {
        // Relative to a tile of 5 m, whose relief is 0.1 m.
        for amplitude in [1e-6, 0.05, 0.5, 10.0f32] {
            for steps in [1, 256] {
                for tier in [PomMethod::Linear, PomMethod::Auto, PomMethod::Offset] {
                    let relief = PomSettings {
                        amplitude,
                        steps_min: steps,
                        steps_max: steps,
                        silhouette: silhouettes[index % 4],
                        shadow: shadows[index % 2],
                        depth: index % 3 == 0,
                        pivot: [0.5, 0.0, 1.0][index % 3],
                        tiling: [[1.0, 1.0], [8.0, 0.25], [0.25, 8.0]][index / 3 % 3],
                        ..pom_settings(tier)
                    };
                    index += 1;
                    let mut everything = objects::of(Scene::Spom);
                    everything.extend([plane(Mode::Settings), plane(Mode::Geometry)]);
                    let light = renderer.shown(&everything, pose, relief, Show::Image).unwrap();
                    assert_eq!(light.unlit(), 0, "{pose} {relief:?}");
                    seen += light.0.len();
                }
            }
        }
    }
    assert!(seen > 0);
    // Control: a NaN sun is detected.
    let mut frame = renderer.frame(around(30.0, 0.0, 3.0), RenderSettings::default());
    frame.uniforms.sun = [f32::NAN; 3];
    assert!(renderer.light(&frame).unwrap().unlit() > 100, "the control must fail");
}

#[test]
fn every_scene_is_drawn_with_every_setting_and_with_nan() {
    let odd = Horizon { strength: f32::NAN, height_bias: 9.0, safe_threshold: -1.0, falloff: f32::INFINITY };
    let rows = [
        PomSettings::default(),
        PomSettings {
            silhouette: Silhouette::Rectangle,
            shadow: PomShadow::Hard,
            ..pom_settings(PomMethod::Linear)
        },
        PomSettings {
            silhouette: Silhouette::Horizon,
            horizon: odd,
            depth: true,
            ..pom_settings(PomMethod::Cones)
        },
        PomSettings {
            silhouette: Silhouette::Shell,
            depth: true,
            amplitude: f32::NAN,
            ..pom_settings(PomMethod::MaxMip)
        },
    ];
    for scene in SCENES {
        let Some(mut renderer) = renderer(scene, (160, 90)) else { return };
        let mut of = |relief, show| {
            let frame = renderer
                .frame(scene.start(), RenderSettings { pom: relief, show, ..RenderSettings::default() });
            let light = renderer.light(&frame).unwrap();
            assert_eq!(light.unlit(), 0, "{scene:?} {show:?} {relief:?}");
            light
        };
        let standard = of(rows[0], Show::Image);
        for relief in &rows[1..] {
            let changed = of(*relief, Show::Image).differing(&standard).count();
            assert!(changed > 0, "{scene:?}: {relief:?} changes nothing");
        }
        for show in [Show::Error, Show::Normals, Show::Levels, Show::Wireframe] {
            assert!(of(rows[0], show).differing(&standard).count() > 1000, "{scene:?} {show:?}");
        }
    }
}

/// A set of one colour whose heights are stripes.
fn striped() -> CustomMaterials {
    let texel = |index: usize| shaders::layout::BakeTexel {
        albedo: [0.8, 0.05, 0.6],
        height: f32::from(u8::from(index % 64 < 32)),
        normal: [0.0; 2],
        roughness: 0.9,
        occlusion: 1.0,
    };
    let texels = (0..MATERIAL_TEXELS).map(texel).collect();
    let mut sets: [Option<CustomMaterial>; 7] = Default::default();
    sets[LAYER as usize] = Some(CustomMaterial { texels, normals_given: false, occlusion_given: false });
    Arc::new(sets)
}

#[test]
fn a_users_textures_cover_the_objects_of_every_scene() {
    for scene in SCENES {
        // A curve that keeps saturated colours.
        let mut base = options(scene, PomSettings::default());
        base.settings.post.tone = Tone::Filmic;
        let Some(own) = drawn(&Options { materials: striped(), ..base.clone() }) else { return };
        let Some(procedural) = drawn(&base) else { return };
        let pink = |picture: &Image| {
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
fn a_shell_has_the_silhouette_of_displaced_geometry() {
    let Some(mut renderer) = renderer(Scene::Pom, (480, 270)) else { return };
    for elevation_deg in [16.0, 5.0] {
        let mut overlap = |mode, silhouette, tier| {
            let settings = PomSettings { silhouette, ..pom_settings(tier) };
            silhouette_overlap(&mut renderer, mode, settings, elevation_deg).unwrap()
        };
        for tier in [PomMethod::Auto, PomMethod::MaxMip, PomMethod::Linear] {
            let own = overlap(Mode::Settings, Silhouette::Shell, tier);
            println!("{tier:?} at {elevation_deg} degrees: shell {own:.4}");
            assert!(own >= 0.98, "{tier:?} at {elevation_deg} degrees: {own}");
        }
        let flat = overlap(Mode::Flat, Silhouette::Shell, PomMethod::Auto);
        let rectangle = overlap(Mode::Settings, Silhouette::Rectangle, PomMethod::Auto);
        println!("at {elevation_deg} degrees: flat {flat:.4}, rectangle {rectangle:.4}");
        assert!(flat < 0.98, "the control must fail: {flat} at {elevation_deg} degrees");
    }
}

#[test]
fn an_eye_inside_a_shell_sees_the_relief() {
    let Some(mut renderer) = renderer(Scene::Pom, (96, 54)) else { return };
    // The relief reaches from 0.05 m below the plane to 0.05 m above it, times the amplitude.
    let shell =
        PomSettings { silhouette: Silhouette::Shell, amplitude: 16.0, ..pom_settings(PomMethod::MaxMip) };
    for height_m in [0.4, 1.2] {
        let pose: Pose = format!("0,{height_m},0.5,0,-60").parse().unwrap();
        let seen = renderer.cover(&[plane(Mode::Settings)], pose, shell).unwrap().count();
        assert!(seen > 96 * 54 / 2, "{seen} pixels from {height_m} m");
    }
}

#[test]
fn relief_depth_cuts_objects_where_displaced_geometry_does() {
    let Some(mut renderer) = renderer(Scene::Pom, (480, 270)) else { return };
    for elevation_deg in [16.0, 40.0] {
        let mut distance = |depth, silhouette| {
            let settings = PomSettings { depth, silhouette, ..pom_settings(PomMethod::MaxMip) };
            cut_distance(&mut renderer, settings, elevation_deg).unwrap()
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
fn maximum_mipmap_traversal_resembles_displaced_geometry() {
    let Some(mut renderer) = renderer(Scene::Pom, (320, 180)) else { return };
    let pose = around(25.0, 10.0, 3.0);
    let mut of = |mode| {
        let relief = PomSettings { silhouette: Silhouette::Shell, ..pom_settings(PomMethod::MaxMip) };
        let light = renderer.shown(&[plane(mode)], pose, relief, Show::Image).unwrap();
        assert_eq!(light.unlit(), 0);
        renderer.picture().unwrap()
    };
    let reference = of(Mode::Geometry);
    let [own, flat, offset] =
        [Mode::Settings, Mode::Flat, Mode::Offset].map(|mode| apart(&of(mode), &reference));
    println!("mean difference to geometry: walk {own:.2}, flat {flat:.2}, offset {offset:.2}");
    assert!(own < 0.35 * flat && own < 0.35 * offset, "{own} against {flat} and {offset}");
}

#[test]
fn every_scene_bakes_cones_on_request() {
    for scene in SCENES {
        let Some(mut renderer) = renderer(scene, (192, 108)) else { return };
        // The view of levels has a colour for each tier.
        let mut of = |tier| {
            let settings =
                RenderSettings { pom: pom_settings(tier), show: Show::Levels, ..RenderSettings::default() };
            renderer.light(&renderer.frame(scene.start(), settings)).unwrap()
        };
        let walk = of(PomMethod::MaxMip);
        assert!(of(PomMethod::Cones).differing(&walk).count() > 500, "{scene:?} has no cones");
        assert_eq!(
            of(PomMethod::MaxMip).differing(&walk).count(),
            0,
            "{scene:?}: cones changed the traversal"
        );
    }
}

#[test]
fn cones_agree_with_maximum_mipmap_traversal() {
    let Some(mut renderer) = renderer(Scene::Pom, (320, 180)) else { return };
    // Of the finest mip level, and of coarser ones.
    for distance_m in [3.0, 8.0] {
        let mut of = |tier| {
            let relief = PomSettings { fade_px: 0.0, ..pom_settings(tier) };
            renderer
                .shown(&[plane(Mode::Settings)], around(25.0, 10.0, distance_m), relief, Show::Normals)
                .unwrap();
            renderer.picture().unwrap()
        };
        let [walk, cones, offset] = [PomMethod::MaxMip, PomMethod::Cones, PomMethod::Offset].map(&mut of);
        let (own, control) = (apart(&cones, &walk), apart(&offset, &walk));
        println!(
            "{distance_m} m: normals of cones {own:.4} off those of the walk, of one offset {control:.4}"
        );
        assert!(own < 0.25 * control, "{own} against {control} from {distance_m} m");
    }
}

/// The light of objects with a tiling.
fn of_all(renderer: &mut PomRenderer, objects: &[Object], tiling: [f32; 2], show: Show) -> Light {
    let relief =
        PomSettings { tiling, silhouette: Silhouette::Shell, depth: true, ..pom_settings(PomMethod::MaxMip) };
    renderer.shown(objects, around(30.0, 20.0, 5.0), relief, show).unwrap()
}

#[test]
fn tiling_by_two_equals_tiles_of_half_the_size() {
    let Some(mut renderer) = renderer(Scene::Pom, (192, 108)) else { return };
    // One object at a time.
    let position_m = plane(Mode::Settings).position_m;
    let solids = objects::of(Scene::Spom).into_iter().map(|object| vec![Object { position_m, ..object }]);
    let shapes = COMPARED.map(|mode| vec![plane(mode)]).into_iter().chain(solids);
    for whole in shapes.filter(|objects| objects[0].mode != Mode::Plain) {
        let halved = [Object { tile_m: 0.5 * whole[0].tile_m, ..whole[0] }];
        for show in [Show::Image, Show::Wireframe] {
            let tiled = of_all(&mut renderer, &whole, [2.0; 2], show);
            assert_eq!(
                tiled.differing(&of_all(&mut renderer, &halved, [1.0; 2], show)).count(),
                0,
                "{whole:?}"
            );
            for tiling in [[1.0, 1.0], [2.0, 1.0], [1.0, 2.0]] {
                let control = of_all(&mut renderer, &whole, tiling, show).differing(&tiled).count();
                let is_seen = show == Show::Image || whole[0].mode == Mode::Geometry;
                assert!(!is_seen || control > 300, "{tiling:?} {whole:?}: {control}");
            }
        }
    }
}

#[test]
fn tiling_does_not_change_heights_in_metres() {
    let Some(mut renderer) = renderer(Scene::Pom, (192, 108)) else { return };
    // Seen from twice as far, everything twice as large is the same picture; its material is tiled
    // half as often, and its relief is twice as high.
    let mut of = |scale: f32, relief_m: f32, tiling: f32, mode| {
        let shape = Shape::Plane { width_m: SIDE_M * scale, height_m: SIDE_M * scale };
        let object = Object { shape, relief_m, ..plane(mode) };
        let relief = PomSettings {
            tiling: [tiling; 2],
            fade_px: 0.0,
            silhouette: Silhouette::Shell,
            ..pom_settings(PomMethod::MaxMip)
        };
        renderer.shown(&[object], around(25.0, 10.0, 3.0 * f64::from(scale)), relief, Show::Normals).unwrap();
        renderer.picture().unwrap()
    };
    // The sky depends on the height of the eye, a little.
    let differing = |one: &Image, other: &Image| {
        let pixels = one.rgba.chunks_exact(4).zip(other.rgba.chunks_exact(4));
        pixels.filter(|(a, b)| a.iter().zip(*b).any(|(a, b)| a.abs_diff(*b) > 4)).count()
    };
    for mode in [Mode::Settings, Mode::Geometry] {
        let small = of(1.0, RELIEF_M, 2.0, mode);
        let same = differing(&of(2.0, 2.0 * RELIEF_M, 1.0, mode), &small);
        let control = differing(&of(2.0, RELIEF_M, 1.0, mode), &small);
        println!("{mode:?}: {same} pixels differ, {control} of a relief half as high");
        assert!(same <= 192 * 108 / 500 && control > 1_000, "{mode:?}: {same}, {control}");
    }
}

#[test]
fn a_tiled_relief_matches_displaced_geometry() {
    let Some(mut renderer) = renderer(Scene::Pom, (320, 180)) else { return };
    // Tiles half as long along u as along v, and a vertex for every texel of both.
    let shape = Shape::Plane { width_m: 0.5 * SIDE_M, height_m: SIDE_M };
    let object = |mode| Object { shape, ..plane(mode) };
    let relief = PomSettings {
        tiling: [2.0, 1.0],
        silhouette: Silhouette::Shell,
        depth: true,
        ..pom_settings(PomMethod::MaxMip)
    };
    let pose = around(16.0, 30.0, 2.6);
    let mut cover = |mode| renderer.cover(&[object(mode)], pose, relief).unwrap();
    let reference = cover(Mode::Geometry);
    let (own, flat) = (cover(Mode::Settings).overlap(&reference), cover(Mode::Flat).overlap(&reference));
    println!("overlap: marched {own:.4}, flat {flat:.4}");
    assert!(own >= 0.98 && flat < 0.98, "{own}, the control must fail: {flat}");

    let pose = around(25.0, 10.0, 2.0);
    let mut of = |mode, tiling| {
        renderer.shown(&[object(mode)], pose, PomSettings { tiling, ..relief }, Show::Image).unwrap();
        renderer.picture().unwrap()
    };
    let reference = of(Mode::Geometry, relief.tiling);
    let own = apart(&of(Mode::Settings, relief.tiling), &reference);
    let control = apart(&of(Mode::Settings, [1.0, 2.0]), &reference);
    println!("mean difference to geometry: {own:.2}, of another tiling {control:.2}");
    assert!(own < 0.35 * control, "{own} against {control}");

    let ball = Object { shape: Shape::Capsule { radius_m: 0.35, half_length_m: 0.0 }, ..ball() };
    let mut line = |mode, depth| {
        let settings = PomSettings { depth, ..relief };
        renderer.cut_line(&object(mode), &ball, pose, settings).unwrap()
    };
    let reference = line(Mode::Geometry, true);
    let mut off = |depth| quantile(&line_distances(&line(Mode::Settings, depth), &reference), 0.99);
    let (own, control) = (off(true), off(false));
    println!(
        "line in which a ball is cut: {own} px off, without depth {control} px, {} pixels",
        reference.len()
    );
    assert!(own <= 1.0 && control > 1.0 && reference.len() > 30, "{own}, the control must fail: {control}");
}

#[test]
fn differing_light_is_counted() {
    let one = Light(vec![[1, 2, 3, 4]; 4]);
    let mut other = one.clone();
    assert_eq!(one.differing(&other).count(), 0);
    other.0[2][1] = 9;
    assert_eq!(one.differing(&other).count(), 1);
}
