//! The first oracle: pictures of which plant is seen where, drawn without culling by the renderer
//! itself. Whatever shows in any of them has to be in the set that a test keeps; what no pixel
//! happens to show is left to the second oracle.

use crate::culling::poses::Trial;
use crate::culling::scene::Scene;
use crate::studio::{ChosenKind, Studio};
use anyhow::{Context, Result, ensure};
use client::frame::{FrameData, Shot};
use client::looks::Looks;
use client::plants::kept::{BySlot, noise_of};
use client::plants::{Cull, PlantKnobs};
use client::scene;
use client::world::Selection;
use serde::Serialize;
use shaders::layout::{CULL_EXACT, CULL_FRUSTUM, CULL_MARCH, CULL_NOISE, Culling};
use shaders::twin::planting::{Clump, kept};
use shaders::twin::surface::Surface;
use std::collections::{BTreeMap, BTreeSet};
use terrain::Land;

/// Sizes in which each pose is drawn, pixels: once, twice and four times as fine.
const SIZES: [(u32, u32); 3] = [(160, 90), (320, 180), (640, 360)];

/// Slots of the pool.
const SLOTS: u32 = 2000;

/// The lower 24 bits of a name are a place; see `shaders/wgsl/shared/name.wesl`.
const PLACE: u32 = 0xff_ffff;

/// What the pictures showed.
#[derive(Clone, Debug, Default, Serialize)]
pub struct Shown {
    /// Poses drawn.
    pub poses: u64,
    /// Width of the pictures, pixels.
    pub widths: Vec<u32>,
    /// Plants seen at each of them, a plant once a pose.
    pub seen_by_width: Vec<u64>,
    /// Plants seen at any of them.
    pub seen: u64,
    /// Of these, left out by the frustum alone (T1).
    pub lost_frustum: u64,
    /// By T2.
    pub lost_noise: u64,
    /// By T3 as first published, clump by clump.
    pub lost_march: u64,
    /// By T3.
    pub lost_exact: u64,
    /// By T4, as the GPU chose.
    pub lost_hierarchical: u64,
    /// Clumps that were there to be drawn.
    pub drawn: u64,
    /// The first few that T3 or T4 left out, for people.
    pub culprits: Vec<String>,
}

/// Kind and place of a plant.
type Name = (u32, u32, u32);

/// Draws all trials.
///
/// # Errors
/// There is no GPU, it failed, or it had not enough room for all that is to be drawn.
pub fn look(land: &Land, trials: &[Trial]) -> Result<Shown> {
    let mut studio = Studio::open(SIZES[0], SLOTS).context("pictures need a GPU")?;
    let mut shown = Shown {
        widths: SIZES.iter().map(|size| size.0).collect(),
        seen_by_width: vec![0; SIZES.len()],
        ..Shown::default()
    };
    for trial in trials {
        let Some(scene) = Scene::of(land, trial, studio.slots()) else { continue };
        studio.furnish(&scene.world);
        one(&mut studio, &scene, &mut shown).with_context(|| format!("pose {}", trial.name))?;
    }
    Ok(shown)
}

fn one(studio: &mut Studio, scene: &Scene, shown: &mut Shown) -> Result<()> {
    let whole = frame_of(scene, Cull::Distance);
    let mut seen: BTreeSet<Name> = BTreeSet::new();
    studio.choose(&whole)?;
    for (size, count) in SIZES.into_iter().zip(&mut shown.seen_by_width) {
        let pixels = studio.names(&whole, size)?;
        let names: BTreeSet<Name> = pixels.into_iter().filter(|name| name[1] != 0).map(name_of).collect();
        *count += names.len() as u64;
        seen.extend(names);
    }
    let all = clumps_by_name(studio)?;
    studio.choose(&frame_of(scene, Cull::Hierarchical))?;
    let chosen = clumps_by_name(studio)?;

    let slots = BySlot::new(&scene.world);
    let square = &scene.plants.square;
    let surface = Surface { slots: &slots, tiles: &square.tiles, leaves: &square.leaves };
    let noise = noise_of(&scene.world, square);
    shown.poses += 1;
    shown.seen += seen.len() as u64;
    shown.drawn += all.len() as u64;
    for name in seen {
        let clump = all.get(&name).context("a plant is seen that was not drawn")?;
        let stand = scene.plants.stands.iter().find(|stand| stand.field.kind == name.0);
        let stand = stand.context("a plant is seen of a kind that does not grow")?;
        let is_lost = |path| {
            let culling = Culling { path, ..stand.culling };
            kept(&surface, &noise, &culling, &stand.planting, clump).is_none()
        };
        shown.lost_frustum += u64::from(is_lost(CULL_FRUSTUM));
        shown.lost_noise += u64::from(is_lost(CULL_NOISE));
        shown.lost_march += u64::from(is_lost(CULL_MARCH));
        let lost = (is_lost(CULL_EXACT), !chosen.contains_key(&name));
        shown.lost_exact += u64::from(lost.0);
        shown.lost_hierarchical += u64::from(lost.1);
        if (lost.0 || lost.1) && shown.culprits.len() < 8 {
            shown.culprits.push(format!("{}: {clump:?}", scene.name));
        }
    }
    Ok(())
}

fn name_of([east, south]: [u32; 2]) -> Name {
    (east >> 24, east & PLACE, south & PLACE)
}

/// What the last choice kept.
fn clumps_by_name(studio: &Studio) -> Result<BTreeMap<Name, Clump>> {
    let mut found = BTreeMap::new();
    for ChosenKind { kind, clumps, told } in studio.chosen()? {
        ensure!(told.blocks_lost + told.clumps_lost == 0, "no room for all that is kept: {told:?}");
        found.extend(clumps.into_iter().map(|[x, z, y, looks]| {
            let (x, z) = (x & PLACE, z & PLACE);
            ((kind, x, z), Clump { x: x as i32, z: z as i32, y: y as i32, looks })
        }));
    }
    Ok(found)
}

/// The scene's frame with another way of choosing plants.
#[must_use]
pub fn frame_of(scene: &Scene, cull: Cull) -> FrameData {
    let looks = Looks { plants: PlantKnobs { cull, ..scene.shot.looks.plants }, ..scene.shot.looks };
    let selection = Selection { drawn: scene.drawn.clone(), wanting: 0 };
    Shot { looks, ..scene.shot }.frame(scene::Scene::Island, &scene.world, &selection)
}
