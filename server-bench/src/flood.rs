//! Sessions that send views without pause, beside one polite client: the largest view that the
//! server accepts, ordinary views, views at a new place each time from sessions that hold thousands
//! of chunks, and views beyond the limit.
//!
//! The liveness probe must be answered, the polite client must get its chunks, and the server must
//! stop on SIGTERM.

use crate::Plan;
use crate::clients::{BusyThreads, other_thread};
use crate::connection::{Connection, get};
use crate::keys::{WORLD_SEED, land_keys};
use crate::polite::{Polite, polite};
use crate::rounds::{Rounds, quantile_ms};
use crate::server_process::{ServerProcess, series};
use anyhow::Result;
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
use tokio::runtime::Runtime;
use tokio::task::JoinHandle;

/// Sessions that flood.
const SESSIONS: [usize; 3] = [4, 8, 32];

/// Runs beside busy threads in a round: as many as each kind of views has.
const BUSY_RUNS: u32 = 2 * SESSIONS.len() as u32;

/// Views a second of a session with a fixed rate.
const RATE: u32 = 60;

/// Time between two requests of the polite client.
const POLITE_INTERVAL: Duration = Duration::from_millis(50);

/// The same where the p90 of a few seconds is measured.
const DENSE_INTERVAL: Duration = Duration::from_millis(10);

/// Longest time that the polite client is measured alone.
const MOST_ALONE: Duration = Duration::from_secs(10);

/// Time between two probes.
const PROBE_INTERVAL: Duration = Duration::from_millis(100);

/// A probe without an answer for so long counts as lost, with this latency.
const PROBE_TIMEOUT: Duration = Duration::from_secs(2);

/// Time for the server's metrics, which are no probe.
const METRICS_TIMEOUT: Duration = Duration::from_secs(10);

/// Views that the server must count a second of each session: with fewer there was no flood. Some
/// hundred are sent; a server that pauses a session or falls behind counts fewer.
const LEAST_VIEWS_PER_S: f64 = 1.0;

/// Chunks that a teleporting session holds.
const HELD: i32 = 4096;

/// The kind of views that the flooding sessions send.
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
    let mut busy_ms = Vec::new();
    for _ in 0..BUSY_RUNS * plan.rounds {
        busy_ms.push(busy_p99_ms(plan, &keys).await?);
    }
    let (alone_p90_ms, alone_ms) = (quantile_ms(alone.clone(), 0.9), quantile_ms(alone, 0.99));
    for scenario in &mut scenarios {
        scenario["polite_p90_ratio"] = json!(ratio(at(scenario, "polite_p90_ms"), alone_p90_ms));
        scenario["polite_p99_ratio"] = json!(ratio(at(scenario, "polite_p99_ms"), alone_ms));
    }
    let busy_ratio = ratio(busy_ms.iter().copied().reduce(f64::max), alone_ms);
    let busy = json!({ "polite_p99_ms": busy_ms, "polite_p99_ratio": busy_ratio });
    Ok(json!({
        "scenarios": scenarios,
        "polite_p90_alone_ms": alone_p90_ms, "polite_p99_alone_ms": alone_ms, "busy": busy
    }))
}

/// The control: the p99 of the polite client, milliseconds, without a flood, while other threads of
/// the machine are busy.
async fn busy_p99_ms(plan: &Plan, keys: &[ChunkKey]) -> Result<f64> {
    let server = ServerProcess::start(&plan.launch, &[])?;
    let _busy = BusyThreads::start();
    let end = Instant::now() + Duration::from_secs(plan.seconds);
    Ok(polite(server.address, keys.to_vec(), POLITE_INTERVAL, end).await?.p99_ms())
}

