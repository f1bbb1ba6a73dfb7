//! The codec of chunks: what a tolerance and an effort cost and save, and samples against seeds.
//!
//! Times are the shortest of `TURNS` for each chunk, in milliseconds; in a debug build they mean
//! little.

use super::Curve;
use crate::chart::{Panel, linear, log, measured, stated};
use crate::sample;
use crate::table::Table;
use anyhow::{Result, anyhow};
use protocol::chunk_codec::{self, Effort, quantised, refined, seed_only};
use protocol::{Delivery, Tolerance};
use std::hint::black_box;
use std::time::Instant;
use terrain::constants::{UNITS_PER_METRE, VERTEX_COUNT};
use terrain::{Chunk, ChunkKey, Land, Pyramid, WorldDigest};

/// Times that each chunk is coded.
const TURNS: u32 = 7;

/// Places whose chunks are coded.
const PLACES: u32 = 32;

/// Measures a world.
///
/// # Errors
/// A quantised height is farther off than its frame states, or a frame does not give back its
/// chunk.
pub fn measure(world_seed: u64) -> Result<Curve> {
    let land = Land::new(world_seed);
    let world = land.digest();
    let tolerances = tolerances(&land, &world)?;
    let deliveries = deliveries(&land, &world)?;
    let pyramids = pyramids(&land, &world);
    let (tolerance, bytes) = ("tolerance, m", "bytes per vertex, compact");
    let span = [Tolerance::FINEST.metres(), Tolerance::COARSEST.metres()];
    let panels = vec![
        Panel {
            title: "Size against tolerance",
            x: log(tolerance),
            y: linear("bytes per vertex"),
            series: vec![
                measured("compact", tolerances.curve(tolerance, bytes).into_iter().skip(1)),
                measured("fast", tolerances.curve(tolerance, "bytes per vertex, fast").into_iter().skip(1)),
            ],
        },
        Panel {
            title: "Height error against tolerance",
            x: log(tolerance),
            y: log("height error, m"),
            series: vec![
                measured("largest found", tolerances.curve(tolerance, "max error, m").into_iter().skip(1)),
                stated("the tolerance", span.map(|m| (m, m))),
            ],
        },
        Panel {
            title: "What a tolerance costs to decode",
            x: log(tolerance),
            y: linear("decode, ms per chunk"),
            series: vec![
                measured("compact", tolerances.curve(tolerance, "decode, ms, compact").into_iter().skip(1)),
                measured("fast", tolerances.curve(tolerance, "decode, ms, fast").into_iter().skip(1)),
            ],
        },
        Panel {
            title: "Bytes against the client's time, by level of detail",
            x: log("bytes per chunk"),
            y: log("client, ms per chunk"),
            series: [
                ("exact, compact", "exact"),
                ("exact, fast", "fast"),
                ("refined", "refined"),
                ("seed only", "seed"),
            ]
            .map(|(label, name)| {
                let points = deliveries.curve(&format!("bytes, {name}"), &format!("client ms, {name}"));
                measured(label, points.into_iter().filter(|(bytes, ms)| bytes.is_finite() && ms.is_finite()))
            })
            .into(),
        },
    ];
    Ok(Curve {
        name: "codec",
        title: "Codec of chunks: bytes, milliseconds and error (truth: the land's own integers)",
        tables: vec![tolerances, deliveries, pyramids],
        panels,
    })
}

/// Chunks with land of a level.
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

fn tolerances(land: &Land, world: &WorldDigest) -> Result<Table> {
    let chunks = chunks(land, 0);
    let mut table = Table::new(
        "codec_tolerance",
        format!(
            "whole frames of {} level-0 chunks with land, exact (tolerance 0) and quantised, at both efforts; times of one thread, digest and pyramids included.",
            chunks.len()
        ),
        &[
            "tolerance, m",
            "max error, m",
            "bytes per vertex, compact",
            "encode, ms, compact",
            "decode, ms, compact",
            "bytes per vertex, fast",
            "encode, ms, fast",
            "decode, ms, fast",
        ],
    );
    for tolerance in std::iter::once(None).chain(Tolerance::all().map(Some)) {
        let delivery = tolerance.map_or(Delivery::Exact, Delivery::Quantised);
        let decode = |frame: &[u8]| match tolerance {
            None => chunk_codec::decode(frame, world),
            Some(tolerance) => quantised::decode(frame, world, tolerance),
        };
        let stated_m = tolerance.map_or(0.0, Tolerance::metres);
        let (mut row, mut farthest) = (vec![stated_m, 0.0], 0);
        for effort in [Effort::Compact, Effort::Fast] {
            let encode = |chunk: &Chunk| chunk_codec::encode_with(delivery, effort, chunk, world);
            let frames: Vec<_> = chunks.iter().map(encode).collect();
            for (chunk, frame) in chunks.iter().zip(&frames) {
                let got = decode(frame)?;
                let apart = got.heights.iter().zip(&chunk.heights[..]).map(|(got, own)| got.abs_diff(*own));
                farthest = farthest.max(apart.max().unwrap_or(0));
            }
            row.extend([
                bytes(&frames) / VERTEX_COUNT as f64,
                milliseconds(&chunks, |_, chunk| encode(chunk)),
                milliseconds(&chunks, |index, _| decode(&frames[index])),
            ]);
        }
        row[1] = f64::from(farthest) / f64::from(UNITS_PER_METRE);
        if row[1] > stated_m {
            return Err(anyhow!("a height is {} m off, the frame states {stated_m} m", row[1]));
        }
        table.push(row);
    }
    // The comparison sees an error where there is one.
    if table.rows.iter().skip(1).any(|row| row[1] * 2.0 < row[0]) {
        return Err(anyhow!("quantising moves no height by half of its tolerance: the comparison is blind"));
    }
    Ok(table)
}

