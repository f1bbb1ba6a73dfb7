//! What a backend computes of the probes, and how two backends are compared.

use crate::digest::probes::Probe;
use shaders::layout::PROBE_WORDS;

/// Per probe: `mod_trunc(x, z)`, `mod_floor(x, z)`, the sum of the fine octaves, the height with
/// all octaves and with a few.
pub const NAMES: [&str; PROBE_WORDS] = ["mod_trunc", "mod_floor", "fine", "height", "coarse height"];

/// blake3 over the words, little-endian, as hexadecimal digits.
pub fn digest(words: &[i32]) -> String {
    let mut hasher = blake3::Hasher::new();
    for part in words.chunks(1 << 14) {
        let bytes: Vec<u8> = part.iter().flat_map(|word| word.to_le_bytes()).collect();
        hasher.update(&bytes);
    }
    hasher.finalize().to_hex().to_string()
}

/// Words that differ; a missing or surplus word differs too.
pub fn count_differences(expected: &[i32], found: &[i32]) -> usize {
    let pairs = expected.iter().zip(found);
    pairs.filter(|(expected, found)| expected != found).count() + expected.len().abs_diff(found.len())
}

/// The first `limit` differences, one line each.
pub fn describe_differences(probes: &[Probe], expected: &[i32], found: &[i32], limit: usize) -> Vec<String> {
    if expected.len() != found.len() {
        return vec![format!("{} words instead of {}", found.len(), expected.len())];
    }
    let pairs = expected.iter().zip(found).enumerate();
    let differing = pairs.filter(|(_, (expected, found))| expected != found);
    differing
        .take(limit)
        .map(|(index, (expected, found))| {
            let ([x, z], name) = (probes[index / PROBE_WORDS], NAMES[index % PROBE_WORDS]);
            format!("at ({x}, {z}) {name} is {found}, expected {expected}")
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn one_flipped_bit_changes_the_digest_and_is_described() {
        let expected: Vec<i32> = (0..50_000).collect();
        let mut found = expected.clone();
        assert_eq!(digest(&found), digest(&expected));
        found[7 * PROBE_WORDS + 2] ^= 1;
        assert_ne!(digest(&found), digest(&expected));
        assert_eq!(count_differences(&expected, &found), 1);
        let probes: Vec<Probe> = (0..10_000).map(|n| [n, -n]).collect();
        assert_eq!(
            describe_differences(&probes, &expected, &found, 3),
            ["at (7, -7) fine is 36, expected 37"]
        );
    }

    #[test]
    fn missing_words_are_differences() {
        assert_eq!(count_differences(&[1, 2, 3], &[1, 2]), 1);
        assert_eq!(describe_differences(&[[0, 0]], &[1, 2, 3], &[1, 2], 3), ["2 words instead of 3"]);
    }
}
