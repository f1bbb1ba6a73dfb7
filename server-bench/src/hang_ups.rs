//! Clients that connect, ask and hang up, over and over: nothing of them may remain.

use crate::Plan;
use crate::connection::{Connection, frames, hello, loopback, open_from, upgrade};
use crate::keys::{WORLD_SEED, land_keys};
use crate::server_process::{Launch, ServerProcess, series};
use anyhow::{Context, Result};
use bars::Bar;
use bars::figures::at;
use bars::stats::median;
use serde_json::{Value, json};
use std::net::SocketAddr;
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::Duration;
use terrain::{ChunkKey, Land};
use tokio::io::AsyncWriteExt;
use tokio_util::either::Either;

/// Cycles, and their parts, with a sample of the memory after each part. The median of the second
/// half is compared with that of the first: single samples differ by up to four percent, because
/// the allocator takes and returns whole pages. The bytes that the program holds do not grow at
/// all, as the server's test `hang_ups` shows by counting them.
const CYCLES: usize = 200_000;
const PARTS: usize = 8;
const HALF: usize = PARTS / 2;

/// Clients at once, each from an address of its own.
const CLIENTS: usize = 32;

/// Chunks that are requested before the client hangs up, and the number of all chunks: many times
/// what the cache of the server holds, so that most are to be generated when their client is gone.
const REQUESTED: usize = 16;
const CHUNKS: usize = 16 * 1024;
const CACHE: [&str; 2] = ["--cache-mb", "1"];

/// Jobs whose client was gone, as the server counts them, and how many there must be at least.
const CANCELLED: &str = "tombolo_generation_jobs_total{outcome=\"cancelled\"}";
const LEAST_CANCELLED: f64 = 10_000.0;

/// Time for the server to notice the last ones.
const SETTLE: Duration = Duration::from_secs(3);

/// Where a client hangs up.
#[derive(Clone, Copy, Debug)]
enum Moment {
    /// After it has connected.
    Connected,
    /// In the request of the upgrade.
    InRequest,
    /// After the request of the upgrade, without its answer.
    Requested,
    /// After it has requested chunks.
    Asked,
    /// In a frame.
    InFrame,
}

impl Moment {
    const ALL: [Self; 5] = [Self::Connected, Self::InRequest, Self::Requested, Self::Asked, Self::InFrame];
}

/// Runs the benchmark once: its figures are counts and memory.
pub async fn run(plan: &Plan) -> Result<Value> {
    let keys: Arc<[ChunkKey]> = land_keys(&Land::new(WORLD_SEED), 0, CHUNKS).into();
    let launch = Launch { has_small_pages: true, ..plan.launch.clone() };
    let mut server = ServerProcess::start(&launch, &CACHE)?;
    let (mut failed, mut rss, mut threads) = (0, Vec::new(), Vec::new());
    let part = CYCLES / PARTS;
    for number in 0..PARTS {
        failed += cycles(server.address, &keys, number * part..(number + 1) * part).await?;
        tokio::time::sleep(SETTLE).await;
        rss.push(server.process.rss_bytes()? as f64 / 1_048_576.0);
        threads.push(server.process.threads()?);
    }
    let threads_more = threads[PARTS - 1].saturating_sub(threads[0]);
    let sessions = server.metric(series::SESSIONS).await?;
    let jobs = server.metric(series::PENDING_JOBS).await?;
    let [generated, cancelled] = server.metrics([series::GENERATED, CANCELLED]).await?;
    // Without the connection that asks.
    let connections = server.metric(series::CONNECTIONS).await? - 1.0;
    let is_running = server.process.is_running();
    let half = |parts: std::ops::Range<usize>| median(rss[parts].iter().copied());
    Ok(json!({
        "cycles": CYCLES,
        "generated": generated,
        "cancelled": cancelled,
        "failed_cycles": failed,
        "rss_mib": rss,
        "rss_ratio_of_looks": rss[PARTS - 1] / rss[0],
        "rss_ratio": half(HALF..PARTS).zip(half(0..HALF)).map(|(second, first)| second / first),
        "leaked": sessions + jobs + connections + threads_more as f64,
        "panics": is_running.then(|| server.panics()),
    }))
}

