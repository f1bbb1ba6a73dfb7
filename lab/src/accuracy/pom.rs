//! Parallax occlusion: every way to march over every map under every angle against the f64 truth,
//! the knees of the automatic tier, and what filtering heights by the sampler costs in accuracy
//! when a texel fills the picture.
//!
//! A search that must miss narrow features has to miss them, or the measurement is refused.

use super::Curve;
use super::errors::quantile;
use crate::chart::{Axis, Choice, Panel, Series, front, linear, log, measured};
use crate::relief::bench::ReliefBench;
use crate::relief::maps::{Kind, SIDE};
use crate::relief::trial::{AMPLITUDE, Condition, Score, Stage, probes, relief};
use crate::relief::truth;
use crate::table::Table;
use anyhow::{Result, ensure};
use client::relief::ReliefKnobs;
use client::relief::knobs::{Heights, Refine, ReliefShadow, ReliefTier};
use shaders::layout::{Relief, ReliefProbe};

/// Rays of a condition.
const RAYS: u32 = 20_000;
/// Angles from the plane's normal, degrees; at 0 nothing travels.
const ANGLES_DEG: [f32; 5] = [30.0, 60.0, 75.0, 85.0, 89.0];
/// Shares below this cannot be told from none with so many rays, per cent.
const NONE: f64 = 100.0 / RAYS as f64;
/// Travels at which the tiers are compared, texels.
const TRAVELS: [f32; 11] = [0.25, 0.5, 1.0, 2.0, 3.0, 4.0, 6.0, 8.0, 12.0, 16.0, 24.0];
/// Rays that are asked for the sun; each takes hundreds of shadow rays.
const SUNNY: u32 = 1_000;
/// Rays to the disc of the sun, and its radius as a share of the distance: that of the sun, four
/// times over, so that penumbras are met.
const DISC: u32 = 64;
const DISC_RADIUS: f64 = 0.0187;

/// The sun stands so low that even smooth hills have shadows.
const SUN_DEG: f32 = 12.0;

/// A way to march.
struct Method {
    name: String,
    how: Relief,
    is_shipped: bool,
}

fn methods() -> Vec<Method> {
    let search = |steps: u32, refine: Refine, rounds: u32| Relief {
        steps_min: steps,
        steps_max: steps,
        refine: refine as u32,
        refinements: rounds,
        ..relief(ReliefTier::Linear)
    };
    let method = |name: &str, how: Relief| Method { name: name.to_owned(), how, is_shipped: false };
    let mut all = vec![method("offset", relief(ReliefTier::Offset))];
    all.extend(
        [4, 8, 16, 32, 64, 128]
            .map(|steps| method(&format!("{steps} + secant"), search(steps, Refine::Secant, 3))),
    );
    all.push(method("16 + segment", search(16, Refine::Segment, 0)));
    all.push(method("16 + bisection", search(16, Refine::Bisection, 5)));
    all.push(method("64", search(64, Refine::None, 0)));
    all.push(method("cones", relief(ReliefTier::Cones)));
    all.push(method("pyramid", relief(ReliefTier::Pyramid)));
    all.push(Method { is_shipped: true, ..method("auto", relief(ReliefTier::Auto)) });
    all
}

