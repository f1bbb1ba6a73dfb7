//! Layouts of surfaces against reflection: materials, reflection, parallax, waves.

use super::{assert_same_layout, reflected};
use crate::SHADERS;
use crate::layout::{
    BAKE_WORKGROUP, BRDF_TERMS, Bake, BakeTexel, BrdfProbe, CONE_WORKGROUP, ConeOrder, MATERIALS,
    MAX_MIP_WORKGROUP, MaxMipReduction, PROBE_FIXED, PROBE_MARCHED, PROBE_STEPPED, PomObject, PomParams,
    PomProbe, PomResult, REDUCE_WORKGROUP, TILING_WORKGROUP, TilingProbe, WAVE_MAP_SIDE, WAVE_WORKGROUP,
    WaveProbe,
};
use crate::validate::validate;
use std::mem::offset_of;

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
