//! Options of the viewer: what is read, and what is refused.

use super::*;
use crate::features::pom::PomSettings;
use crate::features::pom::settings::{Heights, Horizon, LoopForm, PomMethod, PomShadow, Refine, Silhouette};
use crate::features::post::{Antialias, PostSettings, Tone};
use crate::features::vegetation::VegetationSettings;
use crate::native::profile::Profile;
use std::time::Duration;

fn parse(arguments: &[&str]) -> Result<Args, clap::Error> {
    Args::try_parse_from(std::iter::once(&"tombolo-view").chain(arguments))
}

#[test]
fn the_defaults_are_a_window_over_the_island() {
    let args = parse(&[]).unwrap();
    assert_eq!(args.server().unwrap().to_string(), "ws://127.0.0.1:7580/v1/stream");
    let profile = Profile::of(&args, false);
    assert_eq!((args.size, profile.view_distance_m, profile.tolerance_px), ((1280, 720), 20_000, 2.0));
    assert_eq!(args.pose(), Scene::Island.start());
    assert!(args.follows_world() && !parse(&["--camera", "0,9,0,0,0"]).unwrap().follows_world());
    assert!(!parse(&["--scene", "grass"]).unwrap().follows_world(), "its seed is given");
    assert_eq!((args.delivery, args.digest), (Delivery::Exact, None));
}

#[test]
fn every_option_is_read() {
    let args = parse(&[
        "--connect",
        "ws://host:1/v1/stream",
        "--delivery",
        "seed",
        "--digest",
        &"0A".repeat(32),
        "--scene",
        "island",
        "--camera",
        "-1.5,2,-3,-4,-5",
        "--shot",
        "a.png",
        "--size",
        "640x360",
        "--frames",
        "7",
        "--stats",
        "s.json",
        "--view-distance",
        "4000",
        "--tolerance",
        "1.5",
        "--fov",
        "75",
        "--chunk-mb",
        "32",
        "--samples",
        "1",
        "--orbit",
        "-3",
        "--time",
        "2",
        "--show",
        "levels",
        "--sun",
        "-90,-10.5",
        "--exposure",
        "-1",
        "--shadows",
        "hard",
        "--normals",
        "mesh",
        "--tiling",
        "two-scale",
        "--diffuse",
        "lambert",
        "--visibility",
        "fast",
        "--water",
        "march",
        "--parallax-factor",
        "0.5",
        "--parallax-bias",
        "-0.25",
        "--wave-steepness",
        "2",
        "--relief",
        "linear",
        "--relief-steps",
        "4,64",
        "--relief-refine",
        "bisection",
        "--relief-refinements",
        "5",
        "--relief-loop",
        "flag",
        "--relief-heights",
        "sampler",
        "--relief-shadow",
        "soft",
        "--silhouette",
        "horizon",
        "--relief-depth",
        "--relief-pivot",
        "1",
        "--relief-amplitude",
        "2.5",
        "--relief-tiling",
        "2,0.5",
        "--relief-fade",
        "3",
        "--horizon",
        "2,0.1,0.5,3",
        "--tone",
        "neutral",
        "--auto-exposure",
        "off",
        "--bloom",
        "0.5",
        "--antialias",
        "fxaa",
        "--sharpen",
        "0.25",
        "--render-scale",
        "0.75",
        "--token-file",
        "t",
        "--timeout",
        "9",
        "--grass",
        "5",
        "--trees",
        "1",
        "--ui-scale",
        "1.5",
        "--quality",
        "high",
    ])
    .unwrap();
    assert_eq!((args.ui_scale(), args.quality), (1.5, Quality::High));
    assert_eq!((args.delivery, args.digest), (Delivery::SeedOnly, Some(WorldDigest([10; 32]))));
    let profile = Profile::of(&args, false);
    let options = profile.headless_options(&args);
    assert_eq!(options.pose.position_m.x, -1.5);
    assert_eq!(
        (options.projection.width, options.projection.height, options.projection.fov_deg),
        (640, 360, 75.0)
    );
    assert_eq!((options.frames, options.chunk_bytes, options.samples), (7, 32 << 20, 1));
    let sun = Some(SunPosition { azimuth_deg: 270.0, elevation_deg: -10.5 });
    let settings = RenderSettings {
        diffuse: Diffuse::Lambert,
        visibility: Visibility::Fast,
        tiling: Tiling::TwoScale,
        water: WaterTier::March,
        shadows: Shadows::Hard,
        normals: Normals::Mesh,
        show: Show::Levels,
        sun,
        exposure_ev: -1.0,
        waves: WaveSettings { parallax_factor: 0.5, parallax_bias_m: -0.25, steepness: 2.0 },
        plants: VegetationSettings {
            density: 5,
            range_m: 400.0,
            trees: 1,
            tree_range_m: 8000.0,
            ..VegetationSettings::STANDARD
        },
        pom: PomSettings {
            method: PomMethod::Linear,
            steps_min: 4,
            steps_max: 64,
            refine: Refine::Bisection,
            refinements: 5,
            loop_form: LoopForm::Flag,
            heights: Heights::Sampler,
            shadow: PomShadow::Soft,
            silhouette: Silhouette::Horizon,
            depth: true,
            pivot: 1.0,
            amplitude: 2.5,
            tiling: [2.0, 0.5],
            fade_px: 3.0,
            horizon: Horizon { strength: 2.0, height_bias: 0.1, safe_threshold: 0.5, falloff: 3.0 },
        },
        post: PostSettings {
            tone: Tone::Neutral,
            auto_exposure: false,
            bloom: 0.5,
            antialias: Antialias::Fxaa,
            sharpen: 0.25,
            render_scale: 0.75,
        },
    };
    assert_eq!(options.settings, settings);
    assert_eq!((options.orbit_step_deg, options.timeout), (-0.05, Duration::from_secs(9)));
}

