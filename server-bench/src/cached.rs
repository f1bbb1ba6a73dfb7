//! Cached chunks over many connections with several requests outstanding each, beside nginx with
//! the same bytes in the same run.

use super::host::Host;
use super::land_keys::{WORLD_SEED, land_keys};
use super::rival::{self, Rival};
use super::stats::median;
use super::wire::{Arrived, Wire};
use super::{Plan, to_end};
use anyhow::{Result, ensure};
use protocol::chunk_codec;
use rustc_hash::FxHashMap;
use serde_json::{Value, json};
use std::time::{Duration, Instant};
use terrain::{ChunkKey, Land};

/// Different chunks asked for in turn: 1.2 MB of frames, more than a core's own caches.
const CHUNKS: usize = 256;

/// Requests outstanding on each connection.
const WINDOW: usize = 16;

/// The same where the server pushes: many chunks outstanding, asked for in requests of half as
/// many.
const PUSH_WINDOW: usize = 256;

/// Connections.
const CONNECTIONS: usize = 64;

/// Runs the benchmark: `plan.rounds` rounds of each side, in turn.
///
/// # Errors
/// The server fails, or a frame is not what it must be.
pub async fn run(plan: &Plan) -> Result<Value> {
    let land = Land::new(WORLD_SEED);
    let keys = land_keys(&land, CHUNKS);
    let frames: FxHashMap<ChunkKey, _> =
        keys.iter().map(|key| (*key, chunk_codec::encode(&land.chunk(*key), &land.digest()))).collect();
    let host = Host::start(&plan.launch, &[])?;
    verify(&host, &keys, &frames).await?;

    let has_rival = ["nginx", "wrk"].iter().all(|program| rival::is_installed(program));
    let files: Vec<_> = keys.iter().map(|key| &frames[key]).collect();
    let rival = if has_rival { Some(Rival::start(&plan.launch, &files)?) } else { None };

    let (mut ours, mut theirs, mut ratios, mut cpu) = (Vec::new(), Vec::new(), Vec::new(), Vec::new());
    let (mut pushed, mut push_cpu) = (Vec::new(), Vec::new());
    for _ in 0..plan.rounds {
        let round = measure(&host, &keys, plan.seconds, Asking::OneByOne).await?;
        ours.push(round.chunks_per_s);
        cpu.push(round.cpu_s_per_gb);
        let round_pushed = measure(&host, &keys, plan.seconds, Asking::Together).await?;
        pushed.push(round_pushed.chunks_per_s);
        push_cpu.push(round_pushed.cpu_s_per_gb);
        if let Some(rival) = &rival {
            let rate = rival.measure(CONNECTIONS, WINDOW, files.len(), plan.seconds)?;
            ratios.push(round.chunks_per_s / rate.replies_per_s);
            theirs.push(rate);
        }
    }
    let bytes: usize = frames.values().map(bytes::Bytes::len).sum();
    Ok(json!({
        "connections": CONNECTIONS,
        "window": WINDOW,
        "frame_bytes": bytes / CHUNKS,
        "rounds": plan.rounds,
        "chunks_per_s": median(ours.clone()),
        "chunks_per_s_rounds": ours,
        "server_cpu_s_per_gb": median(cpu.clone()),
        "server_cpu_s_per_gb_rounds": cpu,
        "push_window": PUSH_WINDOW,
        "push_chunks_per_s": median(pushed),
        "push_cpu_s_per_gb": median(push_cpu.clone()),
        "push_cpu_s_per_gb_rounds": push_cpu,
        "nginx_replies_per_s": median(theirs.iter().map(|rate| rate.replies_per_s).collect()),
        "nginx_cpu_s_per_gb": median(theirs.iter().map(|rate| rate.cpu_s_per_gb).collect()),
        "nginx_busy": median(theirs.iter().map(|rate| rate.busy).collect()),
        "ratio_to_nginx": median(ratios.clone()),
        "ratio_to_nginx_rounds": ratios,
    }))
}

/// Every chunk once, compared byte for byte; afterwards all are in the server's cache.
async fn verify(host: &Host, keys: &[ChunkKey], frames: &FxHashMap<ChunkKey, bytes::Bytes>) -> Result<()> {
    let mut wire = Wire::connect(host.address).await?;
    wire.request(keys.iter().copied()).await?;
    let (mut right, mut wrong) = (0, 0);
    while right + wrong < keys.len() {
        wire.receive(|arrived| match arrived {
            Arrived::Chunk(frame) => {
                let expected = chunk_codec::kind_and_key(frame).ok().and_then(|(_, key)| frames.get(&key));
                if expected.is_some_and(|expected| expected == frame) { right += 1 } else { wrong += 1 }
            }
            Arrived::Message(_) => wrong += 1,
        })
        .await?;
    }
    ensure!(wrong == 0, "{wrong} of {} chunks are not what they must be", keys.len());
    Ok(())
}

struct Round {
    chunks_per_s: f64,
    cpu_s_per_gb: f64,
}

/// How a client keeps its window full.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Asking {
    /// Like a browser or nginx's client: one request a chunk, as soon as one is answered.
    OneByOne,
    /// Like a viewer: half a window at once, when half is answered.
    Together,
}

async fn measure(host: &Host, keys: &[ChunkKey], seconds: u64, asking: Asking) -> Result<Round> {
    let mut wires = Vec::new();
    for _ in 0..CONNECTIONS {
        wires.push(Wire::connect(host.address).await?);
    }
    let (cpu_before, started) = (host.process.cpu_s()?, Instant::now());
    let end = started + Duration::from_secs(seconds);
    let clients = wires.into_iter().enumerate().map(|(index, wire)| {
        // Each at another place of the list, so that the cache is asked for all of it.
        let keys =
            keys.iter().copied().cycle().skip(index * CHUNKS / CONNECTIONS).take(CHUNKS).collect::<Vec<_>>();
        tokio::spawn(keep_asking(wire, keys, end, asking))
    });
    let counts = to_end(clients.collect()).await?;
    let (seconds, cpu_s) = (started.elapsed().as_secs_f64(), host.process.cpu_s()? - cpu_before);
    let (chunks, bytes) =
        counts.iter().fold((0, 0), |(chunks, bytes), count| (chunks + count.0, bytes + count.1));
    Ok(Round { chunks_per_s: chunks as f64 / seconds, cpu_s_per_gb: cpu_s / (bytes as f64 / 1e9) })
}

/// Keeps the window full until the end. Returns chunks and their bytes.
async fn keep_asking(
    mut wire: Wire,
    keys: Vec<ChunkKey>,
    end: Instant,
    asking: Asking,
) -> Result<(u64, u64)> {
    let mut next = keys.iter().copied().cycle();
    let (window, at_once) = match asking {
        Asking::OneByOne => (WINDOW, 1),
        Asking::Together => (PUSH_WINDOW, PUSH_WINDOW / 2),
    };
    let mut free = window;
    let (mut chunks, mut bytes, mut refused) = (0, 0, 0u64);
    while Instant::now() < end {
        if asking == Asking::OneByOne && free > 0 {
            wire.request(next.by_ref().take(free)).await?;
            free = 0;
        }
        while asking == Asking::Together && free >= at_once {
            wire.request_together(next.by_ref().take(at_once)).await?;
            free -= at_once;
        }
        wire.receive(|arrived| match arrived {
            Arrived::Chunk(frame) => {
                free += 1;
                chunks += 1;
                bytes += frame.len() as u64;
            }
            Arrived::Message(_) => refused += 1,
        })
        .await?;
        ensure!(refused == 0, "a cached chunk was refused");
    }
    Ok((chunks, bytes))
}
