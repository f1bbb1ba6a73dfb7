//! A thousand clients that request chunks and never read, beside clients that do: memory, the
//! healthy clients' latency, and how long the server keeps the others.

use crate::Plan;
use crate::clients::other_thread;
use crate::connection::{Connection, loopback, open_from};
use crate::keys::{WORLD_SEED, land_keys};
use crate::polite;
use crate::rounds::Rounds;
use crate::server_process::{ServerProcess, series};
use anyhow::{Context, Result};
use bars::Bar;
use bars::figures::at;
use protocol::limits::{MAX_CREDITS, MAX_KEYS};
use serde_json::{Value, json};
use std::cell::Cell;
use std::time::{Duration, Instant};
use terrain::{ChunkKey, Land};
use tokio_util::either::Either;

/// Clients that never read, and addresses that they come from.
const CLIENTS: usize = 1000;
const ADDRESSES: usize = 100;

/// Their receive buffers, bytes. With large ones the kernel would take all that they request.
const RECEIVE_BUFFER: u32 = 4096;

/// Clients that read, and the time between two requests of one.
const HEALTHY: usize = 8;
const INTERVAL: Duration = Duration::from_millis(20);

/// Least length of the measured part.
const LEAST: Duration = Duration::from_secs(20);

/// Time after the last connect in which sessions are counted: longer than the server may keep one.
const AFTER: Duration = Duration::from_secs(14);

/// Time in which the server has closed the sessions of clients that hung up.
const HANG_UP: Duration = Duration::from_secs(1);

/// Time between two samples of the number of sessions.
const SAMPLE_INTERVAL: Duration = Duration::from_millis(100);

/// Runs the benchmark, each round against a fresh server.
pub async fn run(plan: &Plan) -> Result<Value> {
    let keys = land_keys(&Land::new(WORLD_SEED), 0, 64 * 1024);
    let mut rounds = Rounds::default();
    for _ in 0..plan.rounds {
        round(plan, &keys, &mut rounds).await?;
    }
    Ok(rounds.add_to(json!({ "clients": CLIENTS, "healthy": HEALTHY })))
}

async fn round(plan: &Plan, keys: &[ChunkKey], rounds: &mut Rounds) -> Result<()> {
    let server = ServerProcess::start(&plan.launch, &[])?;
    let address = server.address;
    let (requested, fresh) = keys.split_at(MAX_CREDITS as usize);
    let (first, second) = fresh.split_at(fresh.len() / 2);
    let length = LEAST.max(Duration::from_secs(plan.seconds));
    let healthy = |keys, end| polite::several(address, keys, HEALTHY, INTERVAL, end);
    // Chunks requested by the dead clients are cached in both parts.
    cache(&server, requested).await?;
    let alone = healthy(first, Instant::now() + length).await?;

    let end = Instant::now() + length;
    // On a thread of its own, so that connecting does not delay the healthy clients.
    let dead = other_thread()?;
    let wanted = requested.to_vec();
    let connected = dead.spawn(async move {
        let mut clients = Vec::with_capacity(CLIENTS);
        for index in 0..CLIENTS {
            let started = Instant::now();
            clients.push((started, never_read(index, address, &wanted).await?));
        }
        anyhow::Ok(clients)
    });
    // The end of counting, once all are connected, and when the healthy clients are gone.
    let (until, gone) = (Cell::new(None), Cell::new(None));
    let connected = async {
        let clients = connected.await.context("the dead clients failed")??;
        until.set(Some(Instant::now() + AFTER));
        Ok(clients)
    };
    let beside = async {
        let beside = healthy(second, end).await?;
        gone.set(Some(Instant::now() + HANG_UP));
        Ok(beside)
    };
    let (beside, samples, clients) = tokio::try_join!(beside, sessions(&server, &until, &gone), connected)?;
    let starts: Vec<_> = clients.iter().map(|(started, _)| *started).collect();
    let (longest, left) = longest_stay(&starts, &samples);
    rounds.push("p99_alone_ms", alone.p99_ms());
    rounds.push("p99_ms", beside.p99_ms());
    rounds.push("p99_ratio", beside.p99_ms() / alone.p99_ms());
    rounds.push("healthy_chunks_share", beside.chunks as f64 / alone.chunks as f64);
    rounds.push_extreme("peak_rss_mib", server.process.peak_rss_bytes()? as f64 / 1_048_576.0);
    rounds.push_extreme("longest_stay_s", longest.as_secs_f64());
    rounds.push_extreme("left_at_the_end", left as f64);
    rounds.push("most_sessions", samples.iter().map(|(_, open)| *open).max().map(|open| open as f64));
    rounds.push_extreme("panics", f64::from(server.panics()));
    drop(clients);
    dead.shutdown_background();
    Ok(())
}

/// Requests all keys once.
async fn cache(server: &ServerProcess, keys: &[ChunkKey]) -> Result<()> {
    let mut connection = Connection::connect(server.address).await?;
    let mut received = 0;
    for keys in keys.chunks(64) {
        connection.request(keys.iter().copied(), true).await?;
        let until = received + keys.len();
        while received < until {
            connection.receive(|_| received += 1).await?;
        }
    }
    Ok(())
}

/// Opens a session, requests all keys, and keeps the socket.
async fn never_read(index: usize, address: std::net::SocketAddr, keys: &[ChunkKey]) -> Result<Connection> {
    let stream = open_from(loopback(index % ADDRESSES), address, Some(RECEIVE_BUFFER)).await?;
    let mut connection = Connection::over(Either::Left(stream), address).await?;
    for keys in keys.chunks(MAX_KEYS) {
        // The server may stop reading: what it does not take is not requested.
        let sent = connection.request(keys.iter().copied(), true);
        if !matches!(tokio::time::timeout(SAMPLE_INTERVAL, sent).await, Ok(Ok(()))) {
            break;
        }
    }
    Ok(connection)
}

