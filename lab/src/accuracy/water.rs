//! Waves: every tier of parallax against the marched truth of the same height function, as places
//! and as pictures.
//!
//! Places are measured by the shipped functions in texels of the distortion map's finer displaced
//! scale (0.186 m), pictures of the scene of the water by mean FLIP. Two controls must be worse
//! than the tiers that they mimic, or the measurement is refused: the plain parallax of a fixed
//! view, and flat water.

use super::Curve;
use super::errors::quantile;
use super::octaves::ratios;
use crate::chart::{Choice, Panel, controls, front, linear, log, measured};
use crate::flip::{PIXELS_PER_DEGREE, mean};
use crate::sample::{unit, word};
use crate::table::Table;
use crate::waves::{FoundWave, WaveBench};
use anyhow::{Result, bail, ensure};
use client::headless::{self, Options};
use client::looks::{Looks, WaterTier, WaveKnobs};
use client::render::Picture;
use client::scene::Scene;
use shaders::layout::{PROBE_FIXED, PROBE_MARCHED, PROBE_STEPPED, WAVE_MAP_SIDE, WaveProbe};
use std::time::Instant;

/// Rays of a condition.
const RAYS: u32 = 3_000;
/// Steps of the truth, far more than any wave needs.
const TRUTH_STEPS: u32 = 1_024;
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
/// truth. Diagrams end here.
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
    floor_cosine: f32,
    /// The tier as an option, if it is one.
    tier: Option<WaterTier>,
}

impl Method {
    const fn tier(name: &'static str, tier: WaterTier) -> Self {
        Self { name, method: tier as u32, steps: 0, floor_cosine: 1.0, tier: Some(tier) }
    }
}

const METHODS: [Method; 8] = [
    Method::tier("flat", WaterTier::Flat),
    Method { name: "fixed view", method: PROBE_FIXED, steps: 0, floor_cosine: 1.0, tier: None },
    Method::tier("offset", WaterTier::Offset),
    Method::tier("two", WaterTier::Two),
    Method::tier("three", WaterTier::Three),
    Method::tier("four", WaterTier::Four),
    Method {
        name: "three, normal's vertical part only",
        method: PROBE_STEPPED,
        steps: 3,
        floor_cosine: 1.0,
        tier: None,
    },
    Method::tier("march", WaterTier::March),
];

/// Methods of the curves, by their place in [`METHODS`]: at most six lines can be told apart. The
/// march, which is left out, runs along the resolution.
const CURVES: [usize; 6] = [1, 0, 2, 3, 4, 5];

