//! The effect of each mechanism against overload: a load that needs it, on a server with it and on
//! one without it, in turn.
//!
//! Each figure is of one load that was chosen for its mechanism. Under other loads a mechanism may
//! do nothing; together they may do less than the sum.

use crate::Plan;
use crate::clients::{Window, closed_loop, rotated, run_all, waits};
use crate::connection::Connection;
use crate::flood;
use crate::keys::{WORLD_SEED, land_keys};
use crate::mechanism::Mechanism;
use crate::overload::{self, LoadFigures, capacity, send_at_rates};
use crate::rounds::{Rounds, quantile_ms};
use crate::server_process::{Launch, ServerProcess};
use anyhow::{Context, Result};
use bars::Bar;
use bars::figures::{at, each, list, ratio, text};
use clap::ValueEnum;
use serde_json::{Value, json};
use std::net::{IpAddr, Ipv4Addr};
use std::time::{Duration, Instant};
use terrain::{ChunkKey, Land};

/// Places for sessions, and how many a second address asks for after the first has taken what it
/// can.
const PLACES: usize = 64;
const SECOND_ADDRESS: usize = 16;

/// Clients with few requests for cheap chunks, and how many each.
const POLITE: usize = 16;
const POLITE_WINDOW: usize = 4;

/// Clients with many requests for chunks of a coarse level, which cost many times more.
const GREEDY: usize = 8;
const GREEDY_WINDOW: usize = 64;
const COARSE_LEVEL: u8 = 8;

/// Requests outstanding of each client that repeats rejected requests at once. There are as many
/// clients as in `overload`.
const REPEATED_WINDOW: usize = 1000;

/// Sessions that send views without pause.
const FLOODING: usize = 8;

/// Load at which requests wait for their deadline, as a multiple of the capacity.
const OVERLOAD: f64 = 2.0;

/// Time in which late answers still arrive.
const DRAIN: Duration = Duration::from_secs(4);

/// Different chunks, requested in turn. The cache of 1 MiB holds some 400 of them.
const CHUNKS: usize = 16 * 1024;
const COARSE_CHUNKS: usize = 2048;

/// Name of the control: the same server on both sides.
const CONTROL: &str = "nothing";

/// The figure that a load measures.
#[derive(Clone, Copy, Debug)]
struct Figure {
    name: &'static str,
    unit: &'static str,
    /// Whether more is better.
    more_is_better: bool,
    /// The least factor by which a server without the mechanism must be worse, so that the
    /// mechanism counts as having an effect; of the control the factor by which it may be better or
    /// worse.
    least_effect: f64,
}

/// The figure of a mechanism; of the control without one.
const fn figure(mechanism: Option<Mechanism>) -> Figure {
    // By CPU time, so that other programs on the machine matter little.
    const PER_CPU_S: &str = "new chunks a CPU second";
    const REPEATED: &str = "new chunks a CPU second, rejected requests repeated";
    let (name, unit, more_is_better, least_effect) = match mechanism {
        Some(Mechanism::SessionsPerAddress) => ("sessions that a second address gets", "", true, 2.0),
        Some(Mechanism::RateLimit) => ("share of a core that one address takes", "", false, 2.0),
        Some(Mechanism::Turns) => ("p99 of polite clients beside coarse requests", "ms", false, 1.5),
        Some(Mechanism::Deadline) => ("p99 of chunks at twice the capacity", "ms", false, 1.5),
        Some(Mechanism::RefusalBackoff) => (REPEATED, "", true, 1.2),
        Some(Mechanism::ViewTurns) => ("slowest liveness probe in a flood of views", "ms", false, 1.5),
        Some(Mechanism::ViewYields) => ("p90 of a polite client in a flood of views", "ms", false, 1.5),
        Some(Mechanism::FastEffort) => (PER_CPU_S, "", true, 1.05),
        None => (PER_CPU_S, "", true, 1.03),
    };
    Figure { name, unit, more_is_better, least_effect }
}

/// The chunks that loads request.
struct Keys {
    cheap: Vec<ChunkKey>,
    coarse: Vec<ChunkKey>,
}

