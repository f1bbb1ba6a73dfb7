//! Random inputs, and mutations of valid ones: bits, bytes, extremes, cuts, copies, pieces.

use test_support::Random;

/// Longest input, bytes.
const LONGEST: usize = 20_000;

/// Numbers at which code changes its way.
const EXTREMES: [u64; 9] =
    [0, 1, 0x7f, 0xff, 0x7fff, 0xffff, 0x7fff_ffff, 0xffff_ffff, 0x7fff_ffff_ffff_ffff];

/// Inputs of one seed.
pub struct Mutations {
    corpus: Vec<Vec<u8>>,
    random: Random,
}

impl Mutations {
    pub const fn new(corpus: Vec<Vec<u8>>, seed: u64) -> Self {
        Self { corpus, random: Random(seed) }
    }

    /// One input in eight is random, the others are mutated.
    pub fn next_input(&mut self) -> Vec<u8> {
        if self.random.below(8) == 0 {
            let length = self.random.below(300);
            return (0..length).map(|_| self.random.bits() as u8).collect();
        }
        let chosen = self.random.below(self.corpus.len());
        let mut input = self.corpus[chosen].clone();
        for _ in 0..=self.random.below(4) {
            self.mutate(&mut input);
        }
        input.truncate(LONGEST);
        input
    }

    fn mutate(&mut self, input: &mut Vec<u8>) {
        let at = self.random.below(input.len());
        match self.random.below(8) {
            0 if !input.is_empty() => input[at] ^= 1 << self.random.below(8),
            1 if !input.is_empty() => input[at] = self.random.bits() as u8,
            2 => input.truncate(at),
            3 => input.insert(at, self.random.bits() as u8),
            4 if !input.is_empty() => {
                input.remove(at);
            }
            5 => {
                let mut bytes = EXTREMES[self.random.below(EXTREMES.len())].to_le_bytes();
                if self.random.below(2) == 0 {
                    bytes.reverse();
                }
                let length = (1 << self.random.below(4)).min(input.len() - at);
                input[at..][..length].copy_from_slice(&bytes[..length]);
            }
            6 => {
                let other = self.random.below(self.corpus.len());
                let from = self.random.below(self.corpus[other].len());
                input.truncate(at);
                input.extend_from_slice(&self.corpus[other][from..]);
            }
            _ => {
                let piece = input[at..].to_vec();
                let length = piece.len().min(self.random.below(64));
                input.extend_from_slice(&piece[..length]);
            }
        }
    }
}