/// Measures one map.
///
/// # Errors
/// There is no GPU, it failed, or a search that must miss something misses nothing.
pub fn measure(kind: Kind) -> Result<Curve> {
    let bench = ReliefBench::open()?;
    let stage = Stage::new(&bench, true);
    let layer = Kind::ALL.iter().position(|other| *other == kind).unwrap_or(0);
    let methods = methods();
    let names: Vec<String> =
        methods.iter().enumerate().map(|(index, method)| format!("{index} {}", method.name)).collect();
    let (name, title, titles) = words(kind);
    let mut table = Table::new(
        name,
        format!(
            "places found by each method against the f64 truth, map {} of {SIDE} texels, relief {AMPLITUDE} tiles high, {RAYS} rays each, {}; methods: {}.",
            kind.name(),
            bench.adapter(),
            names.join("; ")
        ),
        &[
            "angle, degrees",
            "method",
            "p50, texels",
            "p95, texels",
            "p99.9, texels",
            "more than 4 texels off, %",
            "of these no tangents, % of all",
            "residual p99.9, of the relief",
            "fetches",
        ],
    );
    let mut panels = Vec::new();
    for (angle_deg, title) in ANGLES_DEG.into_iter().zip(titles) {
        let condition = Condition::new(&stage, layer, angle_deg, RAYS);
        let mut choices = Vec::new();
        for (index, method) in methods.iter().enumerate() {
            let score = condition.score(&bench, &stage, &method.how)?;
            let Score { texels: [p50, p95, p999], residual, fetches, .. } = score;
            let (wrong, unexcused) = (100.0 * score.wrong, 100.0 * score.wrong_without_excuse);
            table.push([
                f64::from(angle_deg),
                index as f64,
                p50,
                p95,
                p999,
                wrong,
                unexcused,
                residual,
                fetches,
            ]);
            let at = (fetches, wrong.max(NONE));
            choices.push(Choice { name: method.name.clone(), at, is_shipped: method.is_shipped });
        }
        let (x, y) =
            (log("heights and bounds looked up, mean"), log("more than 4 texels off, % (0.005: none)"));
        panels.push(Panel { title, x, y, series: front(&choices) });
    }
    let coarse = table.rows.iter().filter(|row| row[1] == 1.0).map(|row| row[5]).fold(0.0, f64::max);
    ensure!(coarse > 1.0, "4 steps miss nothing of {}: the measurement cannot be trusted", kind.name());
    Ok(Curve { name, title, tables: vec![table], panels })
}

/// Name, title and titles of the panels.
fn words(kind: Kind) -> (&'static str, &'static str, [&'static str; 5]) {
    const ANGLES: [&str; 5] =
        ["30 degrees from above", "60 degrees", "75 degrees", "85 degrees", "89 degrees: along the plane"];
    match kind {
        Kind::Fbm => ("pom_fbm", "Parallax occlusion over smooth hills: what a missed feature costs", ANGLES),
        Kind::Brick => ("pom_brick", "Parallax occlusion over bricks: what a missed feature costs", ANGLES),
        Kind::Posts => {
            ("pom_posts", "Parallax occlusion over thin posts: what a missed feature costs", ANGLES)
        }
        Kind::Ridges => {
            ("pom_ridges", "Parallax occlusion over ridges of one texel: what a missed feature costs", ANGLES)
        }
    }
}

/// Measures the knobs that are no march: thresholds of the automatic tier, filtering of heights,
/// shadow.
///
/// # Errors
/// There is no GPU, it failed, or a control is no worse than what it controls.
pub fn knobs(_: u64) -> Result<Curve> {
    let bench = ReliefBench::open()?;
    let stage = Stage::new(&bench, false);
    let (travel, travel_panels) = travels(&bench, &stage)?;
    let (filter, filter_panel) = filtering(&bench, &stage)?;
    let (shadow, shadow_panel) = shadows(&bench, &stage)?;
    let mut panels = travel_panels;
    panels.extend([filter_panel, shadow_panel]);
    Ok(Curve {
        name: "pom_knobs",
        title: "Parallax occlusion: knees of the automatic tier, filtering, shadow",
        tables: vec![travel, filter, shadow],
        panels,
    })
}

/// How far off each tier is and what it looks up, by travel.
fn travels(bench: &ReliefBench, stage: &Stage) -> Result<(Table, Vec<Panel>)> {
    let tiers = ["flat", "offset", "linear, a texel a step", "pyramid", "auto"];
    let mut columns = vec!["map".to_owned(), "travel, texels".to_owned()];
    columns.extend(
        tiers.iter().flat_map(|tier| ["p99.9, texels", "fetches"].map(|what| format!("{tier} {what}"))),
    );
    let columns: Vec<&str> = columns.iter().map(String::as_str).collect();
    let maps = Kind::ALL
        .iter()
        .enumerate()
        .map(|(index, kind)| format!("{index} {}", kind.name()))
        .collect::<Vec<_>>()
        .join("; ");
    let mut table = Table::new(
        "pom_travel",
        format!(
            "error and work of each tier by how far the ray travels through the relief, {RAYS} rays each, {}; maps: {maps}.",
            bench.adapter()
        ),
        &columns,
    );
    for layer in 0..Kind::ALL.len() {
        for travel in TRAVELS {
            let angle_deg = (travel / (AMPLITUDE * SIDE as f32)).atan().to_degrees();
            let condition = Condition::new(stage, layer, angle_deg, RAYS);
            let steps = (travel.ceil() as u32 + 1).min(ReliefKnobs::MAX_STEPS);
            let ways = [
                relief(ReliefTier::Flat),
                relief(ReliefTier::Offset),
                Relief { steps_min: steps, steps_max: steps, ..relief(ReliefTier::Linear) },
                relief(ReliefTier::Pyramid),
                relief(ReliefTier::Auto),
            ];
            let mut row = vec![layer as f64, f64::from(travel)];
            for how in &ways {
                let score = condition.score(bench, stage, how)?;
                row.extend([score.texels[2], score.fetches]);
            }
            table.push(row);
        }
    }
    let lines = |layer: usize, what: &str| -> Vec<Series> {
        let x = table.columns.iter().position(|column| column == "travel, texels").unwrap_or(0);
        let line = |tier: &&'static str| {
            let y = table.columns.iter().position(|column| *column == format!("{tier} {what}")).unwrap_or(0);
            let rows = table.rows.iter().filter(|row| row[0] == layer as f64);
            measured(*tier, rows.map(|row| (row[x], row[y].max(1e-3))))
        };
        // A flat plane looks nothing up.
        tiers.iter().skip(usize::from(what == "fetches")).map(line).collect()
    };
    let x = log("travel through the relief, texels");
    let panel = |title, y: Axis, series| Panel { title, x, y, series };
    let off = "p99.9 error, texels (0.001: rounding)";
    let panels = vec![
        panel("Error by travel, bricks", log(off), lines(1, "p99.9, texels")),
        panel("Error by travel, ridges of one texel", log(off), lines(3, "p99.9, texels")),
        panel("Work by travel, bricks", linear("heights and bounds looked up, mean"), lines(1, "fetches")),
        panel(
            "Work by travel, ridges of one texel",
            linear("heights and bounds looked up, mean"),
            lines(3, "fetches"),
        ),
    ];
    Ok((table, panels))
}

