//! Open-loop load at a fixed rate, from half of the server's capacity to five times as much, and
//! the recovery afterwards.
//!
//! Every time counts from when a request was due, so a late client or a full socket cannot improve
//! a figure.

use crate::Plan;
use crate::clients::{Window, closed_loop, rotated, run_all};
use crate::connection::{Connection, Received};
use crate::keys::{WORLD_SEED, land_keys};
use crate::rounds::{Rounds, ms, quantile_ms};
use crate::server_process::ServerProcess;
use anyhow::{Context, Result};
use bars::Bar;
use bars::figures::{at, fill, list};
use rustc_hash::FxHashMap;
use serde_json::{Value, json};
use std::time::{Duration, Instant};
use terrain::{ChunkKey, Land};

/// Connections that the requests are spread over.
pub const CONNECTIONS: usize = 64;

/// Requests outstanding on each connection in the closed loop that measures the capacity.
pub const WINDOW: usize = 16;

/// Different chunks, requested in turn. The cache of 1 MiB holds some 400 of them.
const CHUNKS: usize = 16 * 1024;

/// Loads as multiples of the capacity. The last one is judged.
const LOADS: [f64; 5] = [0.5, 0.8, 1.0, 2.0, 5.0];

/// Load after the last one, while the server recovers; also the load whose latency is normal.
const PARTIAL: f64 = 0.5;

/// Time between two bursts of one connection; the bursts of all connections are spread over it. A
/// request is sent up to this long after it was due, which its latency includes.
const BURST: Duration = Duration::from_millis(4);

/// Width of the windows of the recovery, and the time that they cover.
const RECOVERY_WINDOW: Duration = Duration::from_millis(100);
const RECOVERY: Duration = Duration::from_secs(4);

/// Time after the other loads in which late answers are still counted.
const DRAIN: Duration = Duration::from_secs(1);

/// Least values of the threshold up to which a latency is normal, milliseconds: the threshold is
/// `max(2 x p99 at half load, floor)`. The first is what the scheduler of two shared cores alone
/// can add; the second is reported beside it.
const NORMAL_FLOORS_MS: [f64; 2] = [50.0, 20.0];

/// How the recovery is defined, for readers of the figures.
const RECOVERY_DEFINITION: &str = "seconds from the end of the overload to the end of the last \
    100 ms window that is not normal, at half of the capacity; a window is normal if at least 99 % \
    of the requests due in it were answered with a chunk within max(2 x p99 at half load, floor); a \
    refusal or no answer is not";

/// How the goodput is judged, for readers of the figures.
const GOODPUT_DEFINITION: &str = "chunks a second at five times the capacity over the highest rate \
    of any round at any load, the closed loops that measured the capacity included";

/// Runs the benchmark, every round in a fresh server. Figures are medians over the rounds; `loads`
/// are those of the last round.
pub async fn run(plan: &Plan) -> Result<Value> {
    let keys = land_keys(&Land::new(WORLD_SEED), 0, CHUNKS);
    let (mut rounds, mut last, mut goodputs) = (Rounds::default(), None, Vec::new());
    let (mut peak, mut most_unanswered) = (0.0_f64, 0);
    for _ in 0..plan.rounds {
        let round = round(plan, &keys).await?;
        peak = peak.max(round.peak);
        goodputs.push(round.goodput);
        most_unanswered = most_unanswered.max(round.unanswered);
        // A round without refusals or without recovery has no such figure; then the run has none.
        rounds.push("refusal_p99_ms", round.refusal_p99_ms);
        rounds.push("normal_p99_ms", round.normal_p99_ms);
        rounds.push("recovery_s", round.recovery_s[0]);
        rounds.push("recovery_s_strict", round.recovery_s[1]);
        last = Some(round);
    }
    let last = last.context("no round was run")?;
    for goodput in &goodputs {
        rounds.push("goodput_of_peak", goodput / peak);
    }
    let lowest = goodputs.into_iter().fold(f64::INFINITY, f64::min);
    Ok(rounds.add_to(json!({
        "connections": CONNECTIONS,
        "burst_ms": ms(BURST),
        "capacity_per_s": last.capacity,
        "loads": last.loads,
        "peak_per_s": peak,
        "goodput_of_peak_worst": lowest / peak,
        "unanswered_worst": most_unanswered,
        "goodput_definition": GOODPUT_DEFINITION,
        "recovery_floor_ms": NORMAL_FLOORS_MS[0],
        "recovery_floor_ms_strict": NORMAL_FLOORS_MS[1],
        "recovery_definition": RECOVERY_DEFINITION,
    })))
}

