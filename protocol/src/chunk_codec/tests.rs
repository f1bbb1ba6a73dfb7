//! Properties of every kind of chunk frame, and of frames from other encoders.

use super::*;
use proptest::prelude::*;
use std::sync::LazyLock;
use terrain::Land;
use terrain::hash::mix;

const KEYS: [(u8, i32, i32); 6] = [(0, 3, -7), (0, 60, 60), (1, -3, -3), (4, 0, -1), (9, 2, 2), (16, 0, 0)];

fn sample(level: u8, x: i32, z: i32) -> (Chunk, WorldDigest) {
    let land = Land::new(1);
    (land.chunk(ChunkKey::new(level, x, z).unwrap()), land.digest())
}

/// A chunk of sea, its parent, and their world: made once for the many cases of the properties.
static SEA: LazyLock<(Chunk, Chunk, WorldDigest)> = LazyLock::new(|| {
    let (chunk, world) = sample(0, 60, 60);
    (chunk, sample(1, 30, 30).0, world)
});

type Decode = Box<dyn Fn(&[u8]) -> Result<Chunk, ChunkError>>;

/// A frame with heights of each kind, with what decodes it.
fn kinds(chunk: &Chunk, world: &WorldDigest) -> Vec<(Bytes, Decode)> {
    let (own, tolerance) = (*world, Tolerance::new(16).unwrap());
    let mut kinds: Vec<(Bytes, Decode)> = Vec::new();
    for effort in [Effort::Fast, Effort::Compact] {
        let exact = encode_with(Delivery::Exact, effort, chunk, world);
        kinds.push((exact, Box::new(move |frame| decode(frame, &own))));
        let coarse = quantised::encode(chunk, world, tolerance, effort).unwrap();
        kinds.push((coarse, Box::new(move |frame| quantised::decode(frame, &own, tolerance))));
        let parent = chunk.key.parent().map(|key| Land::new(1).chunk(key));
        if let Some(parent) = parent
            && let Some(refined) = refined::encode(chunk, &parent, world, effort)
        {
            kinds.push((refined, Box::new(move |frame| refined::decode(frame, &own, &parent))));
        }
    }
    kinds
}

/// Recomputes the length and the digest of a changed frame, as a hostile server does. The parent of
/// a refined one is that of the samples' land.
fn signed(mut frame: Vec<u8>, world: &WorldDigest) -> Vec<u8> {
    let refined = kind_and_key(&frame).ok().filter(|(kind, _)| *kind == KIND_REFINED);
    let parent = refined.and_then(|(_, key)| key.parent()).map(|key| Land::new(1).chunk_heights(key));
    rewrite_digest(&mut frame, world, parent.as_deref());
    frame
}

/// A frame of another payload with the right length and digest.
fn with_payload(frame: &[u8], payload: &[u8], world: &WorldDigest) -> Vec<u8> {
    let mut frame = frame[..CHUNK_HEADER].to_vec();
    frame.extend_from_slice(payload);
    signed(frame, world)
}

#[test]
fn exact_chunks_survive_the_wire_at_every_level_and_effort() {
    for (level, x, z) in KEYS {
        let (chunk, world) = sample(level, x, z);
        for effort in [Effort::Fast, Effort::Compact] {
            let frame = encode_with(Delivery::Exact, effort, &chunk, &world);
            assert!(frame.len() <= bound());
            assert_eq!(decode(&frame, &world), Ok(chunk.clone()));
            assert_eq!(kind_and_key(&frame), Ok((KIND_EXACT, chunk.key)));
            assert_eq!(error(&frame), Some(chunk.error));
        }
    }
}

