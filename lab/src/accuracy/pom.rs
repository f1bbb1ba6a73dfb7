//! Parallax occlusion mapping: every march over every map under every angle against the reference
//! in f64, thresholds of the automatic tier, precision of heights filtered by the sampler, shadow.
//!
//! Control: a coarse search that must miss narrow features.

use crate::curve::{Curve, Sheet, floored, numbered};
use crate::pom::bench::PomBench;
use crate::pom::comparison::{AMPLITUDE, Condition, Score, Stage, probes, relief};
use crate::pom::maps::{Kind, SIDE};
use crate::pom::reference;
use crate::stats::{mean, quantiles, worst};
use crate::table::Table;
use anyhow::{Result, ensure};
use chart::{Choice, Panel, linear, log};
use client::features::pom::PomSettings;
use client::features::pom::settings::{Heights, PomMethod, PomShadow, Refine};
use shaders::layout::{PomParams, PomProbe, PomResult};

/// Rays of a condition.
const RAYS: u32 = 20_000;
/// Angles from the plane's normal, degrees; at 0 nothing travels.
const ANGLES_DEG: [f32; 5] = [30.0, 60.0, 75.0, 85.0, 89.0];
/// Shares below this cannot be distinguished from 0 with so many rays, per cent.
const NONE: f64 = 100.0 / RAYS as f64;
/// Travels at which the tiers are compared, texels.
const TRAVELS: [f32; 11] = [0.25, 0.5, 1.0, 2.0, 3.0, 4.0, 6.0, 8.0, 12.0, 16.0, 24.0];
/// Positions with reference shadows.
const SHADOWED: u32 = 1_000;
/// Rays to the disc of the sun, and its radius as a share of the distance: four times that of the
/// sun, for penumbras.
const DISC: u32 = 64;
const DISC_RADIUS: f64 = 0.0187;

/// Elevation of the sun: even smooth hills have shadows.
const SUN_DEG: f32 = 12.0;

/// A way to march.
struct Method {
    name: String,
    how: PomParams,
    is_shipped: bool,
}

fn methods() -> Vec<Method> {
    let search = |steps: u32, refine: Refine, rounds: u32| PomParams {
        steps_min: steps,
        steps_max: steps,
        refine: refine as u32,
        refinements: rounds,
        ..relief(PomMethod::Linear)
    };
    let method = |name: &str, how: PomParams| Method { name: name.to_owned(), how, is_shipped: false };
    let mut all = vec![method("offset", relief(PomMethod::Offset))];
    all.extend(
        [4, 8, 16, 32, 64, 128]
            .map(|steps| method(&format!("{steps} + secant"), search(steps, Refine::Secant, 3))),
    );
    all.push(method("16 + segment", search(16, Refine::Segment, 0)));
    all.push(method("16 + bisection", search(16, Refine::Bisection, 5)));
    all.push(method("64", search(64, Refine::None, 0)));
    all.push(method("cones", relief(PomMethod::Cones)));
    all.push(method("pyramid", relief(PomMethod::MaxMip)));
    all.push(Method { is_shipped: true, ..method("auto", relief(PomMethod::Auto)) });
    all
}

/// A march under an angle.
struct Row {
    angle_deg: f32,
    method: usize,
    score: Score,
}