/// Figures of one round.
struct Round {
    /// Chunks a second with full windows.
    capacity: f64,
    /// One value for each of [`LOADS`].
    loads: Vec<Value>,
    /// The highest rate of chunks, the capacity included.
    peak: f64,
    /// Chunks a second at the last load.
    goodput: f64,
    refusal_p99_ms: Option<f64>,
    normal_p99_ms: Option<f64>,
    /// Requests without an answer until the end of their run, at all loads.
    unanswered: usize,
    /// One value for each of [`NORMAL_FLOORS_MS`].
    recovery_s: [Option<f64>; 2],
}

async fn round(plan: &Plan, keys: &[ChunkKey]) -> Result<Round> {
    let server = ServerProcess::start(&plan.launch, &["--cache-mb", "1"])?;
    let length = Duration::from_secs(plan.seconds);
    let capacity = capacity(&server, keys, length).await?;
    let (mut loads, mut peak, mut normal_p99_ms, mut last) = (Vec::new(), capacity, None, None);
    let mut unanswered = 0;
    for load in LOADS {
        let is_last = load == LOADS[LOADS.len() - 1];
        let after = if is_last { (PARTIAL * capacity, RECOVERY) } else { (0.0, DRAIN) };
        let requests = send_at_rates(&server, keys, &[(load * capacity, length), after]).await?;
        let figures = LoadFigures::new(&requests, length);
        peak = peak.max(figures.goodput_per_s);
        unanswered += figures.unanswered;
        if load == PARTIAL {
            normal_p99_ms = figures.chunk_p99_ms;
        }
        loads.push(figures.to_json(load, capacity));
        last = Some((figures, requests));
    }
    let (figures, requests) = last.context("no load was run")?;
    let recovery_s = |floor| recovery(&requests, length, normal_p99_ms.unwrap_or(f64::NAN), floor);
    Ok(Round {
        capacity,
        loads,
        peak,
        goodput: figures.goodput_per_s,
        refusal_p99_ms: figures.refusal_p99_ms,
        normal_p99_ms,
        unanswered,
        recovery_s: NORMAL_FLOORS_MS.map(recovery_s),
    })
}

/// Figures of one load.
#[derive(Debug, PartialEq)]
pub struct LoadFigures {
    sent_per_s: f64,
    /// Chunks that arrived before the end of the load.
    goodput_per_s: f64,
    /// Of all requests that were due in the load, whenever the answer came, milliseconds. A request
    /// without a chunk counts as longer than any; none without requests.
    pub chunk_p99_ms: Option<f64>,
    refused: usize,
    refusal_p99_ms: Option<f64>,
    /// Without an answer until the end of the run.
    unanswered: usize,
}

impl LoadFigures {
    /// Of the requests that were due in the first part of a run.
    pub fn new(requests: &[Request], length: Duration) -> Self {
        let due = || requests.iter().filter(|request| request.due < length);
        let waits = |is_chunk: bool| {
            let waits =
                due().filter_map(|request| request.answer).filter(|answer| answer.is_chunk == is_chunk);
            waits.map(|answer| answer.wait).collect::<Vec<_>>()
        };
        let in_time = |request: &&Request| {
            request.answer.is_some_and(|answer| answer.is_chunk && request.due + answer.wait < length)
        };
        let (refusals, seconds) = (waits(false), length.as_secs_f64());
        Self {
            sent_per_s: due().count() as f64 / seconds,
            goodput_per_s: due().filter(in_time).count() as f64 / seconds,
            chunk_p99_ms: quantile_ms(waits(true), 0.99),
            refused: refusals.len(),
            refusal_p99_ms: quantile_ms(refusals, 0.99),
            unanswered: due().filter(|request| request.answer.is_none()).count(),
        }
    }

    fn to_json(&self, load: f64, capacity_per_s: f64) -> Value {
        json!({
            "load": load,
            "capacity_per_s": capacity_per_s,
            "offered_per_s": load * capacity_per_s,
            "sent_per_s": self.sent_per_s,
            "goodput_per_s": self.goodput_per_s,
            "chunk_p99_ms": self.chunk_p99_ms,
            "refused": self.refused,
            "refusal_p99_ms": self.refusal_p99_ms,
            "unanswered": self.unanswered,
        })
    }
}

