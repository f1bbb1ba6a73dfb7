//! Triangles of the 8 km view, culled as they are drawn, against the same view without levels of
//! detail.

use super::screen::{self, ViewCase};
use crate::places;
use crate::world_builder::WorldBuilder;
use client::cache::ChunkCache;
use client::camera::Pose;
use client::frame::TRIANGLES_PER_INSTANCE;
use client::lod::{Drawn, Selection};
use client::scene::Scene;
use client::view::ViewParams;
use rayon::prelude::*;
use serde::Serialize;
use shaders::twin::morph::Seams;
use terrain::constants::{CHUNK_BITS, UNITS_PER_METRE, WORLD_HALF};
use terrain::{ChunkKey, Land};

/// Tolerance of the bar, pixels.
pub const TOLERANCE_PX: f64 = 1.0;

/// The 8 km view of `cargo xtask measure end-to-end`.
pub const EIGHT_KM: &str = "0,250,2500,0,-8";

/// That view, then others: the start, a shore, a beach, mountains, and from high up.
fn cameras(land: &Land) -> [String; 6] {
    let poses = [
        Scene::Island.start_in(land),
        places::along_shore(land),
        places::beach(land),
        places::over_mountains(land),
        places::above(),
    ];
    let [start, shore, beach, mountains, above] = poses.map(|pose| pose.to_string());
    [EIGHT_KM.to_owned(), start, shore, beach, mountains, above]
}

/// Triangles of one camera.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct View {
    /// The camera, as `--camera` takes it.
    pub camera: String,
    /// Chunks in sight.
    pub chunks: usize,
    pub triangles: u64,
    /// Triangles of all level-0 chunks in sight.
    pub triangles_without_lod: u64,
}

pub fn count(land: &Land) -> Vec<View> {
    let mut builder = WorldBuilder::new(*land);
    let view = |camera: String| {
        let pose: Pose = camera.parse().expect("the cameras of this module are poses");
        let shot = ViewCase { pose, tolerance_px: TOLERANCE_PX }.shot();
        let (world, selection) = screen::selected(&mut builder, &shot);
        builder.clear();
        let (chunks, instances) = in_sight(&shot, &world, &selection);
        View {
            camera,
            chunks,
            triangles: instances as u64 * TRIANGLES_PER_INSTANCE,
            triangles_without_lod: without_lod(land, &shot) as u64 * TRIANGLES_PER_INSTANCE,
        }
    };
    cameras(land).into_iter().map(view).collect()
}

/// Chunks in sight, and instances.
fn in_sight(shot: &ViewParams, world: &ChunkCache, selection: &Selection) -> (usize, usize) {
    let frame = shot.frame(Scene::Island, world, selection);
    (frame.chunks, frame.instances.len())
}

/// Instances of all level-0 chunks in sight within the view distance.
fn without_lod(land: &Land, shot: &ViewParams) -> usize {
    let viewer = shot.viewer();
    let reach = i64::from(viewer.distance_m) * i64::from(UNITS_PER_METRE);
    let range = |eye: i32| {
        let at = |way: i64| {
            (i64::from(eye) + way).clamp(-i64::from(WORLD_HALF), i64::from(WORLD_HALF)) >> CHUNK_BITS
        };
        at(-reach) as i32..=at(reach) as i32
    };
    let (columns, rows) = (range(viewer.eye.0), range(viewer.eye.2));
    let keys: Vec<ChunkKey> = rows
        .flat_map(|z| columns.clone().map(move |x| (x, z)))
        .filter_map(|(x, z)| ChunkKey::new(0, x, z).ok())
        .filter(|key| viewer.sees(*key))
        .collect();
    // A part at a time: all chunks with their pyramids take half a gigabyte.
    let part = |keys: &[ChunkKey]| {
        let chunks: Vec<_> = keys.par_iter().map(|key| land.chunk(*key)).collect();
        let mut world = ChunkCache::new(chunks.len() as u32);
        chunks.into_iter().for_each(|chunk| drop(world.insert(chunk)));
        let drawn = keys.iter().map(|key| Drawn { key: *key, seams: Seams::default() }).collect();
        in_sight(shot, &world, &Selection { drawn, missing: 0 }).1
    };
    keys.chunks(1_024).map(part).sum()
}
