//! Sessions that send views without pause, beside one polite client: the largest view that the
//! server accepts, ordinary views, views at a new place each time from sessions that hold thousands
//! of chunks, and views beyond the limit.
//!
//! The liveness probe must be answered, the polite client must get its chunks, and the server must
//! stop on SIGTERM.

use crate::Plan;
use crate::clients::other_thread;
use crate::connection::{Connection, get};
use crate::keys::{WORLD_SEED, land_keys};
use crate::polite::{Polite, polite};
use crate::rounds::{Rounds, quantile_ms};
use crate::server_process::{ServerProcess, series};
use anyhow::{Context, Result};
use bars::Bar;
use bars::figures::{at, least, list, ratio, worst};
use protocol::limits::{MAX_KEYS, MAX_VIEW_ESTIMATE, MAX_VIEWPORT};
use protocol::message::{ClientMessage, WireKey};
use protocol::view::View;
use serde_json::{Value, json};
use std::net::SocketAddr;
use std::time::{Duration, Instant};
use terrain::lod::{self, MAX_VIEW_DISTANCE_M};
use terrain::{ChunkKey, Land};

/// Sessions that flood.
const SESSIONS: [usize; 3] = [4, 8, 32];

/// Views a second of a session with a fixed rate.
const RATE: u32 = 60;

/// Time between two requests of the polite client.
const POLITE_INTERVAL: Duration = Duration::from_millis(50);

/// Longest time that the polite client is measured alone.
const MOST_ALONE: Duration = Duration::from_secs(10);

/// Time between two probes.
const PROBE_INTERVAL: Duration = Duration::from_millis(100);

/// A probe without an answer for so long counts as lost, with this latency.
const PROBE_TIMEOUT: Duration = Duration::from_secs(2);

/// Chunks that a teleporting session holds.
const HELD: i32 = 4096;

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

    /// View number `id`.
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
        let extreme = View {
            viewport: [MAX_VIEWPORT; 2],
            distance_m: MAX_VIEW_DISTANCE_M,
            tolerance_q4: 1,
            ..ordinary
        };
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

/// Runs every scenario, each round of it against a fresh server.
pub async fn run(plan: &Plan) -> Result<Value> {
    let keys = land_keys(&Land::new(WORLD_SEED), 0, 64 * 1024);
    let mut scenarios = Vec::new();
    let mut alone = Vec::new();
    for kind in Kind::ALL {
        for sessions in SESSIONS {
            for rate in [Some(RATE), None] {
                let mut rounds = Rounds::default();
                for _ in 0..plan.rounds {
                    scenario(plan, &keys, (kind, sessions, rate), &mut rounds, &mut alone).await?;
                }
                let scenario = json!({ "views": kind.name(), "sessions": sessions, "views_per_s": rate });
                scenarios.push(rounds.add_to(scenario));
            }
        }
    }
    let alone_ms = quantile_ms(alone, 0.99);
    for scenario in &mut scenarios {
        scenario["polite_p99_ratio"] = json!(ratio(at(scenario, "polite_p99_ms"), alone_ms));
    }
    Ok(json!({ "scenarios": scenarios, "polite_p99_alone_ms": alone_ms }))
}

/// One scenario. The latencies of the polite client alone are added to those of the scenarios before:
/// it does the same in all, and one scenario has too few for a 99th percentile that others can be
/// divided by.
async fn scenario(
    plan: &Plan,
    keys: &[ChunkKey],
    (kind, sessions, rate): (Kind, usize, Option<u32>),
    rounds: &mut Rounds,
    all_alone: &mut Vec<Duration>,
) -> Result<()> {
    let mut server = ServerProcess::start(&plan.launch, &[])?;
    let (first, second) = keys.split_at(keys.len() / 2);
    let length = Duration::from_secs(plan.seconds);
    let alone_for = length.min(MOST_ALONE);
    let alone = polite(server.address, first.to_vec(), POLITE_INTERVAL, Instant::now() + alone_for).await?;

    let end = Instant::now() + length;
    // On a thread of its own, so that it does not delay the measured clients. It continues until
    // the server has stopped.
    let flooders = other_thread()?;
    for _ in 0..sessions {
        flooders.spawn(flood(server.address, kind, rate));
    }
    let (probes, beside) = tokio::try_join!(
        probe(server.address, end),
        polite(server.address, second.to_vec(), POLITE_INTERVAL, end)
    )?;
    let view_seconds = tokio::time::timeout(PROBE_TIMEOUT, server.metric(series::VIEW_SECONDS)).await;
    let stopped = server.process.stop(Duration::from_secs(30)).await?;
    flooders.shutdown_background();

    let lost = probes.iter().filter(|latency| **latency >= PROBE_TIMEOUT).count();
    rounds.push("probes", probes.len() as f64);
    rounds.push("probes_lost", lost as f64);
    rounds.push("probe_worst_ms", quantile_ms(probes, 1.0));
    let rate = |polite: &Polite, time: Duration| polite.chunks as f64 / time.as_secs_f64();
    rounds.push("polite_chunks_share", rate(&beside, length) / rate(&alone, alone_for));
    rounds.push("polite_refused", beside.refused as f64);
    rounds.push("polite_p99_alone_ms", alone.p99_ms());
    rounds.push("polite_p99_ms", beside.p99_ms());
    rounds.push("view_seconds", view_seconds.ok().and_then(Result::ok));
    rounds.push("stop_s", stopped.map(|time| time.as_secs_f64()));
    all_alone.extend(alone.latencies);
    Ok(())
}

