//! The test of sight at its extremes: where the eye stands, and what shape the land has. Everywhere
//! the same is asked: that nothing is left out of which the drawn triangles leave a vertex in
//! sight, and that something hidden is left out wherever there is any.

use client::camera::{Lens, Pose};
use client::frame::Shot;
use client::looks::Looks;
use client::plants::kept::{BySlot, kept_of};
use client::plants::{Cull, PlantKnobs, Stand};
use client::world::{World, select};
use glam::DVec3;
use lab::culling::leaves::leaves_of;
use lab::culling::oracle::{Oracle, eye_of};
use lab::culling::scene::Scene;
use shaders::layout::{CULL_DISTANCE, CULL_FRUSTUM, CULL_HIERARCHICAL, Culling};
use shaders::twin::planting::distance_squared;
use shaders::twin::sight::{Target, is_hidden};
use shaders::twin::surface::Surface;
use std::collections::BTreeSet;
use terrain::constants::{VERTEX_COUNT, VERTICES};
use terrain::{Chunk, GrassSeed, Land, lod};

const SLOTS: u32 = 2000;

/// Clumps of a scene that are judged.
const SAMPLE: usize = 120;

const FEW: PlantKnobs =
    PlantKnobs { density: 2, range_m: 180.0, tree_range_m: 600.0, ..PlantKnobs::STANDARD };

/// A shape of land: height over a place, both in units of 2^-8 m.
type Shape = fn(i64, i64) -> i32;

const METRE: i64 = 256;

/// Land of a shape, covered with grass and trees, as it is drawn from an eye (east, up, south;
/// metres) that looks along a yaw (degrees).
fn scene(shape: Shape, eye_m: [f64; 3], yaw_deg: f64, knobs: PlantKnobs) -> Scene {
    let land = Land::new(1);
    let shot = Shot {
        pose: Pose { position_m: DVec3::from(eye_m), yaw_deg, pitch_deg: -4.0 },
        lens: Lens { fov_deg: 70.0, width: 640, height: 360 },
        // An eye that is farther above the sea than it sees is shown nothing.
        view_distance_m: if eye_m[1] > 900.0 { 6000 } else { 1000 },
        tolerance_px: 2.0,
        time_s: 0.0,
        looks: Looks { plants: knobs, ..Looks::default() },
    };
    let mut world = World::new(SLOTS);
    world.set_seed(1);
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
    let plants = shot.plants(&world, &drawn).expect("something grows");
    Scene { name: String::new(), shot, world, drawn, plants }
}

/// What became of the clumps of a scene that stand in the view.
#[derive(Clone, Copy, Debug, Default)]
struct Judged {
    seen: usize,
    hidden: usize,
    /// Of the hidden ones.
    left_out: usize,
}

/// Judges a sample of clumps of a scene; fails if one that is seen is left out.
fn judged(scene: &Scene) -> Judged {
    let oracle = Oracle::new(&scene.world, &scene.drawn);
    let slots = BySlot::new(&scene.world);
    let square = &scene.plants.square;
    let surface = Surface { slots: &slots, tiles: &square.tiles, leaves: &square.leaves };
    let (mut found, mut hint_m) = (Judged::default(), 0.0);
    for stand in &scene.plants.stands {
        let with = |path| Stand { culling: Culling { path, ..stand.culling }, ..stand.clone() };
        let all = kept_of(&scene.world, &scene.plants, &with(CULL_FRUSTUM));
        let kept: BTreeSet<_> =
            kept_of(&scene.world, &scene.plants, &with(CULL_HIERARCHICAL)).into_iter().collect();
        assert!(kept.len() <= all.len());
        for clump in all.iter().step_by((all.len() / SAMPLE).max(1)) {
            let leaves = leaves_of(scene, &surface, stand, &clump.clump, clump.detail);
            if leaves.height_m < 0.1 {
                continue;
            }
            let is_kept = kept.contains(clump);
            if oracle.sees_any(eye_of(&scene.shot.pose), &leaves.points, &mut hint_m) {
                assert!(is_kept, "left out although it is seen: {clump:?}");
                found.seen += 1;
            } else {
                found.hidden += 1;
                found.left_out += usize::from(!is_kept);
            }
        }
    }
    found
}

/// Hills of 24 m, 96 m apart, that rise and fall evenly.
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
fn nothing_seen_is_lost_where_the_eye_is_on_a_vertex_a_diagonal_or_a_border_of_chunks() {
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
        // Next to a border by the finest step there is.
        [-128.0 - 1.0 / 256.0, 64.0 + 1.0 / 256.0],
    ];
    let mut all = Judged::default();
    for (index, [x, z]) in places.into_iter().enumerate() {
        // Whole right angles: rays along grid lines, and along diagonals.
        for yaw in [0.0, 45.0] {
            let eye = [x, height_m(hills, x, z) + 1.7, z];
            let judged = judged(&scene(hills, eye, yaw + 90.0 * index as f64, FEW));
            assert!(judged.seen > 0, "{x} {z} {yaw}: {judged:?}");
            all.hidden += judged.hidden;
            all.left_out += judged.left_out;
        }
    }
    // The control: land that hides something, and a test that finds it.
    assert!(all.hidden > 500 && 10 * all.left_out > 8 * all.hidden, "{all:?}");
}

