//! Every pass. Written by `cargo xtask bless shaders --write`.

use crate::{EntryPoint, Shader, Stage};

/// Every pass.
#[derive(Debug)]
pub struct Shaders {
    /// `wgsl/antialias.wesl`, linked.
    pub antialias: Shader,
    /// `wgsl/bake_cones.wesl`, linked.
    pub bake_cones: Shader,
    /// `wgsl/bake_materials.wesl`, linked.
    pub bake_materials: Shader,
    /// `wgsl/bake_waves.wesl`, linked.
    pub bake_waves: Shader,
    /// `wgsl/cull_blocks.wesl`, linked.
    pub cull_blocks: Shader,
    /// `wgsl/cull_clumps.wesl`, linked.
    pub cull_clumps: Shader,
    /// `wgsl/draw_bay.wesl`, linked.
    pub draw_bay: Shader,
    /// `wgsl/draw_far_trees.wesl`, linked.
    pub draw_far_trees: Shader,
    /// `wgsl/draw_grass.wesl`, linked.
    pub draw_grass: Shader,
    /// `wgsl/draw_plant_ids.wesl`, linked.
    pub draw_plant_ids: Shader,
    /// `wgsl/draw_pom.wesl`, linked.
    pub draw_pom: Shader,
    /// `wgsl/draw_sky.wesl`, linked.
    pub draw_sky: Shader,
    /// `wgsl/draw_terrain.wesl`, linked.
    pub draw_terrain: Shader,
    /// `wgsl/draw_trees.wesl`, linked.
    pub draw_trees: Shader,
    /// `wgsl/draw_water.wesl`, linked.
    pub draw_water: Shader,
    /// `wgsl/fill_chunks.wesl`, linked.
    pub fill_chunks: Shader,
    /// `wgsl/filter_bloom.wesl`, linked.
    pub filter_bloom: Shader,
    /// `wgsl/integrate_sky.wesl`, linked.
    pub integrate_sky: Shader,
    /// `wgsl/light_trees.wesl`, linked.
    pub light_trees: Shader,
    /// `wgsl/meter_exposure.wesl`, linked.
    pub meter_exposure: Shader,
    /// `wgsl/place_far_trees.wesl`, linked.
    pub place_far_trees: Shader,
    /// `wgsl/place_trees.wesl`, linked.
    pub place_trees: Shader,
    /// `wgsl/prepare_grass.wesl`, linked.
    pub prepare_grass: Shader,
    /// `wgsl/prepare_trees.wesl`, linked.
    pub prepare_trees: Shader,
    /// `wgsl/probe_atmosphere.wesl`, linked.
    pub probe_atmosphere: Shader,
    /// `wgsl/probe_brdf.wesl`, linked.
    pub probe_brdf: Shader,
    /// `wgsl/probe_heights.wesl`, linked.
    pub probe_heights: Shader,
    /// `wgsl/probe_heights_float.wesl`, linked.
    pub probe_heights_float: Shader,
    /// `wgsl/probe_pom.wesl`, linked.
    pub probe_pom: Shader,
    /// `wgsl/probe_tiling.wesl`, linked.
    pub probe_tiling: Shader,
    /// `wgsl/probe_tree_shade.wesl`, linked.
    pub probe_tree_shade: Shader,
    /// `wgsl/probe_waves.wesl`, linked.
    pub probe_waves: Shader,
    /// `wgsl/reduce_materials.wesl`, linked.
    pub reduce_materials: Shader,
    /// `wgsl/reduce_max_mip.wesl`, linked.
    pub reduce_max_mip: Shader,
    /// `wgsl/resample.wesl`, linked.
    pub resample: Shader,
    /// `wgsl/scan_plants.wesl`, linked.
    pub scan_plants: Shader,
    /// `wgsl/tonemap.wesl`, linked.
    pub tonemap: Shader,
    /// `wgsl/trace_terrain_shadow.wesl`, linked.
    pub trace_terrain_shadow: Shader,
}