#[test]
fn quantised_heights_and_errors_stay_within_the_tolerance() {
    for (level, x, z) in KEYS {
        let (chunk, world) = sample(level, x, z);
        let mut shorter = usize::MAX;
        for tolerance in Tolerance::all() {
            let frame = quantised::encode(&chunk, &world, tolerance, Effort::Compact).unwrap();
            let got = quantised::decode(&frame, &world, tolerance).unwrap();
            assert_eq!(Some(&got), quantised::quantise(&chunk, tolerance).as_ref());
            let moved =
                got.heights.iter().zip(&chunk.heights[..]).map(|(a, b)| a.abs_diff(*b)).max().unwrap();
            assert!(moved <= u32::from(tolerance.units()), "{level}: {moved} for {tolerance:?}");
            assert_eq!(got.error, chunk.error + moved);
            assert_eq!((&got.grass, error(&frame)), (&chunk.grass, Some(got.error)));
            let mut heights = Box::new([0; VERTEX_COUNT]);
            assert_eq!(heights_on(Kernel::best(), &frame, &mut heights), Ok(()));
            assert_eq!(heights, got.heights);
            assert!(frame.len() <= shorter.saturating_add(8), "{level}: {} after {shorter}", frame.len());
            shorter = frame.len();
            // A finer tolerance and exact delivery reject the frame, a coarser tolerance accepts
            // it.
            if let Some(finer) = Tolerance::new(tolerance.units() / 2) {
                let fault = ChunkError::Tolerance { theirs: tolerance.units(), ours: finer.units() };
                assert_eq!(quantised::decode(&frame, &world, finer), Err(fault));
            }
            assert!(quantised::decode(&frame, &world, Tolerance::COARSEST).is_ok());
            assert_eq!(decode(&frame, &world), Err(ChunkError::UnknownKind(KIND_QUANTISED)));
        }
        // The coarsest tolerance changes land that is not flat.
        let coarse = quantised::quantise(&chunk, Tolerance::COARSEST).unwrap();
        assert!(coarse != chunk || chunk.min() == chunk.max());
    }
}

#[test]
fn quantised_neighbours_agree_on_their_border() {
    let (here, _) = sample(0, 3, -7);
    let (east, _) = sample(0, 4, -7);
    for tolerance in Tolerance::all() {
        let [here, east] = [&here, &east].map(|chunk| quantised::quantise(chunk, tolerance).unwrap());
        assert!((0..65).all(|row| here.vertex(64, row) == east.vertex(0, row)), "{tolerance:?}");
    }
}

#[test]
fn heights_that_rounding_would_move_out_of_range_are_exact() {
    let (chunk, world) = sample(0, 3, -7);
    let mut heights = chunk.heights.clone();
    heights[9] = HEIGHT_LIMIT - 1;
    let tall = Chunk::from_parts(chunk.key, heights, 0, chunk.grass);
    assert_eq!(quantised::encode(&tall, &world, Tolerance::FINEST, Effort::Compact), None);
    let frame = encode_for(Delivery::Quantised(Tolerance::FINEST), &tall, &world);
    assert_eq!(decode(&frame, &world), Ok(tall));
}

#[test]
fn refined_chunks_need_their_parent_and_are_shorter_than_exact() {
    let land = Land::new(1);
    let world = land.digest();
    for (level, x, z) in [(0, 3, -7), (0, 2, -8), (0, 3, -8), (0, 2, -7), (1, -3, -3), (0, 60, 60)] {
        let chunk = land.chunk(ChunkKey::new(level, x, z).unwrap());
        let parent = land.chunk(chunk.key.parent().unwrap());
        let frame = refined::encode(&chunk, &parent, &world, Effort::Compact).unwrap();
        assert_eq!(refined::decode(&frame, &world, &parent), Ok(chunk.clone()));
        let exact = encode(&chunk, &world).len();
        assert!(
            frame.len() <= exact && (chunk.slope == 0 || frame.len() * 4 < exact * 3),
            "{level}: {} of {exact}",
            frame.len()
        );

        let mut other = parent.clone();
        other.heights.iter_mut().for_each(|height| *height += 1);
        assert_eq!(refined::decode(&frame, &world, &other), Err(ChunkError::Digest));
        assert_eq!(refined::encode(&chunk, &other, &world, Effort::Compact), None);
        for other in [&chunk, &land.chunk(ChunkKey::new(level + 1, 9, 9).unwrap())] {
            assert_eq!(refined::decode(&frame, &world, other), Err(ChunkError::Parent(chunk.key)));
        }
        assert_eq!(decode(&frame, &world), Err(ChunkError::UnknownKind(KIND_REFINED)));
    }
    // Above level 2 parents carry fewer octaves.
    let chunk = land.chunk(ChunkKey::new(4, 0, -1).unwrap());
    let parent = land.chunk(chunk.key.parent().unwrap());
    assert_eq!(refined::encode(&chunk, &parent, &world, Effort::Compact), None);
}

