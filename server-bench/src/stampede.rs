//! One chunk that is requested 10,000 times while it waits for its generation: it must be generated
//! once.
//!
//! Other connections first occupy the one generation thread with coarse chunks. The chunk under
//! test waits behind them, so that its requests join one job instead of finding it in the cache.

use crate::Plan;
use crate::clients::{Event, Window, closed_loop, run_all};
use crate::connection::Received;
use crate::keys::WORLD_SEED;
use crate::server_process::{ServerProcess, series};
use anyhow::{Result, ensure};
use bars::Bar;
use bars::figures::at;
use protocol::chunk_codec;
use serde_json::{Value, json};
use std::sync::Arc;
use std::time::Instant;
use terrain::{ChunkKey, Land};
use tokio::sync::Barrier;

/// Connections, and requests for the same chunk on each.
const CONNECTIONS: usize = 1000;
const REQUESTS: usize = 10;

/// Level of the chunk: coarse, so that generation with its error bound takes milliseconds.
const LEVEL: u8 = 8;

/// Connections that request one other chunk of the level each. Generation takes turns by
/// connection, so the chunk under test waits for nearly all of them.
const BLOCKERS: usize = 128;

/// Runs the benchmark once: its figures are counts.
pub async fn run(plan: &Plan) -> Result<Value> {
    let land = Land::new(WORLD_SEED);
    let key = ChunkKey::new(LEVEL, 0, 0)?;
    let expected = chunk_codec::encode(&land.chunk(key), &land.digest());
    // The default deadline would reject requests that wait for the blockers.
    let server = ServerProcess::start(&plan.launch, &["--threads", "1", "--deadline-ms", "60000"])?;
    let mut blockers = server.connect(BLOCKERS).await?;
    let connections = server.connect(CONNECTIONS).await?;
    for (index, blocker) in (1..).zip(&mut blockers) {
        blocker.request([ChunkKey::new(LEVEL, index % 16, index / 16)?], false).await?;
    }
    let (start, started) = (Arc::new(Barrier::new(CONNECTIONS)), Instant::now());
    let answers = run_all(connections, |_, mut connection| {
        let (start, expected) = (Arc::clone(&start), expected.clone());
        async move {
            start.wait().await;
            let mut right = 0;
            let compare = |event: Event<'_>| {
                let is_right = matches!(event, Event::Received(Received::Chunk(frame)) if frame == expected);
                right += usize::from(is_right);
            };
            closed_loop(&mut connection, [key; REQUESTS], Window::OneByOne(REQUESTS), None, compare).await?;
            ensure!(right == REQUESTS, "{} answers are not the chunk", REQUESTS - right);
            Ok(right)
        }
    });
    let answers: usize = answers.await?.into_iter().sum();
    let seconds = started.elapsed().as_secs_f64();
    for blocker in &mut blockers {
        let mut is_answered = false;
        while !is_answered {
            blocker.receive(|received| is_answered |= matches!(received, Received::Chunk(_))).await?;
        }
    }
    Ok(json!({
        "connections": CONNECTIONS,
        "requests": CONNECTIONS * REQUESTS,
        "blockers": BLOCKERS,
        "answers": answers,
        "generations": server.metric(series::GENERATED).await? - BLOCKERS as f64,
        "coalesced": server.metric(series::COALESCED).await?,
        "cache_hits": server.metric(series::CACHE_HITS).await?,
        "seconds": seconds,
    }))
}

/// The bars of this benchmark.
pub fn bars(figures: &Value) -> Vec<Bar> {
    let of = |path| at(figures, path);
    vec![
        Bar::at_most("stampede: generations", of("generations"), "", 1.0),
        Bar::at_least("stampede: right answers", of("answers"), "", 10_000.0),
        Bar::at_least("stampede: requests that joined one job", of("coalesced"), "", 9_000.0).with_note(
            "the others found the chunk in the cache; without enough coalesced requests the count of \
             generations says nothing",
        ),
    ]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::test_bars::{check, check_absent};

    #[test]
    fn each_bar_can_be_missed() {
        let good = json!({ "generations": 1.0, "answers": 10_000, "coalesced": 9_990.0 });
        let bad = [("/generations", json!(2)), ("/answers", json!(9_999)), ("/coalesced", json!(19))];
        check(bars, &good, &bad);
        check_absent(bars, &good, &[("", "generations", 1), ("", "answers", 1), ("", "coalesced", 1)]);
    }
}
