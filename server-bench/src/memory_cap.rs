//! A server with a hard limit of memory, far more clients than it can serve, and then few again;
//! clients beyond its memory mark (`mark`), and clients of one address there (`one_address`).

mod mark;
mod one_address;

use crate::Plan;
use crate::cgroup::Cgroup;
use crate::clients::{Totals, Window, closed_loop, other_thread, rotated};
use crate::connection::{Connection, loopback, open_from};
use crate::keys::{WORLD_SEED, land_keys};
use crate::polite;
use crate::server_process::{Launch, ServerProcess};
use anyhow::{Context, Result};
use bars::Bar;
use bars::figures::at;
use protocol::limits::MAX_CREDITS;
use serde_json::{Value, json};
use std::net::SocketAddr;
use std::sync::Arc;
use std::time::{Duration, Instant};
use terrain::{ChunkKey, Land};
use tokio_util::either::Either;

/// The limit, bytes.
const LIMIT: u64 = 512 * 1024 * 1024;

/// A smaller limit, which the load reaches in seconds: with the default settings a server must live
/// under it, and with a cache that is larger than the limit.
const SMALL_LIMIT: u64 = 128 * 1024 * 1024;
const SMALL_LENGTH: Duration = Duration::from_secs(60);
const LARGE_CACHE: [&str; 2] = ["--cache-mb", "1024"];

/// A limit that is less than a server needs to start: that of the control.
const TINY_LIMIT: u64 = 1024 * 1024;

/// Clients. Every fourth one does not read; the others request chunks, each from an own region.
const CLIENTS: usize = 200;
const UNREAD: usize = 4;

/// Requests outstanding of a client that reads.
const WINDOW: usize = 256;

/// The receive buffer of a client that does not, bytes.
const RECEIVE_BUFFER: u32 = 4096;

/// Times as long as other benchmarks: of 10 minutes with `--seconds 10`.
const LENGTH: u32 = 60;

/// Polite clients before and after, the time between two requests, and the length.
const POLITE: usize = 4;
const INTERVAL: Duration = Duration::from_millis(20);
const POLITE_LENGTH: Duration = Duration::from_secs(5);

/// Time for the server to end its sessions.
const SETTLE: Duration = Duration::from_secs(15);

/// Longest time until the server is ready again.
const READY_WAIT: Duration = Duration::from_secs(60);

/// Different chunks: several times what the cache holds.
const CHUNKS: usize = 128 * 1024;

/// Runs the benchmark once, with smaller limits twice more and as a control, the clients of `mark`
/// with the memory mark and without, and those of `one_address`.
pub async fn run(plan: &Plan) -> Result<Value> {
    let length = Duration::from_secs(plan.seconds) * LENGTH;
    let land = Land::new(WORLD_SEED);
    let keys: Arc<[ChunkKey]> = land_keys(&land, 0, CHUNKS).into();
    let many = async |server: &ServerProcess| load(server, &keys, length).await;
    let short = async |server: &ServerProcess| load(server, &keys, SMALL_LENGTH).await;
    let unread = async |server: &ServerProcess| mark::load(server, &keys).await;
    let one_address = async |server: &ServerProcess| one_address::load(server, &keys).await;
    let limited = under(&plan.launch, LIMIT, &[], many).await?;
    let small = under(&plan.launch, SMALL_LIMIT, &[], short).await?;
    let large = under(&plan.launch, SMALL_LIMIT, &LARGE_CACHE, short).await?;
    let control = under(&plan.launch, TINY_LIMIT, &[], short).await?;
    let mark = under(&plan.launch, mark::LIMIT, &[], unread).await?;
    let without_mark = under(&plan.launch, mark::LIMIT, &mark::WITHOUT, unread).await?;
    let one_address = under(&plan.launch, mark::LIMIT, &[], one_address).await?;
    Ok(json!({
        "clients": CLIENTS,
        "seconds": length.as_secs(),
        "limit_mib": LIMIT / 1_048_576,
        "limited": limited,
        "small_limit_mib": SMALL_LIMIT / 1_048_576,
        "small": small,
        "large_cache": large,
        "control": control,
        "mark": mark,
        "without_mark": without_mark,
        "one_address": one_address,
    }))
}

