//! `codec`: chunks on the wire against common codecs, in bytes and in time, interleaved in one run.
//!
//! Every codec gets the heights of the same level-0 chunks with land and must restore them. Bytes
//! are those of the heights alone: for ours the frame without its header and grass, without any
//! container. A time is the median of all turns for each chunk, and the mean over the chunks.
//! Decoding times are of the heights alone too, except those of the refined codec, which has no
//! decoder of heights alone; those of whole frames, digest and pyramids included, stand beside
//! them.

mod bars;
mod baselines;
pub(crate) mod samples;

use crate::Outputs;
use crate::report::publish;
use crate::stats::median;
use ::bars::figures::at;
use anyhow::{Result, bail};
use bars::{COMPACT, FAST};
use protocol::chunk_codec::{self, Effort, Kernel, refined};
use protocol::limits::CHUNK_HEADER;
use protocol::{Delivery, Tolerance};
use serde::Serialize;
use serde_json::{Value, json};
use std::collections::HashMap;
use std::hint::black_box;
use std::path::{Path, PathBuf};
use std::time::Instant;
use terrain::constants::{VERTEX_COUNT, VERTICES};
use terrain::{Chunk, Land, WorldDigest};

/// Bytes of grass seed (u32) and palette (u8), the first fields of a payload.
const GRASS_SEED: usize = 5;

/// Bytes of a chunk's heights as u16, to which rates refer.
const U16_BYTES: f64 = 2.0 * VERTEX_COUNT as f64;

/// Options of `codec`.
#[derive(Clone, Debug, clap::Args)]
pub struct Options {
    /// Turns of every codec over all chunks, 3 to 1000
    #[arg(long, value_name = "N", default_value_t = 25,
          value_parser = clap::value_parser!(u32).range(3..=1000))]
    pub turns: u32,
    /// Chunks, 1 to 256
    #[arg(long, value_name = "N", default_value_t = 48,
          value_parser = clap::value_parser!(u32).range(1..=256))]
    pub chunks: u32,
    /// Seed of the world
    #[arg(long, value_name = "N", default_value_t = 1)]
    pub world_seed: u64,
    /// JSON file that `benches/lerc` wrote; adds the row of LERC
    #[arg(long, value_name = "FILE")]
    pub lerc: Option<PathBuf>,
}

/// What one codec does. Field names are a contract with scripts.
#[derive(Clone, Debug, Serialize)]
struct Row {
    codec: &'static str,
    bytes_per_sample: f64,
    /// Ratio of the bytes to the order-0 entropy of the plane residuals.
    of_entropy: f64,
    /// Nanoseconds to encode a chunk; ours with header and digest.
    encode_ns: f64,
    /// Nanoseconds to decode the heights of a chunk, or the whole frame (`decodes_whole_frame`).
    decode_ns: f64,
    /// Whether `decode_ns` includes digest, grass and pyramids: of the refined codec.
    decodes_whole_frame: bool,
    decode_gb_per_s: f64,
    /// Nanoseconds from a whole frame to a verified chunk with pyramids; ours only.
    #[serde(skip_serializing_if = "Option::is_none")]
    decode_frame_ns: Option<f64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    frame_gb_per_s: Option<f64>,
    /// Whether every chunk came back.
    lossless: bool,
}

/// The result. Field names are a contract with scripts.
#[derive(Clone, Debug, Serialize)]
struct Report {
    world_seed: u64,
    /// Level-0 chunks with land whose relief fits u16.
    chunks: usize,
    turns: u32,
    /// Whether the build is optimised; otherwise times mean nothing.
    optimised: bool,
    /// The kernel of the plane transform.
    kernel: String,
    /// Order-0 entropy of the plane residuals, each chunk by its own.
    entropy_bytes_per_sample: f64,
    /// Ours first.
    rows: Vec<Row>,
    /// The figures of LERC with their share of the entropy, if a file was named; null if that
    /// cannot be read.
    #[serde(skip_serializing_if = "Option::is_none")]
    lerc: Option<Value>,
}

/// One chunk.
struct Sample {
    chunk: Chunk,
    parent: Chunk,
    /// Heights above the lowest.
    above: Vec<u16>,
}

