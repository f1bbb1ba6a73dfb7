//! Cached chunks over many connections with several requests outstanding each, beside nginx with
//! the same bytes in the same run.
//!
//! The comparison is between two ways to deliver small static data, not between two HTTP servers:
//! binary WebSocket messages here, pipelined HTTP requests there, with a client program for each.
//! `http` compares two HTTP servers.

use crate::Plan;
use crate::clients::{Event, Window, closed_loop, rotated, run_all};
use crate::connection::{Connection, Received};
use crate::keys::{WORLD_SEED, land_keys};
use crate::nginx::{self, Nginx};
use crate::rounds::Rounds;
use crate::server_process::ServerProcess;
use crate::wrk::{Load, Wrk};
use anyhow::{Result, ensure};
use bars::Bar;
use bars::figures::{at, fill};
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
pub const PUSH_WINDOW: usize = 256;

/// Connections.
pub const CONNECTIONS: usize = 64;

/// Runs the benchmark: `plan.rounds` rounds of each server, in turn.
pub async fn run(plan: &Plan) -> Result<Value> {
    let land = Land::new(WORLD_SEED);
    let keys = land_keys(&land, 0, CHUNKS);
    let frames: FxHashMap<ChunkKey, _> =
        keys.iter().map(|key| (*key, chunk_codec::encode(&land.chunk(*key), &land.digest()))).collect();
    let server = ServerProcess::start(&plan.launch, &[])?;
    verify(&mut Connection::connect(server.address).await?, &keys, &frames).await?;

    let has_nginx = ["nginx", "wrk"].iter().all(|program| nginx::is_installed(program));
    let files: Vec<_> = keys.iter().map(|key| &frames[key]).collect();
    let nginx = has_nginx.then(|| Nginx::start(&plan.launch, &files)).transpose()?;
    let wrk = Wrk::new("cached", &Nginx::paths(files.len()))?;
    let load = Load { connections: CONNECTIONS, in_flight: WINDOW, seconds: plan.seconds };
    let mut rounds = Rounds::default();
    for _ in 0..plan.rounds {
        let [singly, batched, pushed] =
            [Window::OneByOne(WINDOW), Window::Batches(WINDOW), Window::Halves(PUSH_WINDOW)];
        let singly = measure_plain(&server, &keys, plan.seconds, singly).await?;
        rounds.push("chunks_per_s", singly.chunks_per_s);
        rounds.push("server_cpu_s_per_gb", singly.cpu_s_per_gb);
        let batched = measure_plain(&server, &keys, plan.seconds, batched).await?;
        rounds.push("batch_chunks_per_s", batched.chunks_per_s);
        let pushed = measure_plain(&server, &keys, plan.seconds, pushed).await?;
        rounds.push("push_chunks_per_s", pushed.chunks_per_s);
        rounds.push("push_cpu_s_per_gb", pushed.cpu_s_per_gb);
        let measure = |nginx: &Nginx| wrk.measure(nginx.address, &nginx.process, load);
        let theirs = nginx.as_ref().map(measure).transpose()?;
        rounds.push("batch_ratio_to_nginx", theirs.map(|rate| batched.chunks_per_s / rate.replies_per_s));
        rounds.push("ratio_to_nginx", theirs.map(|rate| singly.chunks_per_s / rate.replies_per_s));
        rounds.push("nginx_replies_per_s", theirs.map(|rate| rate.replies_per_s));
        rounds.push("nginx_cpu_s_per_gb", theirs.map(|rate| rate.cpu_s_per_gb));
        rounds.push("nginx_busy", theirs.map(|rate| rate.busy));
    }
    let bytes: usize = frames.values().map(bytes::Bytes::len).sum();
    Ok(rounds.add_to(json!({
        "connections": CONNECTIONS,
        "window": WINDOW,
        "push_window": PUSH_WINDOW,
        "frame_bytes": bytes / CHUNKS,
        "rounds": plan.rounds,
    })))
}