/// Measures it; the world does not matter.
///
/// # Errors
/// There is no GPU, a control is no worse than what it controls, or the truth does not lie on the
/// waves.
pub fn measure(_: u64) -> Result<Curve> {
    let bench = WaveBench::open()?;
    let places = measured_places(&bench)?;
    let costs = measured_costs(&bench)?;
    let pictures = measured_pictures()?;
    verdict(&places, &pictures)?;

    let at = |table: &Table, column: &str, steepness: f64, angle: f64| -> f64 {
        let index = table.columns.iter().position(|name| name == column).unwrap_or(0);
        let row = table.rows.iter().find(|row| row[0] == steepness && row[1] == angle);
        row.map_or(f64::NAN, |row| row[index])
    };
    let shown = |(x, error): (f64, f64)| (x, error.max(RESOLUTION));
    let lines = |fixed: bool, part: &str| {
        CURVES
            .map(|index| {
                let name = METHODS[index].name;
                let column = format!("{name} {part}");
                let points: Vec<(f64, f64)> = if fixed {
                    ANGLES_DEG
                        .iter()
                        .map(|a| f64::from(*a))
                        .map(|a| (a, at(&places, &column, 1.0, a)))
                        .collect()
                } else {
                    let angle = f64::from(FRONT.1);
                    STEEPNESS
                        .iter()
                        .map(|s| f64::from(*s))
                        .map(|s| (s, at(&places, &column, s, angle)))
                        .collect()
                };
                measured(name, above_resolution(&points))
            })
            .to_vec()
    };
    let (steepness, angle) = (f64::from(FRONT.0), f64::from(FRONT.1));
    let left =
        |method: &Method, part: &str| at(&places, &format!("{} {part}", method.name), steepness, angle);
    let names = METHODS.iter().enumerate().map(|(index, method)| format!("{index} {}", method.name));
    let mut table = Table::new(
        "water_cost",
        format!(
            "time of {TIMED_RAYS} rays and their shading lookup over that of flat water, median of {ROUNDS} interleaved rounds, and errors at steepness {steepness}, {angle} degrees, {}; methods: {}.",
            bench.adapter(),
            names.collect::<Vec<_>>().join("; ")
        ),
        &["method", "cost ratio", "p95, texels", "p99.9, texels"],
    );
    let (mut choices, mut compared) = (Vec::new(), Vec::new());
    for (index, (method, cost)) in METHODS.iter().zip(&costs).enumerate() {
        let (p95, p999) = (left(method, "p95, texels"), left(method, "p99.9, texels"));
        table.push([index as f64, *cost, p95, p999]);
        let is_shipped = method.tier == Some(WaterTier::default());
        let choice = Choice { name: method.name.to_owned(), at: shown((*cost, p999)), is_shipped };
        if method.tier.is_some() { choices.push(choice) } else { compared.push(choice) }
    }
    let mut trade = front(&choices);
    trade.push(controls(compared));
    let flip_lines = CURVES
        .map(|index| METHODS[index].name)
        .map(|name| measured(name, pictures.curve("steepness", name)))
        .to_vec();
    let panels = vec![
        Panel {
            title: "Error against steepness, 65 degrees from the vertical",
            x: log("steepness of the waves, 1 = fresh breeze"),
            y: log("p95 error of the place, texels (0.001: rounding)"),
            series: lines(false, "p95, texels"),
        },
        Panel {
            title: "Error against the view's angle, steepness 1",
            x: linear("angle from the vertical, degrees"),
            y: log("p95 error of the place, texels (0.001: rounding)"),
            series: lines(true, "p95, texels"),
        },
        Panel {
            title: "Pictures of the scene against its truth",
            x: log("steepness of the waves, 1 = fresh breeze"),
            y: log("mean FLIP, 67 pixels per degree"),
            series: flip_lines,
        },
        Panel {
            title: "What an error costs, steepness 1, 65 degrees",
            x: linear("time over that of flat water"),
            y: log("p99.9 error of the place, texels (0.001: rounding)"),
            series: trade,
        },
    ];
    Ok(Curve {
        name: "water",
        title: "Parallax of waves: tiers against the marched truth",
        tables: vec![places, pictures, table],
        panels,
    })
}

/// A curve down to where it meets the resolution; what lies beyond says nothing.
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
    let Method { method, steps, floor_cosine, .. } = method;
    rays.iter().map(|ray| WaveProbe { method, steps, floor_cosine, ..*ray }).collect()
}

const TRUTH: Method =
    Method { name: "truth", method: PROBE_MARCHED, steps: TRUTH_STEPS, floor_cosine: 1.0, tier: None };

/// Distance between two places in texels.
fn texels(one: &FoundWave, other: &FoundWave) -> f64 {
    let [x, z] = [0, 1].map(|axis| f64::from(one.place_m[axis]) - f64::from(other.place_m[axis]));
    x.hypot(z) / TEXEL_M
}

