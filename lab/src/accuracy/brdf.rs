//! Reflection: what the fast visibility term and fewer digits cost, against f64.
//!
//! A pass evaluates the functions that the viewer draws with (`shared/brdf.wesl`) for directions
//! that lie where the lobes of GGX are; the truth is the exact form in f64 for the same directions.
//! Half precision is emulated here, since few devices compute in it: every intermediate result is
//! rounded.

use super::Curve;
use super::octaves::ratios;
use crate::adapters::{self, OpenGpu};
use crate::chart::{Choice, Panel, front, linear, log, measured, stated};
use crate::probe;
use crate::table::Table;
use anyhow::{Context as _, Result};
use shaders::SHADERS;
use shaders::layout::{BRDF_TERMS, BrdfProbe};
use std::f64::consts::{PI, TAU};
use std::time::Instant;

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
const TIMED: u32 = 1 << 14;

/// The timed entry points: label, and what they combine.
const VARIANTS: [(&str, &str); 4] = [
    ("time_exact", "exact visibility, N x H"),
    ("time_fast", "fast visibility, N x H"),
    ("time_exact_naive", "exact visibility, 1 - NH^2"),
    ("time_fast_naive", "fast visibility, 1 - NH^2"),
];

type Vector = [f64; 3];

fn dot(a: Vector, b: Vector) -> f64 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

fn cross(a: Vector, b: Vector) -> Vector {
    [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
}

fn unit(v: Vector) -> Vector {
    let length = dot(v, v).sqrt();
    v.map(|component| component / length)
}

fn sum(a: Vector, b: Vector) -> Vector {
    [a[0] + b[0], a[1] + b[1], a[2] + b[2]]
}

fn widened(v: [f32; 3]) -> Vector {
    unit(v.map(f64::from))
}

/// A surface that is aligned with no axis, so that no product is exact by luck: normal and two
/// tangents.
fn surface() -> [Vector; 3] {
    let normal = unit([0.36, 0.81, -0.47]);
    let east = unit(cross(normal, [0.1, 0.2, 0.9]));
    [normal, east, cross(normal, east)]
}

fn narrow(v: Vector) -> [f32; 3] {
    v.map(|component| component as f32)
}

/// The directions of one roughness: half vectors by equal shares of the lobe's facets, eyes by
/// equal steps of angle.
fn probes(roughness: f64) -> Vec<BrdfProbe> {
    let [normal, east, south] = surface();
    let place = |polar: f64, turn: f64| {
        let (level, up) = polar.sin_cos();
        std::array::from_fn(|axis| {
            up * normal[axis] + level * (turn.cos() * east[axis] + turn.sin() * south[axis])
        })
    };
    let alpha = roughness * roughness;
    let mut probes = Vec::new();
    for eye in 0..EYES {
        let to_eye: Vector = place(f64::from(eye) * 5.0f64.to_radians(), 0.3);
        for lobe in 0..LOBES {
            // Inverse of the lobe's distribution (Walter et al., 2007, eq. 35).
            let share = (f64::from(lobe) + 0.5) / f64::from(LOBES);
            let polar = (alpha * (share / (1.0 - share)).sqrt()).atan();
            for turn in 0..TURNS {
                let middle: Vector = place(polar, f64::from(turn) / f64::from(TURNS) * TAU);
                let along = 2.0 * dot(to_eye, middle);
                let to_light = std::array::from_fn(|axis| along * middle[axis] - to_eye[axis]);
                // Light from below, and so grazing that its share is lost in any picture.
                if dot(normal, to_light) > 0.01 && dot(to_eye, middle) > 0.0 {
                    probes.push(BrdfProbe {
                        normal: narrow(normal),
                        roughness: roughness as f32,
                        to_eye: narrow(to_eye),
                        f0: F0 as f32,
                        to_light: narrow(to_light),
                        gap: 0.0,
                    });
                }
            }
        }
    }
    probes
}

/// Distribution over everything else that a lobe consists of, by a formula that may round.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Form {
    /// 1 - NH^2 from the cross product.
    Lagrange,
    /// 1 - NH^2 as it stands.
    Naive,
}

