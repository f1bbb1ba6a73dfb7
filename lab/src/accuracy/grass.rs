//! Grass: fewer clumps, and thinning with the distance, against the full field: how much of the
//! picture they cover, how different it looks (FLIP), and what is drawn for it.

use super::Curve;
use crate::chart::{Choice, Panel, front, log};
use crate::culling::names::frame_of;
use crate::culling::poses::{LENS, Place, Trial};
use crate::culling::scene::Scene;
use crate::flip::{PIXELS_PER_DEGREE, mean};
use crate::studio::Studio;
use crate::table::Table;
use anyhow::{Context, Result, ensure};
use client::camera::Lens;
use client::frame::Shot;
use client::looks::Looks;
use client::plants::{Cull, PlantKnobs};
use client::render::Picture;
use client::world::stretch;
use terrain::Land;

/// Size of the pictures that are compared, pixels; each is drawn so many times as fine and
/// averaged.
const SIZE: (u32, u32) = (240, 135);
const FINER: u32 = 4;

/// Slots of the pool.
const SLOTS: u32 = 2000;

/// No trees, no wind: the grass alone.
const MEADOW: PlantKnobs = PlantKnobs { trees: 0, wind: 0.0, range_m: 180.0, ..PlantKnobs::STANDARD };

/// All clumps everywhere, none wider than it is.
const TRUTH: PlantKnobs = PlantKnobs { density: 32, thin_from_m: 180.0, widest: 1.0, ..MEADOW };

/// Densities, clumps on a cell of 4 m².
const DENSITIES: [u32; 5] = [32, 16, 8, 4, 2];

/// Where thinning begins, metres; and how much wider than they are clumps get at most.
const THIN_FROM_M: [f32; 5] = [10.0, 20.0, 42.0, 80.0, 140.0];
const WIDEST: [f32; 4] = [1.0, 2.0, 6.0, 12.0];

/// What one setting came to.
struct Seen {
    picture: Picture,
    /// Share of the fine picture that shows grass.
    coverage: f64,
    clumps: f64,
}

