//! Every shader against naga and Tint, with controls that must fail.

use super::passes;
use crate::validate::validate;
use crate::{SHADERS, Stage};
use std::io::Write as _;
use std::process::{Command, Stdio};

#[test]
fn every_shader_is_portable_and_either_computes_or_draws() {
    for shader in SHADERS.all() {
        validate(shader.name, shader.wgsl).unwrap_or_else(|complaint| panic!("{complaint}"));
    }
    for shader in passes(false) {
        let stages: Vec<Stage> = shader.entry_points.iter().map(|entry| entry.stage).collect();
        // A pass may have several ways of writing what it draws; the first of each stage is the
        // usual one.
        let vertices = stages.iter().take_while(|stage| **stage == Stage::Vertex).count();
        let fragments = &stages[vertices..];
        let is_whole = !fragments.is_empty() && fragments.iter().all(|stage| *stage == Stage::Fragment);
        assert!(vertices > 0 && is_whole, "{}: {stages:?}", shader.name);
    }
    let names: Vec<&str> = passes(true).map(|shader| shader.name).collect();
    assert_eq!(
        names,
        [
            "bake_cones",
            "bake_materials",
            "bake_waves",
            "cull_blocks",
            "cull_clumps",
            "fill_chunks",
            "integrate_sky",
            "light_trees",
            "meter_exposure",
            "place_far_trees",
            "place_trees",
            "prepare_grass",
            "prepare_trees",
            "probe_atmosphere",
            "probe_brdf",
            "probe_heights",
            "probe_heights_float",
            "probe_pom",
            "probe_tiling",
            "probe_tree_shade",
            "probe_waves",
            "reduce_materials",
            "reduce_max_mip",
            "scan_plants",
            "trace_terrain_shadow",
        ]
    );
}

#[test]
fn a_broken_shader_is_rejected_with_its_name() {
    let good = SHADERS.draw_sky.wgsl;
    for broken in [
        good.replacen("vec4f(", "vec3f(", 1),
        good.replacen("return", "retrun", 1),
        format!("{good}\n@compute @workgroup_size(64) fn extra() {{ let x: i64 = 1li; }}"),
    ] {
        assert_ne!(broken, good);
        let complaint = validate("broken_sky", &broken).expect_err("a broken shader passed");
        assert!(complaint.contains("broken_sky"), "{complaint}");
    }
}

/// Whether a line has a smoothstep whose first edge is not below its second: SPIR-V leaves it
/// undefined.
fn has_reversed_smoothstep(line: &str) -> bool {
    line.split("smoothstep(").skip(1).any(|arguments| {
        let mut edges = arguments.split(',').map(|edge| edge.trim().parse::<f64>());
        matches!((edges.next(), edges.next()), (Some(Ok(low)), Some(Ok(high))) if low >= high)
    })
}

#[test]
fn no_smoothstep_has_its_edges_reversed() {
    assert!(has_reversed_smoothstep("x = smoothstep(0.2, -1.2, y);"), "a control must fail");
    for shader in SHADERS.all() {
        for line in shader.wgsl.lines() {
            assert!(!has_reversed_smoothstep(line), "{}: {line}", shader.name);
        }
    }
}

/// Whether a shader reads and writes one storage texture: an optional feature of WGSL
/// (`readonly_and_readwrite_storage_textures`).
fn has_read_write_texture(wgsl: &str) -> bool {
    wgsl.lines().any(|line| line.contains("texture_storage") && !line.contains(", write>"))
}

#[test]
fn storage_textures_are_written_only() {
    let control = "@group(0) @binding(2) var both: texture_storage_2d<r32float, read_write>;";
    assert!(has_read_write_texture(control), "a control must fail");
    for shader in SHADERS.all() {
        assert!(!has_read_write_texture(shader.wgsl), "{}", shader.name);
    }
}

/// Runs Tint on a source; `None` when it is not installed.
fn tint(name: &str, wgsl: &str) -> Option<Result<(), String>> {
    let folder = std::env::temp_dir().join(format!("tombolo-tint-{}-{name}", std::process::id()));
    std::fs::create_dir_all(&folder).expect("a temporary folder");
    let path = folder.join(format!("{name}.wgsl"));
    std::fs::File::create(&path)
        .and_then(|mut file| file.write_all(wgsl.as_bytes()))
        .expect("a temporary file");
    // Parsed, resolved and written as WGSL: the one writer that every build of Tint contains.
    let run = Command::new("tint").args(["--format", "wgsl"]).arg(&path).stdin(Stdio::null()).output();
    let outcome = match run {
        Err(error) if error.kind() == std::io::ErrorKind::NotFound => None,
        Err(error) => Some(Err(error.to_string())),
        Ok(output) if output.status.success() => Some(Ok(())),
        Ok(output) => Some(Err(String::from_utf8_lossy(&output.stderr).into_owned())),
    };
    std::fs::remove_dir_all(&folder).expect("the temporary folder");
    outcome
}

#[test]
fn every_shader_compiles_with_tint_and_a_broken_one_fails() {
    for shader in SHADERS.all() {
        let Some(outcome) = tint(shader.name, shader.wgsl) else {
            eprintln!("SKIPPED: `tint` is not on PATH; shaders were checked by naga only");
            return;
        };
        outcome.unwrap_or_else(|complaint| panic!("{}: {complaint}", shader.name));
    }
    // The second parses and has a type error: Tint validates, too.
    let good = SHADERS.draw_sky.wgsl;
    for broken in [good.replacen("return", "retrun", 1), good.replacen("vec4f(", "vec3f(", 1)] {
        assert_ne!(broken, good);
        assert!(tint("broken_sky", &broken).is_some_and(|outcome| outcome.is_err()), "a control must fail");
    }
}
