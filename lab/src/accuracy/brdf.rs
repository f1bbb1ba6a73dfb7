//! Reflection: error and cost of the approximate visibility term and of lower precision.
//!
//! A compute pass evaluates the functions of the viewer (`shared/brdf.wesl`) for directions inside
//! the lobes of GGX; the reference is the exact form in f64. Half precision is emulated, since few
//! devices compute in it: every intermediate result is rounded.

use crate::curve::{Curve, Sheet, numbered};
use crate::probe_pass::{self, Dispatch};
use crate::stats::{Figures, interleaved, ratios};
use anyhow::{Context as _, Result};
use chart::{Panel, linear, log};
use client::gpu::Gpu;
use glam::DVec3;
use shaders::SHADERS;
use shaders::layout::{BRDF_TERMS, BrdfProbe};
use std::f64::consts::{PI, TAU};
use std::time::Duration;

/// Reflectance at normal incidence of all probes.
const F0: f64 = 0.04;

/// The least roughness that the viewer draws: `MIN_ROUGHNESS` of `shared/brdf.wesl`.
const FLOOR: f64 = 0.045;

/// Roughnesses, some below the floor: they show why it is there.
const ROUGHNESSES: [f64; 16] =
    [0.005, 0.01, 0.02, 0.03, 0.045, 0.07, 0.089, 0.12, 0.17, 0.25, 0.35, 0.45, 0.6, 0.75, 0.9, 1.0];

/// Angles of the eye to the normal, half vectors by their share of the lobe, and their turns about
/// the normal.
const EYES: u32 = 18;
const LOBES: u32 = 12;
const TURNS: u32 = 12;

/// Rounds of the timing, and invocations of one of them.
const ROUNDS: usize = 41;
const TIMED: usize = 1 << 14;

/// The timed entry points, their names, and whether the visibility term is the fast one.
const VARIANTS: [(&str, &str, bool, Form); 4] = [
    ("time_exact", "exact visibility, N x H", false, Form::Lagrange),
    ("time_fast", "fast visibility, N x H", true, Form::Lagrange),
    ("time_exact_naive", "exact visibility, 1 - NH^2", false, Form::Naive),
    ("time_fast_naive", "fast visibility, 1 - NH^2", true, Form::Naive),
];

/// Columns of errors.
const ERRORS: [&str; 5] = ["fast", "f32", "f32 naive", "f16", "f16 naive"];

fn unit(v: DVec3) -> DVec3 {
    v / v.length()
}

fn widened(v: [f32; 3]) -> DVec3 {
    unit(DVec3::from(v.map(f64::from)))
}

/// A surface aligned with no axis, so that products round: normal and two tangents.
fn surface() -> [DVec3; 3] {
    let normal = unit(DVec3::new(0.36, 0.81, -0.47));
    let east = unit(normal.cross(DVec3::new(0.1, 0.2, 0.9)));
    [normal, east, normal.cross(east)]
}

/// The directions of one roughness: half vectors by equal shares of the lobe's facets, eyes by
/// equal steps of angle.
fn probes(roughness: f64) -> Vec<BrdfProbe> {
    let [normal, east, south] = surface();
    let place = |polar: f64, turn: f64| {
        let (level, up) = polar.sin_cos();
        up * normal + level * (turn.cos() * east + turn.sin() * south)
    };
    let alpha = roughness * roughness;
    let mut probes = Vec::new();
    for eye in 0..EYES {
        let to_eye = place(f64::from(eye) * 5.0f64.to_radians(), 0.3);
        for lobe in 0..LOBES {
            // Inverse of the lobe's distribution (Walter et al., 2007, eq. 35).
            let share = (f64::from(lobe) + 0.5) / f64::from(LOBES);
            let polar = (alpha * (share / (1.0 - share)).sqrt()).atan();
            for turn in 0..TURNS {
                let middle = place(polar, f64::from(turn) / f64::from(TURNS) * TAU);
                let to_light = 2.0 * to_eye.dot(middle) * middle - to_eye;
                // Light from below, and so grazing that its share is lost in any picture.
                if normal.dot(to_light) > 0.01 && to_eye.dot(middle) > 0.0 {
                    probes.push(BrdfProbe {
                        normal: normal.as_vec3().to_array(),
                        roughness: roughness as f32,
                        to_eye: to_eye.as_vec3().to_array(),
                        f0: F0 as f32,
                        to_light: to_light.as_vec3().to_array(),
                        gap: 0.0,
                    });
                }
            }
        }
    }
    probes
}

