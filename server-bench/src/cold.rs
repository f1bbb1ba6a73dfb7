//! Chunks that must be generated: CPU time from request to socket at levels 0, 2 and 4, and the
//! time of each stage at level 0.
//!
//! The error bound of a coarse chunk costs many times its heights; level 0 has none. A figure of
//! one level therefore says little about another.

use crate::connection::{Connection, Received};
use crate::keys::{WORLD_SEED, land_keys};
use crate::server_process::{ServerProcess, series};
use crate::stats::median;
use crate::{Plan, at, join_all, listed, shown};
use anyhow::{Result, ensure};
use bars::{Bar, Limit};
use protocol::Delivery;
use protocol::chunk_codec::{self, Effort};
use serde_json::{Value, json};
use std::hint::black_box;
use std::time::Instant;
use terrain::{Chunk, GrassSeed, Land};

/// Connections that the requests are spread over.
const CONNECTIONS: usize = 16;

/// Chunks that the stages are timed over.
const STAGE_CHUNKS: usize = 2000;

/// What is requested of one level.
#[derive(Clone, Copy, Debug)]
struct LevelPlan {
    level: u8,
    /// Different chunks.
    chunks: usize,
    /// Requests outstanding on each connection. Few for slow levels: requests that would wait
    /// longer than the server's deadline are rejected.
    window: usize,
}

const LEVELS: [LevelPlan; 3] = [
    LevelPlan { level: 0, chunks: 16 * 1024, window: 64 },
    LevelPlan { level: 2, chunks: 2 * 1024, window: 8 },
    LevelPlan { level: 4, chunks: 2 * 1024, window: 8 },
];

/// Runs the benchmark: every round of every level in a fresh server, so that nothing is cached.
///
/// # Errors
/// The server fails or refuses.
pub async fn run(plan: &Plan) -> Result<Value> {
    let land = Land::new(WORLD_SEED);
    let mut levels = Vec::new();
    for level in LEVELS {
        levels.push(measure(plan, &land, level).await?);
    }
    let is_fast = at(&levels[0], "/fast_encoded_share") > Some(0.5);
    let effort = if is_fast { Effort::Fast } else { Effort::Compact };
    let stages = stages(&land, &land_keys(&land, 0, STAGE_CHUNKS), effort);
    let generation_us: f64 = stages.iter().map(|(_, us)| us).sum();
    let mut stages: serde_json::Map<_, _> =
        stages.into_iter().map(|(name, us)| (name.to_owned(), json!(us))).collect();
    stages.insert("serve_us".into(), json!(shown(&levels[0], "/total_us") - generation_us));
    Ok(json!({ "connections": CONNECTIONS, "levels": levels, "stages": stages }))
}

async fn measure(plan: &Plan, land: &Land, level: LevelPlan) -> Result<Value> {
    let LevelPlan { level, chunks, window } = level;
    let keys = land_keys(land, level, chunks);
    ensure!(keys.len() == chunks, "level {level} has only {} chunks with land", keys.len());
    let (mut per_core, mut per_second, mut bytes, mut fast) = (Vec::new(), Vec::new(), 0, Vec::new());
    for _ in 0..plan.rounds {
        let server = ServerProcess::start(&plan.launch, &[])?;
        let mut connections = Vec::new();
        for _ in 0..CONNECTIONS {
            connections.push(Connection::connect(server.address).await?);
        }
        let (cpu_before, started) = (server.process.cpu_s()?, Instant::now());
        let parts = keys.chunks(chunks / CONNECTIONS).map(<[_]>::to_vec);
        let clients = connections.into_iter().zip(parts);
        let clients = clients.map(|(connection, keys)| tokio::spawn(take_all(connection, keys, window)));
        bytes = join_all(clients.collect()).await?.into_iter().sum::<u64>();
        let seconds = started.elapsed().as_secs_f64();
        per_second.push(chunks as f64 / seconds);
        per_core.push(chunks as f64 / (server.process.cpu_s()? - cpu_before));
        let generated = server.metric(series::GENERATED).await?;
        ensure!(generated as usize == chunks, "{generated} chunks were generated instead of {chunks}");
        fast.push(server.metric(series::FAST_ENCODED).await? / chunks as f64);
    }
    Ok(json!({
        "level": level,
        "chunks": chunks,
        "window": window,
        "frame_bytes": bytes / chunks as u64,
        "fast_encoded_share": median(fast),
        "chunks_per_core_s": median(per_core.clone()),
        "chunks_per_core_s_rounds": per_core,
        "chunks_per_s": median(per_second.clone()),
        "chunks_per_s_rounds": per_second,
        "total_us": median(per_core).map(|rate| 1e6 / rate),
    }))
}