/// Measures one map.
pub fn measure(kind: Kind) -> Result<Curve> {
    let bench = PomBench::open()?;
    let stage = Stage::new(&bench, true)?;
    let layer = Kind::ALL.iter().position(|other| *other == kind).unwrap_or(0);
    let methods = methods();
    let mut rows = Vec::new();
    for angle_deg in ANGLES_DEG {
        let condition = Condition::new(&stage, layer, angle_deg, RAYS);
        for (index, method) in methods.iter().enumerate() {
            rows.push(Row { angle_deg, method: index, score: condition.score(&bench, &stage, &method.how)? });
        }
    }
    // Method 1 takes 4 steps.
    let coarse = worst(rows.iter().filter(|row| row.method == 1).map(|row| row.score.wrong));
    ensure!(coarse > 0.01, "4 steps miss nothing of {}: the measurement detects nothing", kind.name());
    let (name, title) = TITLES[layer];
    let caption = format!(
        "places found by each method against the f64 reference, map {} of {SIDE} texels, relief {AMPLITUDE} \
         tiles high, {RAYS} rays each, {}; methods: {}.",
        kind.name(),
        bench.adapter(),
        numbered(methods.iter().map(|method| &method.name), "; ")
    );
    let mut sheet = Sheet::new(name, caption, rows);
    sheet.columns(["angle, degrees", "method"], |row| [row.angle_deg.into(), row.method as f64]);
    sheet.columns(["p50, texels", "p95, texels", "p99.9, texels"], |row| row.score.texels);
    sheet.column("more than 4 texels off, %", |row| 100.0 * row.score.wrong);
    sheet.column("of these no tangents, % of all", |row| 100.0 * row.score.wrong_without_excuse);
    sheet.column("residual p99.9, of the relief", |row| row.score.residual);
    sheet.column("fetches", |row| row.score.fetches);
    let choice = |row: &Row| Choice {
        name: methods[row.method].name.clone(),
        at: (row.score.fetches, (100.0 * row.score.wrong).max(NONE)),
        is_shipped: methods[row.method].is_shipped,
    };
    let (x, y) = (log("heights and bounds looked up, mean"), log("more than 4 texels off, % (0.005: none)"));
    let panel = |(angle_deg, title)| {
        let rows = sheet.rows.iter().filter(|row| row.angle_deg == angle_deg);
        Panel::new(title, x, y).front(&rows.map(choice).collect::<Vec<_>>())
    };
    let panels = ANGLES_DEG.into_iter().zip(ANGLE_TITLES).map(panel).collect();
    Ok(Curve { name, title, tables: vec![sheet.into()], panels })
}

const ANGLE_TITLES: [&str; 5] =
    ["30 degrees from above", "60 degrees", "75 degrees", "85 degrees", "89 degrees: along the plane"];

/// Names and titles of the curves of maps.
const TITLES: [(&str, &str); Kind::ALL.len()] = [
    ("pom_fbm", "Parallax occlusion over smooth hills: cost of a missed feature"),
    ("pom_brick", "Parallax occlusion over bricks: cost of a missed feature"),
    ("pom_posts", "Parallax occlusion over thin posts: cost of a missed feature"),
    ("pom_ridges", "Parallax occlusion over ridges of one texel: cost of a missed feature"),
];

/// Measures the other knobs: thresholds of the automatic tier, filtering of heights, shadow.
pub fn knobs(_: u64) -> Result<Curve> {
    let bench = PomBench::open()?;
    let stage = Stage::new(&bench, false)?;
    let (travel, mut panels) = travels(&bench, &stage)?;
    let (filter, filter_panel) = filtering(&bench, &stage)?;
    let (shadow, shadow_panel) = shadows(&bench, &stage)?;
    panels.extend([filter_panel, shadow_panel]);
    let tables = vec![travel, filter, shadow];
    let title = "Parallax occlusion: thresholds of the automatic tier, filtering, shadow";
    Ok(Curve { name: "pom_knobs", title, tables, panels })
}

const TIERS: [&str; 5] = ["flat", "offset", "linear, a texel a step", "pyramid", "auto"];

/// 99.9th percentile of the error and fetches of each tier, by travel of the ray in a map.
struct Travel {
    layer: usize,
    texels: f32,
    tiers: [[f64; 2]; 5],
}