/// The sun's reflection, exact visibility, each result passed through `round`: identity for the
/// truth.
fn reflection(probe: &BrdfProbe, form: Form, round: impl Fn(f64) -> f64 + Copy) -> f64 {
    let vector = |v: Vector| v.map(round);
    let product = |a: Vector, b: Vector| {
        let parts: [f64; 3] = std::array::from_fn(|axis| round(a[axis] * b[axis]));
        round(round(parts[0] + parts[1]) + parts[2])
    };
    let normal = vector(widened(probe.normal));
    let (to_eye, to_light) = (vector(widened(probe.to_eye)), vector(widened(probe.to_light)));
    let both = vector(sum(to_eye, to_light));
    let length = round(product(both, both).sqrt());
    let middle = both.map(|component| round(component / length));
    let roughness = round(f64::from(probe.roughness));
    let alpha = round(roughness * roughness);
    let (nl, nv) = (product(normal, to_light), product(normal, to_eye).max(1e-4));
    let (nh, lh) = (product(normal, middle), product(to_light, middle));

    let along = round(nh * alpha);
    let off = match form {
        Form::Lagrange => {
            let aside = cross(normal, middle).map(round);
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

/// A relative error beyond which it makes no difference how wrong a value is; what is no number
/// counts as this wrong.
const HOPELESS: f64 = 1000.0;

/// Largest, root mean square and 99th percentile of relative errors.
fn statistics(errors: impl Iterator<Item = f64>) -> [f64; 3] {
    let mut errors: Vec<f64> =
        errors.map(|error| if error.is_finite() { error.abs().min(HOPELESS) } else { HOPELESS }).collect();
    errors.sort_unstable_by(f64::total_cmp);
    let count = errors.len().max(1);
    let square = errors.iter().map(|error| error * error).sum::<f64>() / count as f64;
    let at = |share: f64| errors.get((share * (count - 1) as f64) as usize).copied().unwrap_or_default();
    [at(1.0), square.sqrt(), at(0.99)]
}

/// Terms of the pass for some probes.
type Terms = [f32; BRDF_TERMS];

/// The pass on one device.
struct Bench {
    gpu: OpenGpu,
    module: wgpu::ShaderModule,
}

impl Bench {
    fn open() -> Result<Self> {
        let adapter = adapters::all(wgpu::Backends::PRIMARY).into_iter().next().context(
            "reflection is measured on a GPU and none was found: install a Vulkan driver, on Debian or Ubuntu `apt install mesa-vulkan-drivers libvulkan1`",
        )?;
        let gpu = adapters::open(&adapter).with_context(|| adapters::name(&adapter))?;
        let module = gpu.device.create_shader_module(wgpu::ShaderModuleDescriptor {
            label: Some(SHADERS.probe_brdf.name),
            source: wgpu::ShaderSource::Wgsl(SHADERS.probe_brdf.wgsl.into()),
        });
        Ok(Self { gpu, module })
    }

    fn job(&self, entry_point: &str, probes: &[BrdfProbe], words: usize) -> Job {
        let device = &self.gpu.device;
        let pipeline = device.create_compute_pipeline(&wgpu::ComputePipelineDescriptor {
            label: Some(entry_point),
            layout: None,
            module: &self.module,
            entry_point: Some(entry_point),
            compilation_options: wgpu::PipelineCompilationOptions::default(),
            cache: None,
        });
        let input = probe::input(&self.gpu, "probes", probes);
        let output = probe::output::<f32>(&self.gpu, "terms", words);
        let bindings = device.create_bind_group(&wgpu::BindGroupDescriptor {
            label: Some(entry_point),
            layout: &pipeline.get_bind_group_layout(0),
            entries: &[
                wgpu::BindGroupEntry { binding: 0, resource: input.as_entire_binding() },
                wgpu::BindGroupEntry { binding: 1, resource: output.as_entire_binding() },
            ],
        });
        Job { pipeline, bindings, output }
    }

    /// The terms of probes, in their order.
    fn terms(&self, probes: &[BrdfProbe]) -> Result<Vec<Terms>> {
        let job = self.job("probe_brdf", probes, BRDF_TERMS * probes.len());
        self.gpu.queue.submit([job.record(&self.gpu, probes.len() as u32).finish()]);
        probe::read(&self.gpu, &job.output)
    }

    /// Costs of the variants over that of the first, in their order: medians over rounds in which
    /// they take turns, so that a change of the machine's speed meets all.
    fn costs(&self) -> Result<Vec<f64>> {
        let probes = probes(0.5);
        let jobs: Vec<Job> =
            VARIANTS.iter().map(|(entry, _)| self.job(entry, &probes, TIMED as usize)).collect();
        let mut times = vec![Vec::new(); jobs.len()];
        for round in 0..=ROUNDS {
            for (job, times) in jobs.iter().zip(&mut times) {
                let encoder = job.record(&self.gpu, TIMED);
                let begun = Instant::now();
                self.gpu.queue.submit([encoder.finish()]);
                self.gpu.wait()?;
                // The first round compiles and fills caches.
                if round > 0 {
                    times.push(begun.elapsed());
                }
            }
        }
        Ok(ratios(&times))
    }
}

/// An entry point with its buffers.
struct Job {
    pipeline: wgpu::ComputePipeline,
    bindings: wgpu::BindGroup,
    output: wgpu::Buffer,
}

impl Job {
    fn record(&self, gpu: &OpenGpu, invocations: u32) -> wgpu::CommandEncoder {
        let mut encoder = gpu.device.create_command_encoder(&wgpu::CommandEncoderDescriptor::default());
        let mut pass = encoder.begin_compute_pass(&wgpu::ComputePassDescriptor::default());
        pass.set_pipeline(&self.pipeline);
        pass.set_bind_group(0, &self.bindings, &[]);
        pass.dispatch_workgroups(invocations.div_ceil(64), 1, 1);
        drop(pass);
        encoder
    }
}

/// The reflection that a variant makes of a probe's terms.
fn assembled(terms: &Terms, fast: bool, form: Form) -> f64 {
    let [lagrange, naive, exact, approximate, fresnel, _, _, nl] = terms.map(f64::from);
    let distribution = if form == Form::Naive { naive } else { lagrange };
    distribution * if fast { approximate } else { exact } * fresnel * nl
}

/// Measures it.
///
/// # Errors
/// There is no GPU, or it fails.
pub fn measure(_: u64) -> Result<Curve> {
    let bench = Bench::open()?;
    let mut errors = Table::new(
        "brdf",
        format!(
            "relative error of the sun's reflection (GGX, f0 {F0}) against f64 with exact visibility, at half vectors spread evenly over the lobe and eyes 0 to 85 degrees off the normal; f32 on {}, f16 emulated, errors cut at {HOPELESS}. The viewer draws no roughness below {FLOOR}.",
            bench.gpu.name
        ),
        &[
            "roughness",
            "fast max",
            "fast RMS",
            "fast p99",
            "f32 max",
            "f32 RMS",
            "f32 p99",
            "f32 naive max",
            "f32 naive RMS",
            "f32 naive p99",
            "f16 max",
            "f16 RMS",
            "f16 p99",
            "f16 naive max",
            "f16 naive RMS",
            "f16 naive p99",
        ],
    );
    // Over all roughnesses that are drawn, for each variant.
    let mut of_variants: [Vec<f64>; 4] = Default::default();
    for roughness in ROUGHNESSES {
        let probes = probes(roughness);
        let terms = bench.terms(&probes)?;
        let truth: Vec<f64> =
            probes.iter().map(|probe| reflection(probe, Form::Lagrange, |value| value)).collect();
        let on_gpu = |fast, form| {
            let pairs = terms.iter().zip(&truth);
            pairs.map(move |(terms, truth)| assembled(terms, fast, form) / truth - 1.0)
        };
        let in_half = |form| {
            let pairs = probes.iter().zip(&truth);
            pairs.map(move |(probe, truth)| reflection(probe, form, half) / truth - 1.0)
        };
        let row = [
            statistics(on_gpu(true, Form::Lagrange)),
            statistics(on_gpu(false, Form::Lagrange)),
            statistics(on_gpu(false, Form::Naive)),
            statistics(in_half(Form::Lagrange)),
            statistics(in_half(Form::Naive)),
        ];
        errors.push(std::iter::once(roughness).chain(row.into_iter().flatten()).collect::<Vec<_>>());
        if roughness >= FLOOR {
            let variants =
                [(false, Form::Lagrange), (true, Form::Lagrange), (false, Form::Naive), (true, Form::Naive)];
            for (all, (fast, form)) in of_variants.iter_mut().zip(variants) {
                all.extend(on_gpu(fast, form));
            }
        }
    }

    let ratios = bench.costs()?;
    let mut costs = Table::new(
        "brdf_cost",
        format!(
            "cost of one reflection, over that of variant 0, median of {ROUNDS} interleaved rounds on {}, against the error over all roughnesses from {FLOOR} on; variants: {}.",
            bench.gpu.name,
            VARIANTS
                .iter()
                .enumerate()
                .map(|(n, (_, name))| format!("{n} {name}"))
                .collect::<Vec<_>>()
                .join("; ")
        ),
        &["variant", "cost ratio", "RMS", "p99", "max"],
    );
    for (index, (cost, all)) in ratios.iter().zip(of_variants).enumerate() {
        let [max, rms, p99] = statistics(all.into_iter());
        costs.push([index as f64, *cost, rms, p99, max]);
    }
    let curve = |column| errors.curve("roughness", column);
    let drawn = |column| curve(column).into_iter().filter(|(roughness, _)| *roughness >= FLOOR);
    let floor = || stated("least roughness drawn", [(FLOOR, 1e-6), (FLOOR, HOPELESS)]);
    let choices: Vec<Choice> = costs
        .curve("cost ratio", "RMS")
        .into_iter()
        .zip(VARIANTS)
        .enumerate()
        .map(|(index, (at, (_, name)))| Choice { name: name.to_owned(), at, is_shipped: index == 0 })
        .collect();
    let panels = vec![
        Panel {
            title: "Fast visibility against exact",
            x: linear("roughness"),
            y: log("relative error of the reflection"),
            series: vec![
                measured("largest found", drawn("fast max")),
                measured("99th percentile", drawn("fast p99")),
                measured("RMS", drawn("fast RMS")),
            ],
        },
        Panel {
            title: "Precision, exact visibility: 99th percentile",
            x: log("roughness"),
            y: log("relative error of the reflection, cut at 1000"),
            series: vec![
                measured("f32, N x H", curve("f32 p99")),
                measured("f32, 1 - NH^2", curve("f32 naive p99")),
                measured("f16, N x H", curve("f16 p99")),
                measured("f16, 1 - NH^2", curve("f16 naive p99")),
                floor(),
            ],
        },
        Panel {
            title: "Precision, exact visibility: RMS",
            x: log("roughness"),
            y: log("relative error of the reflection, cut at 1000"),
            series: vec![
                measured("f32, N x H", curve("f32 RMS")),
                measured("f32, 1 - NH^2", curve("f32 naive RMS")),
                measured("f16, N x H", curve("f16 RMS")),
                measured("f16, 1 - NH^2", curve("f16 naive RMS")),
                floor(),
            ],
        },
        Panel {
            title: "What an error saves",
            x: linear("time, share of exact visibility with N x H"),
            y: log("RMS relative error"),
            series: front(&choices),
        },
    ];
    Ok(Curve {
        name: "brdf",
        title: "Reflection: visibility term and precision (truth: f64, exact visibility)",
        tables: vec![errors, costs],
        panels,
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sample;

    /// The pass; none, visibly, where there is no adapter and none is required.
    fn bench() -> Option<Bench> {
        match Bench::open() {
            Ok(bench) => Some(bench),
            Err(error) => {
                assert!(std::env::var_os("TOMBOLO_REQUIRE_GPU").is_none(), "a GPU is required: {error}");
                eprintln!("SKIPPED: {error}");
                None
            }
        }
    }

    #[test]
    fn half_floats_round_as_the_format_does() {
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
    fn f32_is_near_the_truth_where_the_viewer_draws_and_the_naive_form_is_not() {
        let Some(bench) = bench() else { return };
        for roughness in [FLOOR, 0.2, 0.9] {
            let probes = probes(roughness);
            let terms = bench.terms(&probes).unwrap();
            let [max, ..] = statistics(terms.iter().zip(&probes).map(|(terms, probe)| {
                assembled(terms, false, Form::Lagrange) / reflection(probe, Form::Lagrange, |v| v) - 1.0
            }));
            assert!(max < 2e-3, "roughness {roughness}: {max}");
        }
        let probes = probes(FLOOR);
        let terms = bench.terms(&probes).unwrap();
        let [max, ..] = statistics(terms.iter().zip(&probes).map(|(terms, probe)| {
            assembled(terms, false, Form::Naive) / reflection(probe, Form::Lagrange, |v| v) - 1.0
        }));
        assert!(max > 0.02, "the control must fail: {max}");
    }

    /// Share of white light from everywhere that a surface gives back to an eye at the cosine `nv`:
    /// the lobe for a Fresnel term of 1, the lobe with the shipped Fresnel term, the same plus the
    /// body below it, and the first without masking and shadowing.
    fn furnace(bench: &Bench, roughness: f64, nv: f64) -> [f64; 4] {
        const SAMPLES: u32 = 1 << 14;
        let [normal, east, south] = surface();
        let level = (1.0 - nv * nv).sqrt();
        let to_eye: Vector = std::array::from_fn(|axis| nv * normal[axis] + level * east[axis]);
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
            let middle: Vector = std::array::from_fn(|axis| {
                cos * normal[axis] + sin * (turn.cos() * east[axis] + turn.sin() * south[axis])
            });
            let (to_light, density) = if of_lobe {
                let along = dot(to_eye, middle);
                let to_light = std::array::from_fn(|axis| 2.0 * along * middle[axis] - to_eye[axis]);
                let k = alpha / (sin * sin + cos * cos * alpha * alpha);
                (to_light, k * k / PI * cos / (4.0 * along.abs().max(1e-9)))
            } else {
                (middle, cos / PI)
            };
            let above = dot(normal, to_light) > 1e-6 && dot(to_eye, sum(to_eye, to_light)) > 0.0;
            probes.push(BrdfProbe {
                normal: narrow(normal),
                roughness: roughness as f32,
                to_eye: narrow(to_eye),
                f0: F0 as f32,
                to_light: narrow(if above { to_light } else { normal }),
                gap: 0.0,
            });
            weights.push((of_lobe, if above { 1.0 / density } else { 0.0 }));
        }
        let half = f64::from(SAMPLES) / 2.0;
        let mut shares = [0.0; 4];
        for ((of_lobe, weight), terms) in weights.into_iter().zip(bench.terms(&probes).unwrap()) {
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
    fn no_surface_gives_back_more_than_it_gets_and_one_without_masking_does() {
        const TOLERANCE: f64 = 0.015;
        let Some(bench) = bench() else { return };
        let mut unmasked = 0.0f64;
        for roughness in [0.1, 0.3, 0.5, 0.7, 0.9, 1.0] {
            for nv in [0.05, 0.1, 0.2, 0.35, 0.5, 0.7, 0.9, 1.0] {
                let [lobe, gloss, all, without] = furnace(&bench, roughness, nv);
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