/// See [`RECOVERY_DEFINITION`]; none if the server does not recover within [`RECOVERY`].
fn recovery(requests: &[Request], length: Duration, normal_p99_ms: f64, floor_ms: f64) -> Option<f64> {
    let bound_ms = (2.0 * normal_p99_ms).max(floor_ms);
    let n_windows = (RECOVERY.as_millis() / RECOVERY_WINDOW.as_millis()) as u32;
    let is_normal = |window: u32| {
        let window = length + RECOVERY_WINDOW * window..length + RECOVERY_WINDOW * (window + 1);
        let inside = requests.iter().filter(|request| window.contains(&request.due));
        quantile_ms(inside.map(Request::wait_for_chunk).collect(), 0.99).is_some_and(|wait| wait <= bound_ms)
    };
    // Answers to the last window may come after the end of the run.
    let last_bad = (0..n_windows - 1).rev().find(|window| !is_normal(*window));
    match last_bad {
        Some(window) if window + 2 >= n_windows => None,
        Some(window) => Some((RECOVERY_WINDOW * (window + 1)).as_secs_f64()),
        None => Some(0.0),
    }
}

/// One request that was sent.
#[derive(Clone, Copy, Debug)]
pub struct Request {
    /// When it was due, since the start of the run.
    due: Duration,
    answer: Option<Answer>,
}

#[derive(Clone, Copy, Debug)]
struct Answer {
    /// Since the request was due.
    wait: Duration,
    /// Else a refusal.
    is_chunk: bool,
}

impl Request {
    /// Time until the chunk arrived; without a chunk, longer than any bound.
    fn wait_for_chunk(&self) -> Duration {
        self.answer.filter(|answer| answer.is_chunk).map_or(Duration::MAX, |answer| answer.wait)
    }
}

/// Chunks a second with a full window on each connection.
///
/// # Errors
/// A connection fails.
pub async fn capacity(server: &ServerProcess, keys: &[ChunkKey], length: Duration) -> Result<f64> {
    let connections = server.connect(CONNECTIONS).await?;
    let started = Instant::now();
    let totals = run_all(connections, |index, mut connection| {
        let keys = rotated(keys, index, CONNECTIONS).into_iter().cycle();
        let window = Window::OneByOne(WINDOW);
        async move { closed_loop(&mut connection, keys, window, Some(started + length), |_| ()).await }
    });
    let chunks: u64 = totals.await?.iter().map(|totals| totals.chunks).sum();
    Ok(chunks as f64 / started.elapsed().as_secs_f64())
}

/// Sends requests at one rate after the other, each for a time. Rates are requests a second over
/// all connections.
///
/// # Errors
/// A connection fails.
pub async fn send_at_rates(
    server: &ServerProcess,
    keys: &[ChunkKey],
    rates: &[(f64, Duration)],
) -> Result<Vec<Request>> {
    let connections = server.connect(CONNECTIONS).await?;
    let rates: Vec<_> = rates.iter().map(|(rate, time)| (rate / CONNECTIONS as f64, *time)).collect();
    let started = Instant::now() + BURST;
    let requests = run_all(connections, |index, connection| {
        let phase = BURST * index as u32 / CONNECTIONS as u32;
        send_in_bursts(connection, rotated(keys, index, CONNECTIONS), rates.clone(), started + phase)
    });
    Ok(requests.await?.concat())
}

/// Requests due at one connection by a time since the start.
fn due_count(rates: &[(f64, Duration)], mut elapsed: Duration) -> f64 {
    let mut count = 0.0;
    for (rate, time) in rates {
        count += rate * elapsed.min(*time).as_secs_f64();
        elapsed = elapsed.saturating_sub(*time);
    }
    count
}

/// When request number `index` of a connection, from 0, is due: the inverse of [`due_count`]. The
/// end of the run if it never is.
fn due_time(rates: &[(f64, Duration)], index: usize) -> Duration {
    let (mut left, mut start) = ((index + 1) as f64, Duration::ZERO);
    for (rate, time) in rates {
        let count = rate * time.as_secs_f64();
        if left <= count {
            return start + Duration::from_secs_f64(left / rate);
        }
        left -= count;
        start += *time;
    }
    start
}

