//! `digest`: every backend of this machine computes the same integers.
//!
//! All evaluate the same `probes`. The blake3 digest of the results (`words`) must equal a
//! frozen one, which compares builds and machines that never run together. Backends: this program
//! (`cpu`), WGSL under naga on every adapter (`gpu`, `swiftshader`), WGSL under Tint in a
//! browser (`browser`). A float twin must differ: the control that proves the comparison can
//! fail.

mod browser;
mod child;
mod cpu;
mod floats;
mod gpu;
mod probes;
mod report;
mod swiftshader;
mod words;

use crate::{Outputs, adapters};
use anyhow::{Result, anyhow};
use client::gpu::Gpu;
use probes::Probe;
use report::{AdapterResults, Backend, Control, Report, State};
use shaders::SHADERS;
use std::time::Instant;
use terrain::{Kernel, Land};

/// The world that is probed; both halves of the seed count.
pub const WORLD_SEED: u64 = 0x0123_4567_89ab_cdef;

/// The digest of this `terrain::constants::GENERATOR_VERSION`. It changes only with the version and
/// the probe set.
pub const EXPECTED: &str = "da1a42725d1f7a45dd16c37dd3d35b08f50a487c89644078bb4df84d2d4e8623";

/// Differences reported of one backend.
const REPORTED: usize = 3;

/// Options of `digest`.
#[derive(Clone, Debug, clap::Args)]
pub struct Options {
    /// Fail where no GPU adapter is found, a software one included
    #[arg(long, env = "TOMBOLO_REQUIRE_GPU", value_parser = clap::builder::FalseyValueParser::new())]
    pub require_gpu: bool,
    /// Run the Vulkan adapters only and print their results as JSON: how this program runs itself
    /// under SwiftShader
    #[arg(long, hide = true)]
    pub child: bool,
}

/// Runs every backend, prints the table, writes the report.
///
/// # Errors
/// A backend differs or fails, the control does not differ, or a required GPU is missing.
pub fn run(options: &Options, outputs: &Outputs) -> Result<()> {
    let bench = Bench::new();
    if options.child {
        println!("{}", serde_json::to_string(&bench.adapters(wgpu::Backends::VULKAN))?);
        return Ok(());
    }
    child::clean_up_when_interrupted()?;
    let mut backends = bench.cpu();
    let own = bench.adapters(wgpu::Backends::all());
    let any_gpu = own.backends.iter().any(|backend| backend.state != State::Skipped);
    let swiftshader = bench.swiftshader();
    let control = own.control.or(swiftshader.control).unwrap_or_else(|| bench.control_without_gpu());
    backends.extend(own.backends);
    backends.extend(swiftshader.backends);
    backends.push(bench.browser());

    let mut report =
        Report { probes: bench.probes.len(), expected: EXPECTED.into(), backends, control, equal: false };
    let verdict = report.verdict();
    report.equal = verdict.is_ok();
    print!("{report}");
    outputs.write_json(&report)?;
    verdict.map_err(|problem| anyhow!(problem))?;
    if options.require_gpu && !any_gpu {
        return Err(anyhow!(
            "no GPU adapter was found and --require-gpu is set: install a driver, on Debian or Ubuntu \
             `apt install mesa-vulkan-drivers libvulkan1`"
        ));
    }
    Ok(())
}

/// The probes, and the results of the definition.
struct Bench {
    land: Land,
    probes: Vec<Probe>,
    scalar: Vec<i32>,
    scalar_seconds: f64,
}

impl Bench {
    fn new() -> Self {
        let (land, probes) = (Land::new(WORLD_SEED), probes::all());
        let began = Instant::now();
        let scalar = cpu::scalar(&land, &probes);
        Self { land, probes, scalar, scalar_seconds: began.elapsed().as_secs_f64() }
    }

    /// This program: the definition, then the kernels.
    fn cpu(&self) -> Vec<Backend> {
        let build = if cfg!(debug_assertions) { "debug" } else { "release" };
        let mut scalar = self.compare(
            format!("Rust definition ({build})"),
            &self.scalar,
            self.scalar_seconds,
            "point by point",
        );
        if scalar.state == State::Different {
            scalar.detail =
                "this build computes another land than the frozen digest: if that is intended, bump \
                             GENERATOR_VERSION and freeze the new digest"
                    .into();
        }
        let mut backends = vec![scalar];
        for kernel in Kernel::available() {
            let began = Instant::now();
            let words = cpu::by_kernel(&self.land, kernel, &self.probes, &self.scalar);
            let seconds = began.elapsed().as_secs_f64();
            backends.push(self.compare(
                format!("Rust {kernel} kernel ({build})"),
                &words,
                seconds,
                "in grids of 1 to 33 by 1 to 3 vertices",
            ));
        }
        backends
    }

