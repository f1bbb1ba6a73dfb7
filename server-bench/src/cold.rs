//! Chunks that nobody has asked for before, from request to socket, and what each stage of their
//! making costs.

use super::host::Host;
use super::land_keys::{WORLD_SEED, land_keys};
use super::stats::median;
use super::wire::{Arrived, Wire};
use super::{Plan, to_end};
use anyhow::{Result, ensure};
use protocol::Delivery;
use protocol::chunk_codec::{self, Effort};
use serde_json::{Value, json};
use std::hint::black_box;
use std::time::Instant;
use terrain::{Chunk, GrassSeed, Land};

/// Different chunks.
const CHUNKS: usize = 16 * 1024;

/// Connections, and requests outstanding on each.
const CONNECTIONS: usize = 16;
const WINDOW: usize = 64;

/// Chunks that the stages are timed over.
const TIMED: usize = 2000;

/// Runs the benchmark: every round in a fresh server, so that nothing is cached.
///
/// # Errors
/// The server fails or refuses.
pub async fn run(plan: &Plan) -> Result<Value> {
    let land = Land::new(WORLD_SEED);
    let keys = land_keys(&land, CHUNKS);
    let (mut per_core, mut per_second, mut bytes, mut hasty) = (Vec::new(), Vec::new(), 0, Vec::new());
    for _ in 0..plan.rounds {
        let host = Host::start(&plan.launch, &[])?;
        let mut wires = Vec::new();
        for _ in 0..CONNECTIONS {
            wires.push(Wire::connect(host.address).await?);
        }
        let (cpu_before, started) = (host.process.cpu_s()?, Instant::now());
        let parts = keys.chunks(CHUNKS / CONNECTIONS).map(<[_]>::to_vec);
        let clients = wires.into_iter().zip(parts).map(|(wire, keys)| tokio::spawn(take_all(wire, keys)));
        bytes = to_end(clients.collect()).await?.into_iter().sum::<u64>();
        let seconds = started.elapsed().as_secs_f64();
        per_second.push(CHUNKS as f64 / seconds);
        per_core.push(CHUNKS as f64 / (host.process.cpu_s()? - cpu_before));
        let made = host.metric("tombolo_generated_total").await?;
        ensure!(made as usize == CHUNKS, "{made} chunks were made instead of {CHUNKS}");
        hasty.push(host.metric("tombolo_hasty_total").await? / CHUNKS as f64);
    }
    let total_us = 1e6 / median(per_core.clone()).unwrap_or(f64::INFINITY);
    let hasty = median(hasty).unwrap_or_default();
    let effort = if hasty > 0.5 { Effort::Fast } else { Effort::Compact };
    let stages = stages(&land, &keys[..TIMED], effort);
    let made_us: f64 = stages.iter().map(|(_, us)| us).sum();
    let mut stages: serde_json::Map<_, _> =
        stages.into_iter().map(|(name, us)| (name.to_owned(), json!(us))).collect();
    stages.insert("serve_us".into(), json!(total_us - made_us));
    Ok(json!({
        "connections": CONNECTIONS,
        "window": WINDOW,
        "chunks": CHUNKS,
        "frame_bytes": bytes / CHUNKS as u64,
        "hasty_share": hasty,
        "chunks_per_core_s": median(per_core.clone()),
        "chunks_per_core_s_rounds": per_core,
        "chunks_per_s": median(per_second.clone()),
        "chunks_per_s_rounds": per_second,
        "total_us": total_us,
        "stages": stages,
    }))
}

async fn take_all(mut wire: Wire, keys: Vec<terrain::ChunkKey>) -> Result<u64> {
    let mut next = keys.iter().copied();
    wire.request(next.by_ref().take(WINDOW)).await?;
    let (mut chunks, mut bytes, mut refused) = (0, 0, 0u64);
    while chunks < keys.len() {
        let before = chunks;
        wire.receive(|arrived| match arrived {
            Arrived::Chunk(frame) => {
                chunks += 1;
                bytes += frame.len() as u64;
            }
            Arrived::Message(_) => refused += 1,
        })
        .await?;
        ensure!(refused == 0, "a chunk was refused with {WINDOW} outstanding");
        let more: Vec<_> = next.by_ref().take(chunks - before).collect();
        if !more.is_empty() {
            wire.request(more).await?;
        }
    }
    Ok(bytes)
}

/// Microseconds a chunk of each stage, chunk by chunk in this process as a server's thread does it,
/// alone. The fastest of three passes: what the stages cost when nothing disturbs them. Coded with
/// the effort of most of the server's frames.
fn stages(land: &Land, keys: &[terrain::ChunkKey], effort: Effort) -> Vec<(&'static str, f64)> {
    let digest = land.digest();
    let mut best = [f64::INFINITY; 4];
    for _ in 0..3 {
        let mut pass = [0.0; 4];
        for key in keys {
            let (heights, generate) = timed(|| land.chunk_heights(*key));
            let (grass, grow) = timed(|| GrassSeed::grow(WORLD_SEED, *key, &heights));
            let (chunk, derive) = timed(|| Chunk::from_parts(*key, heights, 0, grass));
            let (_, encode) = timed(|| chunk_codec::encode_with(Delivery::Exact, effort, &chunk, &digest));
            for (sum, us) in pass.iter_mut().zip([generate, grow, derive, encode]) {
                *sum += us / keys.len() as f64;
            }
        }
        for (best, new) in best.iter_mut().zip(pass) {
            *best = best.min(new);
        }
    }
    ["generate_us", "grass_us", "pyramids_us", "encode_us"].into_iter().zip(best).collect()
}

/// A result and what it took, microseconds.
fn timed<T>(job: impl FnOnce() -> T) -> (T, f64) {
    let started = Instant::now();
    let result = black_box(job());
    (result, started.elapsed().as_secs_f64() * 1e6)
}