fn measured_places(bench: &WaveBench) -> Result<Table> {
    let parts = ["p50, texels", "p95, texels", "p99.9, texels"];
    let mut columns = vec!["steepness".to_owned(), "angle, degrees".to_owned()];
    columns.extend(METHODS.iter().flat_map(|method| parts.map(|part| format!("{} {part}", method.name))));
    let columns: Vec<&str> = columns.iter().map(String::as_str).collect();
    let mut table = Table::new(
        "water",
        format!(
            "distance between the place that a method finds and the truth ({TRUTH_STEPS} steps and bisection), texels of {TEXEL_M:.3} m, {RAYS} rays each, {}",
            bench.adapter()
        ),
        &columns,
    );
    for steepness in STEEPNESS {
        for angle in ANGLES_DEG {
            let rays = rays(RAYS, steepness, angle);
            let (truth, _) = bench.run(WaveKnobs::default(), TIME_S, &by(TRUTH, &rays), 1)?;
            let stray = truth.iter().map(|found| found.residual_m.abs()).fold(0.0, f32::max);
            ensure!(
                stray < 0.02 * steepness,
                "the truth misses the waves by {stray} m at steepness {steepness}, {angle} degrees: the GPU does not compute as it should"
            );
            let mut row = vec![f64::from(steepness), f64::from(angle)];
            for method in METHODS {
                let (found, _) = bench.run(WaveKnobs::default(), TIME_S, &by(method, &rays), 1)?;
                let mut errors: Vec<f64> =
                    found.iter().zip(&truth).map(|(found, truth)| texels(found, truth)).collect();
                errors.sort_unstable_by(f64::total_cmp);
                row.extend([0.5, 0.95, 0.999].map(|q| quantile(&errors, q)));
            }
            table.push(row);
        }
    }
    Ok(table)
}

/// Time of each method over that of flat water; the methods take turns in every round.
///
/// All methods are branches of one pipeline, as in the viewer. A driver that runs both sides of a
/// branch under a mask, as software rasterisers do, makes the cheap ones dearer than they need be
/// and the differences small.
fn measured_costs(bench: &WaveBench) -> Result<Vec<f64>> {
    let rays = rays(TIMED_RAYS, FRONT.0, FRONT.1);
    let mut times = vec![Vec::new(); METHODS.len()];
    for _ in 0..ROUNDS {
        for (method, times) in METHODS.iter().zip(&mut times) {
            times.push(bench.run(WaveKnobs::default(), TIME_S, &by(*method, &rays), REPEATS)?.1);
        }
    }
    Ok(ratios(&times))
}

/// Mean FLIP of the panels of the scene against the one of the truth, for every tier and steepness.
fn measured_pictures() -> Result<Table> {
    let tiers: Vec<Method> = METHODS.into_iter().filter(|method| method.tier.is_some()).collect();
    let mut columns = vec!["steepness", "fixed view"];
    columns.extend(tiers.iter().map(|method| method.name));
    let mut table = Table::new(
        "water_flip",
        format!(
            "mean FLIP ({PIXELS_PER_DEGREE} pixels per degree) of a panel of the scene of the water against the panel of the truth, {} x {} pixels",
            PICTURE.0 / 3,
            PICTURE.1
        ),
        &columns,
    );
    for steepness in STEEPNESS {
        // The middle panel shows each tier at the same pixels, so that dither is no difference;
        // only the fixed view stands elsewhere.
        let marched = scene(WaterTier::March, steepness)?;
        let truth = panel(&marched, 1);
        let beside = mean(&truth, &panel(&marched, 2), PIXELS_PER_DEGREE);
        ensure!(beside < DITHER, "two panels of the truth differ by FLIP {beside} at steepness {steepness}");
        let mut row = vec![f64::from(steepness), mean(&truth, &panel(&marched, 0), PIXELS_PER_DEGREE)];
        for method in &tiers {
            let picture = scene(method.tier.unwrap_or_default(), steepness)?;
            row.push(mean(&truth, &panel(&picture, 1), PIXELS_PER_DEGREE));
        }
        table.push(row);
    }
    Ok(table)
}

fn scene(tier: WaterTier, steepness: f32) -> Result<Picture> {
    let mut options =
        Options { scene: Scene::Water, pose: Scene::Water.start(), samples: 1, ..Options::default() };
    (options.lens.width, options.lens.height) = PICTURE;
    options.time_s = TIME_S;
    options.looks =
        Looks { water: tier, waves: WaveKnobs { steepness, ..WaveKnobs::default() }, ..Looks::default() };
    Ok(headless::render_local(&options, Instant::now())?.0)
}