/// The slowest liveness probe, milliseconds, while sessions send the largest view that the server
/// accepts without pause.
pub async fn slowest_probe_ms(server: &ServerProcess, sessions: usize, length: Duration) -> Result<f64> {
    let flooders = other_thread()?;
    for _ in 0..sessions {
        flooders.spawn(flood(server.address, Kind::Largest, None));
    }
    let probes = probe(server.address, Instant::now() + length).await?;
    flooders.shutdown_background();
    quantile_ms(probes, 1.0).context("no probe was sent")
}

/// The p99 of the polite client, milliseconds, while sessions send the largest view that the server
/// accepts without pause.
pub async fn flooded_p99_ms(
    server: &ServerProcess,
    sessions: usize,
    keys: &[ChunkKey],
    length: Duration,
) -> Result<f64> {
    let flooders = other_thread()?;
    for _ in 0..sessions {
        flooders.spawn(flood(server.address, Kind::Largest, None));
    }
    let polite = polite(server.address, keys.to_vec(), POLITE_INTERVAL, Instant::now() + length).await?;
    flooders.shutdown_background();
    Ok(polite.p99_ms())
}

/// Probes over new connections. Returns the latency of each, [`PROBE_TIMEOUT`] without an answer.
async fn probe(address: SocketAddr, end: Instant) -> Result<Vec<Duration>> {
    let mut latencies = Vec::new();
    let mut ticks = tokio::time::interval(PROBE_INTERVAL);
    while Instant::now() < end {
        ticks.tick().await;
        let sent = Instant::now();
        let answer = tokio::time::timeout(PROBE_TIMEOUT, get(address, "/livez")).await;
        latencies.push(if matches!(answer, Ok(Ok(_))) { sent.elapsed() } else { PROBE_TIMEOUT });
    }
    Ok(latencies)
}

/// Sends views until the connection ends or the task is aborted.
async fn flood(address: SocketAddr, kind: Kind, rate: Option<u32>) -> Result<()> {
    let mut connection = Connection::connect(address).await?;
    if matches!(kind, Kind::Teleport) {
        let keys: Vec<WireKey> =
            (0..HELD).map(|n| WireKey { level: 0, x: n % 64 - 32, z: n / 64 - 32 }).collect();
        for keys in keys.chunks(MAX_KEYS) {
            connection.send(&[ClientMessage::Holding { keys: keys.to_vec() }]).await?;
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
        connection.send_while_reading(&messages(count)).await?;
        tokio::task::yield_now().await;
    }
}

/// Scenarios of a whole run.
const SCENARIOS: usize = Kind::ALL.len() * SESSIONS.len() * 2;

/// The bars of this benchmark: the worst scenario counts.
pub fn bars(figures: &Value) -> Vec<Bar> {
    let scenarios = list(figures, "scenarios");
    let of = |field| scenarios.iter().map(move |scenario| at(scenario, field));
    let whole = |figure: Option<f64>| figure.filter(|_| scenarios.len() == SCENARIOS);
    let worst_of = |field| whole(worst(of(field)));
    let share = whole(least(of("polite_chunks_share")));
    let alone = at(figures, "polite_p99_alone_ms").unwrap_or(f64::NAN);
    let worst_note = "the worst of all scenarios";
    let p99_note = format!("{worst_note}; alone {alone:.2} ms, of all scenarios together");
    vec![
        Bar::at_most("flood: liveness probe, slowest", worst_of("probe_worst_ms"), "ms", 100.0)
            .with_note(worst_note),
        Bar::at_least("flood: chunks of a polite client over alone", share, "", 0.8).with_note(worst_note),
        Bar::at_most("flood: polite p99 over alone", worst_of("polite_p99_ratio"), "x", 3.0)
            .with_note(p99_note),
        Bar::at_most("flood: stop on SIGTERM", worst_of("stop_s"), "s", 10.0).with_note(worst_note),
    ]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::test_bars::{check, check_absent, check_without_peers};

    #[test]
    fn each_bar_can_be_missed_by_one_scenario() {
        let scenario = json!({
            "probe_worst_ms": 40.0, "polite_chunks_share": 0.97, "polite_p99_ratio": 1.5, "stop_s": 0.4,
        });
        let good = json!({ "scenarios": vec![scenario; SCENARIOS] });
        let bad = [
            ("/scenarios/3/probe_worst_ms", json!(101.0)),
            ("/scenarios/0/polite_chunks_share", json!(0.79)),
            ("/scenarios/23/polite_p99_ratio", json!(3.1)),
            ("/scenarios/7/stop_s", json!(null)),
        ];
        check(bars, &good, &bad);
        check_absent(bars, &good, &[("", "scenarios", 4), ("/scenarios/5", "stop_s", 1)]);
        check_without_peers(bars, &good, "/scenarios", json!(list(&good, "scenarios")[1..]));
    }
}
