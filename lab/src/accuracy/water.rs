//! Waves: every tier of parallax against the converged march over the same height function, as
//! positions and as pictures.
//!
//! Position errors are in texels of the distortion map's finer displaced scale (0.186 m), pictures
//! of the scene of the water are compared by mean FLIP. Two controls must be worse than the tiers:
//! the plain parallax of a fixed view, and flat water.

use crate::curve::{Curve, Sheet, numbered};
use crate::flip::{PIXELS_PER_DEGREE, mean};
use crate::sample::{unit, word};
use crate::stats::{interleaved, quantiles, ratios, worst};
use crate::waves::{FoundWave, WaveBench};
use anyhow::{Result, ensure};
use chart::{Choice, Panel, linear, log};
use client::features::water::{WaterTier, WaveSettings};
use client::gpu::Image;
use client::headless::{self, Options};
use client::scene::Scene;
use client::settings::RenderSettings;
use shaders::layout::{PROBE_FIXED, PROBE_MARCHED, PROBE_STEPPED, WAVE_MAP_SIDE, WaveProbe};
use std::time::Instant;

/// Rays of a condition.
const RAYS: u32 = 3_000;
/// Steps of the reference, far more than any wave needs.
const REFERENCE_STEPS: u32 = 1_024;
/// Steepness of the waves, 1 being a fresh breeze.
const STEEPNESS: [f32; 5] = [0.25, 0.5, 1.0, 2.0, 4.0];
/// Angles from the vertical, degrees.
const ANGLES_DEG: [f32; 6] = [0.0, 20.0, 40.0, 55.0, 65.0, 75.0];
/// The condition of the front: about the scene's view.
const FRONT: (f32, f32) = (1.0, 65.0);
/// Width of a texel of the finer displaced scale: 8192 m over the length of its turn (151, -83)
/// over the side of the map.
const TEXEL_M: f64 = 8192.0 / 172.308 / WAVE_MAP_SIDE as f64;
/// Differences below this are rounding of places in f32, texels: at 512 to 1024 m from the origin
/// of the pattern a place is a multiple of 0.06 mm, and the march ends within a few of those of the
/// reference. Diagrams end here.
const RESOLUTION: f64 = 1e-3;
/// Rounds of the timing, rays of each, and how often each round finds them.
const ROUNDS: usize = 15;
const TIMED_RAYS: u32 = 1 << 16;
const REPEATS: u32 = 16;
/// Moment of the waves, seconds.
const TIME_S: f32 = 7.0;
/// Size of the pictures: three panels of 160 x 270 pixels.
const PICTURE: (u32, u32) = (480, 270);

/// Mean FLIP that dither alone makes of two equal panels, with half as much again to spare.
const DITHER: f64 = 0.016;

/// A way to find the surface.
#[derive(Clone, Copy)]
struct Method {
    name: &'static str,
    method: u32,
    steps: u32,
    /// The tier as an option, if it is one.
    tier: Option<WaterTier>,
}

impl Method {
    const fn tier(name: &'static str, tier: WaterTier) -> Self {
        Self { name, method: tier as u32, steps: 0, tier: Some(tier) }
    }
}

const METHODS: [Method; 8] = [
    Method::tier("flat", WaterTier::Flat),
    Method { name: "fixed view", method: PROBE_FIXED, steps: 0, tier: None },
    Method::tier("offset", WaterTier::Offset),
    Method::tier("two", WaterTier::Two),
    Method::tier("three", WaterTier::Three),
    Method::tier("four", WaterTier::Four),
    Method { name: "three, normal's vertical part only", method: PROBE_STEPPED, steps: 3, tier: None },
    Method::tier("march", WaterTier::March),
];

/// Methods of the curves, by their place in [`METHODS`]: at most six lines can be distinguished.
/// The march, which is left out, runs along the resolution.
const CURVES: [usize; 6] = [1, 0, 2, 3, 4, 5];

const PARTS: [&str; 3] = ["p50, texels", "p95, texels", "p99.9, texels"];

/// Errors of the methods in one condition, by [`PARTS`].
struct Row {
    steepness: f32,
    angle_deg: f32,
    errors: [[f64; 3]; METHODS.len()],
}

