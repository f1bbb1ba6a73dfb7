//! Memory of the process: what it may use ([`limit`]), the mark beyond which no further session
//! begins ([`mark`]), the room below it ([`room`]), which sessions end beyond it ([`shedding`]),
//! and what goes back to the system then ([`reclaim`], [`heaps`]).

pub mod heaps;
pub mod limit;
pub mod mark;
pub mod reclaim;
pub mod room;
pub mod shedding;

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

/// Whether a chunk cache of so many bytes stays below the memory mark, with its map tiles and the
/// pages of the allocator: 1.7 times as much. True without a known limit.
#[must_use]
pub fn has_room_for_cache(limit: Option<&MemoryLimit>, cache_bytes: u64) -> bool {
    limit.is_none_or(|limit| cache_bytes.saturating_mul(17) / 10 < room::mark(limit.bytes()))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_cache_of_four_ninths_of_the_memory_is_too_large() {
        let limit = MemoryLimit::of_machine(900 << 20);
        let has_room = |mib: u64| has_room_for_cache(Some(&limit), mib << 20);
        assert_eq!([112, 396, 398, 1000].map(has_room), [true, true, false, false]);
        assert!(has_room_for_cache(None, u64::MAX) && !has_room_for_cache(Some(&limit), u64::MAX));
    }

    #[test]
    fn the_default_cache_is_an_eighth_of_little_memory() {
        let of = |mib: u64| default_cache_mb(Some(&MemoryLimit::of_machine(mib << 20)));
        assert_eq!([2, 48, 256, 512, 1 << 20].map(of), [1, 6, 32, 64, 128]);
        assert_eq!(default_cache_mb(None), 128);
    }
}