/// Requests all chunks with a window of so many. Returns their bytes.
async fn take_all(mut connection: Connection, keys: Vec<terrain::ChunkKey>, window: usize) -> Result<u64> {
    let mut next = keys.iter().copied();
    connection.request(next.by_ref().take(window)).await?;
    let (mut chunks, mut bytes, mut refused) = (0, 0, 0u64);
    while chunks < keys.len() {
        let before = chunks;
        connection
            .receive(|received| match received {
                Received::Chunk(frame) => {
                    chunks += 1;
                    bytes += frame.len() as u64;
                }
                Received::Message(_) => refused += 1,
            })
            .await?;
        ensure!(refused == 0, "the server refused a chunk with {window} requests outstanding");
        let more: Vec<_> = next.by_ref().take(chunks - before).collect();
        if !more.is_empty() {
            connection.request(more).await?;
        }
    }
    Ok(bytes)
}

/// Microseconds of each stage for a chunk of level 0, run in this process as a thread of the server
/// does it. The fastest of three passes, to leave out disturbances. Encoded with the effort that
/// the server used for most of its frames.
fn stages(land: &Land, keys: &[terrain::ChunkKey], effort: Effort) -> Vec<(&'static str, f64)> {
    let digest = land.digest();
    let mut best = [f64::INFINITY; 4];
    for _ in 0..3 {
        let mut pass = [0.0; 4];
        for key in keys {
            let (heights, generate) = timed(|| land.chunk_heights(*key));
            let (grass, grow) = timed(|| GrassSeed::grow(WORLD_SEED, *key, &heights));
            let (chunk, derive) = timed(|| Chunk::from_parts(*key, heights, 0, grass));
            let (_, encode) = timed(|| chunk_codec::encode_with(Delivery::Exact, effort, &chunk, &digest));
            for (sum, us) in pass.iter_mut().zip([generate, grow, derive, encode]) {
                *sum += us / keys.len() as f64;
            }
        }
        for (best, new) in best.iter_mut().zip(pass) {
            *best = best.min(new);
        }
    }
    ["generate_us", "grass_us", "pyramids_us", "encode_us"].into_iter().zip(best).collect()
}

/// A result and the time that it took, microseconds.
fn timed<T>(job: impl FnOnce() -> T) -> (T, f64) {
    let started = Instant::now();
    let result = black_box(job());
    (result, started.elapsed().as_secs_f64() * 1e6)
}

/// The bars of this benchmark.
#[must_use]
pub fn bars(figures: &Value) -> Vec<Bar> {
    let rate = |index: usize, level: u8| {
        let is_level = at(figures, &format!("/levels/{index}/level")) == Some(f64::from(level));
        at(figures, &format!("/levels/{index}/chunks_per_core_s")).filter(|_| is_level)
    };
    vec![
        Bar::new("new chunks of level 0 a second and core", rate(0, 0), "", Limit::AtLeast(25_000.0))
            .with_note("level 0 needs no error bound"),
        Bar::new("new chunks of level 2 a second and core", rate(1, 2), "", Limit::Reported),
        Bar::new("new chunks of level 4 a second and core", rate(2, 4), "", Limit::Reported),
    ]
}

/// Further figures in sentences.
#[must_use]
pub fn notes(figures: &Value) -> Vec<String> {
    let of = |path: &str| shown(figures, path);
    let mut notes = vec![format!(
        "New chunks of level 0: {:.1} us of CPU each, of which heights {:.1}, grass {:.1}, pyramids \
         {:.1}, encoding {:.1}, and the rest (requests, queues, sockets, and the slowdown in a busy \
         server) {:.1}.",
        of("/levels/0/total_us"),
        of("/stages/generate_us"),
        of("/stages/grass_us"),
        of("/stages/pyramids_us"),
        of("/stages/encode_us"),
        of("/stages/serve_us"),
    )];
    for index in 0..LEVELS.len() {
        let of = |field: &str| of(&format!("/levels/{index}/{field}"));
        notes.push(format!(
            "New chunks of level {:.0}: {:.0} bytes each, {:.0} % encoded fast because of the \
             backlog; a second and core, round by round: {}.",
            of("level"),
            of("frame_bytes"),
            100.0 * of("fast_encoded_share"),
            listed(figures, &format!("/levels/{index}/chunks_per_core_s_rounds"), 0),
        ));
    }
    notes
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::test_bars::{check, check_absent};

    #[test]
    fn each_bar_can_be_missed() {
        let level = |level: u8, rate: f64| json!({ "level": level, "chunks_per_core_s": rate });
        let good = json!({ "levels": [level(0, 26_000.0), level(2, 2_500.0), level(4, 2_000.0)] });
        let bad = [
            ("/levels/0/chunks_per_core_s", json!(24_999.0)),
            ("/levels/0/level", json!(1)),
            ("/levels/1/chunks_per_core_s", json!(null)),
            ("/levels/2/level", json!(2)),
        ];
        check(bars, &good, &bad);
        check_absent(bars, &good, &[("", "levels", 3), ("/levels/1", "level", 1)]);
    }
}
