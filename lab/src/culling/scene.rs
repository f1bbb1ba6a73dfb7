//! A test case with its chunks as a server would send them, the drawn selection and the plants.

use crate::culling::cases::Case;
use client::cache::{ChunkCache, vertical_scale};
use client::features::vegetation::VegetationFrame;
use client::lod::{Drawn, select};
use client::view::ViewParams;
use std::collections::BTreeSet;
use terrain::{ChunkKey, Land, lod};

/// A test case with its data.
#[derive(Debug)]
pub struct Scene {
    /// Its name.
    pub name: String,
    /// The shot, its eye lifted out of the ground.
    pub shot: ViewParams,
    /// The land.
    pub world: ChunkCache,
    /// The drawn selection.
    pub drawn: Vec<Drawn>,
    /// The plants.
    pub plants: VegetationFrame,
}

impl Scene {
    /// Generates the view of a case; none if nothing is drawn.
    pub fn of(land: &Land, case: &Case, slots: u32) -> Option<Self> {
        let mut world = ChunkCache::new(slots);
        world.set_land(*land);
        world.set_vertical_scale(case.stretch);
        let viewer = case.shot.viewer();
        let served = vertical_scale::served(&viewer, case.stretch);
        let tops: BTreeSet<ChunkKey> = served.tops().into_iter().collect();
        let has_arrived = |key: ChunkKey| tops.contains(&key) || case.absent.has_arrived(key);
        let needed = lod::select(land, &served, slots as usize);
        for needed in needed.into_iter().filter(|needed| has_arrived(needed.key)) {
            world.insert(land.chunk(needed.key));
        }
        let eye = case.shot.pose.eye();
        let shot =
            ViewParams { pose: case.shot.pose.above(world.ground(eye.units[0], eye.units[2])), ..case.shot };
        let drawn = select(&mut world, &viewer).drawn;
        let plants = shot.plants(&world, &drawn)?;
        Some(Self { name: case.name.clone(), shot, world, drawn, plants })
    }

    /// Levels of the drawn chunks that the eye is above; several on a border.
    #[must_use]
    pub fn levels_at_eye(&self) -> Vec<u8> {
        let eye = self.shot.pose.eye();
        let touches = |key: ChunkKey| {
            let (x, z) = key.origin();
            let side = i64::from(key.side());
            [(0, x), (2, z)].into_iter().all(|(axis, low)| {
                let beyond = i64::from(eye.units[axis]) - i64::from(low);
                (0..side).contains(&beyond) || beyond == side && eye.fraction_m[axis] == 0.0
            })
        };
        self.drawn.iter().map(|drawn| drawn.key).filter(|key| touches(*key)).map(ChunkKey::level).collect()
    }
}