/// Mean FLIP of the fixed view and of the methods that are tiers.
struct PictureRow {
    steepness: f32,
    fixed: f64,
    tiers: [f64; METHODS.len()],
}

/// Measures it; the world does not matter.
pub fn measure(_: u64) -> Result<Curve> {
    let bench = WaveBench::open()?;
    let rows = positions(&bench)?;
    let costs = costs(&bench)?;
    let pictures = pictures()?;
    check_controls(&rows, &pictures)?;

    let names = METHODS.map(|method| method.name);
    let (steepness, angle) = FRONT;
    let caption = format!(
        "distance between the place that a method finds and the reference ({REFERENCE_STEPS} steps and \
         bisection), texels of {TEXEL_M:.3} m, {RAYS} rays each, {}",
        bench.adapter()
    );
    let mut table = Sheet::new("water", caption, rows);
    table.columns(["steepness", "angle, degrees"], |row| [row.steepness, row.angle_deg].map(f64::from));
    for (index, name) in names.into_iter().enumerate() {
        table.columns(PARTS.map(|quantile| format!("{name} {quantile}")), |row| row.errors[index]);
    }
    let caption = format!(
        "mean FLIP ({PIXELS_PER_DEGREE} pixels per degree) of a panel of the scene of the water against the \
         panel of the reference, {} x {} pixels",
        PICTURE.0 / 3,
        PICTURE.1
    );
    let mut flip = Sheet::new("water_flip", caption, pictures);
    flip.columns(["steepness", "fixed view"], |row| [row.steepness.into(), row.fixed]);
    for (index, method) in METHODS.iter().enumerate().filter(|(_, method)| method.tier.is_some()) {
        flip.column(method.name, |row| row.tiers[index]);
    }
    let front = table.rows.iter().find(|row| (row.steepness, row.angle_deg) == FRONT);
    let errors = front.map_or([[f64::NAN; 3]; METHODS.len()], |row| row.errors);
    let caption = format!(
        "time of {TIMED_RAYS} rays and their shading lookup over that of flat water, median of {ROUNDS} \
         interleaved rounds, and errors at steepness {steepness}, {angle} degrees, {}; methods: {}.",
        bench.adapter(),
        numbered(names, "; ")
    );
    let mut cost = Sheet::new("water_cost", caption, (0..METHODS.len()).collect());
    let columns = ["method", "cost ratio", "p95, texels", "p99.9, texels"];
    cost.columns(columns, |index| [*index as f64, costs[*index], errors[*index][1], errors[*index][2]]);
    let choice = |index: &usize| Choice {
        name: names[*index].to_owned(),
        at: (costs[*index], errors[*index][2].max(RESOLUTION)),
        is_shipped: METHODS[*index].tier == Some(WaterTier::default()),
    };
    let (tiers, others): (Vec<_>, Vec<_>) =
        (0..METHODS.len()).partition(|index| METHODS[*index].tier.is_some());

    let wave = log("steepness of the waves, 1 = fresh breeze");
    let error = log("p95 error of the place, texels (0.001: rounding)");
    let curves = |panel: Panel, is_wanted: fn(&Row) -> bool, x: &str| {
        CURVES.into_iter().fold(panel, |panel, index| {
            let points = table.points_where(is_wanted, x, &format!("{} {}", names[index], PARTS[1]));
            panel.line(names[index], above_resolution(&points))
        })
    };
    let by_angle = Panel::new(
        "Error against the view's angle, steepness 1",
        linear("angle from the vertical, degrees"),
        error,
    );
    let pictures = Panel::new(
        "Pictures of the scene against its reference",
        wave,
        log("mean FLIP, 67 pixels per degree"),
    );
    let panels = vec![
        curves(
            Panel::new("Error against steepness, 65 degrees from the vertical", wave, error),
            |row| row.angle_deg == FRONT.1,
            "steepness",
        ),
        curves(by_angle, |row| row.steepness == 1.0, "angle, degrees"),
        flip.lines(pictures, "steepness", CURVES.map(|index| (names[index], names[index]))),
        Panel::new(
            "Cost against error, steepness 1, 65 degrees",
            linear("time over that of flat water"),
            log("p99.9 error of the place, texels (0.001: rounding)"),
        )
        .front(&tiers.iter().map(choice).collect::<Vec<_>>())
        .controls(others.iter().map(choice)),
    ];
    let title = "Parallax of waves: tiers against the marched reference";
    Ok(Curve { name: "water", title, tables: vec![table.into(), flip.into(), cost.into()], panels })
}