fn travels(bench: &PomBench, stage: &Stage) -> Result<(Table, Vec<Panel>)> {
    let mut rows = Vec::new();
    for (layer, texels) in (0..Kind::ALL.len()).flat_map(|layer| TRAVELS.map(|travel| (layer, travel))) {
        let angle_deg = (texels / (AMPLITUDE * SIDE as f32)).atan().to_degrees();
        let condition = Condition::new(stage, layer, angle_deg, RAYS);
        let steps = (texels.ceil() as u32 + 1).min(PomSettings::MAX_STEPS);
        let methods = [
            relief(PomMethod::Flat),
            relief(PomMethod::Offset),
            PomParams { steps_min: steps, steps_max: steps, ..relief(PomMethod::Linear) },
            relief(PomMethod::MaxMip),
            relief(PomMethod::Auto),
        ];
        let mut tiers = [[0.0; 2]; 5];
        for (how, tier) in methods.iter().zip(&mut tiers) {
            let score = condition.score(bench, stage, how)?;
            *tier = [score.texels[2], score.fetches];
        }
        rows.push(Travel { layer, texels, tiers });
    }
    let caption = format!(
        "error and work of each tier by how far the ray travels through the relief, {RAYS} rays each, \
         {}; maps: {}.",
        bench.adapter(),
        numbered(Kind::ALL.map(Kind::name), "; ")
    );
    let mut sheet = Sheet::new("pom_travel", caption, rows);
    sheet.columns(["map", "travel, texels"], |row| [row.layer as f64, row.texels.into()]);
    for (index, tier) in TIERS.into_iter().enumerate() {
        let names = [format!("{tier} p99.9, texels"), format!("{tier} fetches")];
        sheet.columns(names, |row| row.tiers[index]);
    }
    let x = log("travel through the relief, texels");
    let panel = |title, y, layer: usize, tiers: &[&'static str], figure: &str| {
        tiers.iter().fold(Panel::new(title, x, y), |panel, tier| {
            let column = format!("{tier} {figure}");
            let points = sheet.points_where(|row| row.layer == layer, "travel, texels", &column);
            panel.line(*tier, floored(points, 1e-3))
        })
    };
    let (error, work) =
        (log("p99.9 error, texels (0.001: rounding)"), linear("heights and bounds looked up, mean"));
    // The flat tier looks nothing up.
    let (all, marching) = (&TIERS[..], &TIERS[1..]);
    let panels = vec![
        panel("Error by travel, bricks", error, 1, all, "p99.9, texels"),
        panel("Error by travel, ridges of one texel", error, 3, all, "p99.9, texels"),
        panel("Work by travel, bricks", work, 1, marching, "fetches"),
        panel("Work by travel, ridges of one texel", work, 3, marching, "fetches"),
    ];
    Ok((sheet.into(), panels))
}