/// Formula of the denominator of the distribution.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Form {
    /// 1 - NH^2 from the cross product.
    Lagrange,
    /// 1 - NH^2 as it stands.
    Naive,
}

/// The sun's reflection, exact visibility, each result passed through `round`: identity for the
/// reference.
fn reflection(probe: &BrdfProbe, form: Form, round: impl Fn(f64) -> f64 + Copy) -> f64 {
    let vector = |v: DVec3| v.map(round);
    let product = |a: DVec3, b: DVec3| {
        let parts = (a * b).map(round);
        round(round(parts.x + parts.y) + parts.z)
    };
    let normal = vector(widened(probe.normal));
    let (to_eye, to_light) = (vector(widened(probe.to_eye)), vector(widened(probe.to_light)));
    let both = vector(to_eye + to_light);
    let length = round(product(both, both).sqrt());
    let middle = both.map(|component| round(component / length));
    let roughness = round(f64::from(probe.roughness));
    let alpha = round(roughness * roughness);
    let (nl, nv) = (product(normal, to_light), product(normal, to_eye).max(1e-4));
    let (nh, lh) = (product(normal, middle), product(to_light, middle));

    let along = round(nh * alpha);
    let off = match form {
        Form::Lagrange => {
            let aside = normal.cross(middle).map(round);
            product(aside, aside)
        }
        Form::Naive => round(1.0 - round(nh * nh)),
    };
    let k = round(alpha / round(off + round(along * along)));
    let distribution = round(round(k * k) / PI);

    let a2 = round(alpha * alpha);
    let root = |cosine: f64| round(round(round(round(cosine * cosine) * round(1.0 - a2)) + a2).sqrt());
    let visibility = round(0.5 / round(round(nv * root(nl)) + round(nl * root(nv))));
    let f0 = round(f64::from(probe.f0));
    let rest = round(1.0 - lh);
    let fresnel = round(f0 + round(round((16.5 * f0).clamp(0.0, 1.0) - f0) * round(rest.powi(5))));
    // The distribution last: it and the visibility term together leave the range of half floats.
    round(distribution * round(round(visibility * fresnel) * nl))
}

/// To the nearest half float, ties to even, with its range: 2^-24 to 65504.
fn half(value: f64) -> f64 {
    if value == 0.0 || !value.is_finite() {
        return value;
    }
    let exponent = value.abs().log2().floor().max(-14.0);
    let step = (exponent - 10.0).exp2();
    let rounded = (value / step).round_ties_even() * step;
    if rounded.abs() > 65_504.0 { f64::INFINITY.copysign(value) } else { rounded }
}

/// Relative errors are cut here; values that are not finite count as this.
const ERROR_CAP: f64 = 1000.0;

fn figures(errors: impl Iterator<Item = f64>) -> Figures {
    let cut = |error: f64| if error.is_finite() { error.abs().min(ERROR_CAP) } else { ERROR_CAP };
    Figures::of(errors.map(cut).collect())
}

/// Terms of the pass for some probes.
type Terms = [f32; BRDF_TERMS];

/// The terms of probes, in their order.
fn terms(gpu: &Gpu, probes: &[BrdfProbe]) -> Result<Vec<Terms>> {
    let pipeline = probe_pass::pipeline(gpu, &SHADERS.probe_brdf, Some("probe_brdf"));
    Ok(probe_pass::run(gpu, &pipeline, [], probes, Dispatch::once(probes.len()))?.0)
}

