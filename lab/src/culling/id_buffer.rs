//! The first reference: ID buffers of plants, drawn without culling. A plant in any of them must be
//! in the set that a test keeps. Plants that no pixel samples are left to the second reference
//! ([`super::reference`]).

use crate::culling::cases::Case;
use crate::culling::scene::Scene;
use crate::gpu_probes::cpu_cull::noise_of;
use crate::headless_renderer::{ChosenKind, HeadlessRenderer};
use anyhow::{Context, Result, ensure};
use client::features::vegetation::by_slot::BySlot;
use client::features::vegetation::{Cull, VegetationSettings};
use client::frame::FrameData;
use client::lod::Selection;
use client::scene;
use client::settings::RenderSettings;
use client::view::ViewParams;
use serde::Serialize;
use shaders::layout::{CULL_EXACT, CULL_FRUSTUM, CULL_MARCH, CULL_NOISE, Culling};
use shaders::twin::placement::Clump;
use shaders::twin::surface::Surface;
use shaders::twin::visibility::visible_level;
use std::collections::{BTreeMap, BTreeSet};
use terrain::Land;

/// Sizes in which each pose is drawn, pixels: once, twice and four times as fine.
const SIZES: [(u32, u32); 3] = [(160, 90), (320, 180), (640, 360)];

/// Slots of the pool.
const SLOTS: u32 = 2000;

/// The lower 24 bits of an ID are a position; see `shaders/wgsl/draw_plant_ids.wesl`.
const POSITION: u32 = 0xff_ffff;

/// Plants found in ID buffers, and those of them that the tests lose.
#[derive(Clone, Debug, Default, Serialize)]
pub struct VisiblePlants {
    pub poses: u64,
    /// Widths of the ID buffers, pixels.
    pub widths: Vec<u32>,
    /// Plants seen at each of them, a plant once a pose.
    pub seen_by_width: Vec<u64>,
    /// Plants seen at any of them.
    pub seen: u64,
    /// Of these, culled by the frustum alone (T1).
    pub lost_frustum: u64,
    /// By T2.
    pub lost_noise: u64,
    /// By T3 as first published, clump by clump.
    pub lost_march: u64,
    /// By T3.
    pub lost_exact: u64,
    /// By T4, as the GPU selects.
    pub lost_hierarchical: u64,
    pub drawn: u64,
    /// The first few false culls of T3 or T4, for messages.
    pub violations: Vec<String>,
}

/// Kind and position of a plant.
type PlantId = (u32, u32, u32);

pub fn measure(land: &Land, cases: &[Case]) -> Result<VisiblePlants> {
    let mut renderer = HeadlessRenderer::open(SIZES[0], SLOTS).context("pictures need a GPU")?;
    let mut visible = VisiblePlants {
        widths: SIZES.iter().map(|size| size.0).collect(),
        seen_by_width: vec![0; SIZES.len()],
        ..VisiblePlants::default()
    };
    for case in cases {
        let Some(scene) = Scene::of(land, case, renderer.slots()) else { continue };
        renderer.upload_world(&scene.world);
        measure_case(&mut renderer, &scene, &mut visible).with_context(|| format!("pose {}", case.name))?;
    }
    Ok(visible)
}

fn measure_case(renderer: &mut HeadlessRenderer, scene: &Scene, visible: &mut VisiblePlants) -> Result<()> {
    let whole = frame_of(scene, Cull::Distance);
    let mut seen: BTreeSet<PlantId> = BTreeSet::new();
    renderer.choose(&whole)?;
    for (size, count) in SIZES.into_iter().zip(&mut visible.seen_by_width) {
        let pixels = renderer.id_buffer(&whole, size)?;
        let ids: BTreeSet<PlantId> = pixels.into_iter().filter(|id| id[1] != 0).map(plant_id).collect();
        *count += ids.len() as u64;
        seen.extend(ids);
    }
    let all = clumps_by_id(renderer)?;
    renderer.choose(&frame_of(scene, Cull::Hierarchical))?;
    let chosen = clumps_by_id(renderer)?;

    let slots = BySlot::new(&scene.world);
    let square = &scene.plants.grid;
    let surface = Surface { slots: &slots, nodes: &square.nodes, chunks: &square.chunks };
    let noise = noise_of(&scene.world, square);
    visible.poses += 1;
    visible.seen += seen.len() as u64;
    visible.drawn += all.len() as u64;
    for id in seen {
        let clump = all.get(&id).context("a plant is seen that was not drawn")?;
        let species = scene.plants.species.iter().find(|species| species.field.kind == id.0);
        let species = species.context("a plant is seen of a kind that does not grow")?;
        let is_lost = |path| {
            let culling = Culling { path, ..species.culling };
            visible_level(&surface, &noise, &culling, &species.planting, clump).is_none()
        };
        visible.lost_frustum += u64::from(is_lost(CULL_FRUSTUM));
        visible.lost_noise += u64::from(is_lost(CULL_NOISE));
        visible.lost_march += u64::from(is_lost(CULL_MARCH));
        let lost = (is_lost(CULL_EXACT), !chosen.contains_key(&id));
        visible.lost_exact += u64::from(lost.0);
        visible.lost_hierarchical += u64::from(lost.1);
        if (lost.0 || lost.1) && visible.violations.len() < 8 {
            visible.violations.push(format!("{}: {clump:?}", scene.name));
        }
    }
    Ok(())
}

fn plant_id([east, south]: [u32; 2]) -> PlantId {
    (east >> 24, east & POSITION, south & POSITION)
}

/// Clumps of the last culling pass.
fn clumps_by_id(renderer: &HeadlessRenderer) -> Result<BTreeMap<PlantId, Clump>> {
    let mut found = BTreeMap::new();
    for ChosenKind { kind, clumps, stats } in renderer.chosen()? {
        ensure!(stats.blocks_lost + stats.clumps_lost == 0, "no room for all visible clumps: {stats:?}");
        found.extend(clumps.into_iter().map(|[x, z, y, settings]| {
            let (x, z) = (x & POSITION, z & POSITION);
            ((kind, x, z), Clump { x: x as i32, z: z as i32, y: y as i32, attributes: settings })
        }));
    }
    Ok(found)
}

/// The scene's frame with another culling method.
pub fn frame_of(scene: &Scene, cull: Cull) -> FrameData {
    let settings = RenderSettings {
        plants: VegetationSettings { cull, ..scene.shot.settings.plants },
        ..scene.shot.settings
    };
    let selection = Selection { drawn: scene.drawn.clone(), missing: 0 };
    ViewParams { settings, ..scene.shot }.frame(scene::Scene::Island, &scene.world, &selection)
}
