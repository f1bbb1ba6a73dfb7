//! Chunks that must be generated: CPU time from request to socket at levels 0, 2 and 4, at level 0
//! with the fast and with the compact encoding, and the time of each stage at level 0.
//!
//! The error bound of a coarse chunk costs many times its heights; level 0 has none. A figure of
//! one level therefore says little about another.

use crate::Plan;
use crate::clients::{Window, closed_loop, run_all};
use crate::keys::{WORLD_SEED, land_keys};
use crate::mechanism::Mechanism;
use crate::rounds::Rounds;
use crate::server_process::{Launch, ServerProcess, series};
use anyhow::{Context, Result, ensure};
use bars::Bar;
use bars::figures::{at, each, fill};
use protocol::Delivery;
use protocol::chunk_codec::{self, Effort};
use serde_json::{Map, Value, json};
use std::hint::black_box;
use std::time::Instant;
use terrain::{Chunk, ChunkKey, GrassSeed, Land};

/// Connections that the requests are spread over.
const CONNECTIONS: usize = 16;

/// Chunks that the stages are timed over.
const STAGE_CHUNKS: usize = 2000;

/// The requests of one level.
#[derive(Clone, Copy, Debug)]
struct LevelPlan {
    level: u8,
    /// Different chunks.
    chunks: usize,
    /// Requests outstanding on each connection. Few for slow levels: one of each fills the queue.
    window: usize,
}

/// The CPU time of a chunk is measured here, not the rejection of requests: with the default
/// deadline a slow core rejects some of level 4 before it has estimated their cost.
const DEADLINE: [&str; 2] = ["--deadline-ms", "60000"];

const LEVELS: [LevelPlan; 3] = [
    LevelPlan { level: 0, chunks: 16 * 1024, window: 64 },
    LevelPlan { level: 2, chunks: 2 * 1024, window: 8 },
    LevelPlan { level: 4, chunks: 2 * 1024, window: 1 },
];

/// Runs the benchmark: every round of every level in a fresh server, so that nothing is cached.
pub async fn run(plan: &Plan) -> Result<Value> {
    let land = Land::new(WORLD_SEED);
    let mut levels = Vec::new();
    for level in LEVELS {
        levels.push(measure(plan, &plan.launch, &land, level).await?);
    }
    // Only level 0 is encoded fast under a backlog; the coarser levels above are compact.
    let without_fast = Launch { without: Some(Mechanism::FastEffort), ..plan.launch.clone() };
    let compact = measure(plan, &without_fast, &land, LEVELS[0]).await?;
    ensure!(at(&compact, "fast_encoded_share") == Some(0.0), "chunks were encoded fast without fast effort");
    let is_fast = at(&levels[0], "fast_encoded_share") > Some(0.5);
    let effort = if is_fast { Effort::Fast } else { Effort::Compact };
    let stages = stages(&land, &land_keys(&land, 0, STAGE_CHUNKS), effort);
    let generation_us: f64 = stages.iter().map(|(_, us)| us).sum();
    let mut stages: Map<_, _> = stages.into_iter().map(|(name, us)| (name.to_owned(), json!(us))).collect();
    let total_us = at(&levels[0], "total_us").context("no chunk of level 0 was timed")?;
    stages.insert("serve_us".into(), json!(total_us - generation_us));
    Ok(json!({ "connections": CONNECTIONS, "levels": levels, "compact": compact, "stages": stages }))
}