/// Times of the variants over that of the first.
fn costs(gpu: &Gpu) -> Result<Vec<f64>> {
    let probes = probes(0.5);
    let pipelines = VARIANTS.map(|(entry, ..)| probe_pass::pipeline(gpu, &SHADERS.probe_brdf, Some(entry)));
    let run = |index: usize| -> Result<Duration> {
        let found = probe_pass::run::<_, f32>(gpu, &pipelines[index], [], &probes, Dispatch::once(TIMED));
        Ok(found?.1)
    };
    // The first round compiles pipelines and fills caches.
    interleaved(1, VARIANTS.len(), run)?;
    Ok(ratios(&interleaved(ROUNDS, VARIANTS.len(), run)?))
}

/// The reflection that a variant makes of a probe's terms.
fn assembled(terms: &Terms, fast: bool, form: Form) -> f64 {
    let [lagrange, naive, exact, approximate, fresnel, _, _, nl] = terms.map(f64::from);
    let distribution = if form == Form::Naive { naive } else { lagrange };
    distribution * if fast { approximate } else { exact } * fresnel * nl
}

/// Errors at one roughness.
struct Row {
    roughness: f64,
    errors: [Figures; 5],
    /// Of each of [`VARIANTS`].
    of_variants: [Vec<f64>; 4],
}

fn row(gpu: &Gpu, roughness: f64) -> Result<Row> {
    let probes = probes(roughness);
    let terms = terms(gpu, &probes)?;
    let reference: Vec<f64> =
        probes.iter().map(|probe| reflection(probe, Form::Lagrange, |value| value)).collect();
    let on_gpu = |fast, form| {
        let pairs = terms.iter().zip(&reference);
        pairs.map(move |(terms, reference)| assembled(terms, fast, form) / reference - 1.0)
    };
    let in_half = |form| {
        let pairs = probes.iter().zip(&reference);
        pairs.map(move |(probe, reference)| reflection(probe, form, half) / reference - 1.0)
    };
    let errors = [
        figures(on_gpu(true, Form::Lagrange)),
        figures(on_gpu(false, Form::Lagrange)),
        figures(on_gpu(false, Form::Naive)),
        figures(in_half(Form::Lagrange)),
        figures(in_half(Form::Naive)),
    ];
    let of_variants = VARIANTS.map(|(.., fast, form)| on_gpu(fast, form).collect());
    Ok(Row { roughness, errors, of_variants })
}

