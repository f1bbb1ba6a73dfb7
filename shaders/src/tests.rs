//! Every shader against naga and Tint, every layout against reflection, and the control that must
//! fail.

use std::io::Write as _;
use std::mem::offset_of;
use std::process::{Command, Stdio};

use naga::{BinaryOperator, Binding, Expression, ScalarKind, ShaderStage, TypeInner, VectorSize};

use crate::layout::{
    Atmosphere, BAKE_WORKGROUP, BLOCK_LIST, BLOCK_TEXELS, BRDF_TERMS, Bake, BakeTexel, BrdfProbe,
    CLEARANCE_RANGE, CLUMP_BYTES, CONE_WORKGROUP, ChunkFill, ChunkWords, ConeOrder, Culling, EMPTY_LINK,
    Exposure, FAR_COUNTS, FAR_LOST, FAR_MASKS, FAR_PATCH_CELLS, FILL_NODES, FILL_WORKGROUP, FINE_PER_METRE,
    FarTrees, Field, Frame, GPU_SLOT_BYTES, GRASS_RANGE_M, GRASS_SPREAD_M, GRASS_TILT, GRID_NODES,
    INDIRECT_DRAWS, INDIRECT_PREPARE, INDIRECT_REGIONS, LEAF, MASK_BEGIN, MATERIALS, MAX_MIP_WORKGROUP,
    METER_GROUPS, MaxMipReduction, NOISE_OCTAVES, OccluderChunk, OcclusionNode, PATTERN_PERIOD_M,
    PREPARED_HEAD, PROBE_COARSE_OCTAVES, PROBE_FIXED, PROBE_MARCHED, PROBE_STEPPED, PageNode, Planting,
    PomObject, PomParams, PomProbe, PomResult, Post, RECORD_WORDS, REDUCE_WORKGROUP, SKY_DARK, SKY_TRACE,
    SUN_RADIUS, ShadowTarget, SunParams, TILING_WORKGROUP, TREE_GRID_CELLS, TerrainInstance, TilingProbe,
    VISIBILITY_WORDS, WAVE_MAP_SIDE, WAVE_WORKGROUP, WaveProbe, World,
};
use crate::validate::validate;
use crate::{SHADERS, Shader, Stage};

/// The passes of one kind.
fn passes(compute: bool) -> impl Iterator<Item = &'static Shader> {
    let computes = |shader: &&Shader| shader.entry_points.iter().all(|entry| entry.stage == Stage::Compute);
    SHADERS.all().into_iter().filter(move |shader| computes(shader) == compute)
}

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

/// Everything in a shader that the ring profile forbids: arithmetic on floats, and `/` or `%` on
/// signed integers.
fn outside_the_ring_profile(name: &str, wgsl: &str) -> Vec<String> {
    let (module, info) = validate(name, wgsl).unwrap_or_else(|complaint| panic!("{complaint}"));
    let functions = module.functions.iter().map(|(handle, function)| (function, &info[handle]));
    let entries = module.entry_points.iter().enumerate();
    let entries = entries.map(|(index, entry)| (&entry.function, info.get_entry_point(index)));
    let mut found = Vec::new();
    for (function, types) in functions.chain(entries) {
        for (handle, expression) in function.expressions.iter() {
            let scalar = types[handle].ty.inner_with(&module.types).scalar_kind();
            let divides = matches!(
                expression,
                Expression::Binary { op: BinaryOperator::Divide | BinaryOperator::Modulo, .. }
            );
            let place = function.name.as_deref().unwrap_or("an entry point");
            if divides && scalar == Some(ScalarKind::Sint) {
                found.push(format!("{place}: signed `/` or `%`"));
            }
            if scalar == Some(ScalarKind::Float) {
                found.push(format!("{place}: a float"));
            }
        }
    }
    found
}

