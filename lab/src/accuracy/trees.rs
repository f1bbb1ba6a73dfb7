//! Trees: where impostors begin, and up to where each tree is culled by itself, against leaves and
//! per-tree culling everywhere: mean FLIP, vertices, trees.

use crate::curve::{Curve, Sheet};
use crate::flip::{PIXELS_PER_DEGREE, mean};
use crate::headless_renderer::HeadlessRenderer;
use crate::lod::screen::{self, ViewCase};
use crate::supersampled::{self, averaged};
use crate::world_builder::WorldBuilder;
use anyhow::{Context, Result, ensure};
use chart::{Panel, linear, log};
use client::features::vegetation::VegetationSettings;
use client::gpu::Image;
use client::settings::RenderSettings;
use client::view::ViewParams;
use shaders::layout::{FINE_PER_METRE, KIND_TREES, TREE_VERTICES};
use terrain::Land;

/// Size of the compared pictures, pixels, and the factor of supersampling.
const SIZE: (u32, u32) = (480, 270);
const FINER: u32 = 2;

const SLOTS: u32 = 4_000;

/// Over a wooded plain towards mountains; low over hills.
const CAMERAS: [&str; 2] = ["720,160,1700,0,-8", "-2200,60,-900,70,-3"];

/// No grass, no wind: the trees alone.
const WOODS: VegetationSettings = VegetationSettings {
    density: 0,
    trees: 2,
    wind: 0.0,
    tree_range_m: 3_000.0,
    ..VegetationSettings::STANDARD
};

/// Trees that are single as far as possible: the reference of that knob.
const SINGLE: VegetationSettings =
    VegetationSettings { single_trees_m: VegetationSettings::MAX_RANGE_M, ..WOODS };

/// All of them with leaves: the reference of the impostors.
const LEAVES: VegetationSettings =
    VegetationSettings { impostors_from_m: VegetationSettings::MAX_RANGE_M, ..SINGLE };

/// Values of the knobs, metres.
const IMPOSTORS_FROM_M: [f32; 7] = [0.0, 50.0, 100.0, 220.0, 400.0, 800.0, 1_500.0];
const SINGLE_TREES_M: [f32; 6] = [100.0, 200.0, 350.0, 700.0, 1_500.0, VegetationSettings::MAX_RANGE_M];

/// Drawn features at one camera.
struct Rendered {
    picture: Image,
    /// Trees that are culled one by one and are seen, and their vertices.
    trees: f64,
    vertices: f64,
}

/// A value of a knob: means of the cameras.
struct Row {
    metres: f64,
    is_default: bool,
    trees: f64,
    vertices: f64,
    flip: f64,
}