async fn measure(plan: &Plan, launch: &Launch, land: &Land, level: LevelPlan) -> Result<Value> {
    let LevelPlan { level, chunks, window } = level;
    let keys = land_keys(land, level, chunks);
    ensure!(keys.len() == chunks, "level {level} has only {} chunks with land", keys.len());
    let parts: Vec<_> = keys.chunks(chunks / CONNECTIONS).collect();
    let (mut rounds, mut bytes) = (Rounds::default(), 0);
    for _ in 0..plan.rounds {
        let server = ServerProcess::start(launch, &DEADLINE)?;
        let connections = server.connect(CONNECTIONS).await?;
        let (cpu_before, started) = (server.process.cpu_s()?, Instant::now());
        let totals = run_all(connections, |index, mut connection| {
            let keys = parts[index].to_vec();
            async move {
                let totals = closed_loop(&mut connection, keys, Window::OneByOne(window), None, |_| ()).await;
                totals?.without_refusals().with_context(|| format!("with {window} requests outstanding"))
            }
        });
        bytes = totals.await?.iter().map(|totals| totals.bytes).sum();
        let (seconds, cpu_s) = (started.elapsed().as_secs_f64(), server.process.cpu_s()? - cpu_before);
        let generated = server.metric(series::GENERATED).await?;
        ensure!(generated as usize == chunks, "{generated} chunks were generated instead of {chunks}");
        rounds.push("chunks_per_s", chunks as f64 / seconds);
        rounds.push("chunks_per_core_s", chunks as f64 / cpu_s);
        rounds.push("total_us", 1e6 * cpu_s / chunks as f64);
        rounds.push("fast_encoded_share", server.metric(series::FAST_ENCODED).await? / chunks as f64);
    }
    Ok(rounds.add_to(json!({
        "level": level,
        "chunks": chunks,
        "window": window,
        "frame_bytes": bytes / chunks as u64,
    })))
}

/// Microseconds of each stage for a chunk of level 0, run in this process as a thread of the server
/// does it. The fastest of three passes, to leave out disturbances. Encoded with the effort that
/// the server used for most of its frames.
fn stages(land: &Land, keys: &[ChunkKey], effort: Effort) -> Vec<(&'static str, f64)> {
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
pub fn bars(figures: &Value) -> Vec<Bar> {
    let rate = |index: usize| {
        let level = at(figures, &format!("levels/{index}/level"));
        let is_level = level == Some(f64::from(LEVELS[index].level));
        at(figures, &format!("levels/{index}/chunks_per_core_s")).filter(|_| is_level)
    };
    vec![
        Bar::at_least("new chunks of level 0 a second and core", rate(0), "", 25_000.0)
            .with_note("level 0 needs no error bound"),
        Bar::reported(
            "the same without the fast encoding under backlog",
            at(figures, "compact/chunks_per_core_s").filter(|_| at(figures, "compact/level") == Some(0.0)),
            "",
        ),
        Bar::reported("new chunks of level 2 a second and core", rate(1), ""),
        Bar::reported("new chunks of level 4 a second and core", rate(2), ""),
    ]
}

/// Further figures in sentences.
pub fn notes(figures: &Value) -> Vec<String> {
    let stages = "New chunks of level 0: {levels/0/total_us:.1} us of CPU each, of which heights \
                  {stages/generate_us:.1}, grass {stages/grass_us:.1}, pyramids {stages/pyramids_us:.1}, \
                  encoding {stages/encode_us:.1}, and the rest (requests, queues, sockets, and the slowdown \
                  in a busy server) {stages/serve_us:.1}.";
    let level = "New chunks of level {level:.0}: {frame_bytes:.0} bytes each, {fast_encoded_share*100:.0} % \
                 encoded fast because of the backlog; a second and core, round by round: \
                 {chunks_per_core_s_rounds:.0}.";
    let compact = "Without the fast encoding: {compact/frame_bytes:.0} bytes each of level 0; a second and \
                   core, round by round: {compact/chunks_per_core_s_rounds:.0}.";
    let once = [fill(stages, figures), fill(compact, figures)];
    once.into_iter().chain(each(figures, "levels", level)).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::test_bars::{check, check_absent};

    #[test]
    fn each_bar_can_be_missed() {
        let level = |level: u8, rate: f64| json!({ "level": level, "chunks_per_core_s": rate });
        let levels = [level(0, 26_000.0), level(2, 2_500.0), level(4, 2_000.0)];
        let good = json!({ "levels": levels, "compact": level(0, 16_000.0) });
        let bad = [
            ("/levels/0/chunks_per_core_s", json!(24_999.0)),
            ("/levels/0/level", json!(1)),
            ("/levels/1/chunks_per_core_s", json!(null)),
            ("/levels/2/level", json!(2)),
            ("/compact/chunks_per_core_s", json!(null)),
            ("/compact/level", json!(2)),
        ];
        check(bars, &good, &bad);
        check_absent(bars, &good, &[("", "levels", 3), ("/levels/1", "level", 1), ("", "compact", 1)]);
    }
}
