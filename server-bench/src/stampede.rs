//! One chunk that nobody has made, asked for by everybody at once.

use super::host::Host;
use super::wire::{Arrived, Wire};
use super::{Plan, to_end};
use anyhow::{Result, ensure};
use protocol::chunk_codec;
use serde_json::{Value, json};
use std::sync::Arc;
use std::time::Instant;
use terrain::{ChunkKey, Land};
use tokio::sync::Barrier;

/// Connections, and requests for the same chunk on each.
const CONNECTIONS: usize = 1000;
const REQUESTS: usize = 10;

/// Runs the benchmark once: it is a count.
///
/// # Errors
/// The server fails, or an answer is not the chunk.
pub async fn run(plan: &Plan) -> Result<Value> {
    let land = Land::new(super::land_keys::WORLD_SEED);
    // Coarse, with its error measured: milliseconds of work, so that all requests are there before
    // it is done.
    let key = ChunkKey::new(8, 0, 0)?;
    let expected = chunk_codec::encode(&land.chunk(key), &land.digest());
    let host = Host::start(&plan.launch, &[])?;
    let mut wires = Vec::new();
    for _ in 0..CONNECTIONS {
        wires.push(Wire::connect(host.address).await?);
    }
    let (start, started) = (Arc::new(Barrier::new(CONNECTIONS)), Instant::now());
    let clients = wires.into_iter().map(|mut wire| {
        let (start, expected) = (Arc::clone(&start), expected.clone());
        tokio::spawn(async move {
            start.wait().await;
            wire.request([key; REQUESTS]).await?;
            let (mut right, mut wrong) = (0, 0);
            while right + wrong < REQUESTS {
                wire.receive(|arrived| match arrived {
                    Arrived::Chunk(frame) if frame == expected => right += 1,
                    _ => wrong += 1,
                })
                .await?;
            }
            ensure!(wrong == 0, "{wrong} answers are not the chunk");
            Ok(right)
        })
    });
    let answers: usize = to_end(clients.collect()).await?.into_iter().sum();
    Ok(json!({
        "connections": CONNECTIONS,
        "requests": CONNECTIONS * REQUESTS,
        "answers": answers,
        "generations": host.metric("tombolo_generated_total").await?,
        "coalesced": host.metric("tombolo_coalesced_total").await?,
        "cache_hits": host.metric("tombolo_cache_hits_total").await?,
        "seconds": started.elapsed().as_secs_f64(),
    }))
}
