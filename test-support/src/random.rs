//! Random numbers from a seed, the same on every machine.

use std::ops::Range;

/// SplitMix64 (Steele, Lea and Flood, OOPSLA 2014).
#[derive(Clone, Debug)]
pub struct Random(pub u64);

impl Random {
    /// The next 64 bits.
    pub const fn bits(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut mixed = self.0;
        mixed = (mixed ^ mixed >> 30).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        mixed = (mixed ^ mixed >> 27).wrapping_mul(0x94d0_49bb_1331_11eb);
        mixed ^ mixed >> 31
    }

    /// A number below a limit; 0 for a limit of 0.
    pub fn below(&mut self, limit: usize) -> usize {
        (self.bits() % limit.max(1) as u64) as usize
    }

    /// A number in a range that is not empty.
    pub const fn within(&mut self, range: Range<i64>) -> i64 {
        range.start + (self.bits() % (range.end - range.start) as u64) as i64
    }

    /// Milliseconds in a range that is not empty.
    pub const fn ms(&mut self, range: Range<u64>) -> u64 {
        range.start + self.bits() % (range.end - range.start)
    }

    /// True in `share` of a hundred cases.
    pub const fn percent(&mut self, share: u64) -> bool {
        self.bits() % 100 < share
    }

    /// One of some extremes, or any number.
    pub fn pick<T: Copy, const N: usize>(&mut self, extremes: [T; N], any: impl Fn(u64) -> T) -> T {
        let choice = self.below(N + 1);
        extremes.get(choice).copied().unwrap_or_else(|| any(self.bits()))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_are_those_of_the_reference_implementation() {
        // The first outputs for the seed 1234567, <https://prng.di.unimi.it/splitmix64.c>.
        let mut random = Random(1_234_567);
        assert_eq!(random.bits(), 6_457_827_717_110_365_317);
        assert_eq!(random.bits(), 3_203_168_211_198_807_973);
        assert_eq!(Random(7).below(0), 0);
    }
}
