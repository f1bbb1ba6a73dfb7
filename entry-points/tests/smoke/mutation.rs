//! Random inputs, and mutations of valid ones: bits, bytes, extremes, cuts, copies, pieces.

/// Longest input, bytes.
const LONGEST: usize = 20_000;

/// Numbers at which code changes its way.
const EXTREMES: [u64; 9] =
    [0, 1, 0x7f, 0xff, 0x7fff, 0xffff, 0x7fff_ffff, 0xffff_ffff, 0x7fff_ffff_ffff_ffff];

/// Inputs of one seed.
pub struct Mutations {
    corpus: Vec<Vec<u8>>,
    state: u64,
}

impl Mutations {
    pub const fn new(corpus: Vec<Vec<u8>>, seed: u64) -> Self {
        Self { corpus, state: seed }
    }

    /// SplitMix64 (Steele, Lea and Flood, OOPSLA 2014).
    fn next(&mut self) -> u64 {
        self.state = self.state.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut mixed = self.state;
        mixed = (mixed ^ mixed >> 30).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        mixed = (mixed ^ mixed >> 27).wrapping_mul(0x94d0_49bb_1331_11eb);
        mixed ^ mixed >> 31
    }

    fn below(&mut self, limit: usize) -> usize {
        (self.next() % limit.max(1) as u64) as usize
    }

    /// One input in eight is random, the others are mutated.
    pub fn next_input(&mut self) -> Vec<u8> {
        if self.below(8) == 0 {
            let length = self.below(300);
            return (0..length).map(|_| self.next() as u8).collect();
        }
        let chosen = self.below(self.corpus.len());
        let mut input = self.corpus[chosen].clone();
        for _ in 0..=self.below(4) {
            self.mutate(&mut input);
        }
        input.truncate(LONGEST);
        input
    }

    fn mutate(&mut self, input: &mut Vec<u8>) {
        let at = self.below(input.len());
        match self.below(8) {
            0 if !input.is_empty() => input[at] ^= 1 << self.below(8),
            1 if !input.is_empty() => input[at] = self.next() as u8,
            2 => input.truncate(at),
            3 => input.insert(at, self.next() as u8),
            4 if !input.is_empty() => {
                input.remove(at);
            }
            5 => {
                let mut bytes = EXTREMES[self.below(EXTREMES.len())].to_le_bytes();
                if self.below(2) == 0 {
                    bytes.reverse();
                }
                let length = (1 << self.below(4)).min(input.len() - at);
                input[at..][..length].copy_from_slice(&bytes[..length]);
            }
            6 => {
                let other = self.below(self.corpus.len());
                let from = self.below(self.corpus[other].len());
                input.truncate(at);
                input.extend_from_slice(&self.corpus[other][from..]);
            }
            _ => {
                let piece = input[at..].to_vec();
                let length = piece.len().min(self.below(64));
                input.extend_from_slice(&piece[..length]);
            }
        }
    }
}