    /// Every adapter of some backends, and the control on the first that works.
    fn adapters(&self, which: wgpu::Backends) -> AdapterResults {
        let (mut backends, mut control) = (Vec::new(), None);
        let (instance, adapters) = adapters::all(which);
        for adapter in adapters {
            let name = format!("naga -> {}", adapters::name(&adapter));
            let driver = adapters::driver(&adapter);
            let opened = Gpu::of_adapter(instance.clone(), adapter, wgpu::Features::empty());
            let gpu = match pollster::block_on(opened) {
                Ok(gpu) => gpu,
                Err(error) => {
                    backends.push(Backend::skipped(name, error.to_string()));
                    continue;
                }
            };
            let began = Instant::now();
            let words = gpu::words(&gpu, &SHADERS.probe_heights, &self.land, &self.probes);
            let seconds = began.elapsed().as_secs_f64();
            backends.push(match words {
                Ok(words) => self.compare(name.clone(), &words, seconds, &driver),
                Err(error) => Backend::failed(name.clone(), format!("{error:#}"), seconds),
            });
            if control.is_none() {
                let floats = gpu::words(&gpu, &SHADERS.probe_heights_float, &self.land, &self.probes);
                control = floats.ok().map(|words| self.control(&name, &words));
            }
        }
        if backends.is_empty() {
            backends.push(Backend::skipped("naga -> any adapter", "no adapter was found"));
        }
        AdapterResults { backends, control }
    }

    fn swiftshader(&self) -> AdapterResults {
        const NAME: &str = "naga -> SwiftShader (vulkan)";
        let alone = |backend| AdapterResults { backends: vec![backend], control: None };
        let Some(manifest) = installed_browser::swiftshader_manifest() else {
            return alone(Backend::skipped(NAME, "not installed; it comes with Chromium"));
        };
        let began = Instant::now();
        swiftshader::run(&manifest).unwrap_or_else(|error| {
            alone(Backend::failed(NAME, format!("{error:#}"), began.elapsed().as_secs_f64()))
        })
    }

    fn browser(&self) -> Backend {
        const NAME: &str = "Tint -> SwiftShader (Chromium)";
        let Some(program) = installed_browser::chromium() else {
            return Backend::skipped(NAME, "Chromium is not installed");
        };
        let began = Instant::now();
        let outcome = browser::words(&program, &SHADERS.probe_heights, &self.land, &self.probes);
        let seconds = began.elapsed().as_secs_f64();
        match outcome {
            Ok(browser::Outcome::Words { words, adapter }) => {
                self.compare(NAME.into(), &words, seconds, &adapter)
            }
            Ok(browser::Outcome::NoWebGpu(why)) => Backend::skipped(NAME, why),
            Err(error) => Backend::failed(NAME, format!("{error:#}"), seconds),
        }
    }

    /// `about`: the detail of an equal backend.
    fn compare(&self, name: String, words: &[i32], seconds: f64, about: &str) -> Backend {
        let digest = words::digest(words);
        let state = if digest == EXPECTED { State::Equal } else { State::Different };
        let total = words::count_differences(&self.scalar, words);
        let detail = match (state, total) {
            (State::Different, 0) => "equal to the definition of this build, not to the frozen digest".into(),
            (_, 0) => about.into(),
            _ => {
                let first =
                    words::describe_differences(&self.probes, &self.scalar, words, REPORTED).join("; ");
                format!("{total} words differ from the definition of this build: {first}")
            }
        };
        Backend { name, digest: Some(digest), state, detail, seconds }
    }

    /// The control where no GPU runs it: our formula in f32 on this processor.
    fn control_without_gpu(&self) -> Control {
        self.control("this processor", &floats::words(&self.land, &self.probes))
    }

    fn control(&self, backend: &str, words: &[i32]) -> Control {
        let digest = words::digest(words);
        let words_different = words::count_differences(&self.scalar, words);
        let differs = digest != EXPECTED && words_different > 0;
        Control { name: format!("f32 twin, {backend}"), digest, differs, words_different }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn this_build_computes_the_frozen_digest() {
        let found = words::digest(&cpu::scalar(&Land::new(WORLD_SEED), &probes::all()));
        assert_eq!(found, EXPECTED, "another land: bump GENERATOR_VERSION and freeze the new digest");
        assert!(include_str!("../../../docs/heightfield.md").contains(&format!("`{EXPECTED}`")), "published");
    }
}
