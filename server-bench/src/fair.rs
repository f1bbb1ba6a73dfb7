//! One client with a thousand requests outstanding beside fifty with a few each. All request chunks
//! that must be generated, together more than the server can generate, so that its scheduling alone
//! decides the shares.

use crate::connection::{Connection, Received};
use crate::keys::{WORLD_SEED, land_keys};
use crate::server_process::ServerProcess;
use crate::stats::{jain, median, ms, quantile};
use crate::{Plan, at, join_all, listed, shown};
use anyhow::Result;
use bars::{Bar, Limit};
use protocol::chunk_codec;
use rustc_hash::FxHashMap;
use serde_json::{Value, json};
use std::time::{Duration, Instant};
use terrain::{ChunkKey, Land};

/// Clients with few requests outstanding, and how many each.
const POLITE: usize = 50;
const POLITE_WINDOW: usize = 4;

/// Requests outstanding of the greedy client.
const GREEDY_WINDOW: usize = 1000;

/// Different chunks, requested in turn. The cache holds a hundredth of them.
const CHUNKS: usize = 16 * 1024;

/// Time before the measured part, in which cost estimates and queues reach their steady state.
const SETTLE: Duration = Duration::from_millis(500);

/// Runs the benchmark, without and with the greedy client in turn.
///
/// # Errors
/// The server fails.
pub async fn run(plan: &Plan) -> Result<Value> {
    let keys = land_keys(&Land::new(WORLD_SEED), 0, CHUNKS);
    let (mut alone, mut beside, mut ratios, mut indices, mut polite) =
        (Vec::new(), Vec::new(), Vec::new(), Vec::new(), Vec::new());
    let (mut greedy_share, mut refused) = (Vec::new(), 0);
    for _ in 0..plan.rounds {
        let without = round(plan, &keys, 0).await?;
        let with = round(plan, &keys, 1).await?;
        alone.push(without.p99_ms);
        beside.push(with.p99_ms);
        ratios.push(with.p99_ms / without.p99_ms);
        refused += with.polite_refused;
        indices.push(jain(&with.shares));
        polite.push(jain(&with.shares[..POLITE]));
        let mean = with.shares.iter().sum::<f64>() / with.shares.len() as f64;
        greedy_share.push(with.shares[POLITE] / mean);
    }
    Ok(json!({
        "polite": POLITE,
        "polite_window": POLITE_WINDOW,
        "greedy_window": GREEDY_WINDOW,
        "rounds": plan.rounds,
        "p99_alone_ms": median(alone),
        "p99_beside_greedy_ms": median(beside),
        "polite_refused": refused,
        "p99_ratio": median(ratios.clone()),
        "p99_ratio_rounds": ratios,
        "jain_index": median(indices),
        "jain_index_polite": median(polite),
        "greedy_share_of_mean": median(greedy_share),
    }))
}

struct Round {
    /// Of the polite clients' requests; a refused one counts as the whole length of the round.
    p99_ms: f64,
    /// Requests of polite clients that were refused.
    polite_refused: usize,
    /// Chunks received by each client, the greedy one last.
    shares: Vec<f64>,
}

async fn round(plan: &Plan, keys: &[ChunkKey], greedy: usize) -> Result<Round> {
    let server = ServerProcess::start(&plan.launch, &["--cache-mb", "1"])?;
    let n_clients = POLITE + greedy;
    let mut connections = Vec::new();
    for _ in 0..n_clients {
        connections.push(Connection::connect(server.address).await?);
    }
    let from = Instant::now() + SETTLE;
    let end = from + Duration::from_secs(plan.seconds);
    let clients = connections.into_iter().enumerate().map(|(index, connection)| {
        let window = if index < POLITE { POLITE_WINDOW } else { GREEDY_WINDOW };
        // Far apart in the list: no client finds chunks of another in the cache.
        let own: Vec<_> =
            keys.iter().copied().cycle().skip(index * CHUNKS / n_clients).take(CHUNKS).collect();
        tokio::spawn(keep_requesting(connection, own, window, from, end))
    });
    let outcomes = join_all(clients.collect()).await?;
    let shares = outcomes.iter().map(|outcome| outcome.latencies.len() as f64).collect();
    let (mut all, mut polite_refused) = (Vec::new(), 0);
    for outcome in outcomes.into_iter().take(POLITE) {
        all.extend(outcome.latencies);
        polite_refused += outcome.refused;
    }
    all.extend(std::iter::repeat_n(Duration::from_secs(plan.seconds), polite_refused));
    let p99_ms = quantile(&mut all, 0.99).map_or(f64::NAN, ms);
    Ok(Round { p99_ms, polite_refused, shares })
}

