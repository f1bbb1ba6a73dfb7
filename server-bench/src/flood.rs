//! Sessions that send views without pause, beside one polite client: the largest view that a server
//! accepts, ordinary views, views of sessions that hold thousands of chunks and jump about, and
//! views that are refused.
//!
//! Three promises are measured: a probe is answered, the polite client gets its chunks, and the
//! server stops when it is told to.

use super::host::Host;
use super::land_keys::{WORLD_SEED, land_keys};
use super::stats::{ms, quantile};
use super::wire::{Arrived, Wire, get};
use super::{Plan, to_end};
use anyhow::{Context, Result};
use protocol::view::View;
use protocol::chunk_codec;
use protocol::limits::{MAX_KEYS, MAX_VIEW_ESTIMATE, MAX_VIEWPORT};
use protocol::message::{ClientMessage, WireKey};
use rustc_hash::FxHashMap;
use serde_json::{Value, json};
use std::net::SocketAddr;
use std::time::{Duration, Instant};
use tokio::runtime::Builder;
use terrain::lod::{self, MAX_VIEW_DISTANCE_M};
use terrain::{ChunkKey, Land};

/// Sessions that flood.
const SESSIONS: [usize; 3] = [4, 8, 32];

/// Views a second of a session that does not send as fast as it can.
const RATE: u32 = 60;

/// Time between two requests of the polite client, and between two probes.
const POLITE_INTERVAL: Duration = Duration::from_millis(50);
const PROBE_INTERVAL: Duration = Duration::from_millis(100);

/// A probe without an answer for so long is counted as lost.
const PROBE_TIMEOUT: Duration = Duration::from_secs(2);

/// Chunks that a session holds which jumps about.
const HELD: i32 = 4096;

/// The polite client still waits for so long for chunks that it asked for.
const GRACE: Duration = Duration::from_secs(2);

/// What the flooding sessions send.
#[derive(Clone, Copy, Debug)]
enum Kind {
    Largest,
    Ordinary,
    Teleport,
    Refused,
}

impl Kind {
    const ALL: [Self; 4] = [Self::Largest, Self::Ordinary, Self::Teleport, Self::Refused];

    const fn name(self) -> &'static str {
        match self {
            Self::Largest => "largest view accepted",
            Self::Ordinary => "ordinary view, 8 km at 1 px",
            Self::Teleport => "8 km view at a new place each time, 4,096 chunks held",
            Self::Refused => "view beyond the limit",
        }
    }

    /// The view with a number.
    fn view(self, id: u32) -> View {
        let ordinary = View {
            id,
            eye: [(id % 97) as i32 * 256, 25_600, 0],
            velocity: [50 * 256, 0, 0],
            yaw_mdeg: 0,
            pitch_mdeg: 0,
            fov_mdeg: 60_000,
            viewport: [1280, 720],
            tolerance_q4: 16,
            distance_m: 8000,
        };
        let extreme = View { viewport: [MAX_VIEWPORT; 2], distance_m: MAX_VIEW_DISTANCE_M, tolerance_q4: 1, ..ordinary };
        match self {
            Self::Ordinary => ordinary,
            Self::Teleport => {
                let place = |number: u32| (number.wrapping_mul(0x9e37_79b9) >> 4) as i32 - (1 << 27);
                View { eye: [place(id), 25_600, place(id.wrapping_add(1 << 16))], ..ordinary }
            }
            Self::Refused => extreme,
            Self::Largest => {
                let mut view = extreme;
                while lod::estimated_chunks(&view.viewer()) > MAX_VIEW_ESTIMATE {
                    view.tolerance_q4 += 1;
                }
                view
            }
        }
    }
}

/// Runs every scenario against a server of its own.
///
/// # Errors
/// The server fails.
pub async fn run(plan: &Plan) -> Result<Value> {
    let keys = land_keys(&Land::new(WORLD_SEED), 64 * 1024);
    let mut scenarios = Vec::new();
    for kind in Kind::ALL {
        for sessions in SESSIONS {
            for rate in [Some(RATE), None] {
                let figures = scenario(plan, &keys, kind, sessions, rate).await?;
                eprintln!("{figures}");
                scenarios.push(figures);
            }
        }
    }
    Ok(json!({ "scenarios": scenarios }))
}