/// Times, and how many sessions of dead clients were open then: until `until`, and at least one
/// time without the healthy clients, which are `gone` then.
async fn sessions(
    server: &ServerProcess,
    until: &Cell<Option<Instant>>,
    gone: &Cell<Option<Instant>>,
) -> Result<Vec<(Instant, usize)>> {
    let mut samples: Vec<(Instant, usize)> = Vec::new();
    let mut ticks = tokio::time::interval(SAMPLE_INTERVAL);
    loop {
        ticks.tick().await;
        // The time before the answer: who stays until then stays longer.
        let now = Instant::now();
        let open = server.metric(series::SESSIONS).await? as usize;
        samples.push((now, dead(open, now, gone.get())));
        if [until, gone].iter().all(|time| time.get().is_some_and(|time| now >= time)) {
            return Ok(samples);
        }
    }
}

/// Sessions of dead clients among the open ones at a time. The healthy ones count as open until
/// they are gone: one less while they end, rather than one that is healthy taken for dead.
fn dead(open: usize, now: Instant, gone: Option<Instant>) -> usize {
    let is_alone = gone.is_some_and(|gone| now >= gone);
    open.saturating_sub(if is_alone { 0 } else { HEALTHY })
}

/// How long the oldest of the open sessions had been open, at most over all samples, and how many
/// were left at the last one. Of `n` open sessions the oldest began no later than the `n`-th
/// newest.
fn longest_stay(starts: &[Instant], samples: &[(Instant, usize)]) -> (Duration, usize) {
    let oldest = |(now, open): &(Instant, usize)| {
        let begun = starts.iter().filter(|start| *start <= now).count();
        let oldest = starts[..begun].get(begun.checked_sub(*open)?)?;
        Some(now.duration_since(*oldest))
    };
    let longest = samples.iter().filter_map(oldest).max().unwrap_or_default();
    (longest, samples.last().map_or(0, |(_, open)| *open))
}

/// The bars of this benchmark.
pub fn bars(figures: &Value) -> Vec<Bar> {
    let of = |path| at(figures, path);
    // Figures count only if the dead clients were there, all but those that the server ended before
    // the last one came.
    let were_there = of("most_sessions").is_some_and(|most| most >= 0.95 * CLIENTS as f64);
    let when_there = |path| of(path).filter(|_| were_there);
    vec![
        Bar::at_most("1,000 clients that never read: memory", when_there("peak_rss_mib"), "MiB", 631.0)
            .with_note("the most resident memory; 256 MiB and 384 KiB for each client"),
        Bar::at_most("the same: healthy p99 over alone", when_there("p99_ratio"), "x", 1.25)
            .with_note("8 healthy clients with 50 requests a second each for chunks that must be generated"),
        Bar::at_most("the same: longest stay of one", when_there("longest_stay_s"), "s", 12.0).with_note(
            "from its connect, by the number of open sessions every 100 ms; exact if they end in the order \
             in which they came, else too short",
        ),
        Bar::none("the same: sessions left at the end", when_there("left_at_the_end")),
    ]
}

/// Further figures in sentences.
pub fn notes(figures: &Value) -> Vec<String> {
    let line = "Clients that never read: healthy p99 {p99_alone_ms:.2} ms alone, {p99_ms:.2} ms \
                beside; round by round {p99_ratio_rounds:.2}; at most {most_sessions:.0} of \
                them open at once.";
    vec![bars::figures::fill(line, figures)]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::test_bars::{check, check_without_peers};

    #[test]
    fn each_bar_can_be_missed() {
        let good = json!({
            "peak_rss_mib": 300.0, "p99_ratio": 1.1, "longest_stay_s": 10.5, "left_at_the_end": 0,
            "most_sessions": 990,
        });
        let bad = [
            ("/peak_rss_mib", json!(632)),
            ("/p99_ratio", json!(1.26)),
            ("/longest_stay_s", json!(12.1)),
            ("/left_at_the_end", json!(1)),
        ];
        check(bars, &good, &bad);
        check_without_peers(bars, &good, "/most_sessions", json!(900));
    }

    #[test]
    fn sessions_left_after_the_healthy_clients_are_gone_are_dead() {
        let gone = Instant::now();
        let (before, after) = (gone.checked_sub(HANG_UP).unwrap(), gone + SAMPLE_INTERVAL);
        assert_eq!(dead(HEALTHY + 3, before, None), 3);
        assert_eq!(dead(HEALTHY + 3, before, Some(gone)), 3);
        assert_eq!((dead(HEALTHY, after, Some(gone)), dead(0, after, Some(gone))), (HEALTHY, 0));
    }

    #[test]
    fn the_oldest_session_counts() {
        let zero = Instant::now();
        let at = |s: u64| zero + Duration::from_secs(s);
        let starts = [at(0), at(1), at(2)];
        let samples = [(at(2), 3), (at(9), 3), (at(11), 1), (at(12), 0)];
        // All three at 9 s: the first is 9 s old. One at 11 s: the last, 9 s old.
        assert_eq!(longest_stay(&starts, &samples), (Duration::from_secs(9), 0));
        assert_eq!(longest_stay(&starts, &[(at(13), 2)]), (Duration::from_secs(12), 2));
        assert_eq!(longest_stay(&starts, &[]), (Duration::ZERO, 0));
    }
}