/// One of the three panels, without the separators.
fn panel(picture: &Picture, index: u32) -> Picture {
    const SEPARATOR: u32 = 2;
    let width = picture.width / 3;
    let rows = picture.rgba.chunks_exact(4 * picture.width as usize);
    let (low, high) = (4 * (index * width + SEPARATOR) as usize, 4 * (index * width + width) as usize);
    let rgba = rows.flat_map(|row| &row[low..high]).copied().collect();
    Picture { width: width - SEPARATOR, height: picture.height, rgba }
}

/// Refuses what cannot be: controls that are no worse, a march that is not the truth.
fn verdict(places: &Table, pictures: &Table) -> Result<()> {
    for (worse, better) in [("fixed view", "offset"), ("flat", "offset"), ("offset", "four"), ("two", "four")]
    {
        let column = |name: &str| places.curve("steepness", &format!("{name} p95, texels"));
        let sum = |name: &str| column(name).iter().map(|point| point.1).sum::<f64>();
        if sum(worse) <= sum(better) {
            bail!(
                "`{worse}` is no farther from the truth than `{better}`: the measurement cannot be trusted"
            );
        }
    }
    for (control, shipped) in pictures.curve("fixed view", "three") {
        ensure!(
            control > shipped,
            "the fixed view looks as right as three steps: FLIP {control} and {shipped}"
        );
    }
    let march = pictures.curve("steepness", "march");
    ensure!(march.iter().all(|point| point.1 == 0.0), "one picture drawn twice differs: {march:?}");
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The bench; none, visibly, where there is no adapter and none is required.
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

    fn run(bench: &WaveBench, method: Method, knobs: WaveKnobs, rays: &[WaveProbe]) -> Vec<FoundWave> {
        bench.run(knobs, TIME_S, &by(method, rays), 1).unwrap().0
    }

    fn p95(one: &[FoundWave], other: &[FoundWave]) -> f64 {
        let mut errors: Vec<f64> = one.iter().zip(other).map(|(one, other)| texels(one, other)).collect();
        errors.sort_unstable_by(f64::total_cmp);
        quantile(&errors, 0.95)
    }

    #[test]
    fn the_march_ends_on_the_waves_and_every_step_brings_a_tier_closer_to_it() {
        let Some(bench) = bench() else { return };
        let rays = rays(400, 1.0, 60.0);
        let knobs = WaveKnobs::default();
        let truth = run(&bench, TRUTH, knobs, &rays);
        assert!(truth.iter().all(|found| found.residual_m.abs() < 2e-3), "the truth lies on the waves");
        let heights: Vec<f32> = truth.iter().map(|found| found.at_m).collect();
        let spread = heights.iter().copied().fold(f32::MIN, f32::max)
            - heights.iter().copied().fold(f32::MAX, f32::min);
        assert!(spread > 0.4, "there are waves: {spread} m");
        let errors = METHODS.map(|method| p95(&run(&bench, method, knobs, &rays), &truth));
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
    fn without_parallax_or_waves_every_tier_finds_the_plane_exactly() {
        let Some(bench) = bench() else { return };
        let none = WaveKnobs { parallax_factor: 0.0, ..WaveKnobs::default() };
        for (knobs, rays) in [(none, rays(100, 1.0, 70.0)), (WaveKnobs::default(), rays(100, 0.0, 70.0))] {
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
            let knobs = WaveKnobs { parallax_factor: factor, parallax_bias_m: factor, steepness: factor };
            for method in METHODS {
                for (found, ray) in run(&bench, method, knobs, &probes).iter().zip(&probes) {
                    let all = [found.place_m[0], found.place_m[1], found.at_m, found.residual_m];
                    assert!(all.iter().all(|value| value.is_finite()), "{}: {ray:?} {found:?}", method.name);
                    // No crest stands above the eye, and no offset runs away with a grazing ray.
                    assert!(found.at_m <= ray.eye_m.max(0.0) + 1e-6, "{}: {ray:?} {found:?}", method.name);
                }
            }
        }
    }
}
