//! Chunks in flight: requested from the driver, and not yet delivered, failed or withdrawn.

use std::collections::HashMap;
use terrain::ChunkKey;

/// See the module.
#[derive(Debug, Default)]
pub(super) struct ChunksInFlight {
    chunks: HashMap<ChunkKey, InFlight>,
    /// Those that no view or request needs any more, since the last
    /// [`ChunksInFlight::take_stale`].
    stale: Vec<ChunkKey>,
}

/// A chunk in flight.
#[derive(Clone, Copy, Debug, Default)]
struct InFlight {
    /// Number of requests: a view and several explicit requests may need the same chunk.
    requests: u32,
    /// The latest explicit request; none if the latest was the view.
    latest: Option<u32>,
    /// Whether it was reported as stale since the latest request.
    is_stale: bool,
    /// The priority of the chunk in the active view, if the view waits for these requests instead
    /// of requesting it. If all requests end without the chunk, the view requests it.
    view: Option<u64>,
}

impl ChunksInFlight {
    /// Whether there is none.
    pub(super) fn is_empty(&self) -> bool {
        self.chunks.is_empty()
    }

    /// Number of requests.
    pub(super) fn requests(&self) -> u32 {
        self.chunks.values().map(|chunk| chunk.requests).sum()
    }

    /// Begins a request of a chunk: an explicit one by its id, or that of the view.
    pub(super) fn begin(&mut self, key: ChunkKey, request: Option<u32>) {
        let chunk = self.chunks.entry(key).or_default();
        chunk.requests += 1;
        (chunk.latest, chunk.is_stale) = (request, false);
    }

    /// Ends a request. Returns the priority of its chunk in the view that waits for it, if no other
    /// request of the chunk is left.
    pub(super) fn end(&mut self, key: ChunkKey) -> Option<u64> {
        let chunk = self.chunks.get_mut(&key)?;
        chunk.requests -= 1;
        if chunk.requests > 0 {
            return None;
        }
        self.chunks.remove(&key)?.view
    }

    /// Attaches the active view to a chunk in flight, if it needs the chunk with a priority. False
    /// if the chunk is not in flight.
    pub(super) fn wait_for(&mut self, key: ChunkKey, needed: Option<u64>) -> bool {
        let Some(chunk) = self.chunks.get_mut(&key) else { return false };
        chunk.view = chunk.view.or(needed);
        true
    }

    /// A new view is active: all chunks that it needs are pending, and it waits for none yet.
    pub(super) fn forget_view(&mut self) {
        self.chunks.values_mut().for_each(|chunk| chunk.view = None);
    }

    /// Marks each chunk with exactly one request and no waiting view, if `is_stale` says so of its
    /// key and request. Each is marked once, however often its request is cancelled: looking it up
    /// takes the lock of all sessions.
    pub(super) fn find_stale(&mut self, is_stale: impl Fn(ChunkKey, Option<u32>) -> bool) {
        for (key, chunk) in &mut self.chunks {
            let is_single = chunk.requests == 1 && chunk.view.is_none();
            if is_single && !chunk.is_stale && is_stale(*key, chunk.latest) {
                chunk.is_stale = true;
                self.stale.push(*key);
            }
        }
    }

    /// The marked chunks, each once.
    pub(super) fn take_stale(&mut self) -> Vec<ChunkKey> {
        std::mem::take(&mut self.stale)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn key(x: i32) -> ChunkKey {
        ChunkKey::new(0, x, 0).unwrap()
    }

    #[test]
    fn a_chunk_is_in_flight_until_its_last_request_ends() {
        let mut chunks = ChunksInFlight::default();
        chunks.begin(key(1), Some(7));
        chunks.begin(key(1), None);
        assert!(chunks.wait_for(key(1), Some(50)) && !chunks.wait_for(key(2), Some(50)));
        assert_eq!(chunks.requests(), 2);
        assert_eq!(chunks.end(key(1)), None, "another request is left");
        assert_eq!(chunks.end(key(1)), Some(50), "the view waited for it");
        assert!(chunks.is_empty() && chunks.end(key(1)).is_none());
    }

    #[test]
    fn a_stale_chunk_is_reported_once_until_it_is_requested_again() {
        let mut chunks = ChunksInFlight::default();
        let cancel = |chunks: &mut ChunksInFlight| {
            chunks.find_stale(|_, request| request == Some(7));
            chunks.take_stale()
        };
        chunks.begin(key(1), Some(7));
        assert_eq!((cancel(&mut chunks), cancel(&mut chunks)), (vec![key(1)], vec![]));
        chunks.end(key(1));
        chunks.begin(key(1), Some(7));
        assert!(chunks.wait_for(key(1), Some(50)) && cancel(&mut chunks).is_empty(), "a view waits");
        chunks.forget_view();
        assert_eq!(cancel(&mut chunks), [key(1)]);
        chunks.begin(key(1), Some(7));
        assert!(cancel(&mut chunks).is_empty(), "two requests");
    }
}