/// A load of a server in a control group of its own. A server that was killed gives what the group
/// says alone.
async fn under(
    launch: &Launch,
    limit: u64,
    options: &[&str],
    load: impl AsyncFnOnce(&ServerProcess) -> Result<Value>,
) -> Result<Value> {
    let group = Cgroup::new(limit)?;
    let launch = Launch { cgroup: Some(group.folder().into()), ..launch.clone() };
    let mut outcome = json!({});
    {
        let Ok(mut server) = ServerProcess::start(&launch, options) else {
            return Ok(json!({ "killed": group.killed()?, "is_running": false }));
        };
        match load(&server).await {
            Ok(measured) => outcome = measured,
            Err(error) => outcome["error"] = json!(format!("{error:#}")),
        }
        outcome["is_running"] = json!(server.process.is_running());
        outcome["panics"] = json!(server.panics());
    }
    outcome["limit_mib"] = json!(limit / 1_048_576);
    outcome["killed"] = json!(group.killed()?);
    outcome["peak_mib"] = json!(group.peak_bytes()? as f64 / 1_048_576.0);
    Ok(outcome)
}

async fn load(server: &ServerProcess, keys: &Arc<[ChunkKey]>, length: Duration) -> Result<Value> {
    let (for_before, rest) = keys.split_at(2048);
    let (for_after, requested) = rest.split_at(2048);
    let polite = |keys, end| polite::several(server.address, keys, POLITE, INTERVAL, end);
    let before = polite(for_before, Instant::now() + POLITE_LENGTH).await?;

    let end = Instant::now() + length;
    let clients = other_thread()?;
    let requested: Arc<[ChunkKey]> = requested.into();
    let address = server.address;
    let running: Vec<_> = (0..CLIENTS)
        .map(|index| {
            let keys = rotated(&requested, index, CLIENTS);
            clients.spawn(async move {
                let mut all = Totals::default();
                // The server ends sessions that do not read; each comes again.
                while Instant::now() < end {
                    let totals = if index % UNREAD == 0 {
                        let until = Instant::now() + SETTLE;
                        unread(index, address, &keys, until.min(end)).await
                    } else {
                        read(index, address, &keys, end).await
                    };
                    match totals {
                        Ok(totals) => all += totals,
                        Err(_) => tokio::time::sleep(Duration::from_millis(200)).await,
                    }
                }
                all
            })
        })
        .collect();
    let mut all = Totals::default();
    for client in running {
        all += client.await.context("a client failed")?;
    }
    clients.shutdown_background();
    let ready_s = ready_after(server.address).await?;
    tokio::time::sleep(SETTLE).await;
    let after = polite(for_after, Instant::now() + POLITE_LENGTH).await?;
    Ok(json!({
        "chunks": all.chunks,
        "refused": all.refused,
        "ready_s": ready_s,
        "p99_before_ms": before.p99_ms(),
        "p99_after_ms": after.p99_ms(),
        "refused_after": after.refused,
        "chunks_share_after": after.chunks as f64 / before.chunks as f64,
    }))
}

/// The time until the server is ready, s; none if that takes more than a minute.
async fn ready_after(address: SocketAddr) -> Result<Option<f64>> {
    let start = Instant::now();
    while mark::is_marked(address).await? {
        if start.elapsed() > READY_WAIT {
            return Ok(None);
        }
        tokio::time::sleep(Duration::from_millis(100)).await;
    }
    Ok(Some(start.elapsed().as_secs_f64()))
}

async fn connect(index: usize, address: SocketAddr, receive: Option<u32>) -> Result<Connection> {
    Connection::over(Either::Left(open_from(loopback(index), address, receive).await?), address).await
}

/// A closed loop of requests.
async fn read(index: usize, address: SocketAddr, keys: &[ChunkKey], end: Instant) -> Result<Totals> {
    let mut connection = connect(index, address, None).await?;
    let keys = keys.iter().copied().cycle();
    closed_loop(&mut connection, keys, Window::Halves(WINDOW), Some(end), |_| ()).await
}

/// Requests all that it may, and reads nothing.
async fn unread(index: usize, address: SocketAddr, keys: &[ChunkKey], until: Instant) -> Result<Totals> {
    let mut connection = connect(index, address, Some(RECEIVE_BUFFER)).await?;
    let request = async {
        for keys in keys[..MAX_CREDITS as usize].chunks(WINDOW) {
            connection.request(keys.iter().copied(), true).await?;
        }
        std::future::pending::<Result<()>>().await
    };
    match tokio::time::timeout_at(until.into(), request).await {
        Ok(ended) => ended.map(|()| Totals::default()),
        Err(_) => Ok(Totals::default()),
    }
}