#[test]
fn grass_that_deviates_from_the_rule_is_sent() {
    let (mut chunk, world) = sample(0, 3, -7);
    let by_rule = encode(&chunk, &world);
    for index in 0..chunk.grass.density.len() {
        chunk.grass.density[index] = mix(index as u32) as u8;
    }
    let sent = encode(&chunk, &world);
    assert!(sent.len() > by_rule.len() + 200, "{} and {}", sent.len(), by_rule.len());
    assert_eq!(decode(&sent, &world), Ok(chunk));
}

#[test]
fn sea_takes_few_bytes_and_land_about_a_byte_a_vertex() {
    let length = |(chunk, world): (Chunk, WorldDigest)| encode(&chunk, &world).len();
    assert!(length(sample(0, 3, -7)) < VERTEX_COUNT * 5 / 4);
    assert_eq!(length(sample(0, 60, 60)), CHUNK_HEADER + 5);
}

#[test]
fn every_truncation_and_extension_is_rejected() {
    let (chunk, world) = sample(0, 3, -7);
    for (frame, decode) in kinds(&chunk, &world) {
        assert!(decode(&frame).is_ok());
        for length in 0..frame.len() {
            let cut = decode(&frame[..length]);
            assert!(matches!(cut, Err(ChunkError::Truncated { .. })), "{length}: {cut:?}");
            assert_eq!(error(&frame[..length]), None);
        }
        for extra in [1, 2] {
            let longer = [&frame[..], &vec![0; extra]].concat();
            assert_eq!(decode(&longer), Err(ChunkError::Trailing(extra)));
        }
        assert!(matches!(decode(&vec![0; MAX_CHUNK_FRAME + 1]), Err(ChunkError::TooLong(_))));
        assert_eq!(decode(&vec![0; MAX_CHUNK_FRAME]), Err(ChunkError::BadMagic));
    }
}

#[test]
fn every_flipped_bit_is_rejected() {
    let (chunk, world) = sample(1, 2, 2);
    for (frame, decode) in kinds(&chunk, &world) {
        for bit in 0..frame.len() * 8 {
            let mut damaged = frame.to_vec();
            damaged[bit / 8] ^= 1 << (bit % 8);
            assert!(decode(&damaged).is_err(), "bit {bit}");
        }
    }
}

#[test]
fn a_frame_is_verified_without_decoding_by_kind_length_and_digest() {
    let (chunk, world) = sample(1, -3, -3);
    for delivery in [Delivery::Exact, Delivery::Quantised(Tolerance::new(16).unwrap())] {
        let frame = encode_for(delivery, &chunk, &world);
        assert_eq!(verify(&frame, &world), Ok((chunk.key, delivery)));
        assert_eq!(verify(&frame, &Land::new(2).digest()), Err(ChunkError::Digest));
        for length in 0..frame.len() {
            assert!(matches!(verify(&frame[..length], &world), Err(ChunkError::Truncated { .. })));
        }
        for byte in 0..frame.len() {
            let mut damaged = frame.to_vec();
            damaged[byte] ^= 0x10;
            assert!(verify(&damaged, &world).is_err(), "byte {byte}");
        }
    }
    let seed = encode_for(Delivery::SeedOnly, &chunk, &world);
    assert_eq!(verify(&seed, &world), Err(ChunkError::UnknownKind(KIND_SEED_ONLY)));
    for delivery in [Delivery::Exact, Delivery::Quantised(Tolerance::FINEST)] {
        let mut lie = encode_for(delivery, &chunk, &world).to_vec();
        lie[38] = 3;
        assert!(matches!(verify(&signed(lie, &world), &world), Err(ChunkError::Content(_))), "{delivery}");
    }
}

#[test]
fn a_chunk_of_another_world_is_rejected() {
    let (chunk, world) = sample(0, 3, -7);
    for (frame, _) in kinds(&chunk, &world).iter().take(1) {
        assert_eq!(decode(frame, &Land::new(2).digest()), Err(ChunkError::Digest));
    }
}

#[test]
fn other_versions_and_unknown_kinds_are_distinguished() {
    let (chunk, world) = sample(0, 3, -7);
    let frame = encode(&chunk, &world);
    for version in (0..VERSION).chain([VERSION + 1, u16::MAX]) {
        let mut other = frame.to_vec();
        other[4..6].copy_from_slice(&version.to_le_bytes());
        assert_eq!(decode(&signed(other, &world), &world), Err(ChunkError::UnknownVersion(version)));
    }
    for kind in [KIND_SEED_ONLY, KIND_QUANTISED, KIND_REFINED, 4, u8::MAX] {
        let mut other = frame.to_vec();
        other[6] = kind;
        assert_eq!(decode(&signed(other, &world), &world), Err(ChunkError::UnknownKind(kind)));
    }
}

