//! Drawn vertices of a clump, by the twins of the vertex shaders of `draw_grass` and `draw_trees`.
//! A clump is visible if one of them is.

use crate::culling::reference::Point;
use crate::culling::scene::Scene;
use client::features::vegetation::SpeciesParams;
use shaders::layout::{GRASS_VERTICES, KIND_GRASS, TREE_VERTICES};
use shaders::twin::clump::{add, grown_push, lean_push, root_offset_m, stem_pose, unpacked_clump, wind_push};
use shaders::twin::field::{field_height_scale, field_size_m, field_widening};
use shaders::twin::placement::Clump;
use shaders::twin::surface::{Slots, Surface};
use shaders::twin::tree::{tree_size_m, tree_species};
use shaders::twin::tree_shape::vertex_of_tree;
use shaders::twin::tuft::tuft_vertex;
use shaders::twin::visibility::gradient_at;

/// Metres after which patterns of the world repeat.
const PATTERN_PERIOD_M: f64 = shaders::layout::PATTERN_PERIOD_M as f64;

/// Vertices of a clump.
#[derive(Clone, Debug, Default)]
pub struct ClumpVertices {
    /// Height above the root without lean, metres.
    pub height_m: f64,
    /// The vertices, metres, highest first.
    pub points: Vec<Point>,
}

/// The vertices of a clump in a level of detail, at the time of the shot.
pub fn clump_vertices<S: Slots>(
    scene: &Scene,
    surface: &Surface<'_, S>,
    species: &SpeciesParams,
    clump: &Clump,
    level: u32,
) -> ClumpVertices {
    let field = &species.field;
    let normal = gradient_at(surface, clump.x, clump.z).map_or([0; 2], |[east, south]| {
        let [east, south] = [east, south].map(|rise| f64::from(rise) / 16_384.0);
        let length = (1.0 + east * east + south * south).sqrt();
        [-east, -south].map(|part| (127.0 * part / length).round() as i32)
    });
    let packed = unpacked_clump([
        clump.x as u32 | (normal[0] as u32) << 24,
        clump.z as u32 | (normal[1] as u32) << 24,
        clump.y as u32,
        clump.attributes,
    ]);
    let eye = scene.shot.pose.eye();
    let root_m = root_offset_m(field, &packed, eye.fraction_m.to_array());
    let distance_m = root_m.iter().map(|axis| axis * axis).sum::<f32>().sqrt();
    let corner = scene.plants.grid.corner.map(|units| f64::from(units) / 256.0);
    let at = [f64::from(clump.x) / 4096.0 + corner[0], f64::from(clump.z) / 4096.0 + corner[1]];
    let turns = at.map(|metres| (metres / PATTERN_PERIOD_M).rem_euclid(1.0) as f32);
    let wide = field_widening(field, packed.rank, distance_m);
    let tall = field_height_scale(field, distance_m);
    let [width, height] = field_size_m(field, packed.width, packed.height);
    let size_m = [width * wide, height * tall];
    let wind = wind_push(field.wind, turns, scene.shot.time_s, packed.phase);
    let offsets: Vec<[f32; 3]> = if species.planting.kind == KIND_GRASS {
        let own = grown_push(packed.hue, packed.phase);
        let push = add(add(own, wind), lean_push(field.lean, root_m, distance_m));
        let stem = stem_pose(packed.normal, push);
        let vertices = 0..GRASS_VERTICES[level as usize];
        let detail_m = distance_m * field.detail;
        let vertex = |index| tuft_vertex(level, index, size_m, packed.phase, &stem, detail_m).offset_m;
        vertices.map(vertex).collect()
    } else {
        let species = tree_species(&packed);
        let size_m = tree_size_m(species, size_m);
        // An impostor stands for the geometry of the level before.
        let level = level.min(1);
        let vertices = 0..TREE_VERTICES[level as usize];
        let vertex = |index| vertex_of_tree(species, level, index, size_m, packed.phase, wind);
        vertices.map(vertex).collect()
    };
    let mut points: Vec<Point> = offsets
        .into_iter()
        .map(|[east, up, south]| {
            [at[0] + f64::from(east), f64::from(clump.y) / 4096.0 + f64::from(up), at[1] + f64::from(south)]
        })
        .collect();
    points.sort_unstable_by(|a, b| {
        b[1].total_cmp(&a[1]).then(a[0].total_cmp(&b[0])).then(a[2].total_cmp(&b[2]))
    });
    points.dedup();
    ClumpVertices { height_m: f64::from(size_m[1]), points }
}