#[test]
fn integer_passes_keep_to_the_ring_profile() {
    for shader in [SHADERS.fill_chunks, SHADERS.probe_heights, SHADERS.cull_blocks, SHADERS.scan_plants] {
        assert_eq!(
            outside_the_ring_profile(shader.name, shader.wgsl),
            Vec::<String>::new(),
            "{}",
            shader.name
        );
    }
    let float = SHADERS.probe_heights_float;
    assert!(outside_the_ring_profile(float.name, float.wgsl).iter().any(|found| found.contains("a float")));
    // The tempting way to write it.
    let tempting = SHADERS.probe_heights.wgsl.replacen("mod_trunc(probe.x, probe.y)", "probe.x % probe.y", 1);
    assert_ne!(tempting, SHADERS.probe_heights.wgsl);
    let found = outside_the_ring_profile("tempting", &tempting);
    assert!(found.len() == 1 && found[0].contains('%'), "{found:?}");
}

/// Offsets of a struct's members and its size, as a shader reads them.
fn reflected(shader: &Shader, name: &str) -> (Vec<(String, usize)>, usize) {
    let (module, _) = validate(shader.name, shader.wgsl).unwrap();
    let (_, found) = module
        .types
        .iter()
        .find(|(_, candidate)| candidate.name.as_deref() == Some(name))
        .unwrap_or_else(|| panic!("{} has no {name}", shader.name));
    let TypeInner::Struct { members, span } = &found.inner else { panic!("{name} is no struct") };
    let member = |m: &naga::StructMember| (m.name.clone().unwrap_or_default(), m.offset as usize);
    (members.iter().map(member).collect(), *span as usize)
}

#[test]
fn worlds_and_chunk_fills_have_the_layout_of_the_shaders() {
    let world = [
        ("fine_seeds".to_owned(), offset_of!(World, fine_seeds)),
        ("lattice_seeds".to_owned(), offset_of!(World, lattice_seeds)),
        ("archipelago_seed".to_owned(), offset_of!(World, archipelago_seed)),
    ];
    for shader in [&SHADERS.fill_chunks, &SHADERS.probe_heights, &SHADERS.probe_heights_float] {
        assert_eq!(reflected(shader, "World"), (world.to_vec(), size_of::<World>()), "{}", shader.name);
        let (module, _) = validate(shader.name, shader.wgsl).unwrap();
        let filling = module.entry_points.iter().filter(|entry| entry.name != "fill_pyramids");
        for entry in filling {
            assert_eq!(entry.workgroup_size, [FILL_WORKGROUP, 1, 1], "{}", entry.name);
        }
    }
    let fill = [
        ("x".to_owned(), offset_of!(ChunkFill, x)),
        ("z".to_owned(), offset_of!(ChunkFill, z)),
        ("spacing_bits".to_owned(), offset_of!(ChunkFill, spacing_bits)),
        ("octaves".to_owned(), offset_of!(ChunkFill, octaves)),
    ];
    assert_eq!(reflected(&SHADERS.fill_chunks, "ChunkFill"), (fill.to_vec(), size_of::<ChunkFill>()));
    assert!(SHADERS.fill_chunks.wgsl.contains(&format!("FILL_NODES: u32 = {FILL_NODES}u;")));
    for shader in [&SHADERS.probe_heights, &SHADERS.probe_heights_float] {
        let coarse = format!("COARSE_OCTAVES: u32 = {PROBE_COARSE_OCTAVES}u;");
        assert!(shader.wgsl.contains(&coarse), "{}", shader.name);
    }
}

/// Asserts that a struct of a shader has the members of a Rust struct where that has them.
macro_rules! assert_same_layout {
    ($shader:expr, $type:ident, $($member:ident),+ $(,)?) => {
        let expected = vec![$((stringify!($member).to_owned(), offset_of!($type, $member))),+];
        let found = reflected(&$shader, stringify!($type));
        assert_eq!(found, (expected, size_of::<$type>()), "{}", $shader.name);
    };
}

