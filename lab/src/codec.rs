//! `codec`: chunks on the wire against common codecs, in bytes and in time, interleaved in one run.
//!
//! Every codec gets the heights of the same level-0 chunks with land and must restore them. Bytes
//! are those of the heights alone: for ours the frame without its header and grass, without any
//! container. A time is the shortest of all turns for each chunk, summed. Decoding times are of the
//! heights alone too; those of whole frames, digest and pyramids included, stand beside them.

mod baselines;

use crate::Outputs;
use anyhow::{Result, anyhow, bail};
use protocol::chunk_codec::{self, Effort, Kernel, refined};
use protocol::limits::CHUNK_HEADER;
use protocol::{Delivery, Tolerance};
use serde::Serialize;
use std::collections::HashMap;
use std::fmt;
use std::hint::black_box;
use std::time::Instant;
use terrain::constants::{VERTEX_COUNT, VERTICES};
use terrain::{Chunk, ChunkKey, Land, WorldDigest};

/// Bytes of the first lines of a payload: grass seed and palette.
const GRASS_SEED: usize = 5;

/// Bytes of a chunk's heights as u16, to which rates refer.
const U16_BYTES: f64 = 2.0 * VERTEX_COUNT as f64;

/// Largest allowed size of a compact frame's heights over the order-0 entropy of their plane
/// residuals.
pub const SIZE_BAR: f64 = 1.08;

/// Slowest allowed decoding of heights at the two efforts, GB/s of u16.
pub const COMPACT_RATE_BAR: f64 = 1.2;
/// See [`COMPACT_RATE_BAR`].
pub const FAST_RATE_BAR: f64 = 3.0;

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
}

/// What one codec does. Field names are a contract with scripts.
#[derive(Clone, Debug, Serialize)]
pub struct Row {
    /// Its name.
    pub codec: &'static str,
    /// Bytes a height.
    pub bytes_per_sample: f64,
    /// Those over the order-0 entropy of the plane residuals.
    pub of_entropy: f64,
    /// Encoding a chunk, nanoseconds; ours with header and digest.
    pub encode_ns: f64,
    /// Decoding the heights of a chunk, nanoseconds.
    pub decode_ns: f64,
    /// Its heights as u16 over that time, GB/s.
    pub decode_gb_per_s: f64,
    /// Whole frame to verified chunk with pyramids, nanoseconds; ours only.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub decode_frame_ns: Option<f64>,
    /// Whether every chunk came back.
    pub lossless: bool,
}

/// A bar, its figure, and a control codec that must miss it. Field names are a contract with
/// scripts.
#[derive(Clone, Debug, Serialize)]
pub struct Bar {
    /// Description.
    pub what: &'static str,
    /// Measured.
    pub measured: f64,
    /// The limit.
    pub bar: f64,
    /// Whether the figure meets it.
    pub holds: bool,
    /// The codec that must miss it.
    pub control: &'static str,
    /// Figure of the control.
    pub control_measured: f64,
    /// Whether the control meets it: then the measurement detects nothing.
    pub control_holds: bool,
}

/// The result. Field names are a contract with scripts.
#[derive(Clone, Debug, Serialize)]
pub struct Report {
    /// Seed of the world.
    pub world_seed: u64,
    /// Level-0 chunks with land whose relief fits u16.
    pub chunks: usize,
    /// Turns.
    pub turns: u32,
    /// Whether the build is optimised; otherwise times mean nothing.
    pub optimised: bool,
    /// The kernel of the plane transform.
    pub kernel: String,
    /// Order-0 entropy of the plane residuals, each chunk by its own, bytes a sample.
    pub entropy_bytes_per_sample: f64,
    /// Ours first.
    pub rows: Vec<Row>,
    /// The bars.
    pub bars: Vec<Bar>,
}

/// One chunk.
pub(crate) struct Sample {
    pub(crate) chunk: Chunk,
    pub(crate) parent: Chunk,
    /// Heights above the lowest.
    pub(crate) above: Vec<u16>,
}

type Encode = Box<dyn FnMut(&Sample) -> Vec<u8>>;

/// Writes the heights into a buffer, so that no allocation is timed; leaves it empty on failure.
type Decode = Box<dyn FnMut(&[u8], &Sample, &mut Vec<i32>)>;

type Open = Box<dyn FnMut(&[u8], &Sample) -> bool>;

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
/// A codec loses something, a control meets a bar, or an optimised build misses one.
pub fn run(options: &Options, outputs: &Outputs) -> Result<()> {
    let report = measure(options)?;
    println!("{report}");
    outputs.write_json(&report)?;
    report.verdict()
}

/// Measures.
///
/// # Errors
/// There is no chunk to measure.
pub fn measure(options: &Options) -> Result<Report> {
    let land = Land::new(options.world_seed);
    let world = land.digest();
    let samples = samples(&land, options.chunks as usize);
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
    let rows = compare(&mut cases, &samples, options.turns, entropy);
    let bars = bars(&rows);
    Ok(Report {
        world_seed: options.world_seed,
        chunks: samples.len(),
        turns: options.turns,
        optimised: !cfg!(debug_assertions),
        kernel: Kernel::best().to_string(),
        entropy_bytes_per_sample: entropy,
        rows,
        bars,
    })
}

