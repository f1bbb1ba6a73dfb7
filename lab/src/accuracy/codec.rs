//! Chunk codec: bytes, time and error by tolerance and effort; samples against seeds.
//!
//! Times are the shortest of `TURNS` for each chunk, in milliseconds; in a debug build they mean
//! little.

use crate::curve::{Curve, Sheet};
use crate::sample;
use anyhow::{Result, ensure};
use chart::{Panel, linear, log};
use protocol::chunk_codec::{self, Effort, quantised, refined, seed_only};
use protocol::{Delivery, Tolerance};
use std::hint::black_box;
use std::time::Instant;
use terrain::constants::{UNITS_PER_METRE, VERTEX_COUNT};
use terrain::{Chunk, ChunkKey, Land, WorldDigest};

/// Times that each chunk is coded.
const TURNS: u32 = 7;

/// Places whose chunks are coded.
const PLACES: u32 = 32;

const OWN_FRAME: &str = "a frame of this encoder is valid";

const EFFORTS: [(Effort, &str); 2] = [(Effort::Compact, "compact"), (Effort::Fast, "fast")];

/// Deliveries: name in the table, name in diagrams.
const DELIVERIES: [(&str, &str); 4] =
    [("exact", "exact, compact"), ("fast", "exact, fast"), ("refined", "refined"), ("seed", "seed only")];

const DELIVERY: &str = "\
     bytes of a frame and the client's time to a verified chunk, one thread, by level of \
     detail: samples at both efforts, samples for clients with the parent (up to level 1), and seeds.";

/// # Errors
/// A quantised height is farther off than its frame states, or a frame does not restore its chunk.
pub fn measure(world_seed: u64) -> Result<Curve> {
    let land = Land::new(world_seed);
    let world = land.digest();
    let tolerances = tolerances(&land, &world)?;
    let deliveries = deliveries(&land, &world)?;
    let points = |column: &str| tolerances.points("tolerance, m", column).into_iter().skip(1);
    let span = [Tolerance::FINEST.metres(), Tolerance::COARSEST.metres()];
    let x = log("tolerance, m");
    let by_effort = |title, y, figure: &str| {
        let line = |panel: Panel, (_, name)| panel.line(name, points(&format!("{figure}, {name}")));
        EFFORTS.into_iter().fold(Panel::new(title, x, linear(y)), line)
    };
    let by_level = Panel::new(
        "Bytes against the client's time, by level of detail",
        log("bytes per chunk"),
        log("client, ms per chunk"),
    );
    let line = |panel: Panel, (name, label)| {
        let points = deliveries.points(&format!("bytes, {name}"), &format!("client ms, {name}"));
        panel.line(label, points.into_iter().filter(|(bytes, ms)| bytes.is_finite() && ms.is_finite()))
    };
    let panels = vec![
        by_effort("Size against tolerance", "bytes per vertex", "bytes per vertex"),
        Panel::new("Height error against tolerance", x, log("height error, m"))
            .line("largest found", points("max error, m"))
            .bound("the tolerance", span.map(|m| (m, m))),
        by_effort("Decoding time against tolerance", "decode, ms per chunk", "decode, ms"),
        DELIVERIES.into_iter().fold(by_level, line),
    ];
    let tables = vec![tolerances.into(), deliveries.into()];
    let title = "Codec of chunks: bytes, milliseconds and error (reference: the land's own integers)";
    Ok(Curve { name: "codec", title, tables, panels })
}

/// A tolerance; by effort: bytes of a frame, encoding and decoding in milliseconds.
struct Coded {
    stated_m: f64,
    error_m: f64,
    by_effort: [[f64; 3]; 2],
}

/// Bytes of a frame and milliseconds of the client by delivery.
struct Delivered {
    level: u8,
    chunks: usize,
    by_delivery: [[f64; 2]; 4],
}

fn chunks(land: &Land, level: u8) -> Vec<Chunk> {
    let mut keys: Vec<_> = sample::land_vertices(land.world_seed(), PLACES, 31)
        .map(|(x, z)| ChunkKey::containing(level, x, z))
        .collect();
    keys.sort_unstable();
    keys.dedup();
    keys.into_iter().map(|key| land.chunk(key)).collect()
}

/// Mean over all chunks of the shortest time of some work, milliseconds.
fn milliseconds<T>(chunks: &[Chunk], mut work: impl FnMut(usize, &Chunk) -> T) -> f64 {
    let mut total = 0.0;
    for (index, chunk) in chunks.iter().enumerate() {
        let mut best = f64::INFINITY;
        for _ in 0..TURNS {
            let began = Instant::now();
            black_box(work(index, black_box(chunk)));
            best = best.min(began.elapsed().as_secs_f64());
        }
        total += best;
    }
    1e3 * total / chunks.len() as f64
}

fn bytes<T: AsRef<[u8]>>(frames: &[T]) -> f64 {
    frames.iter().map(|frame| frame.as_ref().len()).sum::<usize>() as f64 / frames.len() as f64
}

