//! Vegetation occlusion culling at extreme eyes and shapes of land. Every case checks the same: no
//! clump with a visible vertex is culled, and hidden clumps are culled where there are any.

use client::cache::ChunkCache;
use client::camera::{Pose, Projection};
use client::features::vegetation::by_slot::BySlot;
use client::features::vegetation::{Cull, SpeciesParams, VegetationSettings};
use client::lod::select;
use client::settings::RenderSettings;
use client::view::ViewParams;
use glam::DVec3;
use lab::culling::clump_vertices::clump_vertices;
use lab::culling::reference::{VisibilityReference, eye_of};
use lab::culling::scene::Scene;
use lab::gpu_probes::cpu_cull::cull_on_cpu;
use shaders::layout::{CULL_DISTANCE, CULL_FRUSTUM, CULL_HIERARCHICAL, Culling};
use shaders::twin::placement::distance_squared;
use shaders::twin::surface::Surface;
use shaders::twin::terrain_occlusion::{Occludee, is_occluded};
use std::collections::BTreeSet;
use terrain::constants::{VERTEX_COUNT, VERTICES};
use terrain::{Chunk, GrassSeed, Land, lod};

const SLOTS: u32 = 2000;

/// Clumps of a scene that are compared with the reference.
const SAMPLE: usize = 120;

const FEW: VegetationSettings =
    VegetationSettings { density: 2, range_m: 180.0, tree_range_m: 600.0, ..VegetationSettings::STANDARD };

/// A shape of land: height over a place, both in units of 2^-8 m.
type Shape = fn(i64, i64) -> i32;

const METRE: i64 = 256;

/// Land of a shape, covered with grass and trees, drawn from an eye (east, up, south; metres) along
/// a yaw (degrees).
fn scene(shape: Shape, eye_m: [f64; 3], yaw_deg: f64, vegetation: VegetationSettings) -> Scene {
    let land = Land::new(1);
    // An eye that is farther above the sea than the view distance sees no chunk.
    let view_distance_m = if eye_m[1] > 900.0 { 6000 } else { 1000 };
    let shot = tests::view_at("0,0,0,0,0", (640, 360), view_distance_m, 2.0);
    let shot = ViewParams {
        pose: Pose { position_m: DVec3::from(eye_m), yaw_deg, pitch_deg: -4.0 },
        projection: Projection { fov_deg: 70.0, ..shot.projection },
        settings: RenderSettings { plants: vegetation, ..shot.settings },
        ..shot
    };
    let mut world = ChunkCache::new(SLOTS);
    world.set_land(Land::new(1));
    for needed in lod::select(&land, &shot.viewer(), SLOTS as usize) {
        let (west, north) = needed.key.origin();
        let spacing = i64::from(needed.key.spacing());
        let mut heights = Box::new([0; VERTEX_COUNT]);
        for (index, height) in heights.iter_mut().enumerate() {
            let (column, row) = ((index % VERTICES) as i64, (index / VERTICES) as i64);
            *height = shape(i64::from(west) + column * spacing, i64::from(north) + row * spacing);
        }
        let bare = GrassSeed::grow(1, needed.key, &heights);
        let grass = GrassSeed { density: Box::new([255; 256]), ..bare };
        world.insert(Chunk::from_parts(needed.key, heights, 1 << 20, grass));
    }
    let drawn = select(&mut world, &shot.viewer()).drawn;
    let plants = shot.plants(&world, &drawn).expect("the view has vegetation");
    Scene { name: String::new(), shot, world, drawn, plants }
}

/// Counts of the clumps in view.
#[derive(Clone, Copy, Debug, Default)]
struct Counts {
    seen: usize,
    hidden: usize,
    /// Hidden and culled.
    culled: usize,
}