fn deliveries(land: &Land, world: &WorldDigest) -> Result<Table> {
    let mut table = Table::new(
        "codec_delivery",
        "bytes of a frame and the client's time to a verified chunk, one thread, by level of detail: samples at both efforts, samples for who has the parent (up to level 1), and seeds.",
        &[
            "level",
            "chunks",
            "bytes, exact",
            "client ms, exact",
            "bytes, fast",
            "client ms, fast",
            "bytes, refined",
            "client ms, refined",
            "bytes, seed",
            "client ms, seed",
        ],
    );
    for level in [0, 1, 2, 3, 4, 6, 8] {
        let chunks = chunks(land, level);
        let mut row = vec![f64::from(level), chunks.len() as f64];
        for effort in [Effort::Compact, Effort::Fast] {
            let frames: Vec<_> = chunks
                .iter()
                .map(|chunk| chunk_codec::encode_with(Delivery::Exact, effort, chunk, world))
                .collect();
            let open = |index: usize, _: &Chunk| chunk_codec::decode(&frames[index], world);
            row.extend([bytes(&frames), milliseconds(&chunks, open)]);
        }
        let parents: Vec<_> =
            chunks.iter().filter_map(|chunk| chunk.key.parent()).map(|key| land.chunk(key)).collect();
        let frames: Option<Vec<_>> = chunks
            .iter()
            .zip(&parents)
            .map(|(chunk, parent)| refined::encode(chunk, parent, world, Effort::Compact))
            .collect();
        row.extend(frames.map_or([f64::NAN; 2], |frames| {
            let open = |index: usize, _: &Chunk| refined::decode(&frames[index], world, &parents[index]);
            [bytes(&frames), milliseconds(&chunks, open)]
        }));
        let frames: Vec<_> = chunks.iter().map(|chunk| seed_only::encode(chunk, world)).collect();
        for (frame, chunk) in frames.iter().zip(&chunks) {
            if seed_only::decode(frame, land, world)? != *chunk {
                return Err(anyhow!("chunk {} made from its seed is another", chunk.key));
            }
        }
        let open = |index: usize, _: &Chunk| seed_only::decode(&frames[index], land, world);
        row.extend([bytes(&frames), milliseconds(&chunks, open)]);
        table.push(row);
    }
    Ok(table)
}

/// What sending the pyramids would cost instead of rebuilding them: every base texel follows from
/// four heights, so whatever is sent of them is too much.
fn pyramids(land: &Land, world: &WorldDigest) -> Table {
    let chunks = chunks(land, 0);
    let mut table = Table::new(
        "codec_pyramids",
        "both pyramids of a level-0 chunk: rebuilt from the heights, or sent as differences to the first corner of each cell in a zstd 1 frame; the frame without them for scale.",
        &["rebuild, ms", "read, ms", "bytes sent", "bytes of the frame"],
    );
    let content = |chunk: &Chunk| -> Vec<u8> {
        let texels = |pyramid: &Pyramid| -> Vec<u8> {
            let corner = |index: usize| chunk.vertex(index % 64, index / 64);
            let differences =
                pyramid.level(0).iter().enumerate().map(|(index, texel)| texel.abs_diff(corner(index)));
            let words: Vec<u32> = differences.collect();
            (0..2)
                .flat_map(|plane| {
                    words.iter().map(move |word| (word >> (8 * plane)) as u8).collect::<Vec<_>>()
                })
                .collect()
        };
        [texels(&chunk.max_pyramid), texels(&chunk.min_pyramid)].concat()
    };
    let sent: Vec<_> =
        chunks.iter().map(|chunk| zstd::bulk::compress(&content(chunk), 1).unwrap_or_default()).collect();
    let frames: Vec<_> = chunks.iter().map(|chunk| chunk_codec::encode(chunk, world)).collect();
    let rebuild =
        |_: usize, chunk: &Chunk| (Pyramid::of_maxima(&chunk.heights), Pyramid::of_minima(&chunk.heights));
    let room = content(&chunks[0]).len();
    let read = |index: usize, _: &Chunk| zstd::bulk::decompress(&sent[index], room);
    table.push([milliseconds(&chunks, rebuild), milliseconds(&chunks, read), bytes(&sent), bytes(&frames)]);
    table
}