#[test]
fn automatic_exposure_and_bloom_need_land_and_antialiasing_one_sample() {
    let post = |arguments: &[&str], samples| {
        let preset = Preset { samples, ..Preset::of(Quality::Medium, false) };
        parse(arguments).unwrap().render_settings(&preset).post
    };
    let island = post(&[], 4);
    assert!(island.auto_exposure && island.bloom > 0.0 && island.antialias == Antialias::None);
    assert_eq!(post(&[], 1), PostSettings { antialias: Antialias::Fxaa, ..island });
    assert_eq!(post(&["--scene", "water"], 4), PostSettings::default());
    assert!(post(&["--scene", "water", "--auto-exposure", "on"], 4).auto_exposure);
    assert_eq!(post(&["--antialias", "none"], 1), island);
}

#[test]
fn options_without_effect_are_named() {
    let named = |line: &str| {
        let words: Vec<_> = line.split_whitespace().collect();
        parse(&words).unwrap().without_effect()
    };
    for line in ["", "--scene grass --world-seed 7", "--timeout 9 --shot a.png", "--ui-scale 2 --digest"] {
        let line = line.replace("--digest", &format!("--digest {}", "0".repeat(64)));
        assert_eq!(named(&line), [""; 0], "{line}");
    }
    for (line, option, why) in [
        ("--world-seed 7", "--world-seed", "the server's"),
        ("--scene grass --ca-file a.pem", "--ca-file", "--connect"),
        ("--scene brick --connect ws://a/b", "--connect", "no land"),
        ("--scene brick --delivery seed", "--delivery", "no land"),
        ("--timeout 9", "--timeout", "window"),
        ("--shot a.png --ui-scale 2", "--ui-scale", "shot"),
    ] {
        let lines = named(line);
        assert_eq!(lines.len(), 1, "{line}: {lines:?}");
        assert!(lines[0].starts_with(option) && lines[0].contains(why), "{line}: {lines:?}");
    }
    assert_eq!(parse(&["--scene", "brick", "--connect", "ws://a/b"]).unwrap().server(), None);
}

#[test]
fn a_bad_option_is_refused_with_name_value_and_what_is_allowed() {
    for (option, value, allowed) in [
        ("--connect", "http://x", "ws://HOST:PORT"),
        ("--delivery", "quantised", "exact, refined, seed or quantised:METRES"),
        ("--digest", "0a", "64 hexadecimal digits"),
        ("--scene", "moon", "island"),
        ("--camera", "1,2,3", "X,Y,Z,YAW,PITCH"),
        ("--camera", "NaN,0,0,0,0", "finite"),
        ("--size", "0x10", "1 to 8192"),
        ("--size", "640", "WxH"),
        ("--frames", "0", "1"),
        ("--view-distance", "99", "100"),
        ("--tolerance", "NaN", "0.0625 to 1000"),
        ("--fov", "180", "1 to 170"),
        ("--chunk-mb", "0", "8"),
        ("--samples", "2", "1 or 4"),
        ("--sun", "90,91", "-90 to 90"),
        ("--sun", "NaN,0", "AZIMUTH,ELEVATION"),
        ("--exposure", "inf", "-8 to 8"),
        ("--show", "nothing", "wireframe"),
        ("--shadows", "long", "soft"),
        ("--water", "deep", "march"),
        ("--parallax-factor", "1.1", "0 to 1"),
        ("--parallax-bias", "NaN", "-2 to 2"),
        ("--wave-steepness", "4.5", "0 to 4"),
        ("--relief", "deep", "pyramid"),
        ("--relief-steps", "64,4", "MIN,MAX"),
        ("--relief-steps", "0,4", "MIN,MAX"),
        ("--relief-refinements", "17", "16"),
        ("--relief-pivot", "NaN", "0 to 1"),
        ("--relief-amplitude", "17", "0 to 16"),
        ("--relief-tiling", "9", "0.25 to 8"),
        ("--relief-tiling", "1,0", "0.25 to 8"),
        ("--relief-fade", "-1", "0 to 16"),
        ("--tone", "flat", "agx"),
        ("--auto-exposure", "yes", "on"),
        ("--bloom", "1.5", "0 to 1"),
        ("--antialias", "8x", "fxaa"),
        ("--sharpen", "NaN", "0 to 1"),
        ("--render-scale", "0.2", "0.25 to 2"),
        ("--horizon", "1,0,0.3", "four numbers"),
        ("--horizon", "1,0,2,2", "safe threshold"),
        ("--timeout", "0", "1"),
        ("--ui-scale", "9", "0.5 to 4"),
        ("--quality", "best", "medium"),
        ("--place", "moon", "next-island"),
    ] {
        let line = parse(&[option, value]).unwrap_err().to_string();
        for part in [option, value, allowed] {
            assert!(line.contains(part), "{option} {value}: {line} lacks {part}");
        }
    }
}
