//! One client with a thousand requests outstanding beside fifty with a few each. All request chunks
//! that must be generated, together more than the server can generate, so that its scheduling alone
//! decides the shares.

use crate::Plan;
use crate::clients::{rotated, run_all, waits};
use crate::keys::{WORLD_SEED, land_keys};
use crate::rounds::{Rounds, jain, quantile_ms};
use crate::server_process::ServerProcess;
use anyhow::Result;
use bars::Bar;
use bars::figures::{at, fill};
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
pub async fn run(plan: &Plan) -> Result<Value> {
    let keys = land_keys(&Land::new(WORLD_SEED), 0, CHUNKS);
    let (mut rounds, mut refused) = (Rounds::default(), 0);
    for _ in 0..plan.rounds {
        let without = round(plan, &keys, 0).await?;
        let with = round(plan, &keys, 1).await?;
        // Alone too: a refusal there counts as a slow answer and would improve the ratio.
        refused += without.polite_refused + with.polite_refused;
        let mean = with.shares.iter().sum::<f64>() / with.shares.len() as f64;
        rounds.push("p99_alone_ms", without.p99_ms);
        rounds.push("p99_beside_greedy_ms", with.p99_ms);
        rounds.push("p99_ratio", with.p99_ms / without.p99_ms);
        rounds.push("jain_index", jain(&with.shares));
        rounds.push("jain_index_polite", jain(&with.shares[..POLITE]));
        rounds.push("greedy_share_of_mean", with.shares[POLITE] / mean);
    }
    Ok(rounds.add_to(json!({
        "polite": POLITE,
        "polite_window": POLITE_WINDOW,
        "greedy_window": GREEDY_WINDOW,
        "rounds": plan.rounds,
        "polite_refused": refused,
    })))
}

struct Round {
    /// Of the polite clients' requests; a refused one counts as the whole length of the round, one
    /// without an answer with its wait.
    p99_ms: f64,
    /// Requests of polite clients that were refused.
    polite_refused: usize,
    /// Chunks received by each client, the greedy one last.
    shares: Vec<f64>,
}

async fn round(plan: &Plan, keys: &[ChunkKey], greedy: usize) -> Result<Round> {
    let server = ServerProcess::start(&plan.launch, &["--cache-mb", "1"])?;
    let n_clients = POLITE + greedy;
    let connections = server.connect(n_clients).await?;
    let from = Instant::now() + SETTLE;
    let end = from + Duration::from_secs(plan.seconds);
    let outcomes = run_all(connections, |index, mut connection| {
        let window = if index < POLITE { POLITE_WINDOW } else { GREEDY_WINDOW };
        let keys = rotated(keys, index, n_clients).into_iter().cycle();
        async move { waits(&mut connection, keys, window, from, end).await }
    });
    let mut outcomes = outcomes.await?;
    let shares = outcomes.iter().map(|waits| waits.chunks as f64).collect();
    outcomes.truncate(POLITE);
    let polite_refused = outcomes.iter().map(|waits| waits.refused).sum();
    let mut all: Vec<_> = outcomes.into_iter().flat_map(|waits| waits.latencies).collect();
    all.extend(std::iter::repeat_n(Duration::from_secs(plan.seconds), polite_refused));
    Ok(Round { p99_ms: quantile_ms(all, 0.99).unwrap_or(f64::NAN), polite_refused, shares })
}

/// The bars of this benchmark.
pub fn bars(figures: &Value) -> Vec<Bar> {
    let of = |path| at(figures, path);
    vec![
        Bar::at_most("polite p99 beside a greedy client over alone", of("p99_ratio"), "x", 1.3)
            .with_note("median of the rounds; a refused request counts as the whole length of its round"),
        Bar::none("refused requests of polite clients", of("polite_refused"))
            .with_note("alone and beside the greedy client, all rounds together"),
        Bar::at_least("Jain's index of their shares", of("jain_index"), "", 0.95),
    ]
}

/// Further figures in sentences.
pub fn notes(figures: &Value) -> Vec<String> {
    let line = "Polite clients: p99 {p99_alone_ms:.1} ms alone, {p99_beside_greedy_ms:.1} ms beside the \
                greedy one, whose share is {greedy_share_of_mean:.2} of the mean; Jain's index of the polite \
                ones alone {jain_index_polite:.3}. Polite p99 over alone, round by round: \
                {p99_ratio_rounds:.2}.";
    vec![fill(line, figures)]
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