async fn scenario(
    plan: &Plan,
    keys: &[ChunkKey],
    kind: Kind,
    sessions: usize,
    rate: Option<u32>,
) -> Result<Value> {
    let mut host = Host::start(&plan.launch, &[])?;
    let (first, second) = keys.split_at(keys.len() / 2);
    let length = Duration::from_secs(plan.seconds);
    let alone = polite(host.address, first.to_vec(), Instant::now() + length).await?;

    let end = Instant::now() + length;
    // On a thread of its own, so that the clients that are measured do not wait for it here. It
    // goes on until the server has stopped.
    let flooders = Builder::new_multi_thread().worker_threads(1).enable_all().build().context("no thread")?;
    for _ in 0..sessions {
        flooders.spawn(flood(host.address, kind, rate));
    }
    let probes = tokio::spawn(probe(host.address, end));
    let beside = tokio::spawn(polite(host.address, second.to_vec(), end));
    let mut probes = to_end(vec![probes]).await?.remove(0);
    let beside = to_end(vec![beside]).await?.remove(0);
    let view_seconds = tokio::time::timeout(PROBE_TIMEOUT, host.metric("tombolo_view_seconds_total")).await;
    let stopped = host.process.stop(Duration::from_secs(30)).await?;
    flooders.shutdown_background();

    let lost = probes.iter().filter(|latency| **latency >= PROBE_TIMEOUT).count();
    Ok(json!({
        "views": kind.name(),
        "sessions": sessions,
        "views_per_s": rate,
        "probe_worst_ms": quantile(&mut probes, 1.0).map(ms),
        "probes": probes.len(),
        "probes_lost": lost,
        "polite_chunks_share": beside.chunks as f64 / alone.chunks as f64,
        "polite_refused": beside.refused,
        "polite_p99_alone_ms": alone.p99_ms,
        "polite_p99_ms": beside.p99_ms,
        "polite_p99_ratio": beside.p99_ms / alone.p99_ms,
        "view_seconds": view_seconds.ok().and_then(Result::ok),
        "stop_s": stopped.map(|time| time.as_secs_f64()),
    }))
}

struct Polite {
    chunks: usize,
    refused: usize,
    /// Of the answered requests; a request without an answer counts as the time that was waited for
    /// it.
    p99_ms: f64,
}

/// Asks for one chunk at a time, at a steady rate whatever comes back.
async fn polite(address: SocketAddr, keys: Vec<ChunkKey>, end: Instant) -> Result<Polite> {
    let Ok(connected) = tokio::time::timeout_at(end.into(), Wire::connect(address)).await else {
        return Ok(Polite { chunks: 0, refused: 0, p99_ms: f64::INFINITY });
    };
    let (mut wire, mut keys) = (connected?, keys.into_iter());
    let mut open: FxHashMap<ChunkKey, Instant> = FxHashMap::default();
    let (mut latencies, mut refused) = (Vec::new(), 0);
    let mut ticks = tokio::time::interval(POLITE_INTERVAL);
    loop {
        let now = Instant::now();
        if now >= end + GRACE || (now >= end && open.is_empty()) {
            break;
        }
        let due = tokio::select! {
            _ = ticks.tick() => true,
            received = wire.receive(|arrived| match arrived {
                Arrived::Chunk(frame) => {
                    let asked = chunk_codec::kind_and_key(frame).ok().and_then(|(_, key)| open.remove(&key));
                    latencies.extend(asked.map(|asked| asked.elapsed()));
                }
                Arrived::Message(protocol::message::ServerMessage::Refused(_)) => refused += 1,
                Arrived::Message(_) => {}
            }) => {
                received?;
                false
            }
        };
        if due && Instant::now() < end {
            let key = keys.next().context("too few keys for such a long run")?;
            open.insert(key, Instant::now());
            wire.request([key]).await?;
        }
    }
    let chunks = latencies.len();
    latencies.extend(open.values().map(Instant::elapsed));
    Ok(Polite { chunks, refused, p99_ms: quantile(&mut latencies, 0.99).map_or(f64::NAN, ms) })
}

/// Probes over new connections. Returns the time to each answer, [`PROBE_TIMEOUT`] for none.
async fn probe(address: SocketAddr, end: Instant) -> Result<Vec<Duration>> {
    let mut latencies = Vec::new();
    let mut ticks = tokio::time::interval(PROBE_INTERVAL);
    while Instant::now() < end {
        ticks.tick().await;
        let asked = Instant::now();
        let answer = tokio::time::timeout(PROBE_TIMEOUT, get(address, "/livez")).await;
        latencies.push(if matches!(answer, Ok(Ok(_))) { asked.elapsed() } else { PROBE_TIMEOUT });
    }
    Ok(latencies)
}

/// Sends views until the server goes away or the task is aborted.
async fn flood(address: SocketAddr, kind: Kind, rate: Option<u32>) -> Result<()> {
    let mut wire = Wire::connect(address).await?;
    if matches!(kind, Kind::Teleport) {
        let keys: Vec<WireKey> = (0..HELD).map(|n| WireKey { level: 0, x: n % 64 - 32, z: n / 64 - 32 }).collect();
        for keys in keys.chunks(MAX_KEYS) {
            wire.send(&ClientMessage::Holding { keys: keys.to_vec() }).await?;
        }
    }
    let mut id = 0;
    let mut messages = |count: u32| {
        id += count;
        (id - count..id).map(|id| ClientMessage::View(kind.view(id))).collect::<Vec<_>>()
    };
    let mut ticks = rate.map(|rate| tokio::time::interval(Duration::from_secs(1) / rate));
    loop {
        let count = match &mut ticks {
            Some(ticks) => {
                ticks.tick().await;
                1
            }
            None => 64,
        };
        wire.send_while_reading(&messages(count)).await?;
        tokio::task::yield_now().await;
    }
}
