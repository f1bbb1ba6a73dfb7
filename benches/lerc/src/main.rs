//! Size and speed of chunks encoded by LERC, as JSON.

use anyhow::{Context, Result, ensure};
use serde_json::json;
use std::hint::black_box;
use std::time::Instant;
use terrain::Land;
use terrain::constants::{VERTEX_COUNT, VERTICES};

/// The chunks of `tombolo-lab codec`.
#[path = "../../../lab/src/codec/samples.rs"]
mod samples;

/// Number of chunks and of turns, as in `tombolo-lab codec`.
const CHUNKS: usize = 48;
const TURNS: usize = 25;

fn main() -> Result<()> {
    let file = std::env::args_os().nth(1).context("expected a file for the figures, such as lerc.json")?;
    let land = Land::new(1);
    let chunks: Vec<_> = samples::chunks(&land, CHUNKS).map(|(_, heights)| heights).collect();
    ensure!(chunks.len() == CHUNKS, "{} chunks instead of {CHUNKS}", chunks.len());
    let (mut bytes, mut best) = (0, vec![[f64::INFINITY; 2]; chunks.len()]);
    for turn in 0..TURNS {
        for (heights, best) in chunks.iter().zip(&mut best) {
            let started = Instant::now();
            let coded = black_box(lerc::encode(black_box(heights), None, VERTICES, VERTICES, 1, 1, 0, 0.0))?;
            best[0] = best[0].min(started.elapsed().as_secs_f64());
            let started = Instant::now();
            let decoded = lerc::decode::<u16>(black_box(&coded), VERTICES, VERTICES, 1, 1, 0)?;
            let (decoded, _) = black_box(decoded);
            best[1] = best[1].min(started.elapsed().as_secs_f64());
            ensure!(decoded == *heights, "a decoded chunk differs");
            if turn == 0 {
                bytes += coded.len();
            }
        }
    }
    let mean_ns = |which: usize| 1e9 * best.iter().map(|best| best[which]).sum::<f64>() / CHUNKS as f64;
    let report = json!({
        "codec": "LERC, no error",
        "bytes_per_sample": bytes as f64 / (CHUNKS * VERTEX_COUNT) as f64,
        "encode_ns": mean_ns(0),
        "decode_ns": mean_ns(1),
        "decode_gb_per_s": 2.0 * VERTEX_COUNT as f64 / mean_ns(1),
    });
    println!("{report}");
    std::fs::write(&file, report.to_string())
        .with_context(|| format!("cannot write {}", file.to_string_lossy()))
}