#[test]
fn extreme_payload_lengths_are_rejected() {
    let (chunk, world) = sample(0, 3, -7);
    let frame = encode(&chunk, &world);
    for value in [MAX_PAYLOAD as u32 + 1, i32::MAX as u32, u32::MAX] {
        let mut damaged = frame.to_vec();
        damaged[40..44].copy_from_slice(&value.to_le_bytes());
        let fault = Err(ChunkError::Length { field: "payload", value });
        assert_eq!(decode(&damaged, &world), fault);
    }
    let actual = (frame.len() - CHUNK_HEADER) as u32;
    for value in [0, 1, actual - 1, actual + 1, MAX_PAYLOAD as u32] {
        let mut damaged = frame.to_vec();
        damaged[40..44].copy_from_slice(&value.to_le_bytes());
        let fault = decode(&damaged, &world);
        assert!(
            matches!(fault, Err(ChunkError::Truncated { .. } | ChunkError::Trailing(_))),
            "{value}: {fault:?}"
        );
    }
}

/// Where the first part of an exact frame's payload begins: behind grass seed, palette, number of
/// plain bits and those bits.
fn parts_at(payload: &[u8]) -> usize {
    6 + (VERTEX_COUNT * usize::from(payload[5])).div_ceil(8)
}

#[test]
fn wrong_numbers_of_plain_bits_with_valid_digests_are_rejected() {
    let (chunk, world) = sample(0, 3, -7);
    for effort in [Effort::Fast, Effort::Compact] {
        let frame = encode_with(Delivery::Exact, effort, &chunk, &world);
        let payload = &frame[CHUNK_HEADER..];
        assert!([1, 2, 4, 8].contains(&payload[5]), "{} plain bits", payload[5]);
        for plain in (0..=255).filter(|plain| *plain != payload[5]) {
            let mut lie = payload.to_vec();
            lie[5] = plain;
            let fault = decode(&with_payload(&frame, &lie, &world), &world);
            assert!(fault.is_err(), "{plain} plain bits instead of {}", payload[5]);
        }
    }
}

#[test]
fn wrong_part_lengths_with_valid_digests_are_rejected() {
    let mut parts = 0;
    let (flat, world) = sample(0, 3, -7);
    let mut heights = flat.heights.clone();
    heights[VERTEX_COUNT / 2] += 1 << 20;
    let spiky = Chunk::from_parts(flat.key, heights, flat.error, flat.grass.clone());
    for (chunk, effort) in
        [&flat, &spiky].into_iter().flat_map(|chunk| [(chunk, Effort::Fast), (chunk, Effort::Compact)])
    {
        let frame = encode_with(Delivery::Exact, effort, chunk, &world);
        let payload = &frame[CHUNK_HEADER..];
        let mut at = parts_at(payload);
        while at < payload.len() {
            let actual = u16::from_le_bytes([payload[at], payload[at + 1]]);
            let most = VERTEX_COUNT as u16;
            for value in [0, 1, actual - 1, actual + 1, most - 1, most, most + 1, u16::MAX] {
                if value == actual {
                    continue;
                }
                let mut lie = payload.to_vec();
                lie[at..at + 2].copy_from_slice(&value.to_le_bytes());
                let fault = decode(&with_payload(&frame, &lie, &world), &world);
                assert!(fault.is_err(), "part at {at} of length {value} instead of {actual}");
            }
            parts += 1;
            at += 2 + usize::from(actual);
        }
        for length in 0..payload.len() {
            let fault = decode(&with_payload(&frame, &payload[..length], &world), &world);
            assert!(matches!(fault, Err(ChunkError::Part | ChunkError::Compression)), "{length}: {fault:?}");
        }
        let longer = [payload, &[7]].concat();
        assert_eq!(decode(&with_payload(&frame, &longer, &world), &world), Err(ChunkError::Trailing(1)));
    }
    assert!(parts > 4, "some of the chunks have several parts: {parts}");
}

