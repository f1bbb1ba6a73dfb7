//! Layouts of the land against reflection: worlds, chunks, instances, shadows.

use super::reflected;
use crate::SHADERS;
use crate::layout::{
    BLOCK_TEXELS, CLEARANCE_RANGE, ChunkFill, EMPTY_LINK, FILL_NODES, FILL_WORKGROUP, GPU_SLOT_BYTES, LEAF,
    PATTERN_PERIOD_M, PROBE_COARSE_OCTAVES, PageNode, SKY_DARK, SKY_TRACE, SUN_RADIUS, ShadowTarget,
    SunParams, TerrainInstance, World,
};
use crate::validate::validate;
use naga::{Binding, ScalarKind, ShaderStage, TypeInner, VectorSize};
use std::mem::offset_of;

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
fn a_resident_chunk_takes_less_than_24_kib_of_the_gpu() {
    let heights = 4 * 65 * 65;
    assert!((heights + 65 * 65..24 << 10).contains(&GPU_SLOT_BYTES), "{GPU_SLOT_BYTES} bytes");
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
        ("max_height", offset_of!(SunParams, max_height)),
        ("sky", offset_of!(SunParams, sky)),
    ];
    let node = [("link", offset_of!(PageNode, link)), ("max_height", offset_of!(PageNode, max_height))];
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