async fn send_in_bursts(
    mut connection: Connection,
    keys: Vec<ChunkKey>,
    rates: Vec<(f64, Duration)>,
    started: Instant,
) -> Result<Vec<Request>> {
    let mut next = keys.iter().copied().cycle();
    // Indices into `requests` by key: a client requests no chunk again before 16,384 others.
    let mut open: FxHashMap<ChunkKey, usize> = FxHashMap::default();
    let mut requests: Vec<Request> = Vec::new();
    let length: Duration = rates.iter().map(|(_, time)| *time).sum();
    let mut ticks = tokio::time::interval_at(started.into(), BURST);
    loop {
        tokio::select! {
            tick = ticks.tick() => {
                // The time of the tick, which may be in the past on a busy machine; missed bursts
                // follow at once.
                let now = tick.into_std().saturating_duration_since(started);
                if now >= length {
                    return Ok(requests);
                }
                let count = (due_count(&rates, now) as usize).saturating_sub(requests.len());
                let burst: Vec<_> = next.by_ref().take(count).collect();
                if burst.is_empty() {
                    continue;
                }
                for key in &burst {
                    open.insert(*key, requests.len());
                    requests.push(Request { due: due_time(&rates, requests.len()), answer: None });
                }
                connection.request(burst, false).await?;
            }
            received = connection.receive(|received| {
                let is_chunk = matches!(received, Received::Chunk(_));
                let key = received.answers();
                if let Some(request) = key.and_then(|key| requests.get_mut(open.remove(&key)?)) {
                    let wait = started.elapsed().saturating_sub(request.due);
                    request.answer = Some(Answer { wait, is_chunk });
                }
            }) => received?,
        }
    }
}

/// The bars of this benchmark.
pub fn bars(figures: &Value) -> Vec<Bar> {
    let is_overload = at(figures, "loads/4/load") == Some(5.0);
    let of = |path| at(figures, path).filter(|_| is_overload);
    vec![
        Bar::at_least("five times the capacity: goodput over peak", of("goodput_of_peak"), "", 0.9)
            .with_note(format!("median of the rounds; {GOODPUT_DEFINITION}")),
        Bar::at_least("the same, worst round", of("goodput_of_peak_worst"), "", 0.85),
        Bar::none("requests without an answer at any load, worst round", of("unanswered_worst")),
        Bar::at_most("refusals, p99", of("refusal_p99_ms"), "ms", 10.0).with_note(format!(
            "from when each request was due; the client sends in bursts every {:.0} ms, which is part of it",
            ms(BURST)
        )),
        Bar::at_most("back to normal after", of("recovery_s"), "s", 2.0)
            .with_note(format!("{RECOVERY_DEFINITION}; floor {:.0} ms", NORMAL_FLOORS_MS[0])),
        Bar::reported("the same with a floor of 20 ms", of("recovery_s_strict"), "s"),
        Bar::some("refused (control)", of("loads/4/refused")),
    ]
}

