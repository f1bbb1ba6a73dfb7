//! More than the server can do: arrivals at a fixed rate whatever is answered, from half of its
//! capacity to five times as much.

use super::host::Host;
use super::land_keys::{WORLD_SEED, land_keys};
use super::stats::{median, ms, quantile};
use super::wire::{Arrived, Wire};
use super::{Plan, to_end};
use anyhow::{Context, Result};
use protocol::chunk_codec;
use protocol::message::ServerMessage;
use rustc_hash::FxHashMap;
use serde_json::{Value, json};
use std::time::{Duration, Instant};
use terrain::{ChunkKey, Land};

/// Connections that the arrivals are spread over.
const CONNECTIONS: usize = 64;

/// Different chunks; asked for round and round from a cache that holds a hundredth of them.
const CHUNKS: usize = 16 * 1024;

/// Loads as multiples of what was measured as capacity. The last is the overload that is judged.
const LOADS: [f64; 5] = [0.5, 0.8, 1.0, 2.0, 5.0];

/// Load after the overload.
const CALM: f64 = 0.5;

/// Time between two bursts of one connection; the bursts of all are spread over it.
const BURST: Duration = Duration::from_millis(10);

/// Width of the windows in which the return to normal is looked for, and for how long.
const LOOK: Duration = Duration::from_millis(100);
const LOOK_FOR: Duration = Duration::from_secs(4);

/// Runs the benchmark: every round in a fresh server. Figures are medians; the loads are those of
/// the last round.
///
/// # Errors
/// The server fails.
pub async fn run(plan: &Plan) -> Result<Value> {
    let keys = land_keys(&Land::new(WORLD_SEED), CHUNKS);
    let mut rounds = Vec::new();
    for _ in 0..plan.rounds {
        rounds.push(round(plan, &keys).await?);
    }
    let all = |figure: fn(&Round) -> Option<f64>| rounds.iter().filter_map(figure).collect::<Vec<_>>();
    let goodput_of_peak = all(|round| Some(round.goodput_of_peak));
    // A round in which nothing was refused, or that never became normal again, has no such figure,
    // and then there is none.
    let whole = |figures: Vec<f64>| median(figures.clone()).filter(|_| figures.len() == rounds.len());
    let last = rounds.last().context("no round was run")?;
    Ok(json!({
        "connections": CONNECTIONS,
        "rounds": plan.rounds,
        "capacity_per_s": last.capacity,
        "loads": last.loads,
        "peak_goodput_per_s": last.peak,
        "goodput_of_peak": median(goodput_of_peak.clone()),
        "goodput_of_peak_rounds": goodput_of_peak,
        "refusal_p99_ms": whole(all(|round| round.refusal_p99_ms)),
        "normal_p99_ms": whole(all(|round| Some(round.normal_p99_ms))),
        "recovery_s": whole(all(|round| round.recovery_s)),
    }))
}

/// What one round came to.
struct Round {
    /// Chunks a second with full windows.
    capacity: f64,
    /// One value for each of [`LOADS`].
    loads: Vec<Value>,
    /// The most chunks a second at any load.
    peak: f64,
    goodput_of_peak: f64,
    refusal_p99_ms: Option<f64>,
    normal_p99_ms: f64,
    recovery_s: Option<f64>,
}