/// Measures both knobs.
pub fn measure(world_seed: u64) -> Result<Curve> {
    let land = Land::new(world_seed);
    let fine = supersampled::size(SIZE, FINER);
    let mut renderer = HeadlessRenderer::open(fine, SLOTS).context("trees need a GPU")?;
    let adapter = renderer.adapter();
    let mut worlds = Vec::new();
    for camera in CAMERAS {
        let settings = RenderSettings { plants: LEAVES, ..RenderSettings::default() };
        let view = ViewCase { pose: camera.parse()?, tolerance_px: 2.0 }.shot_of(SIZE, settings);
        worlds.push((view, screen::selected(&mut WorldBuilder::new(land), &view)));
    }
    let mut drawn = |plants: VegetationSettings| -> Result<Vec<Rendered>> {
        let mut pictures = Vec::new();
        for (view, (world, selection)) in &worlds {
            let view = ViewParams { settings: RenderSettings { plants, ..view.settings }, ..*view };
            renderer.upload_world(world);
            let frame = view.frame(client::scene::Scene::Island, world, selection);
            renderer.choose(&frame)?;
            let chosen = renderer.chosen()?;
            ensure!(chosen.iter().all(|kind| kind.stats.clumps_lost == 0), "no room for all trees");
            let trees = frame.plants.as_ref().and_then(|plants| plants.species.first());
            let species = trees.context("nothing grows before the camera")?;
            let vertices = |words: &[u32; 4]| {
                let away = |place: u32, eye: i32| {
                    (f64::from(place & 0xff_ffff) - f64::from(eye)) / f64::from(FINE_PER_METRE)
                };
                let away_m =
                    away(words[0], species.culling.eye[0]).hypot(away(words[1], species.culling.eye[2]));
                let level =
                    species.field.lod_m.iter().filter(|begin_m| away_m >= f64::from(**begin_m)).count();
                f64::from(TREE_VERTICES[level.min(TREE_VERTICES.len() - 1)])
            };
            let clumps = chosen.iter().filter(|kind| kind.kind == KIND_TREES).flat_map(|kind| &kind.clumps);
            let (trees, vertices) =
                clumps.fold((0.0, 0.0), |(trees, sum), words| (trees + 1.0, sum + vertices(words)));
            pictures.push(Rendered { picture: averaged(&renderer.picture(&frame)?, FINER), trees, vertices });
        }
        Ok(pictures)
    };
    let references = [drawn(LEAVES)?, drawn(SINGLE)?];
    let mut row = |reference: usize, metres: f32, is_default: bool, plants: VegetationSettings| {
        let (all, truth) = (drawn(plants)?, &references[reference]);
        let mean_of =
            |value: &dyn Fn(usize) -> f64| (0..all.len()).map(value).sum::<f64>() / all.len() as f64;
        anyhow::Ok(Row {
            metres: f64::from(metres),
            is_default,
            trees: mean_of(&|at| all[at].trees),
            vertices: mean_of(&|at| all[at].vertices),
            flip: mean_of(&|at| mean(&truth[at].picture, &all[at].picture, PIXELS_PER_DEGREE)),
        })
    };
    let impostors = IMPOSTORS_FROM_M.map(|impostors_from_m| {
        let is_default = impostors_from_m == WOODS.impostors_from_m;
        row(0, impostors_from_m, is_default, VegetationSettings { impostors_from_m, ..SINGLE })
    });
    let impostors = impostors.into_iter().collect::<Result<Vec<_>>>()?;
    let singles = SINGLE_TREES_M.map(|single_trees_m| {
        let is_default = single_trees_m == WOODS.single_trees_m;
        row(1, single_trees_m, is_default, VegetationSettings { single_trees_m, ..WOODS })
    });
    let singles = singles.into_iter().collect::<Result<Vec<_>>>()?;
    // Grass that ends at the eye's feet: a frame without plants has no species.
    let none = row(0, 0.0, false, VegetationSettings { trees: 0, density: 1, range_m: 1.0, ..WOODS })?;
    let worst = impostors.iter().chain(&singles).map(|row| row.flip).fold(0.0, f64::max);
    ensure!(none.flip > worst, "no trees are as near to all of them as a setting is");

    let caption = format!(
        "{} views of woods, {} x {} pixels averaged from {} x {}, trees up to {} m; against leaves, and \
         per-tree culling, up to {} m; FLIP at {PIXELS_PER_DEGREE} pixels per degree; without trees {:.3}; \
         {adapter}.",
        CAMERAS.len(),
        SIZE.0,
        SIZE.1,
        fine.0,
        fine.1,
        WOODS.tree_range_m,
        VegetationSettings::MAX_RANGE_M,
        none.flip,
    );
    let sheet = |name, knob: &str, rows| {
        let mut sheet = Sheet::new(name, caption.clone(), rows);
        let names = [knob, "trees one by one", "vertices", "mean FLIP"];
        sheet.columns(names, |row: &Row| [row.metres, row.trees, row.vertices, row.flip]);
        sheet
    };
    let impostors = sheet("trees_impostors", "impostors from, metres", impostors);
    let singles = sheet("trees_single", "single trees up to, metres", singles);
    let name = |row: &Row| (format!("{} m", row.metres), row.is_default);
    let error = linear("mean FLIP, 67 pixels per degree");
    let panels = vec![
        impostors.front(
            Panel::new("Where impostors begin", log("vertices of trees"), error),
            "vertices",
            "mean FLIP",
            name,
        ),
        singles.front(
            Panel::new("Up to where trees are single", log("trees one by one"), error),
            "trees one by one",
            "mean FLIP",
            name,
        ),
    ];
    let title = "Trees: impostors and patches (reference: leaves and single trees everywhere)";
    Ok(Curve { name: "trees", title, tables: vec![impostors.into(), singles.into()], panels })
}