type Encode = Box<dyn FnMut(&Sample) -> Vec<u8>>;

/// Writes the heights into a buffer; leaves it empty on failure. Ours decode heights alone without
/// an allocation. The times of the baselines and of [`REFINED`] include the memory that their
/// decoders return.
type Decode = Box<dyn FnMut(&[u8], &Sample, &mut Vec<i32>)>;

/// Makes the verified chunk of a whole frame, in memory of its own.
type Open = Box<dyn FnMut(&[u8]) -> Option<Chunk>>;

/// A way to code heights.
struct Case {
    codec: &'static str,
    encode: Encode,
    /// Bytes of an encoding that are not heights.
    extra: usize,
    decode: Decode,
    /// Ours only.
    open: Option<Open>,
}

/// Measures, prints, judges.
///
/// # Errors
/// A codec loses something, or a bar is missed.
pub fn run(options: &Options, outputs: &Outputs) -> Result<()> {
    let report = measure(options)?;
    publish(&report, bars::rows, bars::notes, "/adapter", outputs)?;
    verdict(&report)
}

fn verdict(report: &Report) -> Result<()> {
    if let Some(bar) = bars::rows(&serde_json::to_value(report)?).into_iter().find(::bars::Bar::is_missed) {
        let [figure, limit, _] = bar.cells();
        bail!("{}: {figure}, the bar is {limit}", bar.name);
    }
    Ok(())
}

fn measure(options: &Options) -> Result<Report> {
    let land = Land::new(options.world_seed);
    let world = land.digest();
    let with_parent = |(chunk, above): (Chunk, _)| {
        let parent = land.chunk(chunk.key.parent()?);
        Some(Sample { chunk, parent, above })
    };
    let samples: Vec<Sample> =
        samples::chunks(&land, options.chunks as usize).filter_map(with_parent).collect();
    if samples.is_empty() {
        bail!("no chunk of the home island has a relief below 256 m: try another --world-seed");
    }
    let entropy = samples.iter().map(|sample| entropy(&sample.chunk.heights)).sum::<f64>()
        / (samples.len() * VERTEX_COUNT) as f64;
    let mut cases = ours(world);
    cases.extend(baselines::all().into_iter().map(|baseline| Case {
        codec: baseline.codec,
        encode: Box::new(move |sample| (baseline.encode)(&sample.above)),
        extra: 0,
        decode: Box::new(move |bytes, sample, out| {
            let low = sample.chunk.min();
            out.clear();
            out.extend((baseline.decode)(bytes).into_iter().map(|height| low + i32::from(height)));
        }),
        open: None,
    }));
    Ok(Report {
        world_seed: options.world_seed,
        chunks: samples.len(),
        turns: options.turns,
        optimised: !cfg!(debug_assertions),
        kernel: Kernel::best().to_string(),
        entropy_bytes_per_sample: entropy,
        rows: compare(&mut cases, &samples, options.turns, entropy),
        lerc: options.lerc.as_deref().map(|file| lerc(file, entropy)),
    })
}

/// The figures that `benches/lerc` left.
fn lerc(file: &Path, entropy: f64) -> Value {
    let text = std::fs::read_to_string(file).unwrap_or_default();
    let mut lerc: Value = serde_json::from_str(&text).unwrap_or_default();
    if let Some(bytes) = at(&lerc, "bytes_per_sample") {
        lerc["of_entropy"] = json!(bytes / entropy);
    }
    lerc
}

/// Bits of information in the plane residuals of a chunk if each were coded alone by its share in
/// this chunk; bytes.
fn entropy(heights: &[i32; VERTEX_COUNT]) -> f64 {
    let mut shares = HashMap::<i32, u32>::new();
    for index in 0..VERTEX_COUNT {
        let at = |back: usize| heights[index - back];
        let predicted = match (index % VERTICES, index / VERTICES) {
            (0, 0) => at(0),
            (_, 0) => at(1),
            (0, _) => at(VERTICES),
            _ => at(1) + at(VERTICES) - at(VERTICES + 1),
        };
        *shares.entry(at(0) - predicted).or_default() += 1;
    }
    let bits = |count: u32| -f64::from(count) * (f64::from(count) / VERTEX_COUNT as f64).log2();
    shares.into_values().map(bits).sum::<f64>() / 8.0
}

