//! The land of version 4 as it is known: chunks of every level with all that is derived from them,
//! the chunks that a view needs, and the random attributes of plants. Servers, viewers, caches and
//! stores of other builds have the same ones, so a change needs another version of the generator.

use blake3::Hasher;
use terrain::constants::{TOP_LEVEL, WORLD_HALF};
use terrain::hash::mix;
use terrain::lod::{self, Viewer};
use terrain::pyramid::PYRAMID_LEVELS;
use terrain::random_attributes::random_attributes;
use terrain::{Chunk, ChunkKey, Land};

const CHUNKS: &str = "c12a5bd999cd191e28db27519e65b37bd64a2f8c442785eb4db86722c023d06f";
const VIEWS: &str = "f8baac01f6ee6262b0e57e3f7eabaf72bbc53b9624209febfcf470ddfbc31c91";
const ATTRIBUTES: &str = "5f92a1d5d4772a24a25af014a6f50bb76ee35bdda2f13821cbedfad8ddde3183";

fn update(hasher: &mut Hasher, chunk: &Chunk) {
    let mut number = |value: i32| _ = hasher.update(&value.to_le_bytes());
    chunk.heights.iter().copied().for_each(&mut number);
    number(chunk.error.cast_signed());
    number(chunk.slope.cast_signed());
    for pyramid in [&chunk.max_pyramid, &chunk.min_pyramid] {
        for level in 0..PYRAMID_LEVELS {
            pyramid.level(level).iter().copied().for_each(&mut number);
        }
    }
    number(chunk.grass.seed.cast_signed());
    hasher.update(&[chunk.grass.palette]);
    hasher.update(&chunk.grass.density[..]);
}

/// Places of a world: where a viewer begins, the origin, the corners of the world, and others.
fn places(land: &Land) -> Vec<(i32, i32)> {
    let (start, far) = (land.start(), WORLD_HALF);
    let near = |n: u32| ((mix(2 * n) as i32) >> 10, (mix(2 * n + 1) as i32) >> 10);
    let mut places = vec![(start.x, start.z), (0, 0), (far, far), (-far, far), (far, -far), (-far, -far)];
    places.extend((0..4).map(near));
    places
}

#[test]
fn chunks_are_those_that_are_known() {
    let mut hasher = Hasher::new();
    for seed in 0..2 {
        let land = Land::new(seed);
        for (x, z) in places(&land) {
            for level in 0..=TOP_LEVEL {
                update(&mut hasher, &land.chunk(ChunkKey::containing(level, x, z)));
            }
        }
    }
    assert_eq!(hasher.finalize().to_hex().as_str(), CHUNKS);
}

#[test]
fn views_need_the_chunks_that_are_known() {
    let mut hasher = Hasher::new();
    for seed in 0..2 {
        let land = Land::new(seed);
        for (number, (x, z)) in places(&land).into_iter().enumerate() {
            let viewer = Viewer {
                eye: (x, land.start().inland.0.rem_euclid(1000) * 100, z),
                distance_m: [50, 700, 5000, 20_000][number % 4],
                pixels_per_radian: [312, 624, 935][number % 3],
                tolerance_q4: [16, 64, 256, 1024, 0][number % 5],
            };
            for needed in lod::select(&land, &viewer, 3000) {
                let (x, z) = needed.key.origin();
                hasher.update(&[needed.key.level()]);
                hasher.update(&x.to_le_bytes()).update(&z.to_le_bytes());
                hasher.update(&needed.distance.to_le_bytes()).update(&needed.gain_q4.to_le_bytes());
            }
        }
    }
    assert_eq!(hasher.finalize().to_hex().as_str(), VIEWS);
}

#[test]
fn plants_have_the_attributes_that_are_known() {
    let mut hasher = Hasher::new();
    for number in 0..4096 {
        let at = |stream: u32| mix(number * 8 + stream);
        let clump =
            random_attributes(at(0), at(1) & 7, at(2).cast_signed(), at(3).cast_signed(), at(4) & 255);
        for word in [clump.place, clump.width, clump.height, clump.hue, clump.phase, clump.survival] {
            hasher.update(&word.to_le_bytes());
        }
    }
    assert_eq!(hasher.finalize().to_hex().as_str(), ATTRIBUTES);
}