/// Requests every chunk once and compares it byte for byte. Afterwards all are in the cache.
async fn verify(
    connection: &mut Connection,
    keys: &[ChunkKey],
    frames: &FxHashMap<ChunkKey, bytes::Bytes>,
) -> Result<()> {
    let mut wrong = 0;
    let compare = |event: Event<'_>| {
        if let Event::Received(received) = event {
            let expected = received.key().and_then(|key| frames.get(&key));
            let is_right =
                matches!(received, Received::Chunk(frame) if expected.is_some_and(|bytes| bytes == frame));
            wrong += usize::from(!is_right);
        }
    };
    closed_loop(connection, keys.iter().copied(), Window::OneByOne(keys.len()), None, compare).await?;
    ensure!(wrong == 0, "{wrong} of {} chunks differ from local generation", keys.len());
    Ok(())
}

/// The throughput of a server, and its cost.
#[derive(Clone, Copy, Debug)]
pub struct Rate {
    pub chunks_per_s: f64,
    pub cpu_s_per_gb: f64,
}

async fn measure_plain(
    server: &ServerProcess,
    keys: &[ChunkKey],
    seconds: u64,
    window: Window,
) -> Result<Rate> {
    measure(server, server.connect(CONNECTIONS).await?, keys, seconds, window).await
}

/// Requests the same chunks over and over on [`CONNECTIONS`] connections.
pub async fn measure(
    server: &ServerProcess,
    connections: Vec<Connection>,
    keys: &[ChunkKey],
    seconds: u64,
    window: Window,
) -> Result<Rate> {
    let (cpu_before, started) = (server.process.cpu_s()?, Instant::now());
    let end = Some(started + Duration::from_secs(seconds));
    let totals = run_all(connections, |index, mut connection| {
        let keys = rotated(keys, index, CONNECTIONS).into_iter().cycle();
        async move { closed_loop(&mut connection, keys, window, end, |_| ()).await?.without_refusals() }
    });
    let totals = totals.await?;
    let (seconds, cpu_s) = (started.elapsed().as_secs_f64(), server.process.cpu_s()? - cpu_before);
    let sum = |of: fn(&crate::clients::Totals) -> u64| totals.iter().map(of).sum::<u64>() as f64;
    Ok(Rate {
        chunks_per_s: sum(|totals| totals.chunks) / seconds,
        cpu_s_per_gb: cpu_s / (sum(|totals| totals.bytes) / 1e9),
    })
}

/// The bars of this benchmark.
pub fn bars(figures: &Value) -> Vec<Bar> {
    let of = |path| at(figures, path);
    vec![
        Bar::at_least("cached chunks over nginx's replies", of("ratio_to_nginx"), "x", 2.0).with_note(
            "closed loops over 64 connections with 16 requests outstanding on each: our client sends a \
             request as soon as another is answered, wrk the next 16 when all 16 are answered",
        ),
        Bar::reported("the same, our client refilling like wrk", of("batch_ratio_to_nginx"), "x"),
        Bar::at_least("share of nginx's time in which it was busy (control)", of("nginx_busy"), "", 0.8),
        Bar::at_most("server CPU per GB, 64 clients, pushed", of("push_cpu_s_per_gb"), "s", 0.35)
            .with_note("explicit requests of 128 keys each, 256 chunks outstanding on each connection"),
        Bar::reported("the same, chunk by chunk, 16 outstanding", of("server_cpu_s_per_gb"), "s"),
    ]
}

/// Further figures in sentences.
pub fn notes(figures: &Value) -> Vec<String> {
    let line = "Cached, one by one: {chunks_per_s:.0} chunks a second of {frame_bytes:.0} bytes, \
                {server_cpu_s_per_gb:.2} CPU seconds a GB; nginx {nginx_replies_per_s:.0} replies a second, \
                {nginx_cpu_s_per_gb:.2} CPU seconds a GB. Pushed, {push_window:.0} outstanding: \
                {push_chunks_per_s:.0} chunks a second. Ratios to nginx round by round: \
                {ratio_to_nginx_rounds:.2}; refilled like wrk: {batch_ratio_to_nginx_rounds:.2}.";
    vec![fill(line, figures)]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::test_bars::{check, check_absent};

    #[test]
    fn each_bar_can_be_missed() {
        let good = json!({
            "ratio_to_nginx": 2.9, "nginx_busy": 0.97, "push_cpu_s_per_gb": 0.3,
            "server_cpu_s_per_gb": 0.5, "batch_ratio_to_nginx": 2.5,
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