/// Error of the height at the found place when a texel fills many pixels: rays through a patch of a
/// quarter texel.
fn filtering(bench: &ReliefBench, stage: &Stage) -> Result<(Table, Panel)> {
    let mut table = Table::new(
        "pom_filter",
        format!(
            "surface at the found place against the ray's height there, 2^-16 of the relief, {RAYS} rays through patches of a quarter texel, 60 degrees, 256 steps and 8 rounds of secant; {}.",
            bench.adapter()
        ),
        &["map", "sampler p50", "sampler p95", "exact p50", "exact p95"],
    );
    for layer in 0..Kind::ALL.len() {
        let mut rays = probes(layer, RAYS, 60.0, AMPLITUDE);
        for (index, ray) in rays.iter_mut().enumerate() {
            // A hundred patches all over the map.
            let patch = index / (RAYS as usize / 100);
            let base = [patch % 10, patch / 10].map(|part| part as f32 / 10.0);
            ray.uv = [0, 1].map(|axis| base[axis] + ray.uv[axis] * 0.25 / SIDE as f32);
        }
        let mut row = vec![layer as f64];
        for heights in [Heights::Sampler, Heights::Exact] {
            let how = Relief {
                steps_min: ReliefKnobs::MAX_STEPS,
                steps_max: ReliefKnobs::MAX_STEPS,
                refinements: 8,
                heights: heights as u32,
                ..relief(ReliefTier::Linear)
            };
            let (found, _) = bench.run(&stage.uploaded, &how, &rays, 1)?;
            // The bench's own look at the surface is exact.
            let mut errors: Vec<f64> =
                found.iter().map(|found| f64::from(found.residual.abs()) * 65_536.0).collect();
            errors.sort_unstable_by(f64::total_cmp);
            row.extend([0.5, 0.95].map(|q| quantile(&errors, q)));
        }
        table.push(row);
    }
    let smooth = &table.rows[0];
    ensure!(
        smooth[2] > smooth[4],
        "the sampler is as exact as f32: it would have to know more than 256 places between two texels"
    );
    let line =
        |name, column: usize| measured(name, table.rows.iter().map(|row| (row[0], row[column].max(1e-3))));
    let panel = Panel {
        title: "Heights under magnification",
        x: linear("map: 0 hills, 1 bricks, 2 posts, 3 ridges"),
        y: log("surface off the ray, 1/65536 of the relief"),
        series: vec![
            line("sampler p50", 1),
            line("sampler p95", 2),
            line("exact p50", 3),
            line("exact p95", 4),
        ],
    };
    Ok((table, panel))
}