/// Decodes the heights of one of our frames.
fn heights(frame: &[u8], out: &mut Vec<i32>) {
    out.resize(VERTEX_COUNT, 0);
    let Ok(room) = <&mut [i32; VERTEX_COUNT]>::try_from(&mut out[..]) else { return };
    if chunk_codec::heights_on(Kernel::best(), frame, room).is_err() {
        out.clear();
    }
}

fn ours(world: WorldDigest) -> Vec<Case> {
    let exact = |codec, effort| Case {
        codec,
        encode: Box::new(move |sample: &Sample| {
            chunk_codec::encode_with(Delivery::Exact, effort, &sample.chunk, &world).into()
        }),
        extra: CHUNK_HEADER + GRASS_SEED,
        decode: Box::new(|frame, _, out| heights(frame, out)),
        open: Some(Box::new(move |frame| chunk_codec::decode(frame, &world).ok())),
    };
    vec![
        exact(COMPACT, Effort::Compact),
        exact(FAST, Effort::Fast),
        Case {
            codec: REFINED,
            encode: Box::new(move |sample| {
                refined::encode(&sample.chunk, &sample.parent, &world, Effort::Compact)
                    .map(Into::into)
                    .unwrap_or_default()
            }),
            extra: CHUNK_HEADER + GRASS_SEED,
            // The whole frame: there is no decoder of its heights alone.
            decode: Box::new(move |frame, sample, out| {
                out.clear();
                if let Ok(chunk) = refined::decode(frame, &world, &sample.parent) {
                    out.extend_from_slice(&chunk.heights[..]);
                }
            }),
            open: None,
        },
        Case {
            codec: LOSSY,
            encode: Box::new(move |sample| {
                let delivery = Delivery::Quantised(Tolerance::FINEST);
                chunk_codec::encode_with(delivery, Effort::Compact, &sample.chunk, &world).into()
            }),
            extra: CHUNK_HEADER + GRASS_SEED,
            decode: Box::new(|frame, _, out| heights(frame, out)),
            open: None,
        },
    ]
}

/// The codec that predicts a chunk from its parent.
const REFINED: &str = "refined, compact";

/// The control of losslessness.
const LOSSY: &str = "control: quantised to 1/256 m";