/// Runs the benchmark: for each mechanism a server with it and one without it in each round.
pub async fn run(plan: &Plan) -> Result<Value> {
    let land = Land::new(WORLD_SEED);
    let keys =
        Keys { cheap: land_keys(&land, 0, CHUNKS), coarse: land_keys(&land, COARSE_LEVEL, COARSE_CHUNKS) };
    let launch = Launch { without: None, ..plan.launch.clone() };
    let chosen = Mechanism::value_variants().iter().copied();
    let chosen = chosen.filter(|mechanism| plan.launch.without.is_none_or(|only| only == *mechanism));
    let mut mechanisms = Vec::new();
    for mechanism in chosen.map(Some).chain([None]) {
        let name = mechanism.map_or(CONTROL, Mechanism::name);
        let mut rounds = Rounds::default();
        for round in 0..plan.rounds {
            // The order alternates, so that a trend of the machine favours neither.
            for is_on in [round % 2 == 0, round % 2 != 0] {
                let options = mechanism
                    .map_or(&[][..], |mechanism| if is_on { mechanism.on() } else { mechanism.off() });
                let value = measure(mechanism, &launch, options, plan, &keys).await;
                let value = value.with_context(|| format!("{name}, on: {is_on}"))?;
                rounds.push(if is_on { "with" } else { "without" }, value);
            }
        }
        let Figure { name: figure, unit, .. } = figure(mechanism);
        mechanisms.push(rounds.add_to(json!({ "mechanism": name, "figure": figure, "unit": unit })));
    }
    Ok(json!({ "mechanisms": mechanisms }))
}

/// The mechanism's figure of one server.
async fn measure(
    mechanism: Option<Mechanism>,
    launch: &Launch,
    options: &[&str],
    plan: &Plan,
    keys: &Keys,
) -> Result<Option<f64>> {
    let places = PLACES.to_string();
    let own: &[&str] = match mechanism {
        Some(Mechanism::SessionsPerAddress) => &["--max-sessions", &places],
        _ => &["--cache-mb", "1"],
    };
    let server = ServerProcess::start(launch, &[own, options].concat())?;
    let length = Duration::from_secs(plan.seconds);
    let (cheap, before) = (&keys.cheap, server.process.cpu_s()?);
    let window = match mechanism {
        Some(Mechanism::SessionsPerAddress) => return Ok(Some(second_address(&server).await as f64)),
        Some(Mechanism::RateLimit) => return cpu_share(&server, cheap, length).await.map(Some),
        Some(Mechanism::Turns) => return polite_p99_ms(&server, keys, length).await,
        Some(Mechanism::Deadline) => return overloaded_p99_ms(&server, cheap, length).await,
        Some(Mechanism::ViewTurns) => return flood::slowest_probe_ms(&server, FLOODING, length).await,
        Some(Mechanism::ViewYields) => return flood::polite_p90_ms(&server, FLOODING, cheap, length).await,
        Some(Mechanism::RefusalBackoff) => REPEATED_WINDOW,
        Some(Mechanism::FastEffort) | None => overload::WINDOW,
    };
    let chunks = saturated(&server, cheap, window, length).await?;
    Ok(Some(chunks as f64 / (server.process.cpu_s()? - before)))
}

/// Sessions that a second address gets after a first one has asked for all places.
async fn second_address(server: &ServerProcess) -> usize {
    let mut open = Vec::new();
    let mut counts = [0; 2];
    for (count, (host, asked)) in counts.iter_mut().zip([(1, PLACES), (2, SECOND_ADDRESS)]) {
        let source = IpAddr::from(Ipv4Addr::new(127, 0, 0, host));
        for _ in 0..asked {
            // A refusal is an error.
            let session = Connection::connect_from(source, server.address).await.ok();
            *count += usize::from(session.is_some());
            open.extend(session);
        }
    }
    counts[1]
}

/// CPU time of the server over wall time, while one client requests new chunks in a closed loop.
async fn cpu_share(server: &ServerProcess, keys: &[ChunkKey], length: Duration) -> Result<f64> {
    let mut client = Connection::connect(server.address).await?;
    let (before, started) = (server.process.cpu_s()?, Instant::now());
    let keys = keys.iter().copied().cycle();
    let window = Window::OneByOne(REPEATED_WINDOW);
    closed_loop(&mut client, keys, window, Some(started + length), |_| ()).await?;
    Ok((server.process.cpu_s()? - before) / started.elapsed().as_secs_f64())
}

/// The p99 of clients with few requests for cheap chunks beside clients with many for coarse ones.
/// A refused request counts as the whole length.
async fn polite_p99_ms(server: &ServerProcess, keys: &Keys, length: Duration) -> Result<Option<f64>> {
    let connections = server.connect(POLITE + GREEDY).await?;
    let start = Instant::now();
    let latencies = run_all(connections, |index, mut connection| {
        let is_polite = index < POLITE;
        let own = if is_polite {
            rotated(&keys.cheap, index, POLITE)
        } else {
            rotated(&keys.coarse, index - POLITE, GREEDY)
        };
        let window = if is_polite { POLITE_WINDOW } else { GREEDY_WINDOW };
        async move {
            let keys = own.into_iter().cycle();
            let mut waits = waits(&mut connection, keys, window, start, start + length).await?;
            waits.latencies.extend(std::iter::repeat_n(length, waits.refused));
            Ok(if is_polite { waits.latencies } else { Vec::new() })
        }
    });
    Ok(quantile_ms(latencies.await?.concat(), 0.99))
}

