//! `timings`: chunks per second of the GPU against one thread of the CPU of the same machine.
//!
//! Both generate heights and both pyramids of the same level-0 chunks with land. Their turns
//! alternate, so that a machine that warms up or is disturbed slows both; the median turn counts.

use crate::Outputs;
use crate::codec::samples::land_keys;
use crate::gpu_probes::fill::{ChunkFiller, MAX_BATCH};
use crate::stats::median;
use anyhow::{Result, anyhow};
use client::gpu::Gpu;
use serde::Serialize;
use std::time::Instant;
use terrain::constants::VERTEX_COUNT;
use terrain::{ChunkKey, Grid, Kernel, Land, Pyramid};

/// The world whose home island is timed.
const WORLD_SEED: u64 = 1;

/// Options of `timings`.
#[derive(Clone, Debug, clap::Args)]
pub struct Options {
    /// Turns of each side, 3 to 1000
    #[arg(long, value_name = "N", default_value_t = 15,
          value_parser = clap::value_parser!(u32).range(3..=1000))]
    pub turns: u32,
    /// Chunks of a turn, 1 to 256
    #[arg(long, value_name = "N", default_value_t = 128,
          value_parser = clap::value_parser!(u32).range(1..=MAX_BATCH as i64))]
    pub chunks: u32,
}

/// Field names are a contract with scripts.
#[derive(Clone, Debug, Serialize)]
struct Report {
    gpu: GpuRate,
    cpu: CpuRate,
}

#[derive(Clone, Debug, Serialize)]
struct GpuRate {
    adapter: String,
    /// Until the chunks are in the CPU's memory.
    chunks_per_second: f64,
    /// Until the GPU has them, as a renderer needs them.
    chunks_per_second_without_readback: f64,
}

#[derive(Clone, Debug, Serialize)]
struct CpuRate {
    kernel: String,
    threads: u32,
    chunks_per_second: f64,
}

/// Times both and prints the rates.
pub fn run(options: &Options, outputs: &Outputs) -> Result<()> {
    let land = Land::new(WORLD_SEED);
    // None of them is open sea, where nothing is to be computed.
    let keys: Vec<_> = land_keys(&land, 16).take(options.chunks as usize).collect();
    let gpu = Gpu::open_blocking()?;
    let (device, queue) = (&gpu.device, &gpu.queue);
    let filler = ChunkFiller::new(device, queue, &land, keys.len())?;
    let kernel = Kernel::best();

    // Once unmeasured: pipelines compile, caches fill, and the chunks are compared.
    for filled in filler.fill(device, queue, &keys)? {
        let heights = land.chunk_heights(filled.key);
        if filled.heights != heights {
            return Err(anyhow!(
                "{} fills chunk {} differently; see tombolo-lab digest",
                gpu.name(),
                filled.key
            ));
        }
    }
    let (mut with_readback, mut without, mut on_cpu) = (Vec::new(), Vec::new(), Vec::new());
    for _ in 0..options.turns {
        with_readback.push(timed(|| filler.fill(device, queue, &keys).map(drop))?);
        without.push(timed(|| filler.fill_in_place(device, queue, &keys))?);
        let began = Instant::now();
        keys.iter().for_each(|key| generate(&land, kernel, *key));
        on_cpu.push(began.elapsed().as_secs_f64());
    }
    gpu.check()?;
    let rate = |seconds: Vec<f64>| keys.len() as f64 / median(seconds);
    let report = Report {
        gpu: GpuRate {
            adapter: gpu.name(),
            chunks_per_second: rate(with_readback),
            chunks_per_second_without_readback: rate(without),
        },
        cpu: CpuRate { kernel: kernel.to_string(), threads: 1, chunks_per_second: rate(on_cpu) },
    };
    let build = if cfg!(debug_assertions) { " (a debug build: rates mean little)" } else { "" };
    println!(
        "{} chunks of 65 x 65 with land, heights and pyramids, median of {}{build}",
        keys.len(),
        options.turns
    );
    println!("GPU  {:10.0} chunks/s  {}", report.gpu.chunks_per_second, report.gpu.adapter);
    println!("GPU  {:10.0} chunks/s  without readback", report.gpu.chunks_per_second_without_readback);
    println!("CPU  {:10.0} chunks/s  {kernel}, 1 thread", report.cpu.chunks_per_second);
    outputs.write_json(&report)
}

fn generate(land: &Land, kernel: Kernel, key: ChunkKey) {
    let mut heights = Box::new([0; VERTEX_COUNT]);
    land.heights_on(kernel, &Grid::of_chunk(key), &mut heights[..]);
    let pyramids = (Pyramid::of_maxima_on(kernel, &heights), Pyramid::of_minima_on(kernel, &heights));
    std::hint::black_box((&heights, &pyramids));
}

fn timed<E>(work: impl FnOnce() -> Result<(), E>) -> Result<f64, E> {
    let began = Instant::now();
    work()?;
    Ok(began.elapsed().as_secs_f64())
}
