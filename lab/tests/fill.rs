//! Chunks filled on the GPU against chunks generated on the CPU, bit for bit.

use client::gpu;
use client::gpu::Gpu;
use lab::gpu_probes::fill::{ChunkFiller, FillError, FilledChunk, MAX_BATCH};
use terrain::constants::{TOP_LEVEL, WORLD_HALF};
use terrain::hash::mix;
use terrain::key::ROOT;
use terrain::pyramid::PYRAMID_LEVELS;
use terrain::{ChunkKey, Land, Pyramid};

/// The best adapter; `None`, with the reason printed, where there is none and none is required.
fn open() -> Option<Gpu> {
    match pollster::block_on(Gpu::open(gpu::instance(None), None)) {
        Ok(gpu) => Some(gpu),
        Err(error) => {
            assert!(std::env::var_os("TOMBOLO_REQUIRE_GPU").is_none(), "a GPU is required: {error}");
            eprintln!("SKIPPED: {error}");
            None
        }
    }
}

/// A few hundred chunks: around the home island, at all four corners of the world, in the open sea,
/// and anywhere.
fn keys() -> Vec<ChunkKey> {
    let mut keys = vec![ROOT];
    for level in 0..TOP_LEVEL {
        let ends = [-WORLD_HALF, WORLD_HALF];
        let corners = ends.into_iter().flat_map(|x| ends.map(|z| (x, z)));
        // Both sides of both axes at the origin; the beach of the home island; between four
        // islands.
        let near = [(0, 0), (-1, -1), (-1, 0), (0, -1), (1_600_000, 300_000), (2_097_152, 2_097_152)];
        keys.extend(corners.chain(near).map(|(x, z)| ChunkKey::containing(level, x, z)));
        let anywhere = (0..8u32).map(|n| {
            let bits = 2 * (u32::from(level) * 8 + n);
            (mix(bits) as i32 >> 8, mix(bits + 1) as i32 >> 8)
        });
        keys.extend(anywhere.map(|(x, z)| ChunkKey::containing(level, x, z)));
    }
    keys
}

fn texels(pyramid: &Pyramid) -> Vec<i32> {
    (0..PYRAMID_LEVELS).flat_map(|level| pyramid.level(level).iter().copied()).collect()
}

fn assert_equals_the_cpu(land: &Land, filled: &FilledChunk) {
    let heights = land.chunk_heights(filled.key);
    assert!(filled.heights == heights, "heights of {}", filled.key);
    assert!(filled.maxima[..] == texels(&Pyramid::of_maxima(&heights)), "maxima of {}", filled.key);
    assert!(filled.minima[..] == texels(&Pyramid::of_minima(&heights)), "minima of {}", filled.key);
}

#[test]
fn the_gpu_fills_the_same_chunks_at_every_level() {
    let Some(gpu) = open() else { return };
    for seed in [7, u64::MAX << 32 | 7] {
        let land = Land::new(seed);
        let filler = ChunkFiller::new(&gpu.device, &gpu.queue, &land, 100).unwrap();
        let (mut seas, mut lands) = (0, 0);
        for batch in keys().chunks(filler.batch()) {
            let filled = filler.fill(&gpu.device, &gpu.queue, batch).unwrap();
            assert!(filled.iter().map(|chunk| chunk.key).eq(batch.iter().copied()));
            for chunk in &filled {
                assert_equals_the_cpu(&land, chunk);
                let flat = chunk.maxima.last() == chunk.minima.last();
                *(if flat { &mut seas } else { &mut lands }) += 1;
            }
        }
        gpu.check().unwrap();
        assert!(seas > 20 && lands > 100, "{seas} chunks of open sea, {lands} with land");
    }
}

#[test]
fn another_world_is_detected() {
    let Some(gpu) = open() else { return };
    let key = ChunkKey::new(0, 1, 1).unwrap();
    let filler = ChunkFiller::new(&gpu.device, &gpu.queue, &Land::new(1), 1).unwrap();
    let filled = filler.fill(&gpu.device, &gpu.queue, &[key]).unwrap();
    assert_equals_the_cpu(&Land::new(1), &filled[0]);
    assert!(filled[0].heights != Land::new(1 << 32 | 1).chunk_heights(key), "the control must differ");
}

#[test]
fn a_batch_is_bounded_and_may_be_empty() {
    let Some(gpu) = open() else { return };
    let land = Land::new(1);
    let filler = ChunkFiller::new(&gpu.device, &gpu.queue, &land, usize::MAX).unwrap();
    assert_eq!(filler.batch(), MAX_BATCH);
    assert_eq!(filler.fill(&gpu.device, &gpu.queue, &[]).unwrap(), []);
    let filler = ChunkFiller::new(&gpu.device, &gpu.queue, &land, 0).unwrap();
    let error = filler.fill(&gpu.device, &gpu.queue, &[ROOT, ROOT]).unwrap_err();
    assert!(matches!(error, FillError::TooMany { keys: 2, batch: 1 }), "{error}");
    assert_equals_the_cpu(&land, &filler.fill(&gpu.device, &gpu.queue, &[ROOT]).unwrap()[0]);
}