#[test]
fn payloads_of_every_kind_with_valid_digests_are_read_behind_the_digest() {
    let (chunk, world) = sample(1, -3, -3);
    for (frame, decode) in kinds(&chunk, &world) {
        assert_eq!(signed(frame.to_vec(), &world), frame, "of a valid frame nothing changes");
        let payload = &frame[CHUNK_HEADER..];
        for length in 0..payload.len() {
            let fault = decode(&with_payload(&frame, &payload[..length], &world));
            assert!(matches!(fault, Err(ChunkError::Part | ChunkError::Compression)), "{length}: {fault:?}");
        }
        for at in (0..payload.len()).step_by(5) {
            let mut lie = frame.to_vec();
            lie[CHUNK_HEADER + at] ^= 0x10;
            // The control: the digest hides the rest of the decoder.
            assert_eq!(decode(&lie), Err(ChunkError::Digest));
            let outcome = decode(&signed(lie, &world));
            assert!(
                matches!(outcome, Ok(_) | Err(ChunkError::Part | ChunkError::Compression))
                    || matches!(outcome, Err(ChunkError::Content(_) | ChunkError::Trailing(_))),
                "{at}: {outcome:?}"
            );
        }
    }
}

#[test]
fn unused_fields_that_are_not_0_are_rejected() {
    let (chunk, world) = sample(0, 3, -7);
    let tolerance = Tolerance::FINEST;
    let coarse = quantised::encode(&chunk, &world, tolerance, Effort::Compact).unwrap();
    for frame in [encode(&chunk, &world), coarse] {
        let decode = |frame: &[u8]| match kind_and_key(frame) {
            Ok((KIND_EXACT, _)) => decode(frame, &world),
            _ => quantised::decode(frame, &world, tolerance),
        };
        let mut payload = frame[CHUNK_HEADER..].to_vec();
        let bits = usize::from(payload[5]);
        assert!([1, 2, 4].contains(&bits), "{bits} plain bits");
        // The last field of the plain bits; the one before it in the byte has a vertex.
        let last = 6 + (VERTEX_COUNT * bits).div_ceil(8) - 1;
        assert!(decode(&with_payload(&frame, &payload, &world)).is_ok());
        payload[last] |= 0x80;
        let fault = decode(&with_payload(&frame, &payload, &world));
        assert_eq!(fault, Err(ChunkError::Content("an unused field is not 0")));
    }
}

#[test]
fn wrong_header_fields_with_valid_digests_are_rejected() {
    let (chunk, world) = sample(0, 3, -7);
    let frame = encode(&chunk, &world);
    let changed = |at: usize, by: u8| {
        let mut lie = frame.to_vec();
        lie[at] = lie[at].wrapping_add(by);
        decode(&signed(lie, &world), &world)
    };
    for (at, what) in [(16, "first height"), (20, "minimum"), (24, "maximum"), (32, "slope")] {
        for by in [1, 255] {
            assert!(matches!(changed(at, by), Err(ChunkError::Content(_))), "{what}: {:?}", changed(at, by));
        }
    }
    for by in 1..=255 {
        assert!(changed(36, by).is_err(), "width changed by {by}");
        assert!(changed(37, by).is_err(), "grass mode changed by {by}");
        assert!(changed(38, by).is_err() && changed(39, by).is_err(), "tolerance changed by {by}");
    }
    // Rounding changes nothing about the sea.
    let mut sea = encode(&SEA.0, &world).to_vec();
    sea[38] = 16;
    let fault = decode(&signed(sea, &world), &world);
    assert_eq!(fault, Err(ChunkError::Content("an exact frame states a tolerance")));
    for palette in PALETTES..=u8::MAX {
        let mut payload = frame[CHUNK_HEADER..].to_vec();
        payload[4] = palette;
        let fault = decode(&with_payload(&frame, &payload, &world), &world);
        assert_eq!(fault, Err(ChunkError::Content("the grass palette does not exist")), "{palette}");
    }
    let coarse = quantised::encode(&chunk, &world, Tolerance::COARSEST, Effort::Compact).unwrap();
    for tolerance in [0, 3, 129, 256, u16::MAX] {
        let mut lie = coarse.to_vec();
        lie[38..40].copy_from_slice(&tolerance.to_le_bytes());
        let fault = quantised::decode(&signed(lie, &world), &world, Tolerance::COARSEST);
        assert!(matches!(fault, Err(ChunkError::Content(_))), "{tolerance}: {fault:?}");
    }
}