/// One scenario. The latencies of the polite client alone are added to those of the scenarios
/// before: it does the same in all, and one scenario has too few for a 99th percentile that others
/// can be divided by.
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
    // It continues until the server has stopped.
    let flood = Flood::start(server.address, kind, sessions, rate)?;
    let (probes, beside) = tokio::try_join!(
        probe(server.address, end),
        polite(server.address, second.to_vec(), POLITE_INTERVAL, end)
    )?;
    let sample = flood.sample(&server).await;
    let stopped = server.process.stop(Duration::from_secs(30)).await?;
    drop(flood);

    let lost = probes.iter().filter(|latency| **latency >= PROBE_TIMEOUT).count();
    rounds.push("probes", probes.len() as f64);
    rounds.push_extreme("probes_lost", lost as f64);
    rounds.push_extreme("probe_worst_ms", quantile_ms(probes, 1.0));
    let rate = |polite: &Polite, time: Duration| polite.chunks as f64 / time.as_secs_f64();
    rounds.push("polite_chunks_share", rate(&beside, length) / rate(&alone, alone_for));
    rounds.push("polite_refused", beside.refused as f64);
    rounds.push("polite_p99_alone_ms", alone.p99_ms());
    rounds.push("polite_p90_ms", beside.p90_ms());
    rounds.push("polite_p99_ms", beside.p99_ms());
    rounds.push("view_seconds", sample.view_seconds);
    rounds.push("counted_views", sample.views);
    rounds.push("views_per_s_of_session", sample.views_per_s(sessions, length));
    rounds.push_extreme("sessions_ended", (sessions - sample.open) as f64);
    rounds.push_extreme("stop_s", stopped.map(|time| time.as_secs_f64()));
    all_alone.extend(alone.latencies);
    Ok(())
}

/// The slowest liveness probe, milliseconds, while sessions send the largest view that the server
/// accepts without pause; none without a flood.
pub async fn slowest_probe_ms(
    server: &ServerProcess,
    sessions: usize,
    length: Duration,
) -> Result<Option<f64>> {
    let flood = Flood::start(server.address, Kind::Largest, sessions, None)?;
    let probes = probe(server.address, Instant::now() + length).await?;
    let took_place = flood.sample(server).await.took_place(sessions, length);
    Ok(quantile_ms(probes, 1.0).filter(|_| took_place))
}

/// The p90 of a polite client, milliseconds, while sessions send the largest view that the server
/// accepts without pause; none without a flood.
pub async fn polite_p90_ms(
    server: &ServerProcess,
    sessions: usize,
    keys: &[ChunkKey],
    length: Duration,
) -> Result<Option<f64>> {
    let flood = Flood::start(server.address, Kind::Largest, sessions, None)?;
    let polite = polite(server.address, keys.to_vec(), DENSE_INTERVAL, Instant::now() + length).await?;
    let took_place = flood.sample(server).await.took_place(sessions, length);
    Ok(Some(polite.p90_ms()).filter(|_| took_place))
}

/// Sessions that flood a server, on a thread of their own, so that they do not delay the measured
/// clients. They end when this is dropped.
struct Flood {
    threads: Option<Runtime>,
    sessions: Vec<JoinHandle<Result<()>>>,
}

impl Flood {
    fn start(address: SocketAddr, kind: Kind, sessions: usize, rate: Option<u32>) -> Result<Self> {
        let threads = other_thread()?;
        let sessions = (0..sessions).map(|_| threads.spawn(flood(address, kind, rate))).collect();
        Ok(Self { threads: Some(threads), sessions })
    }

    /// The state of the flood now.
    async fn sample(&self, server: &ServerProcess) -> Sample {
        let open = self.sessions.iter().filter(|session| !session.is_finished()).count();
        let [selected, superseded, refused] = series::VIEWS;
        let names = [selected, superseded, refused, series::VIEW_SECONDS];
        let metrics = tokio::time::timeout(METRICS_TIMEOUT, server.metrics(names)).await;
        let metrics = metrics.ok().and_then(Result::ok);
        let views = metrics.map(|[selected, superseded, refused, _]| selected + superseded + refused);
        Sample { open, views, view_seconds: metrics.map(|metrics| metrics[3]) }
    }
}

impl Drop for Flood {
    fn drop(&mut self) {
        // A runtime that is dropped would wait, which a task must not.
        if let Some(threads) = self.threads.take() {
            threads.shutdown_background();
        }
    }
}

/// The observed state of a flood.
#[derive(Clone, Copy, Debug)]
struct Sample {
    /// Sessions that are still open.
    open: usize,
    /// Views that the server counted, whatever became of them; none if it did not say.
    views: Option<f64>,
    /// CPU seconds that it spent on them.
    view_seconds: Option<f64>,
}

impl Sample {
    fn views_per_s(self, sessions: usize, length: Duration) -> Option<f64> {
        Some(self.views? / sessions as f64 / length.as_secs_f64())
    }