/// Runs these cycles on all clients; how many could not connect.
async fn cycles(address: SocketAddr, keys: &Arc<[ChunkKey]>, range: std::ops::Range<usize>) -> Result<usize> {
    let next = Arc::new(AtomicUsize::new(range.start));
    let clients = (0..CLIENTS).map(|client| {
        let (next, keys, end) = (Arc::clone(&next), Arc::clone(keys), range.end);
        tokio::spawn(async move {
            let mut failed = 0;
            loop {
                let number = next.fetch_add(1, Ordering::Relaxed);
                if number >= end {
                    return failed;
                }
                failed += usize::from(cycle(address, client, number, &keys).await.is_err());
            }
        })
    });
    let mut failed = 0;
    for client in clients.collect::<Vec<_>>() {
        failed += client.await.context("a client failed")?;
    }
    Ok(failed)
}

/// One cycle. Every second one ends with a reset, the others with an end of the stream.
async fn cycle(address: SocketAddr, client: usize, number: usize, keys: &[ChunkKey]) -> Result<()> {
    // Many addresses, because each has a limited number of ports for connections that have just
    // ended.
    let source = loopback(client * 64 + number / CLIENTS % 64);
    let mut stream = open_from(source, address, None).await?;
    if number % 2 == 1 {
        stream.set_zero_linger()?;
    }
    let request = upgrade(address);
    match Moment::ALL[number / 2 % Moment::ALL.len()] {
        Moment::Connected => {}
        Moment::InRequest => stream.write_all(&request.as_bytes()[..request.len() / 2]).await?,
        Moment::Requested => stream.write_all(request.as_bytes()).await?,
        Moment::Asked => {
            let mut connection = Connection::over(Either::Left(stream), address).await?;
            let asked = (0..REQUESTED).map(|offset| keys[(number * 7 + offset) % keys.len()]);
            connection.request(asked, true).await?;
        }
        Moment::InFrame => {
            let frame = frames(&[hello()])?;
            let connection = Connection::over(Either::Left(stream), address).await?;
            connection.into_stream().write_all(&frame[..frame.len() / 2]).await?;
        }
    }
    Ok(())
}

/// The bars of this benchmark.
pub fn bars(figures: &Value) -> Vec<Bar> {
    // Figures count only if the clients reached the server, and left it with chunks to generate.
    let reached = at(figures, "failed_cycles").is_some_and(|failed| failed <= 0.001 * CYCLES as f64)
        && at(figures, "cancelled") >= Some(LEAST_CANCELLED);
    let of = |path| at(figures, path).filter(|_| reached);
    vec![
        Bar::none("200,000 clients that hang up: panics", of("panics")),
        Bar::none("the same: sessions, connections, jobs and threads left", of("leaked")),
        Bar::at_most("the same: memory in the second 100,000 over the first", of("rss_ratio"), "x", 1.05)
            .with_note(
                "resident, medians of four samples each, without huge pages, one of which is a tenth of \
                 it; a leak of ten bytes for each client misses the bar; they hang up after the \
                 connect, in and after the request of the upgrade, after the request of 16 chunks, \
                 nearly all of which are cancelled before they are generated, and in a frame; half of \
                 them with a reset",
            ),
        Bar::reported("the same: memory at the end over after 25,000", of("rss_ratio_of_looks"), "x")
            .with_note("single samples, which differ by up to four percent"),
    ]
}

/// Further figures in sentences.
pub fn notes(figures: &Value) -> Vec<String> {
    let line = "Clients that hang up: {rss_mib:.2} MiB after each eighth; \
                {failed_cycles:.0} could not connect; {generated:.0} chunks were generated, \
                {cancelled:.0} jobs cancelled.";
    vec![bars::figures::fill(line, figures)]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::test_bars::{check, check_without_peers};

    #[test]
    fn each_bar_can_be_missed() {
        let good = json!({
            "panics": 0,
            "leaked": 0,
            "rss_ratio": 1.01,
            "rss_ratio_of_looks": 1.04,
            "failed_cycles": 3,
            "generated": 20_000,
            "cancelled": 200_000,
        });
        check(bars, &good, &[("/panics", json!(1)), ("/leaked", json!(1)), ("/rss_ratio", json!(1.06))]);
        check_without_peers(bars, &good, "/failed_cycles", json!(500));
        check_without_peers(bars, &good, "/cancelled", json!(LEAST_CANCELLED - 1.0));
    }
}