#[test]
fn heights_beyond_either_limit_are_rejected_with_valid_digests() {
    let (chunk, world) = sample(0, 3, -7);
    let fault = ChunkError::Content("a height is out of range");
    let with = |key, heights| Chunk::from_parts(key, heights, 0, chunk.grass.clone());
    for inside in [1 - HEIGHT_LIMIT, HEIGHT_LIMIT - 1] {
        let flat = with(chunk.key, Box::new([inside; VERTEX_COUNT]));
        assert_eq!(decode(&encode(&flat, &world), &world), Ok(flat));
    }
    let parent = with(chunk.key.parent().unwrap(), Box::new([0; VERTEX_COUNT]));
    for outside in [-HEIGHT_LIMIT, HEIGHT_LIMIT] {
        let flat = with(chunk.key, Box::new([outside; VERTEX_COUNT]));
        assert_eq!(decode(&encode(&flat, &world), &world), Err(fault.clone()), "{outside}");
        for count in [1, 2] {
            // In odd columns, which the parent lacks.
            let mut heights = Box::new([0; VERTEX_COUNT]);
            (0..count).for_each(|n| heights[2 * n + 1] = outside);
            let spiky = with(chunk.key, heights);
            let frame = refined::encode(&spiky, &parent, &world, Effort::Compact).unwrap();
            assert_eq!(refined::decode(&frame, &world, &parent), Err(fault.clone()), "{count} of {outside}");
        }
    }
}

#[test]
fn only_the_frame_digest_covers_the_error() {
    // The error cannot be checked against the heights; all else about a chunk is.
    let (chunk, world) = sample(0, 3, -7);
    let mut lie = encode(&chunk, &world).to_vec();
    lie[28] ^= 1;
    assert_eq!(decode(&lie, &world), Err(ChunkError::Digest));
    assert_eq!(decode(&signed(lie, &world), &world).unwrap().error, chunk.error ^ 1);
}

#[test]
fn decompression_bombs_are_rejected() {
    let (chunk, world) = sample(0, 3, -7);
    let frame = encode(&chunk, &world);
    let grass = &frame[CHUNK_HEADER..CHUNK_HEADER + 5];
    // Run-length blocks of 128 KiB, RFC 8878 section 3.1.1.2: 4 bytes each.
    let runs =
        |count: usize| [[0x02, 0x00, 0x10, 0xaa].repeat(count - 1), vec![0x03, 0x00, 0x10, 0xaa]].concat();
    let zstd = [0x28, 0xb5, 0x2f, 0xfd];
    let bombs: [(&str, Vec<u8>); 5] = [
        ("states 4 GiB", [&zstd[..], &[0xa0, 0xff, 0xff, 0xff, 0xff], &runs(900)].concat()),
        ("states 2^63 bytes", [&zstd[..], &[0xe0, 0, 0, 0, 0, 0, 0, 0, 0x80], &runs(900)].concat()),
        ("states nothing", [&zstd[..], &[0x00, 0xff], &runs(900)].concat()),
        ("requests the largest window", [&zstd[..], &[0x40, 0xff, 0x81, 0x0f], &runs(900)].concat()),
        ("states the right size and holds more", [&zstd[..], &[0x60, 0x81, 0x0f], &runs(900)].concat()),
    ];
    for (what, bomb) in bombs {
        let length = (bomb.len() as u16).to_le_bytes();
        let no_plain_bits = [0];
        let payload = [grass, &no_plain_bits, &length, &bomb].concat();
        let fault = decode(&with_payload(&frame, &payload, &world), &world);
        assert_eq!(fault, Err(ChunkError::Compression), "{what}");
    }
}

