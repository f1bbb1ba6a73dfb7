//! Grass: density and thinning with distance against the full field: coverage, mean FLIP, clumps.

use crate::culling::cases::Case;
use crate::culling::id_buffer::frame_of;
use crate::culling::scene::Scene;
use crate::curve::{Curve, Sheet};
use crate::flip::{PIXELS_PER_DEGREE, mean};
use crate::headless_renderer::HeadlessRenderer;
use crate::supersampled::{self, averaged};
use anyhow::{Context, Result, ensure};
use chart::{Choice, Panel, linear, log};
use client::features::vegetation::{Cull, VegetationSettings};
use client::gpu::Image;
use terrain::Land;

/// Size of the compared pictures, pixels, and the factor of supersampling.
const SIZE: (u32, u32) = (240, 135);
const FINER: u32 = 4;

const SLOTS: u32 = 2000;

/// No trees, no wind: the grass alone.
const MEADOW: VegetationSettings =
    VegetationSettings { trees: 0, wind: 0.0, range_m: 180.0, ..VegetationSettings::STANDARD };

/// All clumps everywhere, none widened.
const REFERENCE: VegetationSettings =
    VegetationSettings { density: 32, thin_from_m: 180.0, widest: 1.0, ..MEADOW };

/// Densities, clumps on a cell of 4 m².
const DENSITIES: [u32; 5] = [32, 16, 8, 4, 2];

/// Start of thinning, metres; largest factor of widening.
const THIN_FROM_M: [f32; 5] = [10.0, 20.0, 42.0, 80.0, 140.0];
const WIDEST: [f32; 4] = [1.0, 2.0, 6.0, 12.0];

struct Rendered {
    picture: Image,
    /// Share of the fine picture that shows grass.
    coverage: f64,
    clumps: f64,
}

/// A setting of the knobs with its errors; `key`: its values in the table.
struct Row {
    key: [f64; 2],
    label: String,
    is_default: bool,
    clumps: f64,
    coverage: f64,
    coverage_error: f64,
    flip: f64,
}

pub fn measure(world_seed: u64) -> Result<Curve> {
    let land = Land::new(world_seed);
    let fine = supersampled::size(SIZE, FINER);
    let mut renderer = HeadlessRenderer::open(fine, SLOTS).context("grass needs a GPU")?;
    let reference = render(&mut renderer, &land, REFERENCE)?;
    ensure!(
        reference.coverage > 0.05,
        "no grass is visible at the start of the scene `grass` in world {world_seed}"
    );
    let caption = format!(
        "the scene `grass` from where it starts, {} x {} pixels averaged from {} x {}; against all 32 clumps \
         on every cell up to {} m, which cover {:.1} % of the picture with {:.0} clumps; FLIP at \
         {PIXELS_PER_DEGREE} pixels per degree; {}.",
        SIZE.0,
        SIZE.1,
        fine.0,
        fine.1,
        REFERENCE.range_m,
        100.0 * reference.coverage,
        reference.clumps,
        renderer.adapter()
    );
    let mut row = |key: [f64; 2], label: String, knobs: VegetationSettings| -> Result<Row> {
        let rendered = render(&mut renderer, &land, knobs)?;
        Ok(Row {
            key,
            label,
            is_default: false,
            clumps: rendered.clumps,
            coverage: rendered.coverage,
            coverage_error: (rendered.coverage / reference.coverage - 1.0).abs(),
            flip: mean(&reference.picture, &rendered.picture, PIXELS_PER_DEGREE),
        })
    };
    let (mut densities, mut thinnings) = (Vec::new(), Vec::new());
    for density in DENSITIES {
        let is_default = density == MEADOW.density;
        let label = format!("{density} on 4 m²");
        let row = row([f64::from(density), 0.0], label, VegetationSettings { density, ..MEADOW })?;
        densities.push(Row { is_default, ..row });
    }
    for thin_from_m in THIN_FROM_M {
        for widest in WIDEST {
            let is_default = (thin_from_m, widest) == (MEADOW.thin_from_m, MEADOW.widest);
            let label = format!("{thin_from_m} m x {widest}");
            let key = [thin_from_m, widest].map(f64::from);
            let row = row(key, label, VegetationSettings { thin_from_m, widest, ..MEADOW })?;
            thinnings.push(Row { is_default, ..row });
        }
    }
    let sparse = VegetationSettings { density: 1, thin_from_m: 1.0, widest: 1.0, ..MEADOW };
    let (sparse, shipped) = (row([0.0; 2], String::new(), sparse)?, row([0.0; 2], String::new(), MEADOW)?);
    ensure!(sparse.flip > shipped.flip, "almost no grass is as near to the full field as the default is");

    // The default is in both tables and once in the diagrams.
    let choices = |error: fn(&Row) -> f64| -> Vec<Choice> {
        let rows = densities.iter().chain(thinnings.iter().filter(|row| !row.is_default));
        let choice = |row: &Row| Choice {
            name: row.label.clone(),
            at: (row.clumps, error(row)),
            is_shipped: row.is_default,
        };
        rows.map(choice).collect()
    };
    let x = log("clumps drawn");
    let panels = vec![
        Panel::new("How different settings", x, linear("mean FLIP, 67 pixels per degree"))
            .front(&choices(|row| row.flip)),
        Panel::new("How much it covers", x, log("error of the covered share, %"))
            .front(&choices(|row| 100.0 * row.coverage_error.max(1e-4))),
    ];
    let mut density = Sheet::new("grass_density", caption.clone(), densities);
    density.column("clumps on 4 m²", |row| row.key[0]);
    let mut thinning = Sheet::new("grass_thinning", caption, thinnings);
    thinning.columns(["thinned from, metres", "widest"], |row| row.key);
    for sheet in [&mut density, &mut thinning] {
        let names = ["clumps", "clumps, share of the reference's"];
        sheet.columns(names, |row| [row.clumps, row.clumps / reference.clumps]);
        let covers = ["coverage, %", "coverage error, %"];
        sheet.columns(covers, |row| [row.coverage, row.coverage_error].map(|share| 100.0 * share));
        sheet.column("mean FLIP", |row| row.flip);
    }
    let title = "Grass: density and thinning (reference: every clump at every distance)";
    Ok(Curve { name: "grass", title, tables: vec![density.into(), thinning.into()], panels })
}

fn render(renderer: &mut HeadlessRenderer, land: &Land, plants: VegetationSettings) -> Result<Rendered> {
    let fine = supersampled::size(SIZE, FINER);
    // Levels of detail of the small picture: the terrain does not depend on the resolution.
    let case = Case::at_start(client::scene::Scene::Grass, SIZE, plants);
    let scene = Scene::of(land, &case, renderer.slots()).context("nothing grows in the scene `grass`")?;
    renderer.upload_world(&scene.world);
    let frame = frame_of(&scene, Cull::Frustum);
    renderer.choose(&frame)?;
    let ids = renderer.id_buffer(&frame, fine)?;
    let coverage = ids.iter().filter(|id| id[1] != 0).count() as f64 / ids.len() as f64;
    let chosen = renderer.chosen()?;
    ensure!(chosen.iter().all(|kind| kind.stats.clumps_lost == 0), "no room for all clumps");
    let clumps = chosen.iter().map(|kind| kind.clumps.len() as f64).sum();
    let picture = averaged(&renderer.picture(&frame)?, FINER);
    Ok(Rendered { picture, coverage, clumps })
}
