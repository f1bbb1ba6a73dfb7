//! One address that asks for costly chunks by many HTTP requests at once, beside a session that
//! requests cheap ones without pause: the two must share generation as two clients.

use crate::Plan;
use crate::clients::{Window, closed_loop, other_thread};
use crate::connection::{Connection, loopback, open_from};
use crate::keys::{WORLD_SEED, land_keys};
use crate::rounds::Rounds;
use crate::server_process::ServerProcess;
use anyhow::{Context, Result, ensure};
use bars::Bar;
use bars::figures::{at, fill};
use serde_json::{Value, json};
use std::net::SocketAddr;
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::{Duration, Instant};
use terrain::{ChunkKey, Land, WorldDigest};
use tokio::io::{AsyncReadExt, AsyncWriteExt};

/// Connections that ask, each for one chunk at a time.
const CONNECTIONS: usize = 64;

/// The level of their chunks: the costliest one, whose error is measured.
const LEVEL: u8 = 4;

/// Chunks of that level, more than a server generates in a round.
const CHUNKS: usize = 16 * 1024;

/// Chunks that the session requests, and how many at once.
const REQUESTED: usize = 256 * 1024;
const WINDOW: usize = 64;

/// Time between two checks whether the downloads have begun.
const INTERVAL: Duration = Duration::from_millis(10);

/// Downloads answered a second below which there was no load.
const LEAST_DOWNLOADS: f64 = 10.0;

/// Runs each round against a fresh server.
pub async fn run(plan: &Plan) -> Result<Value> {
    let land = Land::new(WORLD_SEED);
    let (cheap, costly) = (land_keys(&land, 0, REQUESTED), land_keys(&land, LEVEL, CHUNKS));
    let (costly, digest): (Arc<[ChunkKey]>, _) = (costly.into(), land.digest());
    let mut rounds = Rounds::default();
    for _ in 0..plan.rounds {
        round(plan, &cheap, &costly, digest, &mut rounds).await?;
    }
    Ok(rounds.add_to(json!({ "connections": CONNECTIONS, "level": LEVEL })))
}

async fn round(
    plan: &Plan,
    cheap: &[ChunkKey],
    costly: &Arc<[ChunkKey]>,
    digest: WorldDigest,
    rounds: &mut Rounds,
) -> Result<()> {
    let server = ServerProcess::start(&plan.launch, &[])?;
    let length = Duration::from_secs(plan.seconds);
    let (first, second) = cheap.split_at(cheap.len() / 2);
    let alone = session(server.address, first, length).await?;
    let (threads, answered) = (other_thread()?, Arc::new(AtomicUsize::new(0)));
    for index in 0..CONNECTIONS {
        let (keys, answered, address) = (Arc::clone(costly), Arc::clone(&answered), server.address);
        // It ends with the threads.
        threads.spawn(async move { downloads(address, digest, &keys, index, &answered).await });
    }
    // All of them are outstanding when as many are answered; without an answer there is no load.
    let begins_by = Instant::now() + length;
    while answered.load(Ordering::Relaxed) < CONNECTIONS && Instant::now() < begins_by {
        tokio::time::sleep(INTERVAL).await;
    }
    let (started, before) = (Instant::now(), answered.load(Ordering::Relaxed));
    let beside = session(server.address, second, length).await;
    let downloads = (answered.load(Ordering::Relaxed) - before) as f64 / started.elapsed().as_secs_f64();
    threads.shutdown_background();
    rounds.push("chunks_alone_per_s", alone);
    rounds.push("chunks_share", beside? / alone);
    rounds.push("downloads_per_s", downloads);
    Ok(())
}

/// A session that requests without pause; chunks a second.
async fn session(address: SocketAddr, keys: &[ChunkKey], length: Duration) -> Result<f64> {
    let mut connection = Connection::connect(address).await?;
    let started = Instant::now();
    let end = started + length;
    let keys = keys.iter().copied();
    let totals = closed_loop(&mut connection, keys, Window::Halves(WINDOW), Some(end), |_| ()).await?;
    Ok(totals.chunks as f64 / started.elapsed().as_secs_f64())
}

/// One connection: each chunk as soon as the one before is there, until it fails.
async fn downloads(
    address: SocketAddr,
    digest: WorldDigest,
    keys: &[ChunkKey],
    index: usize,
    answered: &AtomicUsize,
) -> Result<()> {
    let mut stream = open_from(loopback(1), address, None).await?;
    for key in keys.iter().skip(index).step_by(CONNECTIONS) {
        let path = format!("/v1/{digest}/chunk/{}/{}/{}", key.level(), key.x(), key.z());
        stream.write_all(format!("GET {path} HTTP/1.1\r\nHost: {address}\r\n\r\n").as_bytes()).await?;
        if read_answer(&mut stream).await? {
            answered.fetch_add(1, Ordering::Relaxed);
        }
    }
    Ok(())
}

/// Reads an answer, whose length its head states. Whether it has the chunk: one without is a
/// refusal.
async fn read_answer(stream: &mut tokio::net::TcpStream) -> Result<bool> {
    let mut bytes = Vec::new();
    let head = loop {
        if let Some(end) = bytes.windows(4).position(|four| four == b"\r\n\r\n") {
            break end + 4;
        }
        ensure!(stream.read_buf(&mut bytes).await? > 0, "the answer has no head");
    };
    let text = String::from_utf8_lossy(&bytes[..head]).to_ascii_lowercase();
    let length = text.lines().find_map(|line| line.strip_prefix("content-length: "));
    let length: usize = length.and_then(|length| length.parse().ok()).context("the answer has no length")?;
    while bytes.len() < head + length {
        ensure!(stream.read_buf(&mut bytes).await? > 0, "the answer is incomplete");
    }
    Ok(text.starts_with("http/1.1 200 "))
}

/// The bars of this benchmark.
pub fn bars(figures: &Value) -> Vec<Bar> {
    let downloads = at(figures, "downloads_per_s");
    let took_place = downloads >= Some(LEAST_DOWNLOADS);
    let share = at(figures, "chunks_share").filter(|_| took_place);
    vec![
        Bar::at_least("64 downloads of one address: chunks of a session over alone", share, "", 0.4)
            .with_note("half would be the share of each of two clients"),
        Bar::at_least("the same: downloads answered a second", downloads, "", LEAST_DOWNLOADS)
            .with_note("with a chunk; refusals do not count"),
    ]
}

/// Further figures in sentences.
pub fn notes(figures: &Value) -> Vec<String> {
    let line = "Downloads: {connections:.0} connections of one address request chunks of level {level:.0}; \
                the session alone gets {chunks_alone_per_s:.0} chunks of level 0 a second.";
    vec![fill(line, figures)]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::test_bars::{check, check_without_peers};

    #[test]
    fn each_bar_can_be_missed() {
        let good = json!({ "chunks_share": 0.5, "downloads_per_s": 90.0 });
        let bad = [("/chunks_share", json!(0.39)), ("/chunks_share", json!(null))];
        check(bars, &good, &bad);
        check_without_peers(bars, &good, "/downloads_per_s", json!(9.0));
    }
}