/// Compares a sample of clumps of a scene with the reference; fails if a visible one is culled.
fn compared(scene: &Scene) -> Counts {
    let reference = VisibilityReference::new(&scene.world, &scene.drawn);
    let slots = BySlot::new(&scene.world);
    let square = &scene.plants.grid;
    let surface = Surface { slots: &slots, nodes: &square.nodes, chunks: &square.chunks };
    let (mut found, mut hint_m) = (Counts::default(), 0.0);
    for species in &scene.plants.species {
        let with = |path| SpeciesParams { culling: Culling { path, ..species.culling }, ..species.clone() };
        let all = cull_on_cpu(&scene.world, &scene.plants, &with(CULL_FRUSTUM));
        let kept: BTreeSet<_> =
            cull_on_cpu(&scene.world, &scene.plants, &with(CULL_HIERARCHICAL)).into_iter().collect();
        assert!(kept.len() <= all.len());
        for clump in all.iter().step_by((all.len() / SAMPLE).max(1)) {
            let vertices = clump_vertices(scene, &surface, species, &clump.clump, clump.detail);
            if vertices.height_m < 0.1 {
                continue;
            }
            let is_kept = kept.contains(clump);
            if reference.sees_any(eye_of(&scene.shot.pose), &vertices.points, &mut hint_m) {
                assert!(is_kept, "culled although visible: {clump:?}");
                found.seen += 1;
            } else {
                found.hidden += 1;
                found.culled += usize::from(!is_kept);
            }
        }
    }
    found
}

/// Triangular hills of 24 m, 96 m apart.
fn hills(x: i64, z: i64) -> i32 {
    let wave = |at: i64| (at.rem_euclid(96 * METRE) - 48 * METRE).abs() / 4;
    (20 * METRE + wave(x) + wave(z)) as i32
}

fn flat(_: i64, _: i64) -> i32 {
    (20 * METRE) as i32
}

fn spike(x: i64, z: i64) -> i32 {
    let is_there = (x, z) == (40 * METRE, 0);
    ((if is_there { 320 } else { 20 }) * METRE) as i32
}

/// A wall of 4 km, one cell thick, with a valley before and behind it.
fn wall(x: i64, z: i64) -> i32 {
    let is_there = x == 40 * METRE && z.abs() <= 4000 * METRE;
    ((if is_there { 4000 } else { 20 }) * METRE) as i32
}

/// The same as a step: high ground that ends at a cliff.
fn cliff(x: i64, _: i64) -> i32 {
    ((if x < 40 * METRE { 4020 } else { 20 }) * METRE) as i32
}

fn height_m(shape: Shape, x_m: f64, z_m: f64) -> f64 {
    f64::from(shape((x_m * 256.0) as i64, (z_m * 256.0) as i64)) / 256.0
}

#[test]
fn eyes_on_vertices_diagonals_and_borders_lose_no_visible_clump() {
    let places = [
        // A vertex, on both axes a border of chunks, cells and blocks.
        [0.0, 0.0],
        // A vertex at a border of negative coordinates.
        [-128.0, -256.0],
        [-640.0, 300.0],
        // On the diagonal of a cell, and on a grid line between vertices.
        [33.0, 51.0],
        [34.5, 52.0],
        [-34.25, -51.25],
        // One unit from a border.
        [-128.0 - 1.0 / 256.0, 64.0 + 1.0 / 256.0],
    ];
    let mut all = Counts::default();
    for (index, [x, z]) in places.into_iter().enumerate() {
        // Whole right angles: rays along grid lines, and along diagonals.
        for yaw in [0.0, 45.0] {
            let eye = [x, height_m(hills, x, z) + 1.7, z];
            let counts = compared(&scene(hills, eye, yaw + 90.0 * index as f64, FEW));
            assert!(counts.seen > 0, "{x} {z} {yaw}: {counts:?}");
            all.hidden += counts.hidden;
            all.culled += counts.culled;
        }
    }
    // Control: hidden clumps exist and are found.
    assert!(all.hidden > 500 && 10 * all.culled > 8 * all.hidden, "{all:?}");
}

#[test]
fn an_eye_below_ground_culls_no_clump() {
    let eye = [10.0, height_m(hills, 10.0, 10.0) - 5.0, 10.0];
    let below = scene(hills, eye, 30.0, FEW);
    let above = scene(hills, [10.0, eye[1] + 7.0, 10.0], 30.0, FEW);
    let count = |scene: &Scene, path| {
        let species = &scene.plants.species[0];
        let with = SpeciesParams { culling: Culling { path, ..species.culling }, ..species.clone() };
        cull_on_cpu(&scene.world, &scene.plants, &with).len()
    };
    assert_eq!(count(&below, CULL_HIERARCHICAL), count(&below, CULL_FRUSTUM));
    assert!(count(&above, CULL_HIERARCHICAL) < count(&above, CULL_FRUSTUM), "control");
}