/// A curve down to the resolution; values below it are rounding.
fn above_resolution(points: &[(f64, f64)]) -> Vec<(f64, f64)> {
    let is_seen = |index: usize| points.get(index).is_some_and(|point| point.1 > RESOLUTION);
    let last_or_seen =
        |index: &usize| is_seen(*index) || is_seen(index + 1) || index.checked_sub(1).is_some_and(is_seen);
    (0..points.len())
        .filter(last_or_seen)
        .map(|index| (points[index].0, points[index].1.max(RESOLUTION)))
        .collect()
}

/// Rays through random places under one angle.
fn rays(count: u32, steepness: f32, angle_deg: f32) -> Vec<WaveProbe> {
    (0..count)
        .map(|index| {
            let share = |part: u32| unit(word(0x7a7e, 3 * index + part)) as f32;
            let (heading, tilt) = (share(2) * std::f32::consts::TAU, angle_deg.to_radians());
            WaveProbe {
                place_m: [share(0) * 1024.0, share(1) * 1024.0],
                footprint_m: 0.02,
                strength: steepness,
                to_eye: [tilt.sin() * heading.cos(), tilt.cos(), tilt.sin() * heading.sin()],
                eye_m: 40.0,
                method: 0,
                steps: 0,
                floor_cosine: 1.0,
                reserved: 0,
            }
        })
        .collect()
}

fn by(method: Method, rays: &[WaveProbe]) -> Vec<WaveProbe> {
    let Method { method, steps, .. } = method;
    rays.iter().map(|ray| WaveProbe { method, steps, ..*ray }).collect()
}

const REFERENCE: Method =
    Method { name: "reference", method: PROBE_MARCHED, steps: REFERENCE_STEPS, tier: None };

/// Distance between two places in texels.
fn texels(one: &FoundWave, other: &FoundWave) -> f64 {
    let [x, z] = [0, 1].map(|axis| f64::from(one.place_m[axis]) - f64::from(other.place_m[axis]));
    x.hypot(z) / TEXEL_M
}

fn positions(bench: &WaveBench) -> Result<Vec<Row>> {
    let mut rows = Vec::new();
    for (steepness, angle_deg) in STEEPNESS.into_iter().flat_map(|s| ANGLES_DEG.map(|angle| (s, angle))) {
        let rays = rays(RAYS, steepness, angle_deg);
        let (reference, _) = bench.run(WaveSettings::default(), TIME_S, &by(REFERENCE, &rays), 1)?;
        let residual = worst(reference.iter().map(|found| f64::from(found.residual_m.abs())));
        ensure!(
            residual < 0.02 * f64::from(steepness),
            "the reference misses the waves by {residual} m at steepness {steepness}, {angle_deg} \
             degrees: the GPU computes wrong results"
        );
        let mut errors = [[0.0; 3]; METHODS.len()];
        for (method, errors) in METHODS.into_iter().zip(&mut errors) {
            let (found, _) = bench.run(WaveSettings::default(), TIME_S, &by(method, &rays), 1)?;
            let distances = found.iter().zip(&reference).map(|(found, reference)| texels(found, reference));
            *errors = quantiles(distances, [0.5, 0.95, 0.999]);
        }
        rows.push(Row { steepness, angle_deg, errors });
    }
    Ok(rows)
}