/// What one client received after the start of the measured part.
struct Outcome {
    /// Of each chunk.
    latencies: Vec<Duration>,
    refused: usize,
}

/// Keeps a window full until the end.
async fn keep_requesting(
    mut connection: Connection,
    keys: Vec<ChunkKey>,
    window: usize,
    from: Instant,
    end: Instant,
) -> Result<Outcome> {
    let mut next = keys.iter().copied().cycle();
    let mut open: FxHashMap<ChunkKey, Instant> = FxHashMap::default();
    let mut outcome = Outcome { latencies: Vec::new(), refused: 0 };
    let mut free = window;
    while Instant::now() < end {
        if free > 0 {
            let (now, more) = (Instant::now(), next.by_ref().take(free).collect::<Vec<_>>());
            open.extend(more.iter().map(|key| (*key, now)));
            connection.request(more).await?;
            free = 0;
        }
        connection
            .receive(|received| {
                free += 1;
                let Received::Chunk(frame) = received else {
                    outcome.refused += usize::from(Instant::now() >= from);
                    return;
                };
                let sent = chunk_codec::kind_and_key(frame).ok().and_then(|(_, key)| open.remove(&key));
                if let Some(sent) = sent.filter(|_| Instant::now() >= from) {
                    outcome.latencies.push(sent.elapsed());
                }
            })
            .await?;
    }
    Ok(outcome)
}

/// The bars of this benchmark.
#[must_use]
pub fn bars(figures: &Value) -> Vec<Bar> {
    vec![
        Bar::new(
            "polite p99 beside a greedy client over alone",
            at(figures, "/p99_ratio"),
            "x",
            Limit::AtMost(1.3),
        )
        .with_note("median of the rounds; a refused request counts as the whole length of its round"),
        Bar::new(
            "refused requests of polite clients",
            at(figures, "/polite_refused"),
            "",
            Limit::AtMost(0.0),
        )
        .with_note("beside the greedy client, all rounds together"),
        Bar::new("Jain's index of their shares", at(figures, "/jain_index"), "", Limit::AtLeast(0.95)),
    ]
}

/// Further figures in sentences.
#[must_use]
pub fn notes(figures: &Value) -> Vec<String> {
    let shown = |path| shown(figures, path);
    let line = format!(
        "Polite clients: p99 {:.1} ms alone, {:.1} ms beside the greedy one, whose share is {:.2} of \
         the mean; Jain's index of the polite ones alone {:.3}. Polite p99 over alone, round by \
         round: {}.",
        shown("/p99_alone_ms"),
        shown("/p99_beside_greedy_ms"),
        shown("/greedy_share_of_mean"),
        shown("/jain_index_polite"),
        listed(figures, "/p99_ratio_rounds", 2),
    );
    vec![line]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::test_bars::{check, check_absent};

    #[test]
    fn each_bar_can_be_missed() {
        let good = json!({ "p99_ratio": 1.1, "jain_index": 0.98, "polite_refused": 0 });
        let bad = [("/p99_ratio", json!(1.31)), ("/jain_index", json!(0.949)), ("/polite_refused", json!(1))];
        check(bars, &good, &bad);
        check_absent(bars, &good, &[("", "p99_ratio", 1), ("", "polite_refused", 1)]);
    }
}