fn tolerances(land: &Land, world: &WorldDigest) -> Result<Sheet<Coded>> {
    let chunks = chunks(land, 0);
    let mut rows = Vec::new();
    for tolerance in std::iter::once(None).chain(Tolerance::all().map(Some)) {
        let delivery = tolerance.map_or(Delivery::Exact, Delivery::Quantised);
        let decode = |frame: &[u8]| match tolerance {
            None => chunk_codec::decode(frame, world),
            Some(tolerance) => quantised::decode(frame, world, tolerance),
        };
        let (mut by_effort, mut error) = ([[0.0; 3]; 2], 0);
        for ((effort, _), figures) in EFFORTS.into_iter().zip(&mut by_effort) {
            let encode = |chunk: &Chunk| chunk_codec::encode_with(delivery, effort, chunk, world);
            let frames: Vec<_> = chunks.iter().map(encode).collect();
            for (chunk, frame) in chunks.iter().zip(&frames) {
                let got = decode(frame)?;
                let errors = got.heights.iter().zip(&chunk.heights[..]).map(|(got, own)| got.abs_diff(*own));
                error = error.max(errors.max().unwrap_or(0));
            }
            *figures = [
                bytes(&frames),
                milliseconds(&chunks, |_, chunk| encode(chunk)),
                milliseconds(&chunks, |index, _| decode(&frames[index])),
            ];
        }
        let stated_m = tolerance.map_or(0.0, Tolerance::metres);
        let error_m = f64::from(error) / f64::from(UNITS_PER_METRE);
        ensure!(error_m <= stated_m, "a height is {error_m} m off, the frame states {stated_m} m");
        rows.push(Coded { stated_m, error_m, by_effort });
    }
    ensure!(
        rows.iter().skip(1).all(|row| row.error_m * 2.0 >= row.stated_m),
        "quantising moves no height by half of its tolerance: the comparison detects nothing"
    );
    let caption = format!(
        "whole frames of {} level-0 chunks with land, exact (tolerance 0) and quantised, at both \
         efforts; times of one thread, digest and pyramids included.",
        chunks.len()
    );
    let mut sheet = Sheet::new("codec_tolerance", caption, rows);
    sheet.columns(["tolerance, m", "max error, m"], |row| [row.stated_m, row.error_m]);
    for (effort, (_, name)) in EFFORTS.into_iter().enumerate() {
        let names = ["bytes per vertex", "encode, ms", "decode, ms"].map(|what| format!("{what}, {name}"));
        sheet.columns(names, |row| {
            let [bytes, encode, decode] = row.by_effort[effort];
            [bytes / VERTEX_COUNT as f64, encode, decode]
        });
    }
    Ok(sheet)
}

fn deliveries(land: &Land, world: &WorldDigest) -> Result<Sheet<Delivered>> {
    let mut rows = Vec::new();
    for level in [0, 1, 2, 3, 4, 6, 8] {
        let chunks = chunks(land, level);
        let [compact, fast] = EFFORTS.map(|(effort, _)| {
            let encode = |chunk| chunk_codec::encode_with(Delivery::Exact, effort, chunk, world);
            let frames: Vec<_> = chunks.iter().map(encode).collect();
            // An error would be a very fast decoder.
            let open = |index: usize, _: &Chunk| chunk_codec::decode(&frames[index], world).expect(OWN_FRAME);
            [bytes(&frames), milliseconds(&chunks, open)]
        });
        let parents: Vec<_> =
            chunks.iter().filter_map(|chunk| chunk.key.parent()).map(|key| land.chunk(key)).collect();
        let pairs = chunks.iter().zip(&parents);
        let encode = |(chunk, parent)| refined::encode(chunk, parent, world, Effort::Compact);
        let frames: Option<Vec<_>> = pairs.map(encode).collect();
        let refined = frames.map_or([f64::NAN; 2], |frames| {
            let open = |index: usize, _: &Chunk| {
                refined::decode(&frames[index], world, &parents[index]).expect(OWN_FRAME)
            };
            [bytes(&frames), milliseconds(&chunks, open)]
        });
        let frames: Vec<_> = chunks.iter().map(|chunk| seed_only::encode(chunk, world)).collect();
        for (frame, chunk) in frames.iter().zip(&chunks) {
            ensure!(
                seed_only::decode(frame, land, world)? == *chunk,
                "chunk {} differs when generated from its seed",
                chunk.key
            );
        }
        let open = |index: usize, _: &Chunk| seed_only::decode(&frames[index], land, world);
        let seed = [bytes(&frames), milliseconds(&chunks, open)];
        rows.push(Delivered { level, chunks: chunks.len(), by_delivery: [compact, fast, refined, seed] });
    }
    let mut sheet = Sheet::new("codec_delivery", DELIVERY, rows);
    sheet.columns(["level", "chunks"], |row| [row.level.into(), row.chunks as f64]);
    for (delivery, (name, _)) in DELIVERIES.into_iter().enumerate() {
        let names = [format!("bytes, {name}"), format!("client ms, {name}")];
        sheet.columns(names, |row| row.by_delivery[delivery]);
    }
    Ok(sheet)
}