/// Shadow of each kind against many rays to a disc.
fn shadows(bench: &ReliefBench, stage: &Stage) -> Result<(Table, Panel)> {
    let mut table = Table::new(
        "pom_shadow",
        format!(
            "mean difference of the share of the sun from {DISC} f64 rays to a disc of radius {DISC_RADIUS}, sun {SUN_DEG} degrees high, {SUNNY} places seen 60 degrees from above, {}.",
            bench.adapter()
        ),
        &["map", "none", "hard", "soft", "true share of shadow"],
    );
    for (layer, map) in stage.maps.iter().enumerate() {
        let mut rays = probes(layer, SUNNY, 60.0, AMPLITUDE);
        let (sin, cos) = SUN_DEG.to_radians().sin_cos();
        for ray in &mut rays {
            let level = cos / ray.to_sun[0].hypot(ray.to_sun[1]);
            ray.to_sun = [ray.to_sun[0] * level, ray.to_sun[1] * level, sin];
        }
        let mut row = vec![layer as f64];
        let mut truths: Vec<f64> = Vec::new();
        for shadow in [ReliefShadow::Off, ReliefShadow::Hard, ReliefShadow::Soft] {
            let how = Relief { shadow: shadow as u32, ..relief(ReliefTier::Pyramid) };
            let (found, _) = bench.run(&stage.uploaded, &how, &rays, 1)?;
            if truths.is_empty() {
                truths = found
                    .iter()
                    .zip(&rays)
                    .map(|(found, ray)| disc_share(map, [found.uv[0], found.uv[1]].map(f64::from), ray))
                    .collect();
            }
            let differences =
                found.iter().zip(&truths).map(|(found, truth)| (f64::from(found.sun) - truth).abs());
            row.push(differences.sum::<f64>() / f64::from(SUNNY));
        }
        row.push(1.0 - truths.iter().sum::<f64>() / f64::from(SUNNY));
        table.push(row);
    }
    for row in &table.rows {
        ensure!(
            row[1] > row[2],
            "a picture without shadows is as right as one with them over map {}",
            row[0]
        );
    }
    let line =
        |name, column: usize| measured(name, table.rows.iter().map(|row| (row[0], row[column].max(1e-4))));
    let panel = Panel {
        title: "Shadow of the relief on itself",
        x: linear("map: 0 hills, 1 bricks, 2 posts, 3 ridges"),
        y: log("mean difference of the sun's share"),
        series: vec![line("none", 1), line("hard", 2), line("soft", 3)],
    };
    Ok((table, panel))
}

/// Share of the disc of the sun that is seen from a place on the surface.
fn disc_share(map: &client::relief::HeightMap, uv: [f64; 2], probe: &ReliefProbe) -> f64 {
    let height = truth::height(map, uv);
    let sun = probe.to_sun.map(f64::from);
    // A sunflower over the disc: even over its area.
    let lit = |index: u32| {
        let radius = DISC_RADIUS * ((f64::from(index) + 0.5) / f64::from(DISC)).sqrt();
        let (sin, cos) = (f64::from(index) * 2.399_963).sin_cos();
        let level = [sun[0] + radius * cos, sun[1] + radius * sin];
        let travel = level.map(|part| part / sun[2] * f64::from(probe.amplitude));
        let lift = 0.5 / (travel[0].hypot(travel[1]) * SIDE as f64).max(0.5);
        truth::is_lit(map, uv, height, travel, lift)
    };
    f64::from((0..DISC).filter(|index| lit(*index)).count() as u32) / f64::from(DISC)
}
