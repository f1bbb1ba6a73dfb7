//! One chunk that is requested 10,000 times while it waits for its generation: it must be generated
//! once.
//!
//! Other connections first occupy the one generation thread with coarse chunks. The chunk under
//! test waits behind them, so that its requests join one job instead of finding it in the cache.
//!
//! The control is the same load of different chunks: no request can join another's job, so a server
//! that coalesces nothing would give the same counts.

use crate::Plan;
use crate::clients::{Event, Window, closed_loop, run_all};
use crate::connection::Received;
use crate::keys::{WORLD_SEED, land_keys};
use crate::server_process::{ServerProcess, series};
use anyhow::Result;
use bars::Bar;
use bars::figures::{at, fill};
use protocol::chunk_codec;
use rustc_hash::FxHashSet;
use serde_json::{Value, json};
use std::sync::Arc;
use std::time::Instant;
use terrain::{ChunkKey, Land};
use tokio::sync::Barrier;

/// Connections, and requests on each.
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
    let one = storm(plan, &[key; CONNECTIONS * REQUESTS], &expected).await?;
    // Level 0, so that the control does not take minutes.
    let keys = land_keys(&land, 0, CONNECTIONS * REQUESTS);
    let different = storm(plan, &keys, &expected).await?;
    Ok(json!({
        "connections": CONNECTIONS,
        "requests": CONNECTIONS * REQUESTS,
        "blockers": BLOCKERS,
        "one_key": one,
        "different_keys": different,
    }))
}

/// Requests all keys at the same time from a fresh server whose thread is occupied. `right` counts
/// the answers that are `expected`, byte for byte.
async fn storm(plan: &Plan, keys: &[ChunkKey], expected: &[u8]) -> Result<Value> {
    // The default deadline would reject requests that wait for the blockers.
    let server = ServerProcess::start(&plan.launch, &["--threads", "1", "--deadline-ms", "60000"])?;
    let mut blockers = server.connect(BLOCKERS).await?;
    let connections = server.connect(CONNECTIONS).await?;
    for (index, blocker) in (1..).zip(&mut blockers) {
        blocker.request([ChunkKey::new(LEVEL, index % 16, index / 16)?], false).await?;
    }
    let (start, started) = (Arc::new(Barrier::new(CONNECTIONS)), Instant::now());
    let expected: Arc<[u8]> = expected.into();
    let answers = run_all(connections, |index, mut connection| {
        let (start, expected) = (Arc::clone(&start), Arc::clone(&expected));
        let keys = keys[index * REQUESTS..(index + 1) * REQUESTS].to_vec();
        async move {
            start.wait().await;
            let (mut right, mut different) = (0, FxHashSet::default());
            let note = |event: Event<'_>| {
                if let Event::Received(Received::Chunk(frame)) = event {
                    right += usize::from(*frame == *expected);
                    different.insert(frame.to_vec());
                }
            };
            closed_loop(&mut connection, keys, Window::OneByOne(REQUESTS), None, note).await?;
            Ok((right, different))
        }
    });
    let (right, different): (Vec<usize>, Vec<FxHashSet<_>>) = answers.await?.into_iter().unzip();
    let seconds = started.elapsed().as_secs_f64();
    let different: FxHashSet<Vec<u8>> = different.into_iter().flatten().collect();
    for blocker in &mut blockers {
        let mut is_answered = false;
        while !is_answered {
            blocker.receive(|received| is_answered |= matches!(received, Received::Chunk(_))).await?;
        }
    }
    Ok(json!({
        "right_answers": right.iter().sum::<usize>(),
        "different_answers": different.len(),
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
        Bar::at_most("stampede: generations", of("one_key/generations"), "", 1.0),
        Bar::at_least("stampede: right answers", of("one_key/right_answers"), "", 10_000.0)
            .with_note("equal to local generation, byte for byte"),
        Bar::at_most("stampede: different answers", of("one_key/different_answers"), "", 1.0),
        Bar::at_least("stampede: requests that joined one job", of("one_key/coalesced"), "", 9_000.0)
            .with_note(
                "the others found the chunk in the cache; without enough coalesced requests the count of \
             generations says nothing",
            ),
        Bar::at_least(
            "stampede of 10,000 different chunks: generations (control)",
            of("different_keys/generations"),
            "",
            10_000.0,
        ),
        Bar::at_least(
            "the same: different answers (control)",
            of("different_keys/different_answers"),
            "",
            10_000.0,
        ),
        Bar::none("the same: requests that joined a job (control)", of("different_keys/coalesced")),
    ]
}

/// Further figures in sentences.
pub fn notes(figures: &Value) -> Vec<String> {
    let line = "Stampede: {requests:.0} requests over {connections:.0} connections behind {blockers:.0} \
                other jobs; {one_key/coalesced:.0} joined the job, {one_key/cache_hits:.0} found the chunk \
                in the cache; {one_key/seconds:.2} s for one chunk, \
                {different_keys/seconds:.2} s for different ones.";
    vec![fill(line, figures)]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::test_bars::{check, check_absent, missed};

    fn good() -> Value {
        json!({
            "one_key": {
                "generations": 1.0, "right_answers": 10_000, "different_answers": 1, "coalesced": 9_990.0,
            },
            "different_keys": {
                "generations": 10_000.0, "right_answers": 0, "different_answers": 10_000, "coalesced": 0.0,
            },
        })
    }

    #[test]
    fn each_bar_can_be_missed() {
        let bad = [
            ("/one_key/generations", json!(2)),
            ("/one_key/right_answers", json!(9_999)),
            ("/one_key/different_answers", json!(2)),
            // As once: nearly all requests were cache hits.
            ("/one_key/coalesced", json!(19)),
            ("/different_keys/generations", json!(9_999)),
            ("/different_keys/different_answers", json!(1)),
            ("/different_keys/coalesced", json!(1)),
        ];
        check(bars, &good(), &bad);
        let absent = [("/one_key", "generations", 1), ("/one_key", "coalesced", 1), ("", "one_key", 4)];
        check_absent(bars, &good(), &absent);
    }

    #[test]
    fn a_server_that_coalesces_nothing_misses() {
        let mut figures = good();
        figures["one_key"] = figures["different_keys"].clone();
        assert_eq!(missed(bars, &figures), 4, "every row of one key");
    }
}