#[test]
fn pom_data_has_the_layout_of_the_shaders() {
    #[rustfmt::skip]
    assert_same_layout!(
        SHADERS.probe_pom, PomParams,
        tier, steps_min, steps_max, refine, refinements, loop_form, heights, shadow, silhouette, depth,
        pivot, amplitude, horizon,
        travel_flat, travel_offset, travel_linear, fade_px,
    );
    #[rustfmt::skip]
    assert_same_layout!(SHADERS.probe_pom, PomProbe, uv, amplitude, lod, to_eye, layer, to_sun, reserved);
    assert_same_layout!(SHADERS.probe_pom, PomResult, uv, height, residual, sun, fetches, reserved);
    assert_same_layout!(SHADERS.reduce_max_mip, MaxMipReduction, side, lod, level, reserved);
    assert_same_layout!(
        SHADERS.bake_cones,
        ConeOrder,
        side,
        lod,
        layer,
        block,
        first,
        count,
        reserved,
        directions
    );
    #[rustfmt::skip]
    assert_same_layout!(
        SHADERS.draw_pom, PomObject,
        origin_m, mode, tangent, silhouette, bitangent, shape, normal, layer, size_m, tile_m, tint,
        relief_m, repeats, reserved,
    );
    let (module, _) = validate("reduce_max_mip", SHADERS.reduce_max_mip.wgsl).unwrap();
    assert_eq!(module.entry_points[0].workgroup_size, [MAX_MIP_WORKGROUP, MAX_MIP_WORKGROUP, 1]);
    let (module, _) = validate("bake_cones", SHADERS.bake_cones.wgsl).unwrap();
    assert_eq!(module.entry_points[0].workgroup_size, [CONE_WORKGROUP, 1, 1]);
}

#[test]
fn post_data_has_the_layout_of_the_shaders() {
    for shader in [SHADERS.tonemap, SHADERS.meter_exposure, SHADERS.resample] {
        #[rustfmt::skip]
        assert_same_layout!(
            shader, Post, tone, auto_exposure, bloom, sharpen, meter, adaptation, scale,
        );
    }
    for shader in [SHADERS.tonemap, SHADERS.meter_exposure] {
        assert_same_layout!(shader, Exposure, ev, factor, is_set, reserved);
    }
    let groups = format!("GROUPS: u32 = {METER_GROUPS}u;");
    assert!(SHADERS.meter_exposure.wgsl.contains(&groups), "{groups}");
}

#[test]
fn fields_have_the_layout_and_vertices_of_the_shaders() {
    for shader in [SHADERS.draw_grass, SHADERS.draw_trees] {
        #[rustfmt::skip]
        assert_same_layout!(
            shader, Field,
            eye_x, eye_y, eye_z, kind, width_low_m, width_high_m, height_low_m, height_high_m, thin_from_m,
            widest, range_m,
            collapse_m, lod_m, wind, lean, casts, detail, stand_m, reserved,
        );
        let fine = format!("METRES_PER_FINE: f32 = 1.0 / {FINE_PER_METRE}.0;");
        assert!(shader.wgsl.contains(&fine), "{}", shader.name);
        let (module, _) = validate(shader.name, shader.wgsl).unwrap();
        // The level of detail is the pipeline's.
        let levels = module.overrides.iter().filter(|(_, level)| level.name.as_deref() == Some("LEVEL"));
        assert_eq!(levels.count(), 1, "{}", shader.name);
    }
    assert_same_layout!(SHADERS.place_far_trees, FarTrees, patches, room, begin_m, reserved);
    let far = SHADERS.place_far_trees;
    for (shader, line) in [
        (far, format!("FAR_COUNTS: u32 = {FAR_COUNTS}u;")),
        (far, format!("FAR_MASKS: u32 = {FAR_MASKS}u;")),
        (far, format!("FAR_LOST: u32 = {FAR_LOST}u;")),
        (far, format!("FAR_PATCH_CELLS: u32 = {FAR_PATCH_CELLS}u;")),
        (SHADERS.draw_grass, format!("MAX_TILT: f32 = {GRASS_TILT:?};")),
        (SHADERS.cull_clumps, format!("SPREAD: i32 = {};", (GRASS_SPREAD_M * FINE_PER_METRE as f32).ceil())),
        (SHADERS.draw_terrain, format!("GRASS_RANGE_M: f32 = {GRASS_RANGE_M:?};")),
        (SHADERS.draw_trees, "SPRAYS = vec2u(168u, 40u);".to_owned()),
        (SHADERS.place_trees, format!("TREE_GRID_CELLS: i32 = {TREE_GRID_CELLS};")),
    ] {
        assert!(shader.wgsl.contains(&line), "{line}");
    }
    assert_eq!(size_of::<[u32; 4]>(), CLUMP_BYTES);
}