proptest! {
    #[test]
    fn any_heights_round_trip_in_every_kind(
        seed: u32, amplitude in 0u32..26, palette in 0..PALETTES, tolerance in 0usize..8, fast: bool,
    ) {
        let mut heights = Box::new([0; VERTEX_COUNT]);
        for (index, height) in heights.iter_mut().enumerate() {
            let word = mix(seed.wrapping_add(index as u32)) as i32;
            *height = word.checked_shr(32 - amplitude).unwrap_or(0).clamp(1 - HEIGHT_LIMIT, HEIGHT_LIMIT - 1);
        }
        let effort = if fast { Effort::Fast } else { Effort::Compact };
        let grass = GrassSeed { seed, palette, density: Box::new([seed as u8; 256]) };
        let chunk = Chunk::from_parts(ChunkKey::new(0, 1, 1).unwrap(), heights, seed / 2, grass);
        let world = WorldDigest([7; 32]);
        let exact = encode_with(Delivery::Exact, effort, &chunk, &world);
        prop_assert!(exact.len() <= bound());
        for kernel in Kernel::available() {
            let mut got = Box::new([0; VERTEX_COUNT]);
            heights_on(kernel, &exact, &mut got).unwrap();
            prop_assert_eq!(&got, &chunk.heights);
        }
        prop_assert_eq!(decode(&exact, &world), Ok(chunk.clone()));

        let tolerance = Tolerance::all().nth(tolerance).unwrap();
        if let Some(expected) = quantised::quantise(&chunk, tolerance) {
            let frame = quantised::encode(&chunk, &world, tolerance, effort).unwrap();
            prop_assert_eq!(quantised::decode(&frame, &world, tolerance), Ok(expected));
        }

        // A parent that agrees where it must, with anything elsewhere.
        let key = chunk.key.parent().unwrap();
        prop_assert_eq!(key.children().unwrap()[3], chunk.key);
        let mut moved = chunk.heights.clone();
        for index in 0..33 * 33 {
            let (x, z) = (index % 33, index / 33);
            moved[(z + 32) * 65 + x + 32] = chunk.heights[2 * z * 65 + 2 * x];
        }
        let parent = Chunk::from_parts(key, moved, 0, chunk.grass.clone());
        let frame = refined::encode(&chunk, &parent, &world, effort).unwrap();
        prop_assert!(frame.len() <= bound());
        prop_assert_eq!(refined::decode(&frame, &world, &parent), Ok(chunk));
    }

    #[test]
    fn random_payloads_with_valid_digests_cause_no_panic(
        bytes in proptest::collection::vec(any::<u8>(), 0..400), width in 0u8..40, kind in 0u8..4,
        tolerance: u16,
    ) {
        let (chunk, parent, world) = &*SEA;
        prop_assert!(decode(&bytes, world).is_err());
        let mut frame = encode(chunk, world).to_vec();
        frame[6] = kind;
        frame[36] = width;
        frame[38..40].copy_from_slice(&tolerance.to_le_bytes());
        let frame = with_payload(&frame, &bytes, world);
        for outcome in [
            decode(&frame, world),
            quantised::decode(&frame, world, Tolerance::COARSEST),
            refined::decode(&frame, world, parent),
        ] {
            prop_assert_ne!(outcome, Err(ChunkError::Digest));
        }
        let _ = error(&frame);
    }

    #[test]
    fn residuals_of_any_width_with_valid_digests_cause_no_panic(
        seed: u32, width in 0u32..=27, kind in 0usize..3, tolerance in 0usize..8, first: i32, near: bool,
    ) {
        let (chunk, parent, world) = &*SEA;
        let kind = [KIND_EXACT, KIND_QUANTISED, KIND_REFINED][kind];
        let count = if kind == KIND_REFINED { VERTEX_COUNT - 33 * 33 } else { VERTEX_COUNT };
        let mask = ((1u64 << width) - 1) as u32;
        let residuals: Vec<u32> = (0..count).map(|index| mix(seed ^ index as u32) & mask).collect();
        let mut payload = vec![0; 5];
        parts::push(Kernel::best(), &residuals, width, Effort::Compact, &mut payload);
        let mut frame = encode(chunk, world).to_vec();
        frame[6] = kind;
        if !near && kind != KIND_REFINED {
            frame[16..20].copy_from_slice(&first.to_le_bytes());
        }
        frame[36] = width as u8;
        let tolerance = Tolerance::all().nth(tolerance).unwrap();
        let units = if kind == KIND_QUANTISED { tolerance.units() } else { 0 };
        frame[38..40].copy_from_slice(&units.to_le_bytes());
        let frame = with_payload(&frame, &payload, world);
        let outcome = match kind {
            KIND_EXACT => decode(&frame, world),
            KIND_QUANTISED => quantised::decode(&frame, world, tolerance),
            _ => refined::decode(&frame, world, parent),
        };
        prop_assert!(matches!(outcome, Ok(_) | Err(ChunkError::Content(_))), "{:?}", outcome);
    }
}