/// The bars of this benchmark.
pub fn bars(figures: &Value) -> Vec<Bar> {
    let was_long = at(figures, "seconds").is_some_and(|seconds| seconds >= 600.0);
    let of = |path| at(figures, path).filter(|_| was_long);
    // A load that failed, or a server that ended otherwise, was not measured.
    let killed = |run: &str| {
        let run = figures.get(run)?;
        let was_measured = run["is_running"] == true && run["error"].is_null();
        at(run, "killed").filter(|_| was_measured)
    };
    let mut rows = vec![
        Bar::none(
            "512 MiB and 200 clients, 10 min: processes killed",
            killed("limited").filter(|_| was_long),
        )
        .with_note(
            "hard limit of a control group; 150 clients with 256 requests outstanding each, 50 that never \
                 read; shorter runs have no figure",
        ),
        Bar::reported("the same: the most memory", of("limited/peak_mib"), "MiB"),
        Bar::at_least("the same: refused requests", of("limited/refused"), "", 1.0),
        Bar::at_most("the same: time until /readyz has 200 after it", of("limited/ready_s"), "s", 30.0),
        Bar::none("the same: requests refused 15 s after that", of("limited/refused_after")),
        Bar::at_least(
            "the same: chunks of polite clients after over before",
            of("limited/chunks_share_after"),
            "",
            0.95,
        ),
        Bar::none("the same with 128 MiB, 1 min: processes killed", killed("small")),
        Bar::reported("the same with 128 MiB: the most memory", at(figures, "small/peak_mib"), "MiB"),
        Bar::none("the same with 128 MiB and a cache of 1 GiB: killed", killed("large_cache")),
        Bar::at_least("the same with 1 MiB: killed (control)", at(figures, "control/killed"), "", 1.0),
    ];
    rows.extend(mark::bars(figures.get("mark").unwrap_or(&Value::Null)));
    let killed = at(figures, "without_mark/killed");
    rows.extend(one_address::bars(figures.get("one_address").unwrap_or(&Value::Null)));
    rows.push(Bar::at_least("192 MiB and 900 clients without the mark: killed (control)", killed, "", 1.0));
    rows
}

/// Further figures in sentences.
pub fn notes(figures: &Value) -> Vec<String> {
    let line = "Limit of memory, {seconds:.0} s: {limited/chunks:.0} chunks, {limited/refused:.0} \
                refused; polite p99 {limited/p99_before_ms:.1} ms before, \
                {limited/p99_after_ms:.1} ms after; with 128 MiB {small/chunks:.0} chunks, \
                {small/refused:.0} refused.";
    let mut notes = vec![bars::figures::fill(line, figures)];
    notes.extend(mark::notes(figures.get("mark").unwrap_or(&Value::Null)));
    notes.extend(one_address::notes(figures.get("one_address").unwrap_or(&Value::Null)));
    notes
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::test_bars::{check, check_without_peers};

    #[test]
    fn each_bar_can_be_missed() {
        let good = json!({
            "seconds": 600,
            "limited": {
                "is_running": true, "killed": 0, "peak_mib": 300.0, "refused": 1000, "refused_after": 0,
                "chunks_share_after": 1.0, "ready_s": 10.0,
            },
            "small": { "is_running": true, "killed": 0, "peak_mib": 90.0, "error": null },
            "large_cache": { "is_running": true, "killed": 0, "error": null },
            "control": { "killed": 1 },
            "mark": mark::tests::good(),
            "without_mark": { "killed": 1 },
            "one_address": one_address::tests::good(),
        });
        let bad = [
            ("/limited/killed", json!(1)),
            ("/limited/is_running", json!(false)),
            ("/limited/refused", json!(0)),
            ("/limited/ready_s", json!(31)),
            ("/limited/ready_s", json!(null)),
            ("/limited/refused_after", json!(2)),
            ("/limited/chunks_share_after", json!(0.9)),
            ("/small/killed", json!(1)),
            ("/small/is_running", json!(false)),
            ("/small/error", json!("503")),
            ("/large_cache/killed", json!(1)),
            ("/large_cache/error", json!("503")),
            ("/control/killed", json!(0)),
            ("/without_mark/killed", json!(0)),
        ];
        check(bars, &good, &bad);
        let of_the_long_load = |figures: &Value| {
            // The others have a length of their own.
            bars(figures).into_iter().take(6).collect::<Vec<_>>()
        };
        check_without_peers(of_the_long_load, &good, "/seconds", json!(599));
    }
}