#[test]
fn wave_probes_have_the_layout_of_the_shaders() {
    let probe = [
        ("place_m".to_owned(), offset_of!(WaveProbe, place_m)),
        ("footprint_m".to_owned(), offset_of!(WaveProbe, footprint_m)),
        ("strength".to_owned(), offset_of!(WaveProbe, strength)),
        ("to_eye".to_owned(), offset_of!(WaveProbe, to_eye)),
        ("eye_m".to_owned(), offset_of!(WaveProbe, eye_m)),
        ("method".to_owned(), offset_of!(WaveProbe, method)),
        ("steps".to_owned(), offset_of!(WaveProbe, steps)),
        ("floor_cosine".to_owned(), offset_of!(WaveProbe, floor_cosine)),
        ("reserved".to_owned(), offset_of!(WaveProbe, reserved)),
    ];
    assert_eq!(reflected(&SHADERS.probe_waves, "WaveProbe"), (probe.to_vec(), size_of::<WaveProbe>()));
    let (module, _) = validate("bake_waves", SHADERS.bake_waves.wgsl).unwrap();
    for entry in &module.entry_points {
        assert_eq!(entry.workgroup_size, [WAVE_WORKGROUP, WAVE_WORKGROUP, 1], "{}", entry.name);
    }
    assert!(SHADERS.bake_waves.wgsl.contains(&format!("WAVE_MAP_SIDE: u32 = {WAVE_MAP_SIDE}u;")));
    for (name, value) in [("STEPPED", PROBE_STEPPED), ("MARCHED", PROBE_MARCHED), ("FIXED", PROBE_FIXED)] {
        assert!(SHADERS.probe_waves.wgsl.contains(&format!("PROBE_{name}: u32 = {value}u;")), "{name}");
    }
}

#[test]
fn material_data_has_the_layout_and_sets_of_the_shaders() {
    let named = |names: &[(&str, usize)]| {
        names.iter().map(|(name, at)| ((*name).to_owned(), *at)).collect::<Vec<_>>()
    };
    let bake = named(&[
        ("layer", offset_of!(Bake, layer)),
        ("size", offset_of!(Bake, size)),
        ("normals_given", offset_of!(Bake, normals_given)),
        ("occlusion_given", offset_of!(Bake, occlusion_given)),
    ]);
    assert_eq!(reflected(&SHADERS.bake_materials, "Bake"), (bake, size_of::<Bake>()));
    let texel = named(&[
        ("albedo", offset_of!(BakeTexel, albedo)),
        ("height", offset_of!(BakeTexel, height)),
        ("normal", offset_of!(BakeTexel, normal)),
        ("roughness", offset_of!(BakeTexel, roughness)),
        ("occlusion", offset_of!(BakeTexel, occlusion)),
    ]);
    assert_eq!(reflected(&SHADERS.bake_materials, "BakeTexel"), (texel, size_of::<BakeTexel>()));
    let probe = named(&[
        ("anchor_m", offset_of!(TilingProbe, anchor_m)),
        ("material", offset_of!(TilingProbe, material)),
        ("tiling", offset_of!(TilingProbe, tiling)),
        ("width", offset_of!(TilingProbe, width)),
        ("height", offset_of!(TilingProbe, height)),
        ("size", offset_of!(TilingProbe, size)),
        ("period", offset_of!(TilingProbe, period)),
    ]);
    assert_eq!(reflected(&SHADERS.probe_tiling, "TilingProbe"), (probe, size_of::<TilingProbe>()));
    for (shader, expected) in [
        (SHADERS.bake_materials, [BAKE_WORKGROUP, 1, 1]),
        (SHADERS.probe_tiling, [TILING_WORKGROUP, 1, 1]),
        (SHADERS.reduce_materials, [REDUCE_WORKGROUP, REDUCE_WORKGROUP, 1]),
    ] {
        let (module, _) = validate(shader.name, shader.wgsl).unwrap();
        for entry in &module.entry_points {
            assert_eq!(entry.workgroup_size, expected, "{}: {}", shader.name, entry.name);
        }
    }
    let baking = SHADERS.bake_materials.wgsl;
    for (number, name) in MATERIALS.iter().enumerate().take(MATERIALS.len() - 1) {
        let name = name.to_uppercase();
        assert!(baking.contains(&format!("const {name}: u32 = {number}u;")), "{name}");
    }
    assert!(baking.contains(&format!("array<MaterialSet, {}>", MATERIALS.len())));
}