pub fn measure(_: u64) -> Result<Curve> {
    let gpu = Gpu::open_blocking().context("reflection is measured on a GPU")?;
    let rows = ROUGHNESSES.map(|roughness| row(&gpu, roughness)).into_iter().collect::<Result<Vec<_>>>()?;
    let drawn = |row: &Row| row.roughness >= FLOOR;
    let costs = costs(&gpu)?.into_iter().enumerate().map(|(index, cost)| {
        let errors = rows.iter().filter(|row| drawn(row)).flat_map(|row| &row.of_variants[index]);
        (index, cost, figures(errors.copied()))
    });
    let caption = format!(
        "cost of one reflection, over that of variant 0, median of {ROUNDS} interleaved rounds on {}, \
         against the error over all roughnesses from {FLOOR} on; variants: {}.",
        gpu.name(),
        numbered(VARIANTS.map(|variant| variant.1), "; ")
    );
    let mut costs = Sheet::new("brdf_cost", caption, costs.collect());
    let names = ["variant", "cost ratio", "RMS", "p99", "max"];
    costs.columns(names, |(variant, cost, error)| [*variant as f64, *cost, error.rms, error.p99, error.max]);
    let caption = format!(
        "relative error of the sun's reflection (GGX, f0 {F0}) against f64 with exact visibility, at \
         half vectors spread evenly over the lobe and eyes 0 to 85 degrees off the normal; f32 on {}, \
         f16 emulated, errors cut at {ERROR_CAP}. The viewer draws no roughness below {FLOOR}.",
        gpu.name()
    );
    let mut errors = Sheet::new("brdf", caption, rows);
    errors.column("roughness", |row| row.roughness);
    for (index, name) in ERRORS.into_iter().enumerate() {
        let names = ["max", "RMS", "p99"].map(|figure| format!("{name} {figure}"));
        errors.columns(names, |Row { errors, .. }| [errors[index].max, errors[index].rms, errors[index].p99]);
    }

    let of_drawn = |column: &str| errors.points_where(drawn, "roughness", column);
    let precision = |title, figure: &str| {
        let panel = Panel::new(title, log("roughness"), log("relative error of the reflection, cut at 1000"));
        let curves = [
            ("f32, N x H", "f32"),
            ("f32, 1 - NH^2", "f32 naive"),
            ("f16, N x H", "f16"),
            ("f16, 1 - NH^2", "f16 naive"),
        ];
        errors
            .lines(panel, "roughness", curves.map(|(label, name)| (label, format!("{name} {figure}"))))
            .bound("least roughness drawn", [(FLOOR, 1e-6), (FLOOR, ERROR_CAP)])
    };
    let time = linear("time, share of exact visibility with N x H");
    let error = log("relative error of the reflection");
    let cost = Panel::new("Cost against error", time, log("RMS relative error"));
    let panels = vec![
        Panel::new("Fast visibility against exact", linear("roughness"), error)
            .line("largest found", of_drawn("fast max"))
            .line("99th percentile", of_drawn("fast p99"))
            .line("RMS", of_drawn("fast RMS")),
        precision("Precision, exact visibility: 99th percentile", "p99"),
        precision("Precision, exact visibility: RMS", "RMS"),
        costs.front(cost, "cost ratio", "RMS", |row| (VARIANTS[row.0].1.to_owned(), row.0 == 0)),
    ];
    let title = "Reflection: visibility term and precision (reference: f64, exact visibility)";
    Ok(Curve { name: "brdf", title, tables: vec![errors.into(), costs.into()], panels })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sample;

    /// The pass; skipped with a message without an adapter, unless one is required.
    fn gpu() -> Option<Gpu> {
        match Gpu::open_blocking() {
            Ok(gpu) => Some(gpu),
            Err(error) => {
                assert!(std::env::var_os("TOMBOLO_REQUIRE_GPU").is_none(), "a GPU is required: {error}");
                eprintln!("SKIPPED: {error}");
                None
            }
        }
    }

    #[test]
    fn half_floats_round_to_nearest_even() {
        for (value, rounded) in [
            (1.0, 1.0),
            (1.0 + 1.0 / 2048.0, 1.0),
            (1.0 + 3.0 / 2048.0, 1.0 + 4.0 / 2048.0),
            (0.1, 0.099_975_585_937_5),
            (65_504.0, 65_504.0),
            (70_000.0, f64::INFINITY),
            (2f64.powi(-24), 2f64.powi(-24)),
            (2f64.powi(-26), 0.0),
            (-0.1, -0.099_975_585_937_5),
        ] {
            assert_eq!(half(value), rounded, "{value}");
        }
    }

    #[test]
    fn f32_is_near_the_reference_and_the_naive_form_is_not() {
        let Some(gpu) = gpu() else { return };
        for roughness in [FLOOR, 0.2, 0.9] {
            let probes = probes(roughness);
            let terms = terms(&gpu, &probes).unwrap();
            let Figures { max, .. } = figures(terms.iter().zip(&probes).map(|(terms, probe)| {
                assembled(terms, false, Form::Lagrange) / reflection(probe, Form::Lagrange, |v| v) - 1.0
            }));
            assert!(max < 2e-3, "roughness {roughness}: {max}");
        }
        let probes = probes(FLOOR);
        let terms = terms(&gpu, &probes).unwrap();
        let Figures { max, .. } = figures(terms.iter().zip(&probes).map(|(terms, probe)| {
            assembled(terms, false, Form::Naive) / reflection(probe, Form::Lagrange, |v| v) - 1.0
        }));
        assert!(max > 0.02, "the control must fail: {max}");
    }

    /// Share of white light from everywhere that a surface gives back to an eye at the cosine `nv`:
    /// the lobe for a Fresnel term of 1, the lobe with the shipped Fresnel term, the same plus the
    /// body below it, and the first without masking and shadowing.
    fn furnace(gpu: &Gpu, roughness: f64, nv: f64) -> [f64; 4] {
        const SAMPLES: u32 = 1 << 14;
        let [normal, east, south] = surface();
        let level = (1.0 - nv * nv).sqrt();
        let to_eye = nv * normal + level * east;
        let mut probes = Vec::new();
        let mut weights = Vec::new();
        let alpha = roughness * roughness;
        for index in 0..SAMPLES {
            // Even samples follow the lobe, odd ones the cosine.
            let (u, v) =
                (f64::from(index / 2) * 2.0 / f64::from(SAMPLES), sample::unit(sample::word(71, index)));
            let (u, turn) = (u + 1.0 / f64::from(SAMPLES), v * TAU);
            let of_lobe = index % 2 == 0;
            let polar = if of_lobe { (alpha * (u / (1.0 - u)).sqrt()).atan() } else { u.sqrt().asin() };
            let (sin, cos) = polar.sin_cos();
            let middle = cos * normal + sin * (turn.cos() * east + turn.sin() * south);
            let (to_light, density) = if of_lobe {
                let along = to_eye.dot(middle);
                let to_light = 2.0 * along * middle - to_eye;
                let k = alpha / (sin * sin + cos * cos * alpha * alpha);
                (to_light, k * k / PI * cos / (4.0 * along.abs().max(1e-9)))
            } else {
                (middle, cos / PI)
            };
            let above = normal.dot(to_light) > 1e-6 && to_eye.dot(to_eye + to_light) > 0.0;
            probes.push(BrdfProbe {
                normal: normal.as_vec3().to_array(),
                roughness: roughness as f32,
                to_eye: to_eye.as_vec3().to_array(),
                f0: F0 as f32,
                to_light: (if above { to_light } else { normal }).as_vec3().to_array(),
                gap: 0.0,
            });
            weights.push((of_lobe, if above { 1.0 / density } else { 0.0 }));
        }
        let half = f64::from(SAMPLES) / 2.0;
        let mut shares = [0.0; 4];
        for ((of_lobe, weight), terms) in weights.into_iter().zip(terms(gpu, &probes).unwrap()) {
            let [distribution, _, visibility, _, fresnel, burley, albedo, nl] = terms.map(f64::from);
            if of_lobe {
                let lobe = distribution * visibility * nl * weight / half;
                shares[0] += lobe;
                shares[1] += lobe * fresnel;
                shares[2] += lobe * fresnel;
                if nl > 0.0 {
                    shares[3] += distribution / (4.0 * nv) * weight / half;
                }
            } else {
                shares[2] += (1.0 - albedo) * burley / PI * nl * weight / half;
            }
        }
        shares
    }

    #[test]
    fn no_surface_gains_energy_and_one_without_masking_does() {
        const TOLERANCE: f64 = 0.015;
        let Some(gpu) = gpu() else { return };
        let mut unmasked = 0.0f64;
        for roughness in [0.1, 0.3, 0.5, 0.7, 0.9, 1.0] {
            for nv in [0.05, 0.1, 0.2, 0.35, 0.5, 0.7, 0.9, 1.0] {
                let [lobe, gloss, all, without] = furnace(&gpu, roughness, nv);
                eprintln!(
                    "roughness {roughness}, cosine {nv}: lobe {lobe:.3}, gloss {gloss:.3}, all {all:.3}"
                );
                assert!(lobe <= 1.0 + TOLERANCE, "roughness {roughness}, cosine {nv}: lobe {lobe}");
                assert!(all <= 1.0 + TOLERANCE, "roughness {roughness}, cosine {nv}: {all}");
                assert!(all > 0.65, "hardly anything is lost: roughness {roughness}, cosine {nv}: {all}");
                if roughness <= 0.3 && nv >= 0.35 {
                    assert!(lobe > 0.95, "a smooth mirror loses nothing: {lobe}");
                }
                unmasked = unmasked.max(without);
            }
        }
        assert!(unmasked > 1.1, "the control must fail: {unmasked}");
    }
}