async fn round(plan: &Plan, keys: &[ChunkKey]) -> Result<Round> {
    let host = Host::start(&plan.launch, &["--cache-mb", "1"])?;
    let length = Duration::from_secs(plan.seconds);
    let capacity = capacity(&host, keys, length).await?;
    let (mut loads, mut peak, mut normal_p99) = (Vec::new(), 0.0f64, f64::NAN);
    let mut last = None;
    for load in LOADS {
        let calm = if load == LOADS[LOADS.len() - 1] { LOOK_FOR } else { Duration::ZERO };
        let outcome = arrivals(&host, keys, &[(load * capacity, length), (CALM * capacity, calm)]).await?;
        let mut answered: Vec<_> =
            outcome.answers.iter().filter(|answer| answer.is_in(length)).copied().collect();
        let goodput = answered.iter().filter(|answer| answer.is_chunk).count() as f64 / length.as_secs_f64();
        peak = peak.max(goodput);
        let p99 = |is_chunk: bool, answers: &mut Vec<Answer>| {
            let mut waits: Vec<_> = answers
                .iter()
                .filter(|answer| answer.is_chunk == is_chunk)
                .map(|answer| answer.wait)
                .collect();
            quantile(&mut waits, 0.99).map(ms)
        };
        let (chunk_p99, refusal_p99) = (p99(true, &mut answered), p99(false, &mut answered));
        if load == CALM {
            normal_p99 = chunk_p99.unwrap_or(f64::NAN);
        }
        loads.push(json!({
            "load": load,
            "offered_per_s": load * capacity,
            "sent_per_s": outcome.sent as f64 / length.as_secs_f64(),
            "goodput_per_s": goodput,
            "chunk_p99_ms": chunk_p99,
            "refused": answered.iter().filter(|answer| !answer.is_chunk).count(),
            "refusal_p99_ms": refusal_p99,
        }));
        last = Some((goodput, refusal_p99, outcome));
    }
    let (goodput, refusal_p99, outcome) = last.context("no load was run")?;
    Ok(Round {
        capacity,
        loads,
        peak,
        goodput_of_peak: goodput / peak,
        refusal_p99_ms: refusal_p99,
        normal_p99_ms: normal_p99,
        recovery_s: recovery(&outcome, length, normal_p99),
    })
}

/// Seconds from the end of the overload until chunks take no longer than twice the normal 99th
/// percentile (at least 50 ms, what the scheduler of two shared cores alone can take), window by
/// window, for the rest of the run; none if that never comes.
fn recovery(outcome: &Outcome, length: Duration, normal_p99_ms: f64) -> Option<f64> {
    let bound_ms = (2.0 * normal_p99_ms).max(50.0);
    let n_windows = (LOOK_FOR.as_millis() / LOOK.as_millis()) as u32;
    let is_calm = |window: u32| {
        let (from, to) = (length + LOOK * window, length + LOOK * (window + 1));
        let inside = outcome.answers.iter().filter(|answer| (from..to).contains(&answer.asked));
        let mut waits: Vec<_> = inside.map(|answer| answer.wait).collect();
        quantile(&mut waits, 0.99).is_some_and(|wait| ms(wait) <= bound_ms)
    };
    // The last window's answers may come after the end of the run.
    let unquiet = (0..n_windows - 1).rev().find(|window| !is_calm(*window));
    match unquiet {
        Some(window) if window + 2 >= n_windows => None,
        Some(window) => Some((LOOK * (window + 1)).as_secs_f64()),
        None => Some(0.0),
    }
}

/// One answer.
#[derive(Clone, Copy)]
struct Answer {
    /// When it was due to be asked for, since the start of the run.
    asked: Duration,
    /// From then to the answer.
    wait: Duration,
    is_chunk: bool,
}

impl Answer {
    fn is_in(&self, length: Duration) -> bool {
        self.asked + self.wait < length
    }
}

struct Outcome {
    sent: u64,
    answers: Vec<Answer>,
}

/// Chunks a second with a full window on each connection.
async fn capacity(host: &Host, keys: &[ChunkKey], length: Duration) -> Result<f64> {
    let started = Instant::now();
    let mut clients = Vec::new();
    for (index, own) in keys.chunks(CHUNKS / CONNECTIONS).take(CONNECTIONS).enumerate() {
        let (mut wire, own) = (Wire::connect(host.address).await?, own.to_vec());
        clients.push(tokio::spawn(async move {
            let mut next = own.iter().copied().cycle().skip(index);
            wire.request(next.by_ref().take(16)).await?;
            let mut count = 0usize;
            while started.elapsed() < length {
                let mut answered = 0;
                wire.receive(|arrived| {
                    answered += 1;
                    count += usize::from(matches!(arrived, Arrived::Chunk(_)));
                })
                .await?;
                wire.request(next.by_ref().take(answered)).await?;
            }
            Ok(count)
        }));
    }
    let count: usize = to_end(clients).await?.into_iter().sum();
    Ok(count as f64 / started.elapsed().as_secs_f64())
}