#[test]
fn brdf_probes_have_the_layout_of_the_shader() {
    let probe = [
        ("normal", offset_of!(BrdfProbe, normal)),
        ("roughness", offset_of!(BrdfProbe, roughness)),
        ("to_eye", offset_of!(BrdfProbe, to_eye)),
        ("f0", offset_of!(BrdfProbe, f0)),
        ("to_light", offset_of!(BrdfProbe, to_light)),
        ("gap", offset_of!(BrdfProbe, gap)),
    ];
    let probe: Vec<_> = probe.into_iter().map(|(name, offset)| (name.to_owned(), offset)).collect();
    assert_eq!(reflected(&SHADERS.probe_brdf, "BrdfProbe"), (probe, size_of::<BrdfProbe>()));
    assert!(SHADERS.probe_brdf.wgsl.contains(&format!("let first = {BRDF_TERMS}u")));
}

#[test]
fn shadow_data_has_the_layout_of_the_shader() {
    let shader = &SHADERS.trace_terrain_shadow;
    let sun_params = [
        ("toward", offset_of!(SunParams, toward)),
        ("slope_low", offset_of!(SunParams, slope_low)),
        ("slope_high", offset_of!(SunParams, slope_high)),
        ("elevation", offset_of!(SunParams, elevation)),
        ("root_bits", offset_of!(SunParams, root_bits)),
        ("columns", offset_of!(SunParams, columns)),
        ("rows", offset_of!(SunParams, rows)),
        ("top", offset_of!(SunParams, top)),
        ("sky", offset_of!(SunParams, sky)),
    ];
    let node = [("link", offset_of!(PageNode, link)), ("top", offset_of!(PageNode, top))];
    let target = [
        ("x", offset_of!(ShadowTarget, x)),
        ("z", offset_of!(ShadowTarget, z)),
        ("slot", offset_of!(ShadowTarget, slot)),
        ("level", offset_of!(ShadowTarget, level)),
    ];
    let named = |fields: &[(&str, usize)]| {
        fields.iter().map(|(name, offset)| ((*name).to_owned(), *offset)).collect()
    };
    assert_eq!(reflected(shader, "SunParams"), (named(&sun_params), size_of::<SunParams>()));
    assert_eq!(reflected(shader, "PageNode"), (named(&node), size_of::<PageNode>()));
    assert_eq!(reflected(shader, "ShadowTarget"), (named(&target), size_of::<ShadowTarget>()));
    let (module, _) = validate(shader.name, shader.wgsl).unwrap();
    assert_eq!(module.entry_points[0].workgroup_size, [FILL_WORKGROUP, 1, 1]);
    for line in [
        format!("SKY_TRACE: u32 = {SKY_TRACE}u"),
        format!("SKY_DARK: u32 = {SKY_DARK}u"),
        format!("LEAF: u32 = {LEAF}u"),
        format!("EMPTY_LINK: u32 = {EMPTY_LINK}u"),
        format!("BLOCK_TEXELS: u32 = {BLOCK_TEXELS}u"),
        format!("SUN_RADIUS: f32 = {SUN_RADIUS}"),
        format!("CLEARANCE_RANGE: f32 = {CLEARANCE_RANGE:?}"),
    ] {
        assert!(shader.wgsl.contains(&line), "{line}");
    }
}