/// Figures by map as a table and as a panel, which shows the first `lines` of them.
fn by_map<const N: usize>(
    (name, caption): (&'static str, String),
    rows: Vec<[f64; N]>,
    columns: [&'static str; N],
    (panel, floor, lines): (Panel, f64, usize),
) -> (Table, Panel) {
    let mut sheet = Sheet::new(name, caption, rows.into_iter().enumerate().collect());
    sheet.column("map", |row| row.0 as f64);
    sheet.columns(columns, |row| row.1);
    let line = |panel: Panel, column| panel.line(column, floored(sheet.points("map", column), floor));
    let panel = columns.into_iter().take(lines).fold(panel, line);
    (sheet.into(), panel)
}

const MAPS: &str = "map: 0 hills, 1 bricks, 2 posts, 3 ridges";

/// Error of the height at the found position when a texel covers many pixels: rays through a patch
/// of a quarter texel.
fn filtering(bench: &PomBench, stage: &Stage) -> Result<(Table, Panel)> {
    let mut rows = Vec::new();
    for layer in 0..Kind::ALL.len() {
        let mut rays = probes(layer, RAYS, 60.0, AMPLITUDE);
        for (index, ray) in rays.iter_mut().enumerate() {
            // A hundred patches all over the map.
            let patch = index / (RAYS as usize / 100);
            let base = [patch % 10, patch / 10].map(|part| part as f32 / 10.0);
            ray.uv = [0, 1].map(|axis| base[axis] + ray.uv[axis] * 0.25 / SIDE as f32);
        }
        let percentiles = |heights: Heights| -> Result<[f64; 2]> {
            let how = PomParams {
                steps_min: PomSettings::MAX_STEPS,
                steps_max: PomSettings::MAX_STEPS,
                refinements: 8,
                heights: heights as u32,
                ..relief(PomMethod::Linear)
            };
            let (found, _) = bench.run(&stage.uploaded, &how, &rays, 1)?;
            // The residual is computed from exact heights.
            let errors = found.iter().map(|found| f64::from(found.residual.abs()) * 65_536.0);
            Ok(quantiles(errors, [0.5, 0.95]))
        };
        let ([sampler50, sampler95], [exact50, exact95]) =
            (percentiles(Heights::Sampler)?, percentiles(Heights::Exact)?);
        rows.push([sampler50, sampler95, exact50, exact95]);
    }
    ensure!(
        rows[0][1] > rows[0][3],
        "the sampler is as exact as f32: it would need more than 256 positions between two texels"
    );
    let caption = format!(
        "surface at the found place against the ray's height there, 2^-16 of the relief, {RAYS} rays through \
         patches of a quarter texel, 60 degrees, 256 steps and 8 rounds of secant; {}.",
        bench.adapter()
    );
    let y = log("surface off the ray, 1/65536 of the relief");
    let panel = Panel::new("Heights under magnification", linear(MAPS), y);
    let columns = ["sampler p50", "sampler p95", "exact p50", "exact p95"];
    Ok(by_map(("pom_filter", caption), rows, columns, (panel, 1e-3, 4)))
}

/// Shadow of each kind against many rays to a disc.
fn shadows(bench: &PomBench, stage: &Stage) -> Result<(Table, Panel)> {
    let mut rows = Vec::new();
    for (layer, map) in stage.maps.iter().enumerate() {
        let mut rays = probes(layer, SHADOWED, 60.0, AMPLITUDE);
        let (sin, cos) = SUN_DEG.to_radians().sin_cos();
        for ray in &mut rays {
            let level = cos / ray.to_sun[0].hypot(ray.to_sun[1]);
            ray.to_sun = [ray.to_sun[0] * level, ray.to_sun[1] * level, sin];
        }
        let run = |shadow: PomShadow| -> Result<_> {
            let how = PomParams { shadow: shadow as u32, ..relief(PomMethod::MaxMip) };
            Ok(bench.run(&stage.uploaded, &how, &rays, 1)?.0)
        };
        let found = [run(PomShadow::Off)?, run(PomShadow::Hard)?, run(PomShadow::Soft)?];
        let share = |(found, ray): (&PomResult, _)| disc_share(map, found.uv.map(f64::from), ray);
        let references: Vec<f64> = found[0].iter().zip(&rays).map(share).collect();
        let error = |(found, reference): (&PomResult, &f64)| (f64::from(found.sun) - reference).abs();
        let [none, hard, soft] = found.map(|found| mean(found.iter().zip(&references).map(error)));
        ensure!(none > hard, "no shadow is as near to the reference as hard shadow over map {layer}");
        rows.push([none, hard, soft, 1.0 - mean(references)]);
    }
    let caption = format!(
        "mean difference of the share of the sun from {DISC} f64 rays to a disc of radius {DISC_RADIUS}, sun \
         {SUN_DEG} degrees high, {SHADOWED} places seen 60 degrees from above, {}.",
        bench.adapter()
    );
    let y = log("mean difference of the sun's share");
    let panel = Panel::new("Shadow of the relief on itself", linear(MAPS), y);
    Ok(by_map(
        ("pom_shadow", caption),
        rows,
        ["none", "hard", "soft", "true share of shadow"],
        (panel, 1e-4, 3),
    ))
}

/// Share of the disc of the sun that is visible from a point on the surface.
fn disc_share(map: &client::features::pom::HeightMap, uv: [f64; 2], probe: &PomProbe) -> f64 {
    let height = reference::height(map, uv);
    let sun = probe.to_sun.map(f64::from);
    // Points of a sunflower spiral, uniform over the area of the disc.
    let is_lit = |index: u32| {
        let radius = DISC_RADIUS * ((f64::from(index) + 0.5) / f64::from(DISC)).sqrt();
        let (sin, cos) = (f64::from(index) * 2.399_963).sin_cos();
        let level = [sun[0] + radius * cos, sun[1] + radius * sin];
        let travel = level.map(|part| part / sun[2] * f64::from(probe.amplitude));
        let lift = 0.5 / (travel[0].hypot(travel[1]) * SIDE as f64).max(0.5);
        reference::is_lit(map, uv, height, travel, lift)
    };
    f64::from((0..DISC).filter(|index| is_lit(*index)).count() as u32) / f64::from(DISC)
}