    fn took_place(self, sessions: usize, length: Duration) -> bool {
        self.open == sessions && self.views_per_s(sessions, length) >= Some(LEAST_VIEWS_PER_S)
    }
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
    // The control: a server that sees no views is not flooded.
    let views = least(of("views_per_s_of_session"));
    let ended = worst(of("sessions_ended"));
    let took_place = views >= Some(LEAST_VIEWS_PER_S) && ended == Some(0.0);
    let whole = |figure: Option<f64>| figure.filter(|_| took_place && scenarios.len() == SCENARIOS);
    let worst_of = |field| whole(worst(of(field)));
    let share = whole(least(of("polite_chunks_share")));
    let alone = at(figures, "polite_p99_alone_ms").unwrap_or(f64::NAN);
    let worst_note = "the worst of all scenarios";
    let share_note = format!("{worst_note}; a chunk counts that comes up to 2 s after the end");
    let alone_p90 = at(figures, "polite_p90_alone_ms").unwrap_or(f64::NAN);
    let p90_note = format!("{worst_note}; alone {alone_p90:.2} ms");
    let p99_note = format!("{worst_note}; alone {alone:.2} ms, of all scenarios together");
    vec![
        Bar::at_most("flood: liveness probe, slowest", worst_of("probe_worst_ms"), "ms", 100.0)
            .with_note(worst_note),
        Bar::at_least("flood: chunks of a polite client over alone", share, "", 0.8).with_note(share_note),
        Bar::at_most("flood: polite p99 over alone", worst_of("polite_p99_ratio"), "x", 3.0)
            .with_note(p99_note),
        Bar::reported("flood: polite p90 over alone", worst_of("polite_p90_ratio"), "x").with_note(p90_note),
        Bar::reported(
            "flood: the same beside busy threads of another program, without a flood (control)",
            at(figures, "busy/polite_p99_ratio"),
            "x",
        )
        .with_note("a thread on each core, nice 3 like those of generation; the worst run"),
        Bar::at_most("flood: stop on SIGTERM", worst_of("stop_s"), "s", 10.0).with_note(worst_note),
        Bar::at_least(
            "flood: views a second of a session that the server counted, fewest (control)",
            views,
            "",
            LEAST_VIEWS_PER_S,
        )
        .with_note(
            "selected, superseded or refused; with fewer, or sessions that ended, there are no figures",
        ),
        Bar::none("flood: flooding sessions that ended before the measured time (control)", ended),
    ]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::test_bars::{check, check_absent, check_without_peers};

    #[test]
    fn each_bar_can_be_missed_by_one_scenario() {
        let scenario = json!({
            "probe_worst_ms": 40.0, "polite_chunks_share": 0.97, "stop_s": 0.4,
            "polite_p90_ratio": 1.2, "polite_p99_ratio": 1.5,
            "views_per_s_of_session": 60.0, "sessions_ended": 0.0,
        });
        let good = json!({ "scenarios": vec![scenario; SCENARIOS], "busy": { "polite_p99_ratio": 5.0 } });
        let bad = [
            ("/scenarios/3/probe_worst_ms", json!(101.0)),
            ("/scenarios/0/polite_chunks_share", json!(0.79)),
            ("/scenarios/23/polite_p99_ratio", json!(3.1)),
            ("/scenarios/7/stop_s", json!(null)),
        ];
        check(bars, &good, &bad);
        check_absent(
            bars,
            &good,
            &[("", "scenarios", 7), ("/scenarios/5", "stop_s", 1), ("/busy", "polite_p99_ratio", 1)],
        );
        check_without_peers(bars, &good, "/scenarios", json!(list(&good, "scenarios")[1..]));
    }

    #[test]
    fn without_a_flood_in_one_scenario_there_are_no_figures() {
        let scenario = json!({
            "probe_worst_ms": 40.0, "polite_chunks_share": 0.97, "stop_s": 0.4,
            "polite_p90_ratio": 1.2, "polite_p99_ratio": 1.5,
            "views_per_s_of_session": 60.0, "sessions_ended": 0.0,
        });
        let good = json!({ "scenarios": vec![scenario; SCENARIOS], "busy": { "polite_p99_ratio": 5.0 } });
        for (path, value) in [
            ("views_per_s_of_session", json!(0.9)),
            ("sessions_ended", json!(1)),
            ("sessions_ended", json!(null)),
        ] {
            let mut figures = good.clone();
            figures["scenarios"][9][path] = value;
            let missed: Vec<_> = bars(&figures).into_iter().filter(Bar::is_missed).collect();
            assert_eq!(missed.len(), 6, "{missed:#?}");
        }
    }

    #[test]
    fn a_flood_is_all_sessions_and_enough_views() {
        let took_place =
            |open, views| Sample { open, views, view_seconds: None }.took_place(4, Duration::from_secs(10));
        assert!(took_place(4, Some(40.0)));
        assert!(!took_place(3, Some(40.0)) && !took_place(4, Some(39.0)) && !took_place(4, None));
    }
}