#[test]
fn a_resident_chunk_takes_less_than_24_kib_of_the_gpu() {
    let heights = 4 * 65 * 65;
    assert!((heights + 65 * 65..24 << 10).contains(&GPU_SLOT_BYTES), "{GPU_SLOT_BYTES} bytes");
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

#[test]
fn frame_uniforms_have_the_layout_of_the_shaders() {
    let expected = [
        ("clip_from_camera", offset_of!(Frame, clip_from_camera)),
        ("ray_right", offset_of!(Frame, ray_right)),
        ("time_s", offset_of!(Frame, time_s)),
        ("ray_up", offset_of!(Frame, ray_up)),
        ("eye_height_m", offset_of!(Frame, eye_height_m)),
        ("ray_forward", offset_of!(Frame, ray_forward)),
        ("view_distance_m", offset_of!(Frame, view_distance_m)),
        ("sun", offset_of!(Frame, sun)),
        ("exposure", offset_of!(Frame, exposure)),
        ("eye_fraction_m", offset_of!(Frame, eye_fraction_m)),
        ("pixel", offset_of!(Frame, pixel)),
        ("pattern_eye_m", offset_of!(Frame, pattern_eye_m)),
        ("viewport", offset_of!(Frame, viewport)),
        ("diffuse", offset_of!(Frame, diffuse)),
        ("visibility", offset_of!(Frame, visibility)),
        ("tiling", offset_of!(Frame, tiling)),
        ("water_tier", offset_of!(Frame, water_tier)),
        ("shadows", offset_of!(Frame, shadows)),
        ("show", offset_of!(Frame, show)),
        ("pixels_per_radian", offset_of!(Frame, pixels_per_radian)),
        ("tolerance_px", offset_of!(Frame, tolerance_px)),
        ("parallax_factor", offset_of!(Frame, parallax_factor)),
        ("parallax_bias_m", offset_of!(Frame, parallax_bias_m)),
        ("wave_steepness", offset_of!(Frame, wave_steepness)),
        ("grass", offset_of!(Frame, grass)),
        ("pom", offset_of!(Frame, pom)),
        ("atmosphere", offset_of!(Frame, atmosphere)),
    ];
    let expected: Vec<_> = expected.into_iter().map(|(name, offset)| (name.to_owned(), offset)).collect();
    let atmosphere = [
        ("sun", offset_of!(Atmosphere, sun)),
        ("sun_aloft", offset_of!(Atmosphere, sun_aloft)),
        ("toward", offset_of!(Atmosphere, toward)),
        ("away", offset_of!(Atmosphere, away)),
        ("upward", offset_of!(Atmosphere, upward)),
        ("manifold", offset_of!(Atmosphere, manifold)),
        ("sky_mean", offset_of!(Atmosphere, sky_mean)),
        ("sky_east", offset_of!(Atmosphere, sky_east)),
        ("sky_up", offset_of!(Atmosphere, sky_up)),
        ("sky_south", offset_of!(Atmosphere, sky_south)),
    ];
    let atmosphere: Vec<_> = atmosphere.into_iter().map(|(name, offset)| (name.to_owned(), offset)).collect();
    // Filters of finished colours know no frame.
    let filters = ["antialias", "filter_bloom", "resample"];
    let drawing = passes(false).filter(|shader| !filters.contains(&shader.name));
    let computing = [
        &SHADERS.integrate_sky,
        &SHADERS.light_trees,
        &SHADERS.meter_exposure,
        &SHADERS.place_trees,
        &SHADERS.prepare_grass,
        &SHADERS.prepare_trees,
        &SHADERS.probe_atmosphere,
        &SHADERS.probe_tree_shade,
        &SHADERS.probe_waves,
    ];
    for shader in drawing.chain(computing) {
        assert_eq!(reflected(shader, "Frame"), (expected.clone(), size_of::<Frame>()), "{}", shader.name);
        assert_eq!(
            reflected(shader, "Atmosphere"),
            (atmosphere.clone(), size_of::<Atmosphere>()),
            "{}",
            shader.name
        );
    }
}

#[test]
fn terrain_instances_have_the_attributes_of_the_shader() {
    let (module, _) = validate("draw_terrain", SHADERS.draw_terrain.wgsl).unwrap();
    let (_, instance) =
        module.types.iter().find(|(_, candidate)| candidate.name.as_deref() == Some("Instance")).unwrap();
    let TypeInner::Struct { members, .. } = &instance.inner else { panic!("Instance is no struct") };
    assert_eq!(members.len(), TerrainInstance::ATTRIBUTES.len());
    for (member, attribute) in members.iter().zip(TerrainInstance::ATTRIBUTES) {
        let Some(Binding::Location { location, .. }) = member.binding else { panic!("no location") };
        assert_eq!(location, attribute.location);
        let TypeInner::Vector { size, scalar } = module.types[member.ty].inner else { panic!("no vector") };
        let components = match size {
            VectorSize::Bi => 2,
            VectorSize::Tri => 3,
            VectorSize::Quad => 4,
        };
        assert_eq!(components, attribute.components);
        assert_eq!(scalar.width, 4);
        assert_eq!(scalar.kind == ScalarKind::Float, attribute.float);
        assert!(attribute.offset + 4 * components as usize <= size_of::<TerrainInstance>());
    }
    assert!(module.entry_points.iter().any(|entry| entry.stage == ShaderStage::Vertex));
}

#[test]
fn terrain_constants_are_the_same_in_rust_and_wgsl() {
    let terrain = SHADERS.draw_terrain.wgsl;
    assert!(SHADERS.draw_water.wgsl.contains(&format!("PATTERN_PERIOD_M: f32 = {PATTERN_PERIOD_M}.0;")));
    for line in ["VERTICES: u32 = 65u", "VERTEX_COUNT: u32 = 4225u", "CELLS: u32 = 64u"] {
        assert!(terrain.contains(line), "{line}");
    }
}

#[test]
fn culling_data_has_the_layout_of_the_shaders() {
    for shader in [&SHADERS.cull_blocks, &SHADERS.cull_clumps] {
        assert_same_layout!(
            shader,
            Culling,
            eye,
            path,
            planes,
            start,
            occlusion_enabled,
            step,
            stay,
            corner,
            frame,
            archipelago_seed,
            land_seeds,
            stretch,
        );
        assert_same_layout!(
            shader,
            Planting,
            kind,
            seed,
            cell_bits,
            per_cell,
            cell_x,
            cell_z,
            width_low,
            width_span,
            height_low,
            height_span,
            thin_from,
            widest,
            reach,
            over,
            range,
            collapse,
            detail,
            wind_reach,
            lean_reach,
            draw_distance_squared,
            vertices,
            room,
        );
        assert_same_layout!(shader, OcclusionNode, top, bottom, chunk, reserved);
        assert_same_layout!(shader, OccluderChunk, words, x, z);
        assert_same_layout!(shader, ChunkWords, slot, parent_slot, edges, corners, inside, place);
        for constant in
            [format!("GRID_NODES: i32 = {GRID_NODES}"), format!("RECORD_WORDS: u32 = {RECORD_WORDS}u")]
        {
            assert!(shader.wgsl.contains(&constant), "{}: {constant}", shader.name);
        }
    }
    for shader in [&SHADERS.cull_blocks, &SHADERS.cull_clumps] {
        assert!(shader.wgsl.contains(&format!("BLOCK_LIST: u32 = {BLOCK_LIST}u")), "{}", shader.name);
    }
    let regions = format!("REGIONS: u32 = {INDIRECT_REGIONS}u");
    assert!(SHADERS.scan_plants.wgsl.contains(&regions));
    for shader in [&SHADERS.prepare_grass, &SHADERS.prepare_trees] {
        for constant in [
            format!("DRAWS: u32 = {}u", INDIRECT_DRAWS / 4),
            format!("REGIONS: u32 = {}u", INDIRECT_REGIONS / 4),
            format!("PREPARED_HEAD: u32 = {PREPARED_HEAD}u"),
        ] {
            assert!(shader.wgsl.contains(&constant), "{}: {constant}", shader.name);
        }
    }
    let prepare = format!("PREPARE: u32 = {INDIRECT_PREPARE}u");
    assert!(SHADERS.scan_plants.wgsl.contains(&prepare));
    let octaves = format!("OCTAVES_OF_NOISE: u32 = {NOISE_OCTAVES}u;");
    assert!(SHADERS.cull_clumps.wgsl.contains(&octaves));
    for shader in [&SHADERS.cull_clumps, &SHADERS.scan_plants] {
        for constant in [
            format!("VISIBILITY_WORDS: u32 = {VISIBILITY_WORDS}u"),
            format!("MASK_BEGIN: u32 = {MASK_BEGIN}u"),
        ] {
            assert!(shader.wgsl.contains(&constant), "{}: {constant}", shader.name);
        }
    }
}
