//! The integer hash behind lattice gradients, islands and grass.
//!
//! `mix` is the two-round xorshift-multiply permutation with the constants of the low-bias search
//! published by Chris Wellons ("Prospecting for hash functions", 2018; constants 0x21f0aaad and
//! 0xd35a2d97 from the follow-up thread). It is a bijection of u32, hence loses nothing, and every
//! operation is in the ring profile.

/// One permutation of u32 with full avalanche.
#[must_use]
#[inline]
pub const fn mix(mut h: u32) -> u32 {
    h ^= h >> 16;
    h = h.wrapping_mul(0x21f0_aaad);
    h ^= h >> 15;
    h = h.wrapping_mul(0xd35a_2d97);
    h ^ (h >> 15)
}

/// Hash of a lattice point under a seed. The two coordinates enter in turn, each behind a full mix,
/// so that no line of lattice points shares a pattern.
#[must_use]
#[inline]
pub const fn hash2(seed: u32, x: i32, z: i32) -> u32 {
    mix(mix(seed ^ (x as u32).wrapping_mul(0x9e37_79b9)).wrapping_add((z as u32).wrapping_mul(0x85eb_ca6b)))
}

/// The seed of one use (`stream`) of a 64-bit world seed.
///
/// The stream enters between the two halves, so that two worlds that share the seed of one stream
/// by chance differ in the others: all 64 bits count.
#[must_use]
pub const fn stream_seed(world_seed: u64, stream: u32) -> u32 {
    let low = world_seed as u32;
    let high = (world_seed >> 32) as u32;
    mix(mix(low.wrapping_add(stream.wrapping_mul(0xc2b2_ae35))).wrapping_add(high))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Flipping any input bit must flip every output bit about half of the time.
    #[test]
    fn hash2_avalanches_in_seed_and_both_coordinates() {
        const SAMPLES: u32 = 4096;
        for input_bit in 0..96 {
            let mut flips = [0u32; 32];
            for n in 0..SAMPLES {
                let (seed, x, z) = (mix(3 * n), mix(3 * n + 1) as i32 >> 12, mix(3 * n + 2) as i32 >> 12);
                let bit = 1u32 << (input_bit % 32);
                let changed = match input_bit / 32 {
                    0 => hash2(seed ^ bit, x, z),
                    1 => hash2(seed, x ^ bit as i32, z),
                    _ => hash2(seed, x, z ^ bit as i32),
                };
                let difference = hash2(seed, x, z) ^ changed;
                for (output_bit, count) in flips.iter_mut().enumerate() {
                    *count += (difference >> output_bit) & 1;
                }
            }
            for (output_bit, count) in flips.into_iter().enumerate() {
                let rate = f64::from(count) / f64::from(SAMPLES);
                assert!((0.45..0.55).contains(&rate), "input {input_bit} -> output {output_bit}: {rate}");
            }
        }
    }

    #[test]
    fn streams_of_one_seed_differ_and_every_seed_bit_counts() {
        let base = stream_seed(7, 0);
        assert_ne!(base, stream_seed(7, 1));
        for bit in 0..64 {
            assert_ne!(base, stream_seed(7 ^ (1 << bit), 0), "seed bit {bit}");
        }
    }

    #[test]
    fn seeds_that_share_one_stream_differ_in_the_others() {
        // For any low half there is a high half with the same stream 0.
        for low in 1..1000u32 {
            let high = mix(0).wrapping_sub(mix(low));
            let twin = u64::from(high) << 32 | u64::from(low);
            assert_eq!(stream_seed(twin, 0), stream_seed(0, 0));
            assert!((1..8).any(|stream| stream_seed(twin, stream) != stream_seed(0, stream)));
        }
    }
}
