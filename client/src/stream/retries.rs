//! Chunks that were bad or refused, and when each is requested again.

use protocol::backoff::Backoff;
use std::collections::{BTreeMap, BTreeSet};
use std::time::Duration;
use terrain::ChunkKey;

/// Most chunks at a time. A further one is not remembered: the caller must restart the session to
/// get it.
pub const MAX_RETRIES: usize = 1024;

/// Most requested at once; the others follow with the next call.
const MAX_DUE: usize = 64;

/// Time for an answer, after which a chunk is requested again.
const ANSWER: Duration = Duration::from_secs(10);

/// See the module. It has no clock: times count from the start of the session.
#[derive(Debug)]
pub struct Retries {
    chunks: BTreeMap<ChunkKey, Retry>,
    first: Duration,
    longest: Duration,
    seed: u64,
}

#[derive(Debug)]
struct Retry {
    due: Duration,
    /// Whether it is requested and has no answer.
    is_requested: bool,
    backoff: Backoff,
}

impl Retries {
    /// None yet. The delay before a request doubles from the first to at most the longest. Clients
    /// with different seeds do not request the same chunk together.
    #[must_use]
    pub const fn new((first, longest): (Duration, Duration), seed: u64) -> Self {
        Self { chunks: BTreeMap::new(), first, longest, seed }
    }

    /// Adds a chunk that was bad or refused, once more or for the first time. False if there are
    /// too many already.
    pub fn add(&mut self, key: ChunkKey, now: Duration) -> bool {
        if !self.chunks.contains_key(&key) && self.chunks.len() >= MAX_RETRIES {
            return false;
        }
        let (first, longest, seed) = (self.first, self.longest, self.seed);
        let retry = self.chunks.entry(key).or_insert_with(|| {
            let seed = seed ^ (u64::from(key.x() as u32) << 32 | u64::from(key.z() as u32));
            Retry { due: Duration::ZERO, is_requested: false, backoff: Backoff::new(first, longest, seed) }
        });
        (retry.due, retry.is_requested) = (now + retry.backoff.next_delay(), false);
        true
    }

    /// Whether a chunk waits for a request or for its answer.
    #[must_use]
    pub fn contains(&self, key: ChunkKey) -> bool {
        self.chunks.contains_key(&key)
    }

    /// Whether a chunk is requested and has no answer.
    #[must_use]
    pub fn is_requested(&self, key: ChunkKey) -> bool {
        self.chunks.get(&key).is_some_and(|retry| retry.is_requested)
    }

    /// The chunks.
    pub fn keys(&self) -> impl Iterator<Item = ChunkKey> {
        self.chunks.keys().copied()
    }

    /// A chunk arrived.
    pub fn remove(&mut self, key: ChunkKey) {
        self.chunks.remove(&key);
    }

    /// Number of chunks.
    #[must_use]
    pub fn len(&self) -> usize {
        self.chunks.len()
    }

    /// Whether there is none.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.chunks.is_empty()
    }

    /// The chunks to request now. Forgets those that are no longer needed. `parents_first` leaves
    /// out chunks whose parents are missing too.
    pub fn take_due(
        &mut self,
        now: Duration,
        is_needed: impl Fn(ChunkKey) -> bool,
        parents_first: bool,
    ) -> Vec<ChunkKey> {
        self.chunks.retain(|key, _| is_needed(*key));
        let missing: BTreeSet<_> = if parents_first { self.keys().collect() } else { BTreeSet::new() };
        let due = self.chunks.iter_mut().filter(|(key, retry)| {
            retry.due <= now && !key.parent().is_some_and(|parent| missing.contains(&parent))
        });
        due.take(MAX_DUE)
            .map(|(key, retry)| {
                (retry.due, retry.is_requested) = (now + ANSWER, true);
                *key
            })
            .collect()
    }

    /// When the next chunk is to be requested. `parents_first` as in [`Retries::take_due`].
    #[must_use]
    pub fn next(&self, parents_first: bool) -> Option<Duration> {
        let waits =
            |key: &ChunkKey| parents_first && key.parent().is_some_and(|parent| self.contains(parent));
        self.chunks.iter().filter(|(key, _)| !waits(key)).map(|(_, retry)| retry.due).min()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const MS: fn(u64) -> Duration = Duration::from_millis;

    fn key(x: i32) -> ChunkKey {
        ChunkKey::new(0, x, 9).unwrap()
    }

    #[test]
    fn delays_grow_and_a_chunk_that_arrived_is_not_requested_again() {
        let mut retries = Retries::new((MS(100), MS(1000)), 1);
        assert_eq!(retries.next(false), None);
        let (mut now, mut last) = (Duration::ZERO, Duration::ZERO);
        for attempt in 0..8 {
            assert!(retries.add(key(1), now));
            let due = retries.next(false).unwrap();
            assert!(due - now <= MS(1000) && (attempt != 3 || due - now > last), "attempt {attempt}");
            assert!(retries.take_due(now, |_| true, false).is_empty());
            (last, now) = (due - now, due);
            assert_eq!(retries.take_due(now, |_| true, false), [key(1)]);
        }
        // Without an answer it is requested again.
        assert_eq!(retries.next(false), Some(now + ANSWER));
        retries.remove(key(1));
        assert!(retries.is_empty() && retries.take_due(MS(1_000_000), |_| true, false).is_empty());
    }

    #[test]
    fn two_clients_do_not_request_a_chunk_together() {
        let due = |seed| {
            let mut retries = Retries::new((MS(100), MS(1000)), seed);
            assert!(retries.add(key(1), MS(0)));
            retries.next(false)
        };
        assert_ne!(due(1), due(2));
        assert_eq!(due(1), due(1));
    }

    #[test]
    fn a_chunk_that_waits_for_its_parent_has_no_time_of_its_own() {
        let child = key(1);
        let parent = child.parent().unwrap();
        let mut retries = Retries::new((MS(100), MS(1000)), 1);
        assert!(retries.add(child, MS(0)) && retries.add(parent, MS(0)));
        assert_eq!(retries.take_due(MS(5000), |_| true, true), [parent]);
        assert!(retries.is_requested(parent) && !retries.is_requested(child));
        assert_eq!(retries.next(true), Some(MS(5000) + ANSWER));
        // The control: without the order it is overdue.
        assert!(retries.next(false).unwrap() < MS(5000));
        retries.remove(parent);
        assert_eq!(retries.next(true), retries.next(false));
        assert!(retries.add(parent, MS(5000)) && !retries.is_requested(parent));
    }

    #[test]
    fn chunks_are_bounded_and_those_out_of_view_are_forgotten() {
        let mut retries = Retries::new((MS(1), MS(1)), 1);
        for x in 0..MAX_RETRIES as i32 {
            assert!(retries.add(key(x), Duration::ZERO));
        }
        assert!(!retries.add(key(-1), Duration::ZERO) && retries.add(key(0), Duration::ZERO));
        assert_eq!(retries.take_due(MS(5), |_| true, false).len(), MAX_DUE);
        assert!(retries.take_due(MS(5), |key| key.x() < 10, false).is_empty(), "requested already");
        assert_eq!(retries.len(), 10);
    }
}