/// Chunks of the home island spread evenly, none of them open sea.
fn samples(land: &Land, count: usize) -> Vec<Sample> {
    let near = (-24..24).flat_map(|z| (-24..24).map(move |x| (x, z)));
    let keys: Vec<_> = near
        .filter_map(|(x, z)| ChunkKey::new(0, x, z).ok())
        .filter(|key| {
            let (x, z) = key.origin();
            !land.archipelago().is_open_sea(x, z, key.side())
        })
        .collect();
    let step = (keys.len() / count.max(1)).max(1);
    keys.into_iter()
        .step_by(step)
        .filter_map(|key| {
            let (chunk, parent) = (land.chunk(key), land.chunk(key.parent()?));
            let low = chunk.min();
            let above =
                chunk.heights.iter().map(|height| u16::try_from(height - low).ok()).collect::<Option<_>>()?;
            Some(Sample { chunk, parent, above })
        })
        .take(count)
        .collect()
}

/// Bits of information in the plane residuals of a chunk if each were coded alone by its share in
/// this chunk; bytes.
pub(crate) fn entropy(heights: &[i32; VERTEX_COUNT]) -> f64 {
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
        open: Some(Box::new(move |frame, sample| {
            chunk_codec::decode(frame, &world).as_ref() == Ok(&sample.chunk)
        })),
    };
    vec![
        exact("exact, compact", Effort::Compact),
        exact("exact, fast", Effort::Fast),
        Case {
            codec: "refined, compact",
            encode: Box::new(move |sample| {
                refined::encode(&sample.chunk, &sample.parent, &world, Effort::Compact)
                    .map(Into::into)
                    .unwrap_or_default()
            }),
            extra: CHUNK_HEADER + GRASS_SEED,
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

/// The control of losslessness.
const LOSSY: &str = "control: quantised to 1/256 m";

fn compare(cases: &mut [Case], samples: &[Sample], turns: u32, entropy: f64) -> Vec<Row> {
    struct Totals {
        bytes: usize,
        lossless: bool,
        /// Shortest times of each chunk, seconds: encoding, decoding, whole frame.
        best: Vec<[f64; 3]>,
    }
    let mut all_totals: Vec<_> = cases
        .iter()
        .map(|_| Totals { bytes: 0, lossless: true, best: vec![[f64::INFINITY; 3]; samples.len()] })
        .collect();
    let mut heights = Vec::new();
    for turn in 0..turns {
        for (index, sample) in samples.iter().enumerate() {
            for (case, totals) in cases.iter_mut().zip(&mut all_totals) {
                let best = &mut totals.best[index];
                let began = Instant::now();
                let coded = black_box((case.encode)(black_box(sample)));
                best[0] = best[0].min(began.elapsed().as_secs_f64());
                let began = Instant::now();
                (case.decode)(black_box(&coded), sample, &mut heights);
                black_box(&heights);
                best[1] = best[1].min(began.elapsed().as_secs_f64());
                if let Some(open) = &mut case.open {
                    let began = Instant::now();
                    totals.lossless &= black_box(open(black_box(&coded), sample));
                    best[2] = best[2].min(began.elapsed().as_secs_f64());
                }
                totals.lossless &= heights == sample.chunk.heights[..];
                if turn == 0 {
                    totals.bytes += coded.len() - case.extra.min(coded.len());
                }
            }
        }
    }
    let rows = cases.iter().zip(all_totals).map(|(case, totals)| {
        let mean_ns = |which: usize| {
            1e9 * totals.best.iter().map(|best| best[which]).sum::<f64>() / samples.len() as f64
        };
        let bytes_per_sample = totals.bytes as f64 / (samples.len() * VERTEX_COUNT) as f64;
        Row {
            codec: case.codec,
            bytes_per_sample,
            of_entropy: bytes_per_sample / entropy,
            encode_ns: mean_ns(0),
            decode_ns: mean_ns(1),
            decode_gb_per_s: U16_BYTES / mean_ns(1),
            decode_frame_ns: case.open.is_some().then(|| mean_ns(2)),
            lossless: totals.lossless,
        }
    });
    rows.collect()
}

fn bars(rows: &[Row]) -> Vec<Bar> {
    let of = |codec: &str| rows.iter().find(|row| row.codec == codec);
    let bar = |what, ours, control: &'static str, value: fn(&Row) -> f64, bar: f64, at_most: bool| {
        let (measured, control_measured) = (value(of(ours)?), value(of(control)?));
        let holds = |value: f64| if at_most { value <= bar } else { value >= bar };
        Some(Bar {
            what,
            measured,
            bar,
            holds: holds(measured),
            control,
            control_measured,
            control_holds: holds(control_measured),
        })
    };
    [
        bar(
            "heights of a compact frame over the order-0 entropy of their plane residuals, at most",
            "exact, compact",
            baselines::SCAN_DELTA,
            |row| row.of_entropy,
            SIZE_BAR,
            true,
        ),
        bar(
            "decoding the heights of a compact frame, GB/s of u16, at least",
            "exact, compact",
            baselines::SCAN_DELTA,
            |row| row.decode_gb_per_s,
            COMPACT_RATE_BAR,
            false,
        ),
        bar(
            "decoding the heights of a fast frame, GB/s of u16, at least",
            "exact, fast",
            baselines::PNG16,
            |row| row.decode_gb_per_s,
            FAST_RATE_BAR,
            false,
        ),
    ]
    .into_iter()
    .flatten()
    .collect()
}

impl Report {
    /// Whether every codec is lossless, every bar is met, and no control meets one.
    ///
    /// # Errors
    /// One line with the first that does not.
    pub fn verdict(&self) -> Result<()> {
        if let Some(row) = self.rows.iter().find(|row| row.lossless == (row.codec == LOSSY)) {
            return Err(if row.lossless {
                anyhow!("the control `{}` loses nothing: the comparison detects nothing", row.codec)
            } else {
                anyhow!("`{}` does not restore its heights", row.codec)
            });
        }
        for bar in &self.bars {
            // Times of a build that is not optimised say nothing; bytes do.
            let judged = self.optimised || bar.bar == SIZE_BAR;
            if judged && bar.control_holds {
                bail!(
                    "the control `{}` meets the bar `{}`: the measurement detects nothing",
                    bar.control,
                    bar.what
                );
            }
            if judged && !bar.holds {
                bail!("{}: {:.3}, the bar is {}", bar.what, bar.measured, bar.bar);
            }
        }
        Ok(())
    }
}

impl fmt::Display for Report {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let build = if self.optimised { "" } else { " (a debug build: times mean nothing)" };
        writeln!(
            f,
            "{} level-0 chunks with land, shortest of {} turns, transform on {}{build}; order-0 entropy of \
             plane residuals {:.4} bytes a sample",
            self.chunks, self.turns, self.kernel, self.entropy_bytes_per_sample
        )?;
        writeln!(
            f,
            "{:<44} {:>8} {:>9} {:>11} {:>11} {:>8} {:>11}",
            "codec", "B/sample", "/entropy", "encode, ns", "decode, ns", "GB/s", "frame, ns"
        )?;
        for row in &self.rows {
            let whole = row.decode_frame_ns.map_or_else(|| "-".into(), |ns| format!("{ns:.0}"));
            writeln!(
                f,
                "{:<44} {:>8.4} {:>9.3} {:>11.0} {:>11.0} {:>8.2} {:>11}{}",
                row.codec,
                row.bytes_per_sample,
                row.of_entropy,
                row.encode_ns,
                row.decode_ns,
                row.decode_gb_per_s,
                whole,
                if row.lossless { "" } else { "  lossy" }
            )?;
        }
        for bar in &self.bars {
            writeln!(
                f,
                "{}: {:.3} (bar {}, {}; control `{}` {:.3})",
                bar.what,
                bar.measured,
                bar.bar,
                if bar.holds { "held" } else { "missed" },
                bar.control,
                bar.control_measured
            )?;
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_codec_but_the_control_is_lossless_and_sizes_hold() {
        let report = measure(&Options { turns: 3, chunks: 4, world_seed: 1 }).unwrap();
        for row in &report.rows {
            assert_eq!(row.lossless, row.codec != LOSSY, "{}", row.codec);
        }
        assert!(report.bars.len() == 3 && report.bars[0].holds && !report.bars[0].control_holds, "{report}");
        let refined = report.rows.iter().find(|row| row.codec.starts_with("refined")).unwrap();
        assert!(refined.bytes_per_sample < 0.8 * report.rows[0].bytes_per_sample, "{report}");
    }

    #[test]
    fn entropy_is_that_of_the_symbols() {
        assert!(entropy(&[7; VERTEX_COUNT]).abs() < 1e-9);
        // Two equally frequent residuals are a bit each: a row of steps that change at every
        // vertex.
        let mut heights = [0; VERTEX_COUNT];
        let mut height = 0;
        for (index, out) in heights.iter_mut().enumerate() {
            height += i32::from(terrain::hash::mix((index % VERTICES) as u32) & 1 == 1);
            *out = height;
        }
        let bits = 8.0 * entropy(&heights);
        assert!(bits < VERTEX_COUNT as f64, "{bits}");
    }

    #[test]
    fn a_control_that_holds_and_a_missed_bar_are_errors() {
        let mut report = measure(&Options { turns: 3, chunks: 2, world_seed: 1 }).unwrap();
        report.bars.truncate(1);
        assert!(report.verdict().is_ok());
        let mut passing = report.clone();
        passing.bars[0].control_holds = true;
        assert!(passing.verdict().unwrap_err().to_string().contains("detects nothing"));
        report.bars[0].holds = false;
        assert!(report.verdict().unwrap_err().to_string().contains("the bar is"));
        let mut lossy = passing;
        lossy.rows[0].lossless = false;
        assert!(lossy.verdict().unwrap_err().to_string().contains("not restore"));
    }
}
