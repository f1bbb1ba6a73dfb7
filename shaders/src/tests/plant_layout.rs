//! Layouts of plants against reflection: drawing and culling.

use super::{assert_same_layout, reflected};
use crate::SHADERS;
use crate::layout::{
    BLOCK_LIST, CLUMP_BYTES, ChunkWords, Culling, FAR_COUNTS, FAR_LOST, FAR_MASKS, FAR_PATCH_CELLS,
    FINE_PER_METRE, FarTrees, Field, GRASS_RANGE_M, GRASS_SPREAD_M, GRASS_TILT, GRID_NODES, INDIRECT_DRAWS,
    INDIRECT_PREPARE, INDIRECT_REGIONS, MASK_BEGIN, NOISE_OCTAVES, OccluderChunk, OcclusionNode,
    PREPARED_HEAD, Planting, RECORD_WORDS, TREE_CELL_M, VISIBILITY_WORDS,
};
use crate::validate::validate;
use std::mem::offset_of;

#[test]
fn fields_have_the_layout_and_vertices_of_the_shaders() {
    for shader in [SHADERS.draw_grass, SHADERS.draw_trees] {
        #[rustfmt::skip]
        assert_same_layout!(
            shader, Field,
            eye_x, eye_y, eye_z, kind, width_low_m, width_high_m, height_low_m, height_high_m, thin_from_m,
            widest, range_m,
            collapse_m, lod_m, wind, lean, casts, detail, stand_m, tree_grid_cells,
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
        (SHADERS.place_trees, format!("TREE_CELL_M: f32 = {TREE_CELL_M:?};")),
    ] {
        assert!(shader.wgsl.contains(&line), "{line}");
    }
    assert_eq!(size_of::<[u32; 4]>(), CLUMP_BYTES);
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
