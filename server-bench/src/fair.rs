//! One client that asks for a thousand chunks at once beside fifty that ask for a few each: all
//! want chunks that must be made, and together more than the server can make, so that only its
//! choice decides who gets what.

use super::host::Host;
use super::land_keys::{WORLD_SEED, land_keys};
use super::stats::{jain, median, ms, quantile};
use super::wire::{Arrived, Wire};
use super::{Plan, to_end};
use anyhow::Result;
use protocol::chunk_codec;
use rustc_hash::FxHashMap;
use serde_json::{Value, json};
use std::time::{Duration, Instant};
use terrain::{ChunkKey, Land};

/// Clients that keep few requests outstanding, and how many.
const POLITE: usize = 50;
const POLITE_WINDOW: usize = 4;

/// Requests outstanding of the greedy one.
const GREEDY_WINDOW: usize = 1000;

/// Different chunks; asked for round and round from a cache that holds a hundredth of them.
const CHUNKS: usize = 16 * 1024;

/// Time before what is measured, so that estimates and queues are as they stay.
const SETTLE: Duration = Duration::from_millis(500);

/// Runs the benchmark: without and with the greedy client in turn.
///
/// # Errors
/// The server fails.
pub async fn run(plan: &Plan) -> Result<Value> {
    let keys = land_keys(&Land::new(WORLD_SEED), CHUNKS);
    let (mut alone, mut beside, mut ratios, mut indices, mut polite) =
        (Vec::new(), Vec::new(), Vec::new(), Vec::new(), Vec::new());
    let mut greedy_share = Vec::new();
    for _ in 0..plan.rounds {
        let without = round(plan, &keys, 0).await?;
        let with = round(plan, &keys, 1).await?;
        alone.push(without.p99_ms);
        beside.push(with.p99_ms);
        ratios.push(with.p99_ms / without.p99_ms);
        indices.push(jain(&with.shares));
        polite.push(jain(&with.shares[..POLITE]));
        let mean = with.shares.iter().sum::<f64>() / with.shares.len() as f64;
        greedy_share.push(with.shares[POLITE] / mean);
    }
    Ok(json!({
        "polite": POLITE,
        "polite_window": POLITE_WINDOW,
        "greedy_window": GREEDY_WINDOW,
        "rounds": plan.rounds,
        "p99_alone_ms": median(alone),
        "p99_beside_greedy_ms": median(beside),
        "p99_ratio": median(ratios.clone()),
        "p99_ratio_rounds": ratios,
        "jain_index": median(indices),
        "jain_index_polite": median(polite),
        "greedy_share_of_mean": median(greedy_share),
    }))
}

struct Round {
    /// Of the polite clients' requests.
    p99_ms: f64,
    /// Chunks of each client, the greedy one last.
    shares: Vec<f64>,
}

async fn round(plan: &Plan, keys: &[ChunkKey], greedy: usize) -> Result<Round> {
    let host = Host::start(&plan.launch, &["--cache-mb", "1"])?;
    let n_clients = POLITE + greedy;
    let mut wires = Vec::new();
    for _ in 0..n_clients {
        wires.push(Wire::connect(host.address).await?);
    }
    let from = Instant::now() + SETTLE;
    let end = from + Duration::from_secs(plan.seconds);
    let clients = wires.into_iter().enumerate().map(|(index, wire)| {
        let window = if index < POLITE { POLITE_WINDOW } else { GREEDY_WINDOW };
        // Far apart in the list: no client finds what another had made.
        let own: Vec<_> =
            keys.iter().copied().cycle().skip(index * CHUNKS / n_clients).take(CHUNKS).collect();
        tokio::spawn(keep_asking(wire, own, window, from, end))
    });
    let latencies = to_end(clients.collect()).await?;
    let shares = latencies.iter().map(|latencies| latencies.len() as f64).collect();
    let mut all: Vec<Duration> = latencies.into_iter().take(POLITE).flatten().collect();
    Ok(Round { p99_ms: quantile(&mut all, 0.99).map_or(f64::NAN, ms), shares })
}

/// Keeps a window full until the end. Returns the latency of each chunk that came after `from`.
async fn keep_asking(
    mut wire: Wire,
    keys: Vec<ChunkKey>,
    window: usize,
    from: Instant,
    end: Instant,
) -> Result<Vec<Duration>> {
    let mut next = keys.iter().copied().cycle();
    let mut open: FxHashMap<ChunkKey, Instant> = FxHashMap::default();
    let mut latencies = Vec::new();
    let mut free = window;
    while Instant::now() < end {
        if free > 0 {
            let (now, more) = (Instant::now(), next.by_ref().take(free).collect::<Vec<_>>());
            open.extend(more.iter().map(|key| (*key, now)));
            wire.request(more).await?;
            free = 0;
        }
        wire.receive(|arrived| {
            // A refusal is an answer too, and counts against nobody's share.
            free += 1;
            let Arrived::Chunk(frame) = arrived else { return };
            let asked = chunk_codec::kind_and_key(frame).ok().and_then(|(_, key)| open.remove(&key));
            if let Some(asked) = asked.filter(|_| Instant::now() >= from) {
                latencies.push(asked.elapsed());
            }
        })
        .await?;
    }
    Ok(latencies)
}