/// Every pass, linked and validated.
pub static SHADERS: Shaders = Shaders {
    antialias: Shader {
        name: "antialias",
        wgsl: include_str!("../linked/antialias.wgsl"),
        entry_points: &[
            EntryPoint { name: "vertex", stage: Stage::Vertex },
            EntryPoint { name: "fragment", stage: Stage::Fragment },
            EntryPoint { name: "fragment_graded", stage: Stage::Fragment },
        ],
    },
    bake_cones: Shader {
        name: "bake_cones",
        wgsl: include_str!("../linked/bake_cones.wgsl"),
        entry_points: &[
            EntryPoint { name: "bake_cones", stage: Stage::Compute },
        ],
    },
    bake_materials: Shader {
        name: "bake_materials",
        wgsl: include_str!("../linked/bake_materials.wgsl"),
        entry_points: &[
            EntryPoint { name: "evaluate_recipe", stage: Stage::Compute },
            EntryPoint { name: "derive_and_store", stage: Stage::Compute },
        ],
    },
    bake_waves: Shader {
        name: "bake_waves",
        wgsl: include_str!("../linked/bake_waves.wgsl"),
        entry_points: &[
            EntryPoint { name: "bake_waves", stage: Stage::Compute },
            EntryPoint { name: "reduce_waves", stage: Stage::Compute },
        ],
    },
    cull_blocks: Shader {
        name: "cull_blocks",
        wgsl: include_str!("../linked/cull_blocks.wgsl"),
        entry_points: &[
            EntryPoint { name: "cull_blocks", stage: Stage::Compute },
        ],
    },
    cull_clumps: Shader {
        name: "cull_clumps",
        wgsl: include_str!("../linked/cull_clumps.wgsl"),
        entry_points: &[
            EntryPoint { name: "test_clumps", stage: Stage::Compute },
            EntryPoint { name: "write_clumps", stage: Stage::Compute },
        ],
    },
    draw_bay: Shader {
        name: "draw_bay",
        wgsl: include_str!("../linked/draw_bay.wgsl"),
        entry_points: &[
            EntryPoint { name: "vertex", stage: Stage::Vertex },
            EntryPoint { name: "fragment", stage: Stage::Fragment },
        ],
    },
    draw_far_trees: Shader {
        name: "draw_far_trees",
        wgsl: include_str!("../linked/draw_far_trees.wgsl"),
        entry_points: &[
            EntryPoint { name: "vertex", stage: Stage::Vertex },
            EntryPoint { name: "fragment", stage: Stage::Fragment },
            EntryPoint { name: "sampled_fragment", stage: Stage::Fragment },
        ],
    },
    draw_grass: Shader {
        name: "draw_grass",
        wgsl: include_str!("../linked/draw_grass.wgsl"),
        entry_points: &[
            EntryPoint { name: "vertex", stage: Stage::Vertex },
            EntryPoint { name: "fragment", stage: Stage::Fragment },
        ],
    },
    draw_plant_ids: Shader {
        name: "draw_plant_ids",
        wgsl: include_str!("../linked/draw_plant_ids.wgsl"),
        entry_points: &[
            EntryPoint { name: "grass_vertex", stage: Stage::Vertex },
            EntryPoint { name: "tree_vertex", stage: Stage::Vertex },
            EntryPoint { name: "far_vertex", stage: Stage::Vertex },
            EntryPoint { name: "fragment", stage: Stage::Fragment },
            EntryPoint { name: "far_fragment", stage: Stage::Fragment },
        ],
    },
    draw_pom: Shader {
        name: "draw_pom",
        wgsl: include_str!("../linked/draw_pom.wgsl"),
        entry_points: &[
            EntryPoint { name: "vertex", stage: Stage::Vertex },
            EntryPoint { name: "fragment", stage: Stage::Fragment },
            EntryPoint { name: "fragment_depth", stage: Stage::Fragment },
        ],
    },
    draw_sky: Shader {
        name: "draw_sky",
        wgsl: include_str!("../linked/draw_sky.wgsl"),
        entry_points: &[
            EntryPoint { name: "vertex", stage: Stage::Vertex },
            EntryPoint { name: "fragment", stage: Stage::Fragment },
        ],
    },
    draw_terrain: Shader {
        name: "draw_terrain",
        wgsl: include_str!("../linked/draw_terrain.wgsl"),
        entry_points: &[
            EntryPoint { name: "vertex", stage: Stage::Vertex },
            EntryPoint { name: "fragment", stage: Stage::Fragment },
            EntryPoint { name: "fragment_inspected", stage: Stage::Fragment },
        ],
    },
    draw_trees: Shader {
        name: "draw_trees",
        wgsl: include_str!("../linked/draw_trees.wgsl"),
        entry_points: &[
            EntryPoint { name: "vertex", stage: Stage::Vertex },
            EntryPoint { name: "far_vertex", stage: Stage::Vertex },
            EntryPoint { name: "fragment", stage: Stage::Fragment },
            EntryPoint { name: "sampled_fragment", stage: Stage::Fragment },
            EntryPoint { name: "far_fragment", stage: Stage::Fragment },
            EntryPoint { name: "sampled_far_fragment", stage: Stage::Fragment },
        ],
    },
    draw_water: Shader {
        name: "draw_water",
        wgsl: include_str!("../linked/draw_water.wgsl"),
        entry_points: &[
            EntryPoint { name: "vertex", stage: Stage::Vertex },
            EntryPoint { name: "fragment", stage: Stage::Fragment },
            EntryPoint { name: "fragment_below", stage: Stage::Fragment },
        ],
    },
    fill_chunks: Shader {
        name: "fill_chunks",
        wgsl: include_str!("../linked/fill_chunks.wgsl"),
        entry_points: &[
            EntryPoint { name: "fill_nodes", stage: Stage::Compute },
            EntryPoint { name: "fill_heights", stage: Stage::Compute },
            EntryPoint { name: "fill_pyramids", stage: Stage::Compute },
        ],
    },
    filter_bloom: Shader {
        name: "filter_bloom",
        wgsl: include_str!("../linked/filter_bloom.wgsl"),
        entry_points: &[
            EntryPoint { name: "vertex", stage: Stage::Vertex },
            EntryPoint { name: "fragment_first", stage: Stage::Fragment },
            EntryPoint { name: "fragment_down", stage: Stage::Fragment },
            EntryPoint { name: "fragment_up", stage: Stage::Fragment },
        ],
    },
    integrate_sky: Shader {
        name: "integrate_sky",
        wgsl: include_str!("../linked/integrate_sky.wgsl"),
        entry_points: &[
            EntryPoint { name: "integrate_sky", stage: Stage::Compute },
        ],
    },
    light_trees: Shader {
        name: "light_trees",
        wgsl: include_str!("../linked/light_trees.wgsl"),
        entry_points: &[
            EntryPoint { name: "light_trees", stage: Stage::Compute },
        ],
    },
    meter_exposure: Shader {
        name: "meter_exposure",
        wgsl: include_str!("../linked/meter_exposure.wgsl"),
        entry_points: &[
            EntryPoint { name: "meter_light", stage: Stage::Compute },
            EntryPoint { name: "adapt_exposure", stage: Stage::Compute },
        ],
    },
    place_far_trees: Shader {
        name: "place_far_trees",
        wgsl: include_str!("../linked/place_far_trees.wgsl"),
        entry_points: &[
            EntryPoint { name: "count_far_trees", stage: Stage::Compute },
            EntryPoint { name: "scan_far_trees", stage: Stage::Compute },
            EntryPoint { name: "write_far_trees", stage: Stage::Compute },
        ],
    },
    place_trees: Shader {
        name: "place_trees",
        wgsl: include_str!("../linked/place_trees.wgsl"),
        entry_points: &[
            EntryPoint { name: "place", stage: Stage::Compute },
            EntryPoint { name: "mark", stage: Stage::Compute },
        ],
    },
    prepare_grass: Shader {
        name: "prepare_grass",
        wgsl: include_str!("../linked/prepare_grass.wgsl"),
        entry_points: &[
            EntryPoint { name: "prepare_grass", stage: Stage::Compute },
        ],
    },
    prepare_trees: Shader {
        name: "prepare_trees",
        wgsl: include_str!("../linked/prepare_trees.wgsl"),
        entry_points: &[
            EntryPoint { name: "prepare_trees", stage: Stage::Compute },
        ],
    },
    probe_atmosphere: Shader {
        name: "probe_atmosphere",
        wgsl: include_str!("../linked/probe_atmosphere.wgsl"),
        entry_points: &[
            EntryPoint { name: "probe_atmosphere", stage: Stage::Compute },
        ],
    },
    probe_brdf: Shader {
        name: "probe_brdf",
        wgsl: include_str!("../linked/probe_brdf.wgsl"),
        entry_points: &[
            EntryPoint { name: "probe_brdf", stage: Stage::Compute },
            EntryPoint { name: "time_exact", stage: Stage::Compute },
            EntryPoint { name: "time_fast", stage: Stage::Compute },
            EntryPoint { name: "time_exact_naive", stage: Stage::Compute },
            EntryPoint { name: "time_fast_naive", stage: Stage::Compute },
        ],
    },
    probe_heights: Shader {
        name: "probe_heights",
        wgsl: include_str!("../linked/probe_heights.wgsl"),
        entry_points: &[
            EntryPoint { name: "probe_heights", stage: Stage::Compute },
        ],
    },
    probe_heights_float: Shader {
        name: "probe_heights_float",
        wgsl: include_str!("../linked/probe_heights_float.wgsl"),
        entry_points: &[
            EntryPoint { name: "probe_heights_float", stage: Stage::Compute },
        ],
    },
    probe_pom: Shader {
        name: "probe_pom",
        wgsl: include_str!("../linked/probe_pom.wgsl"),
        entry_points: &[
            EntryPoint { name: "probe_pom", stage: Stage::Compute },
        ],
    },
    probe_tiling: Shader {
        name: "probe_tiling",
        wgsl: include_str!("../linked/probe_tiling.wgsl"),
        entry_points: &[
            EntryPoint { name: "sample_material", stage: Stage::Compute },
            EntryPoint { name: "without_period", stage: Stage::Compute },
        ],
    },
    probe_tree_shade: Shader {
        name: "probe_tree_shade",
        wgsl: include_str!("../linked/probe_tree_shade.wgsl"),
        entry_points: &[
            EntryPoint { name: "probe_tree_shade", stage: Stage::Compute },
        ],
    },
    probe_waves: Shader {
        name: "probe_waves",
        wgsl: include_str!("../linked/probe_waves.wgsl"),
        entry_points: &[
            EntryPoint { name: "probe_waves", stage: Stage::Compute },
        ],
    },
    reduce_materials: Shader {
        name: "reduce_materials",
        wgsl: include_str!("../linked/reduce_materials.wgsl"),
        entry_points: &[
            EntryPoint { name: "reduce", stage: Stage::Compute },
        ],
    },
    reduce_max_mip: Shader {
        name: "reduce_max_mip",
        wgsl: include_str!("../linked/reduce_max_mip.wgsl"),
        entry_points: &[
            EntryPoint { name: "reduce_max_mip", stage: Stage::Compute },
        ],
    },
    resample: Shader {
        name: "resample",
        wgsl: include_str!("../linked/resample.wgsl"),
        entry_points: &[
            EntryPoint { name: "vertex", stage: Stage::Vertex },
            EntryPoint { name: "fragment", stage: Stage::Fragment },
            EntryPoint { name: "fragment_enlarged", stage: Stage::Fragment },
        ],
    },
    scan_plants: Shader {
        name: "scan_plants",
        wgsl: include_str!("../linked/scan_plants.wgsl"),
        entry_points: &[
            EntryPoint { name: "scan_blocks", stage: Stage::Compute },
            EntryPoint { name: "scan_clumps", stage: Stage::Compute },
        ],
    },
    tonemap: Shader {
        name: "tonemap",
        wgsl: include_str!("../linked/tonemap.wgsl"),
        entry_points: &[
            EntryPoint { name: "vertex", stage: Stage::Vertex },
            EntryPoint { name: "fragment", stage: Stage::Fragment },
            EntryPoint { name: "fragment_graded", stage: Stage::Fragment },
        ],
    },
    trace_terrain_shadow: Shader {
        name: "trace_terrain_shadow",
        wgsl: include_str!("../linked/trace_terrain_shadow.wgsl"),
        entry_points: &[
            EntryPoint { name: "trace_terrain_shadow", stage: Stage::Compute },
        ],
    },
};

impl Shaders {
    /// All passes, by name.
    #[must_use]
    pub fn all(&self) -> [&Shader; 38] {
        [
            &self.antialias,
            &self.bake_cones,
            &self.bake_materials,
            &self.bake_waves,
            &self.cull_blocks,
            &self.cull_clumps,
            &self.draw_bay,
            &self.draw_far_trees,
            &self.draw_grass,
            &self.draw_plant_ids,
            &self.draw_pom,
            &self.draw_sky,
            &self.draw_terrain,
            &self.draw_trees,
            &self.draw_water,
            &self.fill_chunks,
            &self.filter_bloom,
            &self.integrate_sky,
            &self.light_trees,
            &self.meter_exposure,
            &self.place_far_trees,
            &self.place_trees,
            &self.prepare_grass,
            &self.prepare_trees,
            &self.probe_atmosphere,
            &self.probe_brdf,
            &self.probe_heights,
            &self.probe_heights_float,
            &self.probe_pom,
            &self.probe_tiling,
            &self.probe_tree_shade,
            &self.probe_waves,
            &self.reduce_materials,
            &self.reduce_max_mip,
            &self.resample,
            &self.scan_plants,
            &self.tonemap,
            &self.trace_terrain_shadow,
        ]
    }
}
