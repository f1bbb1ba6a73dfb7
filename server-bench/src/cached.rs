//! Cached chunks over many connections with several requests outstanding each, beside nginx with
//! the same bytes in the same run.
//!
//! The comparison is between two ways to deliver small static data, not between two HTTP servers:
//! binary WebSocket messages here, pipelined HTTP requests there, with a client program for each.

use crate::connection::{Connection, Received};
use crate::keys::{WORLD_SEED, land_keys};
use crate::nginx::{self, Nginx};
use crate::server_process::ServerProcess;
use crate::stats::median;
use crate::{Plan, join_all};
use crate::{at, listed, shown};
use anyhow::{Result, ensure};
use bars::{Bar, Limit};
use protocol::chunk_codec;
use rustc_hash::FxHashMap;
use serde_json::{Value, json};
use std::time::{Duration, Instant};
use terrain::{ChunkKey, Land};

/// Different chunks, requested in turn: 1.2 MB of frames, more than the private caches of a core.
const CHUNKS: usize = 256;

/// Requests outstanding on each connection.
const WINDOW: usize = 16;

/// The same in pushed mode, in requests of half as many chunks.
const PUSH_WINDOW: usize = 256;

/// Connections.
const CONNECTIONS: usize = 64;

/// Runs the benchmark: `plan.rounds` rounds of each server, in turn.
///
/// # Errors
/// The server fails, or a frame is not what it must be.
pub async fn run(plan: &Plan) -> Result<Value> {
    let land = Land::new(WORLD_SEED);
    let keys = land_keys(&land, 0, CHUNKS);
    let frames: FxHashMap<ChunkKey, _> =
        keys.iter().map(|key| (*key, chunk_codec::encode(&land.chunk(*key), &land.digest()))).collect();
    let server = ServerProcess::start(&plan.launch, &[])?;
    verify(&server, &keys, &frames).await?;

    let has_nginx = ["nginx", "wrk"].iter().all(|program| nginx::is_installed(program));
    let files: Vec<_> = keys.iter().map(|key| &frames[key]).collect();
    let nginx = if has_nginx { Some(Nginx::start(&plan.launch, &files)?) } else { None };

    let (mut ours, mut theirs, mut ratios, mut cpu) = (Vec::new(), Vec::new(), Vec::new(), Vec::new());
    let (mut pushed, mut push_cpu) = (Vec::new(), Vec::new());
    for _ in 0..plan.rounds {
        let round = measure(&server, &keys, plan.seconds, Requesting::OneByOne).await?;
        ours.push(round.chunks_per_s);
        cpu.push(round.cpu_s_per_gb);
        let round_pushed = measure(&server, &keys, plan.seconds, Requesting::Together).await?;
        pushed.push(round_pushed.chunks_per_s);
        push_cpu.push(round_pushed.cpu_s_per_gb);
        if let Some(nginx) = &nginx {
            let rate = nginx.measure(CONNECTIONS, WINDOW, files.len(), plan.seconds)?;
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

/// Requests every chunk once and compares it byte for byte. Afterwards all are in the cache.
async fn verify(
    server: &ServerProcess,
    keys: &[ChunkKey],
    frames: &FxHashMap<ChunkKey, bytes::Bytes>,
) -> Result<()> {
    let mut connection = Connection::connect(server.address).await?;
    connection.request(keys.iter().copied()).await?;
    let (mut right, mut wrong) = (0, 0);
    while right + wrong < keys.len() {
        connection
            .receive(|received| match received {
                Received::Chunk(frame) => {
                    let expected =
                        chunk_codec::kind_and_key(frame).ok().and_then(|(_, key)| frames.get(&key));
                    if expected.is_some_and(|expected| expected == frame) { right += 1 } else { wrong += 1 }
                }
                Received::Message(_) => wrong += 1,
            })
            .await?;
    }
    ensure!(wrong == 0, "{wrong} of {} chunks differ from local generation", keys.len());
    Ok(())
}

struct Round {
    chunks_per_s: f64,
    cpu_s_per_gb: f64,
}

/// How a client fills its window.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Requesting {
    /// One request a chunk, as soon as another is answered, like wrk.
    OneByOne,
    /// Half a window in one request, when half is answered, like a viewer.
    Together,
}

async fn measure(server: &ServerProcess, keys: &[ChunkKey], seconds: u64, mode: Requesting) -> Result<Round> {
    let mut connections = Vec::new();
    for _ in 0..CONNECTIONS {
        connections.push(Connection::connect(server.address).await?);
    }
    let (cpu_before, started) = (server.process.cpu_s()?, Instant::now());
    let end = started + Duration::from_secs(seconds);
    let clients = connections.into_iter().enumerate().map(|(index, connection)| {
        // Each client starts at another chunk, so that the requests cover the whole list.
        let keys =
            keys.iter().copied().cycle().skip(index * CHUNKS / CONNECTIONS).take(CHUNKS).collect::<Vec<_>>();
        tokio::spawn(keep_requesting(connection, keys, end, mode))
    });
    let counts = join_all(clients.collect()).await?;
    let (seconds, cpu_s) = (started.elapsed().as_secs_f64(), server.process.cpu_s()? - cpu_before);
    let (chunks, bytes) =
        counts.iter().fold((0, 0), |(chunks, bytes), count| (chunks + count.0, bytes + count.1));
    Ok(Round { chunks_per_s: chunks as f64 / seconds, cpu_s_per_gb: cpu_s / (bytes as f64 / 1e9) })
}

/// Keeps the window full until the end. Returns the number of chunks and bytes.
async fn keep_requesting(
    mut connection: Connection,
    keys: Vec<ChunkKey>,
    end: Instant,
    mode: Requesting,
) -> Result<(u64, u64)> {
    let mut next = keys.iter().copied().cycle();
    let (window, at_once) = match mode {
        Requesting::OneByOne => (WINDOW, 1),
        Requesting::Together => (PUSH_WINDOW, PUSH_WINDOW / 2),
    };
    let mut free = window;
    let (mut chunks, mut bytes, mut refused) = (0, 0, 0u64);
    while Instant::now() < end {
        if mode == Requesting::OneByOne && free > 0 {
            connection.request(next.by_ref().take(free)).await?;
            free = 0;
        }
        while mode == Requesting::Together && free >= at_once {
            connection.request_together(next.by_ref().take(at_once)).await?;
            free -= at_once;
        }
        connection
            .receive(|received| match received {
                Received::Chunk(frame) => {
                    free += 1;
                    chunks += 1;
                    bytes += frame.len() as u64;
                }
                Received::Message(_) => refused += 1,
            })
            .await?;
        ensure!(refused == 0, "the server refused a cached chunk");
    }
    Ok((chunks, bytes))
}

/// The bars of this benchmark.
#[must_use]
pub fn bars(figures: &Value) -> Vec<Bar> {
    vec![
        Bar::new(
            "cached chunks over nginx's replies",
            at(figures, "/ratio_to_nginx"),
            "x",
            Limit::AtLeast(2.0),
        ),
        Bar::new(
            "share of nginx's time in which it was busy (control)",
            at(figures, "/nginx_busy"),
            "",
            Limit::AtLeast(0.8),
        ),
        Bar::new(
            "server CPU per GB, 64 clients, pushed",
            at(figures, "/push_cpu_s_per_gb"),
            "s",
            Limit::AtMost(0.35),
        )
        .with_note("explicit requests of 128 keys each, 256 chunks outstanding on each connection"),
        Bar::new(
            "the same, chunk by chunk, 16 outstanding",
            at(figures, "/server_cpu_s_per_gb"),
            "s",
            Limit::Reported,
        ),
    ]
}

/// Further figures in sentences.
#[must_use]
pub fn notes(figures: &Value) -> Vec<String> {
    let shown = |path| shown(figures, path);
    let line = format!(
        "Cached, one by one: {:.0} chunks a second of {:.0} bytes, {:.2} CPU seconds a GB; nginx \
         {:.0} replies a second, {:.2} CPU seconds a GB. Pushed, {:.0} outstanding: {:.0} chunks a \
         second. Ratios to nginx round by round: {}.",
        shown("/chunks_per_s"),
        shown("/frame_bytes"),
        shown("/server_cpu_s_per_gb"),
        shown("/nginx_replies_per_s"),
        shown("/nginx_cpu_s_per_gb"),
        shown("/push_window"),
        shown("/push_chunks_per_s"),
        listed(figures, "/ratio_to_nginx_rounds", 2),
    );
    vec![line]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::test_bars::{check, check_absent};

    #[test]
    fn each_bar_can_be_missed() {
        let good = json!({
            "ratio_to_nginx": 2.9, "nginx_busy": 0.97, "push_cpu_s_per_gb": 0.3,
            "server_cpu_s_per_gb": 0.5,
        });
        let bad = [
            ("/ratio_to_nginx", json!(1.99)),
            ("/nginx_busy", json!(0.18)),
            ("/push_cpu_s_per_gb", json!(0.36)),
        ];
        check(bars, &good, &bad);
        check_absent(bars, &good, &[("", "ratio_to_nginx", 1), ("", "server_cpu_s_per_gb", 1)]);
    }
}