#[test]
fn an_eye_below_ground_loses_nothing() {
    let eye = [10.0, height_m(hills, 10.0, 10.0) - 5.0, 10.0];
    let below = scene(hills, eye, 30.0, FEW);
    let above = scene(hills, [10.0, eye[1] + 7.0, 10.0], 30.0, FEW);
    let count = |scene: &Scene, path| {
        let stand = &scene.plants.stands[0];
        let with = Stand { culling: Culling { path, ..stand.culling }, ..stand.clone() };
        kept_of(&scene.world, &scene.plants, &with).len()
    };
    assert_eq!(count(&below, CULL_HIERARCHICAL), count(&below, CULL_FRUSTUM));
    assert!(count(&above, CULL_HIERARCHICAL) < count(&above, CULL_FRUSTUM), "the control");
}

#[test]
fn what_stands_where_the_eye_is_is_kept() {
    let first = scene(hills, [10.0, height_m(hills, 10.0, 10.0) + 1.7, 10.0], 0.0, FEW);
    let stand = &first.plants.stands[0];
    let all = kept_of(
        &first.world,
        &first.plants,
        &Stand { culling: Culling { path: CULL_DISTANCE, ..stand.culling }, ..stand.clone() },
    );
    let nearest = all
        .iter()
        .min_by_key(|kept| distance_squared(&stand.culling, kept.clump.x, kept.clump.y, kept.clump.z))
        .unwrap();
    let corner = first.plants.square.corner.map(|units| f64::from(units) / 256.0);
    let fine = |at: i32| f64::from(at) / 4096.0;
    let root =
        [fine(nearest.clump.x) + corner[0], fine(nearest.clump.y) + 0.05, fine(nearest.clump.z) + corner[1]];
    let there = scene(hills, root, 0.0, FEW);
    let stand = &there.plants.stands[0];
    let kept = kept_of(&there.world, &there.plants, stand);
    let eye = stand.culling.eye;
    let beside =
        |clump: &shaders::twin::planting::Clump| (clump.x - eye[0]).abs().max((clump.z - eye[2]).abs()) < 64;
    assert!(kept.iter().any(|kept| beside(&kept.clump)), "the clump at the eye");
    // A target that is the eye itself, or beside it by less than the near plane.
    let slots = BySlot::new(&there.world);
    let square = &there.plants.square;
    let surface = Surface { slots: &slots, tiles: &square.tiles, leaves: &square.leaves };
    for apart in [0, 1, 40] {
        let target = Target {
            x: eye[0] + apart,
            top: eye[1] - 100_000,
            z: eye[2],
            radius: 0,
            follow: 0,
            skirt: 0,
            fall: 0,
            east_rise: 0,
            south_rise: 0,
        };
        assert!(!is_hidden(&surface, eye, &target, stand.culling.start), "{apart}");
    }
}

#[test]
fn flat_land_hides_nothing_that_stands_on_it() {
    let judged = judged(&scene(flat, [0.0, 21.7, 0.0], 20.0, FEW));
    assert!(judged.seen > 150 && judged.left_out == 0, "{judged:?}");
}

#[test]
fn a_spike_of_one_cell_hides_what_is_behind_it_and_no_more() {
    // Yaw 90 looks east, where the spike stands.
    let judged = judged(&scene(spike, [30.0, 21.7, 0.3], 90.0, PlantKnobs { density: 12, ..FEW }));
    assert!(judged.seen > 50, "{judged:?}");
}

#[test]
fn a_wall_of_4_km_hides_all_behind_it_and_a_cliff_what_is_below_it() {
    let behind = judged(&scene(wall, [20.0, 21.7, 0.0], 90.0, FEW));
    assert!(behind.seen > 0 && behind.hidden > 100, "{behind:?}");
    assert!(100 * behind.left_out > 97 * behind.hidden, "{behind:?}");
    // From above, and from below the edge.
    for x in [10.0, 45.0] {
        let eye = [x, height_m(cliff, x, 0.0) + 1.7, 0.0];
        let judged = judged(&scene(cliff, eye, 90.0, FEW));
        assert!(judged.seen > 0, "{judged:?}");
    }
}

#[test]
fn nothing_grows_where_the_density_is_none_and_the_most_is_the_most() {
    let eye = [10.0, height_m(hills, 10.0, 10.0) + 1.7, 10.0];
    let none = scene(hills, eye, 0.0, PlantKnobs { density: 0, trees: 1, ..FEW });
    assert!(none.plants.stands.iter().all(|stand| stand.field.kind != shaders::layout::KIND_GRASS));
    let knobs =
        PlantKnobs { density: PlantKnobs::MAX_DENSITY, trees: 0, range_m: 60.0, cull: Cull::Distance, ..FEW };
    let most = scene(hills, eye, 0.0, knobs);
    let all = kept_of(&most.world, &most.plants, &most.plants.stands[0]).len();
    // Cells of 4 m², all of them full up to where thinning begins.
    let disc = std::f64::consts::PI * 42.0 * 42.0 / 4.0 * f64::from(PlantKnobs::MAX_DENSITY);
    assert!(all as f64 > 0.9 * disc, "{all} of {disc}");
    let more = scene(hills, eye, 0.0, PlantKnobs { density: u32::MAX, ..knobs });
    assert_eq!(kept_of(&more.world, &more.plants, &more.plants.stands[0]).len(), all);
}