/// Arrivals at one rate (a second, all connections together) after the other, each for a time.
async fn arrivals(host: &Host, keys: &[ChunkKey], rates: &[(f64, Duration)]) -> Result<Outcome> {
    let mut wires = Vec::new();
    for _ in 0..CONNECTIONS {
        wires.push(Wire::connect(host.address).await?);
    }
    let started = Instant::now() + BURST;
    let clients = wires.into_iter().enumerate().map(|(index, wire)| {
        let own: Vec<_> =
            keys.iter().copied().cycle().skip(index * CHUNKS / CONNECTIONS).take(CHUNKS).collect();
        let rates: Vec<_> = rates.iter().map(|(rate, time)| (rate / CONNECTIONS as f64, *time)).collect();
        let phase = BURST * index as u32 / CONNECTIONS as u32;
        tokio::spawn(arrive(wire, own, rates, started + phase))
    });
    let outcomes = to_end(clients.collect()).await?;
    Ok(outcomes.into_iter().fold(Outcome { sent: 0, answers: Vec::new() }, |mut all, one| {
        all.sent += one.sent;
        all.answers.extend(one.answers);
        all
    }))
}

/// Arrivals due at one connection by a time since the start.
fn due(rates: &[(f64, Duration)], mut elapsed: Duration) -> f64 {
    let mut count = 0.0;
    for (rate, time) in rates {
        count += rate * elapsed.min(*time).as_secs_f64();
        elapsed = elapsed.saturating_sub(*time);
    }
    count
}

async fn arrive(
    mut wire: Wire,
    keys: Vec<ChunkKey>,
    rates: Vec<(f64, Duration)>,
    started: Instant,
) -> Result<Outcome> {
    let mut next = keys.iter().copied().cycle();
    // By key: a client does not ask for a chunk again before 16,384 others.
    let mut open: FxHashMap<ChunkKey, Duration> = FxHashMap::default();
    let mut outcome = Outcome { sent: 0, answers: Vec::new() };
    let length: Duration = rates.iter().map(|(_, time)| *time).sum();
    let mut ticks = tokio::time::interval_at(started.into(), BURST);
    loop {
        tokio::select! {
            tick = ticks.tick() => {
                // When the burst was due, which may be a while ago on a busy machine: a client that
                // is late does not flatter the server. Bursts that were missed follow at once.
                let now = tick.into_std().saturating_duration_since(started);
                if now >= length {
                    return Ok(outcome);
                }
                let due = due(&rates, now) as u64;
                let burst: Vec<_> = next.by_ref().take((due - outcome.sent.min(due)) as usize).collect();
                if burst.is_empty() {
                    continue;
                }
                open.extend(burst.iter().map(|key| (*key, now)));
                outcome.sent += burst.len() as u64;
                wire.request(burst).await?;
            }
            received = wire.receive(|arrived| {
                let (key, is_chunk) = match arrived {
                    Arrived::Chunk(frame) => (chunk_codec::kind_and_key(frame).ok().map(|(_, key)| key), true),
                    Arrived::Message(ServerMessage::Refused(refused)) => {
                        (refused.key.and_then(|key| key.check().ok()), false)
                    }
                    Arrived::Message(_) => (None, false),
                };
                if let Some(asked) = key.and_then(|key| open.remove(&key)) {
                    let wait = started.elapsed().saturating_sub(asked);
                    outcome.answers.push(Answer { asked, wait, is_chunk });
                }
            }) => received?,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn arrivals_are_due_by_rate_and_time_and_stop_at_the_end() {
        let second = Duration::from_secs(1);
        let rates = [(100.0, second), (10.0, 2 * second)];
        assert_eq!(
            [0, 500, 1000, 2000, 3000, 9000].map(|ms| due(&rates, Duration::from_millis(ms))),
            [0.0, 50.0, 100.0, 110.0, 120.0, 120.0]
        );
    }

    #[test]
    fn recovery_is_the_end_of_the_last_window_with_a_slow_answer() {
        let length = Duration::from_secs(1);
        let answers = |slow_until_ms: u64| {
            (0..LOOK_FOR.as_millis() as u64)
                .map(|at| Answer {
                    asked: length + Duration::from_millis(at),
                    wait: Duration::from_millis(if at < slow_until_ms { 300 } else { 3 }),
                    is_chunk: true,
                })
                .collect()
        };
        let seconds =
            |slow_until_ms| recovery(&Outcome { sent: 0, answers: answers(slow_until_ms) }, length, 5.0);
        assert_eq!([0, 150, 1000].map(seconds), [Some(0.0), Some(0.2), Some(1.0)]);
        assert_eq!(seconds(10_000), None);
    }
}