/// Time of each method over that of flat water.
///
/// All methods are branches of one pipeline, as in the viewer. A driver that runs both sides of a
/// branch under a mask, as software rasterisers do, makes the cheap ones expensive and the
/// differences small.
fn costs(bench: &WaveBench) -> Result<Vec<f64>> {
    let rays = rays(TIMED_RAYS, FRONT.0, FRONT.1);
    let run = |index: usize| {
        Ok::<_, anyhow::Error>(
            bench.run(WaveSettings::default(), TIME_S, &by(METHODS[index], &rays), REPEATS)?.1,
        )
    };
    Ok(ratios(&interleaved(ROUNDS, METHODS.len(), run)?))
}

/// Mean FLIP of the panels of the scene against that of the reference.
fn pictures() -> Result<Vec<PictureRow>> {
    let row = |steepness| {
        // The middle panel shows each tier at the same pixels, so that dither does not differ; only
        // the fixed view is elsewhere.
        let marched = scene(WaterTier::March, steepness)?;
        let reference = panel(&marched, 1);
        let flip = |picture: &Image, index| mean(&reference, &panel(picture, index), PIXELS_PER_DEGREE);
        let repeated = flip(&marched, 2);
        ensure!(
            repeated < DITHER,
            "two panels of the reference differ by FLIP {repeated} at steepness {steepness}"
        );
        let mut tiers = [f64::NAN; METHODS.len()];
        for (method, tier) in METHODS.iter().zip(&mut tiers) {
            if let Some(known) = method.tier {
                *tier = flip(&scene(known, steepness)?, 1);
            }
        }
        Ok(PictureRow { steepness, fixed: flip(&marched, 0), tiers })
    };
    STEEPNESS.into_iter().map(row).collect()
}

fn scene(tier: WaterTier, steepness: f32) -> Result<Image> {
    let mut options =
        Options { scene: Scene::Water, pose: Scene::Water.start(), samples: 1, ..Options::default() };
    (options.projection.width, options.projection.height) = PICTURE;
    options.time_s = TIME_S;
    options.settings = RenderSettings {
        water: tier,
        waves: WaveSettings { steepness, ..WaveSettings::default() },
        ..RenderSettings::default()
    };
    Ok(headless::render_local(&options, Instant::now())?.0)
}

/// One of the three panels, without the separators.
fn panel(picture: &Image, index: u32) -> Image {
    const SEPARATOR: u32 = 2;
    let width = picture.width / 3;
    let rows = picture.rgba.chunks_exact(4 * picture.width as usize);
    let (low, high) = (4 * (index * width + SEPARATOR) as usize, 4 * (index * width + width) as usize);
    let rgba = rows.flat_map(|row| &row[low..high]).copied().collect();
    Image { width: width - SEPARATOR, height: picture.height, rgba }
}