/// Measures it; the land is that of the scene `grass`.
///
/// # Errors
/// There is no GPU, it failed, or bare land is as near to the full field as thin grass is.
pub fn measure(world_seed: u64) -> Result<Curve> {
    let land = Land::new(world_seed);
    let fine = (SIZE.0 * FINER, SIZE.1 * FINER);
    let mut studio = Studio::open(fine, SLOTS).context("grass needs a GPU")?;
    let truth = see(&mut studio, &land, TRUTH)?;
    ensure!(truth.coverage > 0.05, "no grass is seen where the scene `grass` starts in world {world_seed}");
    let flip = |seen: &Seen| mean(&truth.picture, &seen.picture, PIXELS_PER_DEGREE);
    let coverage_error = |seen: &Seen| (seen.coverage / truth.coverage - 1.0).abs();
    let caption = format!(
        "the scene `grass` from where it starts, {} x {} pixels averaged from {} x {}; against all 32 clumps on every cell up to {} m, which cover {:.1} % of the picture with {:.0} \
         clumps; FLIP at {PIXELS_PER_DEGREE} pixels per degree; {}.",
        SIZE.0,
        SIZE.1,
        fine.0,
        fine.1,
        TRUTH.range_m,
        100.0 * truth.coverage,
        truth.clumps,
        studio.adapter()
    );
    let columns = ["clumps", "clumps, share of the truth's", "coverage, %", "coverage error, %", "mean FLIP"];
    let row = |seen: &Seen| {
        [
            seen.clumps,
            seen.clumps / truth.clumps,
            100.0 * seen.coverage,
            100.0 * coverage_error(seen),
            flip(seen),
        ]
    };
    let named = |first: &[&'static str]| first.iter().copied().chain(columns).collect::<Vec<_>>();
    let mut densities = Table::new("grass_density", caption.clone(), &named(&["clumps on 4 m²"]));
    let mut thinning = Table::new("grass_thinning", caption, &named(&["thinned from, metres", "widest"]));
    let mut choices = (Vec::new(), Vec::new());
    let mut note = |name: String, seen: &Seen, is_shipped: bool| {
        choices.0.push(Choice { name: name.clone(), at: (seen.clumps, flip(seen)), is_shipped });
        choices.1.push(Choice {
            name,
            at: (seen.clumps, 100.0 * coverage_error(seen).max(1e-4)),
            is_shipped,
        });
    };
    for density in DENSITIES {
        let seen = see(&mut studio, &land, PlantKnobs { density, ..MEADOW })?;
        let mut values = vec![f64::from(density)];
        values.extend(row(&seen));
        densities.push(values);
        note(format!("{density} on 4 m²"), &seen, density == MEADOW.density);
    }
    for thin_from_m in THIN_FROM_M {
        for widest in WIDEST {
            let seen = see(&mut studio, &land, PlantKnobs { thin_from_m, widest, ..MEADOW })?;
            let mut values = vec![f64::from(thin_from_m), f64::from(widest)];
            values.extend(row(&seen));
            thinning.push(values);
            if (thin_from_m, widest) != (MEADOW.thin_from_m, MEADOW.widest) {
                note(format!("{thin_from_m} m x {widest}"), &seen, false);
            }
        }
    }
    let bare = see(&mut studio, &land, PlantKnobs { density: 1, thin_from_m: 1.0, widest: 1.0, ..MEADOW })?;
    let shipped = see(&mut studio, &land, MEADOW)?;
    ensure!(flip(&bare) > flip(&shipped), "almost bare land is as near to the full field as the standard is");
    let x = log("clumps drawn");
    let panels = vec![
        Panel { title: "How different it looks", x, y: linear_flip(), series: front(&choices.0) },
        Panel {
            title: "How much it covers",
            x,
            y: log("error of the covered share, %"),
            series: front(&choices.1),
        },
    ];
    Ok(Curve {
        name: "grass",
        title: "Grass: density and thinning (truth: every clump at every distance)",
        tables: vec![densities, thinning],
        panels,
    })
}

const fn linear_flip() -> crate::chart::Axis {
    crate::chart::linear("mean FLIP, 67 pixels per degree")
}

fn see(studio: &mut Studio, land: &Land, plants: PlantKnobs) -> Result<Seen> {
    let start = client::scene::Scene::Grass;
    let fine = (SIZE.0 * FINER, SIZE.1 * FINER);
    let trial = Trial {
        name: "the scene `grass`".into(),
        place: Place::Land,
        shot: Shot {
            pose: start.start(),
            // Levels of detail as for the small picture: the land does not change with how finely
            // it is drawn.
            lens: Lens { width: SIZE.0, height: SIZE.1, ..LENS },
            view_distance_m: 2600,
            tolerance_px: 2.0,
            time_s: 0.0,
            looks: Looks { plants, ..Looks::default() },
        },
        stretch: stretch::ONE,
    };
    let scene = Scene::of(land, &trial, studio.slots()).context("nothing grows in the scene `grass`")?;
    studio.furnish(&scene.world);
    let frame = frame_of(&scene, Cull::Frustum);
    studio.choose(&frame)?;
    let names = studio.names(&frame, fine)?;
    let coverage = names.iter().filter(|name| name[1] != 0).count() as f64 / names.len() as f64;
    let chosen = studio.chosen()?;
    ensure!(chosen.iter().all(|kind| kind.told.clumps_lost == 0), "no room for all clumps");
    let clumps = chosen.iter().map(|kind| kind.clumps.len() as f64).sum();
    let picture = averaged(&studio.picture(&frame)?);
    Ok(Seen { picture, coverage, clumps })
}

/// The mean of every square of pixels, of the light that they stand for.
fn averaged(fine: &Picture) -> Picture {
    let (width, height) = (fine.width / FINER, fine.height / FINER);
    let linear = |byte: u8| (f64::from(byte) / 255.0).powf(2.2);
    let mut rgba = Vec::with_capacity((4 * width * height) as usize);
    for row in 0..height {
        for column in 0..width {
            for channel in 0..3 {
                let of = |x: u32, y: u32| {
                    let pixel = (row * FINER + y) * fine.width + column * FINER + x;
                    linear(fine.rgba[(4 * pixel + channel) as usize])
                };
                let sum: f64 =
                    (0..FINER).flat_map(|y| (0..FINER).map(move |x| (x, y))).map(|(x, y)| of(x, y)).sum();
                let mean = sum / f64::from(FINER * FINER);
                rgba.push((255.0 * mean.powf(1.0 / 2.2)).round() as u8);
            }
            rgba.push(255);
        }
    }
    Picture { width, height, rgba }
}