fn compare(cases: &mut [Case], samples: &[Sample], turns: u32, entropy: f64) -> Vec<Row> {
    struct Totals {
        bytes: usize,
        lossless: bool,
        /// Times of each chunk, seconds: encoding, decoding, whole frame.
        times: Vec<[Vec<f64>; 3]>,
    }
    let mut all_totals: Vec<_> = cases
        .iter()
        .map(|_| Totals { bytes: 0, lossless: true, times: vec![Default::default(); samples.len()] })
        .collect();
    let mut heights = Vec::new();
    for turn in 0..turns {
        for (index, sample) in samples.iter().enumerate() {
            for (case, totals) in cases.iter_mut().zip(&mut all_totals) {
                let times = &mut totals.times[index];
                let began = Instant::now();
                let coded = black_box((case.encode)(black_box(sample)));
                times[0].push(began.elapsed().as_secs_f64());
                let began = Instant::now();
                (case.decode)(black_box(&coded), sample, &mut heights);
                black_box(&heights);
                times[1].push(began.elapsed().as_secs_f64());
                if let Some(open) = &mut case.open {
                    let began = Instant::now();
                    let chunk = black_box(open(black_box(&coded)));
                    times[2].push(began.elapsed().as_secs_f64());
                    totals.lossless &= chunk.as_ref() == Some(&sample.chunk);
                }
                totals.lossless &= heights == sample.chunk.heights[..];
                if turn == 0 {
                    totals.bytes += coded.len() - case.extra.min(coded.len());
                }
            }
        }
    }
    let rows = cases.iter().zip(all_totals).map(|(case, totals)| {
        // The median over the turns of each chunk, the mean over the chunks.
        let mean_ns = |which: usize| {
            let of_chunks = totals.times.iter().map(|times| median(times[which].iter().copied()));
            1e9 * of_chunks.sum::<f64>() / samples.len() as f64
        };
        let bytes_per_sample = totals.bytes as f64 / (samples.len() * VERTEX_COUNT) as f64;
        Row {
            codec: case.codec,
            bytes_per_sample,
            of_entropy: bytes_per_sample / entropy,
            encode_ns: mean_ns(0),
            decode_ns: mean_ns(1),
            decodes_whole_frame: case.codec == REFINED,
            decode_gb_per_s: U16_BYTES / mean_ns(1),
            decode_frame_ns: case.open.is_some().then(|| mean_ns(2)),
            frame_gb_per_s: case.open.is_some().then(|| U16_BYTES / mean_ns(2)),
            lossless: totals.lossless,
        }
    });
    rows.collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_codec_but_the_control_is_lossless_and_sizes_hold() {
        let report = measure(&Options { turns: 3, chunks: 16, world_seed: 1, lerc: None }).unwrap();
        for row in &report.rows {
            assert_eq!(row.lossless, row.codec != LOSSY, "{}", row.codec);
        }
        verdict(&report).unwrap();
        let refined = report.rows.iter().find(|row| row.codec == REFINED).unwrap();
        let whole: Vec<_> =
            report.rows.iter().filter(|row| row.decodes_whole_frame).map(|row| row.codec).collect();
        assert_eq!(whole, [REFINED]);
        assert!(refined.bytes_per_sample < 0.8 * report.rows[0].bytes_per_sample, "{report:?}");
    }

    #[test]
    fn entropy_is_that_of_the_symbols() {
        assert!(entropy(&[7; VERTEX_COUNT]).abs() < 1e-9);
        // Residuals of 1 at odd places and of 0 at even ones: nearly a bit each.
        let mut heights = [0; VERTEX_COUNT];
        for index in 0..VERTEX_COUNT {
            let predicted = match (index % VERTICES, index / VERTICES) {
                (0, 0) => 0,
                (_, 0) => heights[index - 1],
                (0, _) => heights[index - VERTICES],
                _ => heights[index - 1] + heights[index - VERTICES] - heights[index - VERTICES - 1],
            };
            heights[index] = predicted + (index % 2) as i32;
        }
        let count = VERTEX_COUNT as f64;
        let ones = (VERTEX_COUNT / 2) as f64;
        let bits = -ones * (ones / count).log2() - (count - ones) * (1.0 - ones / count).log2();
        assert!((8.0 * entropy(&heights) - bits).abs() < 1e-6, "{bits}");
        assert!(bits > 0.999 * count, "{bits}");
    }

    #[test]
    fn a_lossy_codec_and_a_control_that_holds_are_errors() {
        let good = measure(&Options { turns: 3, chunks: 16, world_seed: 1, lerc: None }).unwrap();
        verdict(&good).unwrap();
        let corrupted = |corrupt: fn(&mut Row), codec: &str| {
            let mut report = good.clone();
            report.rows.iter_mut().filter(|row| row.codec == codec).for_each(corrupt);
            verdict(&report).unwrap_err().to_string()
        };
        assert!(corrupted(|row| row.lossless = false, COMPACT).contains("lose something"));
        assert!(corrupted(|row| row.lossless = true, LOSSY).contains("control"));
        assert!(corrupted(|row| row.of_entropy = 1.1, COMPACT).contains("the bar is at most 1.080 x"));
    }

    #[test]
    fn lerc_is_compared_with_the_same_entropy_and_is_null_without_its_file() {
        let file = std::env::temp_dir().join(format!("lerc-{}.json", std::process::id()));
        std::fs::write(&file, r#"{"bytes_per_sample":1.5}"#).unwrap();
        assert_eq!(lerc(&file, 0.75)["of_entropy"], 2.0);
        std::fs::remove_file(&file).unwrap();
        assert_eq!(lerc(&file, 0.75), Value::Null);
    }
}
