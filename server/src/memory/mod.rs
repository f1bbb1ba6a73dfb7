//! Memory of the process: what it may use ([`limit`]), the mark beyond which no further session
//! begins ([`mark`]), and what goes back to the system then ([`reclaim`], [`heaps`]).

pub mod heaps;
pub mod limit;
pub mod mark;
pub mod reclaim;

pub use limit::MemoryLimit;
pub use mark::MemoryMark;

/// The largest default of the chunk cache, MiB.
const MOST_CACHE_MB: u64 = 128;

/// The default chunk cache is the memory of the process divided by this, if that is less.
const CACHE_DIVISOR: u64 = 8;

/// The default size of the chunk cache, MiB, at least 1: 128, or an eighth of the memory that the
/// process may use. The largest one if that is not known.
#[must_use]
pub fn default_cache_mb(limit: Option<&MemoryLimit>) -> u64 {
    let share = limit.map_or(u64::MAX, |limit| limit.bytes() / CACHE_DIVISOR) >> 20;
    share.clamp(1, MOST_CACHE_MB)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_default_cache_is_an_eighth_of_little_memory() {
        let of = |mib: u64| default_cache_mb(Some(&MemoryLimit::of_machine(mib << 20)));
        assert_eq!([2, 48, 256, 512, 1 << 20].map(of), [1, 6, 32, 64, 128]);
        assert_eq!(default_cache_mb(None), 128);
    }
}