/// Further figures in sentences.
pub fn notes(figures: &Value) -> Vec<String> {
    let of_load = |load: &Value| {
        let refused = match at(load, "refusal_p99_ms") {
            Some(_) => "{refused:.0} refused, p99 {refusal_p99_ms:.1} ms",
            None => "none refused",
        };
        let line = "Load {load} (of {capacity_per_s:.0} a second): {goodput_per_s:.0} chunks a second, p99 \
                    {chunk_p99_ms:.1} ms; ";
        fill(&format!("{line}{refused}; {{unanswered:.0}} unanswered."), load)
    };
    let rounds = "Loads are those of the last round. Goodput over peak, round by round: \
                  {goodput_of_peak_rounds:.2}.";
    list(figures, "loads").iter().map(of_load).chain([fill(rounds, figures)]).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::test_bars::{check, check_absent};

    const SECOND: Duration = Duration::from_secs(1);

    #[test]
    fn requests_are_due_by_rate_and_time_until_the_end() {
        let rates = [(100.0, SECOND), (10.0, 2 * SECOND)];
        assert_eq!(
            [0, 500, 1000, 2000, 3000, 9000].map(|ms| due_count(&rates, Duration::from_millis(ms))),
            [0.0, 50.0, 100.0, 110.0, 120.0, 120.0]
        );
    }

    #[test]
    fn each_request_is_due_when_the_count_reaches_it() {
        let rates = [(100.0, SECOND), (10.0, 2 * SECOND)];
        assert_eq!(
            [0, 49, 99, 100, 119].map(|index| due_time(&rates, index).as_millis()),
            [10, 500, 1000, 1100, 3000]
        );
        assert_eq!(due_time(&rates, 120), 3 * SECOND);
        assert_eq!(due_time(&[(5.0, SECOND), (0.0, SECOND)], 5), 2 * SECOND, "after a rate of zero");
    }

    /// A request a millisecond in the recovery, answered as `answer` says for its number.
    fn requests(answer: impl Fn(u64) -> Option<Answer>) -> Vec<Request> {
        let number = 0..RECOVERY.as_millis() as u64;
        number.map(|at| Request { due: SECOND + Duration::from_millis(at), answer: answer(at) }).collect()
    }

    fn answer(wait_ms: u64, is_chunk: bool) -> Option<Answer> {
        Some(Answer { wait: Duration::from_millis(wait_ms), is_chunk })
    }

    fn recovered(answer: impl Fn(u64) -> Option<Answer>) -> Option<f64> {
        recovery(&requests(answer), SECOND, 5.0, NORMAL_FLOORS_MS[0])
    }

    #[test]
    fn recovery_is_the_end_of_the_last_window_with_a_slow_answer() {
        let slow_until = |end| recovered(move |at| answer(if at < end { 300 } else { 3 }, true));
        assert_eq!([0, 150, 1000].map(slow_until), [Some(0.0), Some(0.2), Some(1.0)]);
        assert_eq!(slow_until(10_000), None);
    }

    #[test]
    fn a_server_that_continues_to_refuse_does_not_recover() {
        assert_eq!(recovered(|_| answer(1, false)), None);
        assert_eq!(recovered(|at| answer(1, at >= 150)), Some(0.2));
        assert_eq!(recovered(|at| answer(1, at % 50 != 0)), None, "2 % of the requests");
        assert_eq!(recovered(|at| answer(1, at % 500 != 7)), Some(0.0), "one request in a window of 100");
    }

    #[test]
    fn a_server_that_does_not_answer_does_not_recover() {
        assert_eq!(recovered(|_| None), None);
        assert_eq!(recovery(&[], SECOND, 5.0, 50.0), None, "nothing was sent");
    }

    #[test]
    fn the_floor_of_normal_matters_between_the_two_floors() {
        let at_30_ms = requests(|_| answer(30, true));
        let floors = NORMAL_FLOORS_MS.map(|floor| recovery(&at_30_ms, SECOND, 5.0, floor));
        assert_eq!(floors, [Some(0.0), None]);
    }

    #[test]
    fn a_load_counts_only_the_requests_that_were_due_in_it() {
        let request = |due_ms, answer| Request { due: Duration::from_millis(due_ms), answer };
        let requests = [
            request(100, answer(10, true)),
            request(200, answer(900, true)),
            request(300, answer(4, false)),
            request(400, None),
            // In the unloaded part after it.
            request(1500, answer(700, true)),
            request(1600, answer(700, false)),
        ];
        let expected = LoadFigures {
            sent_per_s: 4.0,
            goodput_per_s: 1.0,
            chunk_p99_ms: Some(900.0),
            refused: 1,
            refusal_p99_ms: Some(4.0),
            unanswered: 1,
        };
        assert_eq!(LoadFigures::new(&requests, SECOND), expected);
    }

    #[test]
    fn each_bar_can_be_missed() {
        let good = json!({
            "goodput_of_peak": 0.95, "goodput_of_peak_worst": 0.9, "refusal_p99_ms": 3.0,
            "recovery_s": 0.1, "recovery_s_strict": 0.4, "unanswered_worst": 0,
            "loads": [{}, {}, {}, {}, { "load": 5.0, "refused": 1000 }],
        });
        let bad = [
            ("/goodput_of_peak", json!(0.89)),
            ("/goodput_of_peak_worst", json!(0.84)),
            ("/refusal_p99_ms", json!(10.1)),
            ("/recovery_s", json!(2.1)),
            ("/unanswered_worst", json!(1)),
            ("/loads/4/refused", json!(0)),
        ];
        check(bars, &good, &bad);
        let absent =
            [("", "loads", 7), ("/loads/4", "load", 7), ("", "recovery_s", 1), ("", "unanswered_worst", 1)];
        check_absent(bars, &good, &absent);
    }
}