/// Fails if a control is no worse than a tier, or if the march is not the reference.
fn check_controls(rows: &[Row], pictures: &[PictureRow]) -> Result<()> {
    let index = |name: &str| METHODS.iter().position(|method| method.name == name).unwrap_or(0);
    let sum = |name: &str| rows.iter().map(|row| row.errors[index(name)][1]).sum::<f64>();
    for (worse, better) in [("fixed view", "offset"), ("flat", "offset"), ("offset", "four"), ("two", "four")]
    {
        ensure!(
            sum(worse) > sum(better),
            "`{worse}` is no farther from the reference than `{better}`: the measurement detects nothing"
        );
    }
    for row in pictures {
        let three = row.tiers[index("three")];
        ensure!(
            row.fixed > three,
            "the fixed view is as near to the reference as three steps: FLIP {} and {three}",
            row.fixed
        );
        let march = row.tiers[index("march")];
        ensure!(march == 0.0, "one picture drawn twice differs: FLIP {march}");
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The bench; skipped with a message without an adapter, unless one is required.
    fn bench() -> Option<WaveBench> {
        match WaveBench::open() {
            Ok(bench) => Some(bench),
            Err(error) => {
                assert!(std::env::var_os("TOMBOLO_REQUIRE_GPU").is_none(), "a GPU is required: {error}");
                eprintln!("SKIPPED: {error}");
                None
            }
        }
    }

    fn run(bench: &WaveBench, method: Method, knobs: WaveSettings, rays: &[WaveProbe]) -> Vec<FoundWave> {
        bench.run(knobs, TIME_S, &by(method, rays), 1).unwrap().0
    }

    fn p95(one: &[FoundWave], other: &[FoundWave]) -> f64 {
        quantiles(one.iter().zip(other).map(|(one, other)| texels(one, other)), [0.95])[0]
    }

    #[test]
    fn the_march_ends_on_the_waves_and_every_step_reduces_the_error() {
        let Some(bench) = bench() else { return };
        let rays = rays(400, 1.0, 60.0);
        let knobs = WaveSettings::default();
        let reference = run(&bench, REFERENCE, knobs, &rays);
        assert!(
            reference.iter().all(|found| found.residual_m.abs() < 2e-3),
            "the reference lies on the waves"
        );
        let heights: Vec<f32> = reference.iter().map(|found| found.at_m).collect();
        let spread = heights.iter().copied().fold(f32::MIN, f32::max)
            - heights.iter().copied().fold(f32::MAX, f32::min);
        assert!(spread > 0.4, "there are waves: {spread} m");
        let errors = METHODS.map(|method| p95(&run(&bench, method, knobs, &rays), &reference));
        let [flat, fixed, offset, two, three, four, premecz, march] = errors;
        assert!(march < 0.05, "{errors:?}");
        assert!(four < three && three < two && two < offset && offset < flat, "{errors:?}");
        assert!(fixed > 2.0 * offset, "the control: a fixed view is worse, {errors:?}");
        assert!(three < premecz, "the tangent plane is a better step, {errors:?}");
    }

    #[test]
    fn a_curve_ends_where_it_meets_the_resolution() {
        let curve = [(0.0, 0.0), (1.0, 1e-5), (2.0, 0.1), (3.0, 1.0), (4.0, 1e-4), (5.0, 0.0)];
        assert_eq!(above_resolution(&curve), [(1.0, RESOLUTION), (2.0, 0.1), (3.0, 1.0), (4.0, RESOLUTION)]);
        assert_eq!(above_resolution(&curve[..2]), [], "nothing of it is seen");
    }

    #[test]
    fn without_parallax_or_waves_every_tier_finds_the_plane() {
        let Some(bench) = bench() else { return };
        let none = WaveSettings { parallax_factor: 0.0, ..WaveSettings::default() };
        for (knobs, rays) in [(none, rays(100, 1.0, 70.0)), (WaveSettings::default(), rays(100, 0.0, 70.0))] {
            for method in METHODS.into_iter().filter(|method| method.tier.is_some()) {
                let found = run(&bench, method, knobs, &rays);
                for (found, ray) in found.iter().zip(&rays) {
                    assert_eq!((found.place_m, found.at_m), (ray.place_m, 0.0), "{}", method.name);
                }
            }
        }
    }

    #[test]
    fn extreme_rays_find_finite_places() {
        let Some(bench) = bench() else { return };
        let extreme = |to_eye: [f32; 3], eye_m: f32, strength: f32| WaveProbe {
            to_eye,
            eye_m,
            strength,
            ..rays(1, 1.0, 0.0)[0]
        };
        let mut probes = Vec::new();
        for to_eye in [[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.999_999_9, 1e-7, 0.0], [0.0, 0.01, -0.999_95]] {
            for eye_m in [0.0, 1e-6, 0.3, 20_000.0] {
                for strength in [0.0, 1e-6, 1.0, 8.0] {
                    probes.push(extreme(to_eye, eye_m, strength));
                }
            }
        }
        for factor in [0.0, 0.2, f32::INFINITY, f32::NAN] {
            let knobs = WaveSettings { parallax_factor: factor, parallax_bias_m: factor, steepness: factor };
            for method in METHODS {
                for (found, ray) in run(&bench, method, knobs, &probes).iter().zip(&probes) {
                    let all = [found.place_m[0], found.place_m[1], found.at_m, found.residual_m];
                    assert!(all.iter().all(|value| value.is_finite()), "{}: {ray:?} {found:?}", method.name);
                    // No crest is above the eye, and offsets of grazing rays stay bounded.
                    assert!(found.at_m <= ray.eye_m.max(0.0) + 1e-6, "{}: {ray:?} {found:?}", method.name);
                }
            }
        }
    }
}
