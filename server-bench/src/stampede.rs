//! One chunk that is requested 10,000 times while it waits for its generation: it must be generated
//! once.
//!
//! Other connections first occupy the one generation thread with coarse chunks. The chunk under
//! test waits behind them, so that its requests join one job instead of finding it in the cache.

use crate::connection::{Connection, Received};
use crate::keys::WORLD_SEED;
use crate::server_process::{ServerProcess, series};
use crate::{Plan, at, join_all};
use anyhow::{Result, ensure};
use bars::{Bar, Limit};
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
const BLOCKERS: i32 = 128;

/// Runs the benchmark once: its figures are counts.
///
/// # Errors
/// The server fails, or an answer is not the chunk.
pub async fn run(plan: &Plan) -> Result<Value> {
    let land = Land::new(WORLD_SEED);
    let key = ChunkKey::new(LEVEL, 0, 0)?;
    let expected = chunk_codec::encode(&land.chunk(key), &land.digest());
    // The default deadline would reject requests that wait for the blockers.
    let server = ServerProcess::start(&plan.launch, &["--threads", "1", "--deadline-ms", "60000"])?;
    let mut blockers = Vec::new();
    for _ in 0..BLOCKERS {
        blockers.push(Connection::connect(server.address).await?);
    }
    let mut connections = Vec::new();
    for _ in 0..CONNECTIONS {
        connections.push(Connection::connect(server.address).await?);
    }
    for (index, blocker) in (1..).zip(&mut blockers) {
        blocker.request([ChunkKey::new(LEVEL, index % 16, index / 16)?]).await?;
    }
    let (start, started) = (Arc::new(Barrier::new(CONNECTIONS)), Instant::now());
    let clients = connections.into_iter().map(|mut connection| {
        let (start, expected) = (Arc::clone(&start), expected.clone());
        tokio::spawn(async move {
            start.wait().await;
            connection.request([key; REQUESTS]).await?;
            let (mut right, mut wrong) = (0, 0);
            while right + wrong < REQUESTS {
                connection
                    .receive(|received| match received {
                        Received::Chunk(frame) if frame == expected => right += 1,
                        _ => wrong += 1,
                    })
                    .await?;
            }
            ensure!(wrong == 0, "{wrong} answers are not the chunk");
            Ok(right)
        })
    });
    let answers: usize = join_all(clients.collect()).await?.into_iter().sum();
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
        "generations": server.metric(series::GENERATED).await? - f64::from(BLOCKERS),
        "coalesced": server.metric(series::COALESCED).await?,
        "cache_hits": server.metric(series::CACHE_HITS).await?,
        "seconds": seconds,
    }))
}

/// The bars of this benchmark.
#[must_use]
pub fn bars(figures: &Value) -> Vec<Bar> {
    vec![
        Bar::new("stampede: generations", at(figures, "/generations"), "", Limit::AtMost(1.0)),
        Bar::new("stampede: right answers", at(figures, "/answers"), "", Limit::AtLeast(10_000.0)),
        Bar::new(
            "stampede: requests that joined one job",
            at(figures, "/coalesced"),
            "",
            Limit::AtLeast(9_000.0),
        )
        .with_note(
            "the others found the chunk in the cache; without enough coalesced requests the \
                        count of generations says nothing",
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
