//! A trial with its land: the world as a server would fill it, what of it is drawn, and the plants
//! on it.

use crate::culling::poses::Trial;
use client::frame::Shot;
use client::plants::PlantFrame;
use client::world::{Drawn, World, select, stretch};
use terrain::{Land, lod};

/// A trial, ready to be judged.
#[derive(Debug)]
pub struct Scene {
    /// Its name.
    pub name: String,
    /// The shot, its eye lifted out of the ground.
    pub shot: Shot,
    /// The land.
    pub world: World,
    /// What is drawn of it.
    pub drawn: Vec<Drawn>,
    /// What grows on it.
    pub plants: PlantFrame,
}

impl Scene {
    /// Fills the view of a trial; none where nothing is drawn.
    #[must_use]
    pub fn of(land: &Land, trial: &Trial, slots: u32) -> Option<Self> {
        let mut world = World::new(slots);
        world.set_seed(land.world_seed());
        world.set_stretch(trial.stretch);
        let times = f64::from(trial.stretch) / f64::from(stretch::ONE);
        let judged = Shot { tolerance_px: trial.shot.tolerance_px / times.max(1.0), ..trial.shot };
        for needed in lod::select(land, &judged.viewer(), slots as usize) {
            world.insert(stretch::stretched(land.chunk(needed.key), trial.stretch));
        }
        let eye = trial.shot.pose.eye();
        let shot =
            Shot { pose: trial.shot.pose.above(world.ground(eye.units[0], eye.units[2])), ..trial.shot };
        let drawn = select(&mut world, &judged.viewer()).drawn;
        let plants = shot.plants(&world, &drawn)?;
        Some(Self { name: trial.name.clone(), shot, world, drawn, plants })
    }
}