#[test]
fn a_clump_at_the_eye_is_kept() {
    let first = scene(hills, [10.0, height_m(hills, 10.0, 10.0) + 1.7, 10.0], 0.0, FEW);
    let species = &first.plants.species[0];
    let all = cull_on_cpu(
        &first.world,
        &first.plants,
        &SpeciesParams { culling: Culling { path: CULL_DISTANCE, ..species.culling }, ..species.clone() },
    );
    let nearest = all
        .iter()
        .min_by_key(|kept| distance_squared(&species.culling, kept.clump.x, kept.clump.y, kept.clump.z))
        .unwrap();
    let corner = first.plants.grid.corner.map(|units| f64::from(units) / 256.0);
    let fine = |at: i32| f64::from(at) / 4096.0;
    let root =
        [fine(nearest.clump.x) + corner[0], fine(nearest.clump.y) + 0.05, fine(nearest.clump.z) + corner[1]];
    let there = scene(hills, root, 0.0, FEW);
    let species = &there.plants.species[0];
    let kept = cull_on_cpu(&there.world, &there.plants, species);
    let eye = species.culling.eye;
    let beside =
        |clump: &shaders::twin::placement::Clump| (clump.x - eye[0]).abs().max((clump.z - eye[2]).abs()) < 64;
    assert!(kept.iter().any(|kept| beside(&kept.clump)), "the clump at the eye");
    // A target that is the eye itself, or beside it by less than the near plane.
    let slots = BySlot::new(&there.world);
    let square = &there.plants.grid;
    let surface = Surface { slots: &slots, nodes: &square.nodes, chunks: &square.chunks };
    for apart in [0, 1, 40] {
        let target = Occludee {
            x: eye[0] + apart,
            top: eye[1] - 100_000,
            z: eye[2],
            radius: 0,
            slope_radius: 0,
            taper: 0,
            taper_drop: 0,
            slope_east: 0,
            slope_south: 0,
        };
        assert!(!is_occluded(&surface, eye, &target, species.culling.start), "{apart}");
    }
}

#[test]
fn flat_land_occludes_no_clump() {
    let counts = compared(&scene(flat, [0.0, 21.7, 0.0], 20.0, FEW));
    assert!(counts.seen > 150 && counts.culled == 0, "{counts:?}");
}

#[test]
fn a_spike_of_one_cell_culls_no_visible_clump() {
    // Yaw 90 is east, towards the spike.
    let counts = compared(&scene(spike, [30.0, 21.7, 0.3], 90.0, VegetationSettings { density: 12, ..FEW }));
    assert!(counts.seen > 50, "{counts:?}");
}

#[test]
fn a_wall_of_4_km_and_a_cliff_cull_no_visible_clump() {
    let behind = compared(&scene(wall, [20.0, 21.7, 0.0], 90.0, FEW));
    assert!(behind.seen > 0 && behind.hidden > 100, "{behind:?}");
    assert!(100 * behind.culled > 97 * behind.hidden, "{behind:?}");
    // From above, and from below the edge.
    for x in [10.0, 45.0] {
        let eye = [x, height_m(cliff, x, 0.0) + 1.7, 0.0];
        let counts = compared(&scene(cliff, eye, 90.0, FEW));
        assert!(counts.seen > 0, "{counts:?}");
    }
}

#[test]
fn densities_are_zero_without_grass_and_limited_at_most() {
    let eye = [10.0, height_m(hills, 10.0, 10.0) + 1.7, 10.0];
    let none = scene(hills, eye, 0.0, VegetationSettings { density: 0, trees: 1, ..FEW });
    assert!(none.plants.species.iter().all(|species| species.field.kind != shaders::layout::KIND_GRASS));
    let vegetation = VegetationSettings {
        density: VegetationSettings::MAX_DENSITY,
        trees: 0,
        range_m: 60.0,
        cull: Cull::Distance,
        ..FEW
    };
    let most = scene(hills, eye, 0.0, vegetation);
    let all = cull_on_cpu(&most.world, &most.plants, &most.plants.species[0]).len();
    // Cells of 4 m², all of them full up to where thinning begins.
    let disc = std::f64::consts::PI * 42.0 * 42.0 / 4.0 * f64::from(VegetationSettings::MAX_DENSITY);
    assert!(all as f64 > 0.9 * disc, "{all} of {disc}");
    let more = scene(hills, eye, 0.0, VegetationSettings { density: u32::MAX, ..vegetation });
    assert_eq!(cull_on_cpu(&more.world, &more.plants, &more.plants.species[0]).len(), all);
}