/// The p99 of chunks at [`OVERLOAD`] times the capacity.
async fn overloaded_p99_ms(
    server: &ServerProcess,
    keys: &[ChunkKey],
    length: Duration,
) -> Result<Option<f64>> {
    let rate = OVERLOAD * capacity(server, keys, length).await?;
    let requests = send_at_rates(server, keys, &[(rate, length), (0.0, DRAIN)]).await?;
    Ok(LoadFigures::new(&requests, length).chunk_p99_ms)
}

/// Chunks that all clients get with full windows. A rejected request is followed by another at
/// once.
async fn saturated(
    server: &ServerProcess,
    keys: &[ChunkKey],
    window: usize,
    length: Duration,
) -> Result<u64> {
    let connections = server.connect(overload::CONNECTIONS).await?;
    let end = Instant::now() + length;
    let totals = run_all(connections, |index, mut connection| {
        let keys = rotated(keys, index, overload::CONNECTIONS).into_iter().cycle();
        async move { closed_loop(&mut connection, keys, Window::OneByOne(window), Some(end), |_| ()).await }
    });
    Ok(totals.await?.iter().map(|totals| totals.chunks).sum())
}

/// How many times worse a server is without a mechanism; none without both figures. Nothing at all
/// counts as one.
fn effect(figures: &Value, more_is_better: bool) -> Option<f64> {
    let (with, without) = (at(figures, "with"), at(figures, "without"));
    if more_is_better { ratio(with, without.map(|value| value.max(1.0))) } else { ratio(without, with) }
}

/// The bars of this benchmark: one for each mechanism that was measured, and the control.
pub fn bars(figures: &Value) -> Vec<Bar> {
    let row = |figures: &Value| {
        let measured = text(figures, "mechanism")?;
        let known = Mechanism::value_variants().iter().copied().map(Some).chain([None]);
        let mechanism = known.into_iter().find(|known| known.map_or(CONTROL, Mechanism::name) == measured)?;
        let Figure { name, least_effect, more_is_better, .. } = figure(mechanism);
        let (row, effect) = (format!("without {measured}: {name}"), effect(figures, more_is_better));
        Some(match mechanism {
            Some(_) => Bar::at_least(format!("{row}, worse by"), effect, "x", least_effect),
            None => {
                // In either direction: a machine that is not steady may favour any side.
                let apart = effect.map(|effect| effect.max(1.0 / effect));
                Bar::under(format!("{row}, apart by (control)"), apart, "x", least_effect)
            }
        })
    };
    let rows: Vec<_> = list(figures, "mechanisms").iter().filter_map(row).collect();
    if rows.len() > 1 { rows } else { vec![Bar::some("mechanisms measured", None)] }
}

/// Further figures in sentences.
pub fn notes(figures: &Value) -> Vec<String> {
    let line = "Mechanism {mechanism}: {figure}: {with:.1} {unit} with it, {without:.1} {unit} \
                without; round by round {with_rounds:.1} and {without_rounds:.1}.";
    each(figures, "mechanisms", line).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::test_bars::{check_absent, missed};

    fn of(mechanism: Option<Mechanism>, with: f64, without: f64) -> Value {
        json!({ "mechanism": mechanism.map_or(CONTROL, Mechanism::name), "with": with, "without": without })
    }

    #[test]
    fn each_bar_can_be_missed() {
        let good = json!({ "mechanisms": [
            of(Some(Mechanism::SessionsPerAddress), 16.0, 0.0),
            of(Some(Mechanism::Deadline), 500.0, 2000.0),
            of(Some(Mechanism::FastEffort), 25_000.0, 20_000.0),
            of(None, 25_000.0, 25_100.0),
        ] });
        let bad = [
            ("/mechanisms/0/without", json!(16.0)),
            ("/mechanisms/1/without", json!(500.0)),
            ("/mechanisms/2/with", json!(20_000.0)),
            // The machine was not steady: no effect of this size means anything.
            ("/mechanisms/3/without", json!(20_000.0)),
            ("/mechanisms/3/without", json!(31_000.0)),
            ("/mechanisms/3/with", json!(0.0)),
        ];
        for (path, value) in bad {
            let mut figures = good.clone();
            *figures.pointer_mut(path).expect(path) = value;
            assert_eq!(missed(bars, &figures), 1, "{path}");
        }
        assert_eq!((missed(bars, &good), missed(bars, &Value::Null)), (0, 1));
        check_absent(bars, &good, &[("/mechanisms/1", "with", 1), ("", "mechanisms", 1)]);
    }

    #[test]
    fn a_server_that_is_the_same_on_both_sides_misses_every_row_but_the_control() {
        let all = Mechanism::value_variants().iter().copied().map(Some).chain([None]);
        let same: Vec<_> = all.map(|mechanism| of(mechanism, 10.0, 10.0)).collect();
        let figures = json!({ "mechanisms": same });
        assert_eq!(missed(bars, &figures), Mechanism::value_variants().len());
    }
}
