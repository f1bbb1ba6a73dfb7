//! The chunks that one client may receive, from its views and requests. Also measures the latency
//! of requests.
//!
//! Its memory is bounded for any behaviour of the server.

use protocol::limits::{MAX_PENDING_REQUESTS, MAX_VIEW_CHUNKS};
use protocol::message::{Refused, WireKey};
use protocol::view::View;
use rustc_hash::FxHashMap;
use std::collections::VecDeque;
use std::time::Duration;
use terrain::lod::{self, Viewer};
use terrain::{ChunkKey, Land};
use tokio::time::Instant;

/// Most views that the server may still be serving: those of 16 s at four views a second. When the
/// list is full the oldest view is dropped, and a chunk that only it needs counts as unexpected.
pub const MAX_VIEWS: usize = 64;

/// The same for a slow client, whose chunks arrive long after their view: those of 17 minutes at
/// four views a second.
pub const MAX_VIEWS_SLOW: usize = 4096;

/// Maximum of requests without an answer; further ones wait. Those that stay open are reported as
/// unanswered. Half of what a server accepts.
pub const MAX_OPEN_REQUESTS: usize = MAX_PENDING_REQUESTS / 2;

/// See the module.
#[derive(Debug)]
pub struct ExpectedChunks {
    land: Land,
    max_views: usize,
    /// Newest last: the id in Settled and refusals, the viewer, and the predicted viewer that the
    /// server may prefetch for.
    views: VecDeque<(u32, Viewer, Option<Viewer>)>,
    /// By key, oldest first: two requests may have the same key.
    requests: FxHashMap<ChunkKey, VecDeque<OpenRequest>>,
    n_requests: usize,
}

#[derive(Clone, Copy, Debug)]
struct OpenRequest {
    id: u32,
    since: Instant,
}

/// Why a chunk arrived.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ChunkStatus {
    /// It answers a request, after this time.
    Requested(Duration),
    /// A view needs or needed it.
    InView,
    /// No view or request explains it.
    Unexpected,
}

impl ExpectedChunks {
    /// Nothing is expected yet. Remembers `max_views` views: [`MAX_VIEWS`] or [`MAX_VIEWS_SLOW`].
    #[must_use]
    pub fn new(land: Land, max_views: usize) -> Self {
        Self { land, max_views, views: VecDeque::new(), requests: FxHashMap::default(), n_requests: 0 }
    }

    /// Adds a view that was sent.
    pub fn add_view(&mut self, view: &View) {
        if self.views.len() == self.max_views {
            self.views.pop_front();
        }
        self.views.push_back((view.id, view.viewer(), view.prefetch_viewer()));
    }

    /// The chunks of a view that is remembered.
    #[must_use]
    pub fn needed_by(&self, view: u32) -> Option<Vec<ChunkKey>> {
        let (_, viewer, _) = self.views.iter().find(|(id, _, _)| *id == view)?;
        let needed = lod::select(&self.land, viewer, MAX_VIEW_CHUNKS);
        Some(needed.into_iter().map(|needed| needed.key).collect())
    }

    /// The id of the newest view.
    #[must_use]
    pub fn newest_view(&self) -> Option<u32> {
        self.views.back().map(|(id, _, _)| *id)
    }

    /// A view is settled: no chunk of an older view is still to come. False if no view of this
    /// number was sent.
    pub fn settled(&mut self, view: u32) -> bool {
        if self.newest_view().is_none_or(|newest| view > newest) {
            return false;
        }
        // Ids only grow within a session; wrapping would take fifteen years.
        self.views.retain(|(id, _, _)| *id >= view);
        true
    }

    /// Whether only a request would bring this chunk, so that its latency is that of the request.
    #[must_use]
    pub fn can_request(&self, key: ChunkKey) -> bool {
        self.n_requests < MAX_OPEN_REQUESTS
            && !self.requests.contains_key(&key)
            && !self.is_needed_by_a_view(key)
    }

    /// Adds a request that was sent, with the time from which it counts.
    pub fn add_request(&mut self, id: u32, key: ChunkKey, since: Instant) {
        self.requests.entry(key).or_default().push_back(OpenRequest { id, since });
        self.n_requests += 1;
    }

    /// Removes the requests that a refusal answers.
    pub fn refused(&mut self, refused: &Refused) {
        let id = refused.id;
        match refused.key.map(WireKey::check) {
            Some(Ok(key)) => {
                if let Some(open) = self.requests.get_mut(&key) {
                    open.retain(|request| request.id != id);
                }
            }
            Some(Err(_)) => {}
            None => {
                self.requests.values_mut().for_each(|open| open.retain(|request| request.id != id));
            }
        }
        self.requests.retain(|_, open| !open.is_empty());
        self.n_requests = self.requests.values().map(VecDeque::len).sum();
    }

    /// Classifies a chunk that arrived.
    pub fn receive(&mut self, key: ChunkKey, now: Instant) -> ChunkStatus {
        match self.answered(key) {
            Some(request) => ChunkStatus::Requested(now.saturating_duration_since(request.since)),
            None if self.is_needed_by_a_view(key) => ChunkStatus::InView,
            None => ChunkStatus::Unexpected,
        }
    }

    /// Whether the current view needs a chunk.
    #[must_use]
    pub fn is_in_view(&self, key: ChunkKey) -> bool {
        self.views.back().is_some_and(|(_, viewer, _)| is_needed(&self.land, viewer, key))
    }

    /// Requests without an answer.
    #[must_use]
    pub const fn open_requests(&self) -> usize {
        self.n_requests
    }

    /// The times from which these requests count.
    pub fn waiting_since(&self) -> impl Iterator<Item = Instant> {
        self.requests.values().flatten().map(|request| request.since)
    }

    /// Removes the oldest request for a key.
    fn answered(&mut self, key: ChunkKey) -> Option<OpenRequest> {
        let open = self.requests.get_mut(&key)?;
        let request = open.pop_front()?;
        if open.is_empty() {
            self.requests.remove(&key);
        }
        self.n_requests -= 1;
        Some(request)
    }

    fn is_needed_by_a_view(&self, key: ChunkKey) -> bool {
        // Newest first: it nearly always matches.
        self.views.iter().rev().any(|(_, viewer, prefetch)| {
            [Some(viewer), prefetch.as_ref()]
                .into_iter()
                .flatten()
                .any(|viewer| is_needed(&self.land, viewer, key))
        })
    }
}

/// Whether a viewer needs a chunk, by the rule of [`lod::select`] for one key: it is within the
/// distance, and its parent is split.
///
/// Cheaper than a selection per view (nearly always one test), and implemented independently.
#[must_use]
pub fn is_needed(land: &Land, viewer: &Viewer, key: ChunkKey) -> bool {
    key.level() <= viewer.top_level()
        && viewer.sees(key)
        && (key.level() == viewer.top_level()
            || key.parent().is_some_and(|parent| is_split(land, viewer, parent)))
}

/// Whether a chunk is split: it is too coarse itself, or one of its children or of their neighbours
/// is split, so that the chunk would differ from it by two levels.
fn is_split(land: &Land, viewer: &Viewer, key: ChunkKey) -> bool {
    if is_too_coarse(land, viewer, key) {
        return true;
    }
    let ring = |key: ChunkKey| {
        (-1..=1).flat_map(move |east| (-1..=1).filter_map(move |south| key.neighbour(east, south)))
    };
    // Such a chain never leaves the neighbours of the first chunk's ancestors, which are too coarse
    // themselves.
    if !ring(key).any(|near| is_too_coarse(land, viewer, near)) {
        return false;
    }
    let children = key.children().into_iter().flatten().filter(|child| viewer.sees(*child));
    children.flat_map(ring).any(|near| is_split(land, viewer, near))
}

fn is_too_coarse(land: &Land, viewer: &Viewer, key: ChunkKey) -> bool {
    viewer.sees(key)
        && viewer.screen_error_q4(lod::error_bound(land, key), viewer.distance_to(key)) > viewer.tolerance()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::path::{FlightPath, PathKind};
    use crate::session::view_of;
    use protocol::message::RefusalReason;
    use std::collections::HashSet;

    fn land() -> Land {
        Land::new(1)
    }

    fn view(id: u32, index: u32, distance_m: u32) -> View {
        let pose = FlightPath::new(PathKind::Fly, 1, index, land().start()).pose(&land(), f64::from(id));
        view_of(id, &pose, distance_m)
    }

    fn key(level: u8, x: i32, z: i32) -> ChunkKey {
        ChunkKey::new(level, x, z).unwrap()
    }

    #[test]
    fn a_key_is_needed_if_and_only_if_it_is_selected() {
        for (index, distance_m) in [(0, 2000), (1, 2000), (2, 300), (3, 8000), (4, 100)] {
            let viewer = view(1, index, distance_m).viewer();
            let selected: HashSet<_> =
                lod::select(&land(), &viewer, usize::MAX).into_iter().map(|needed| needed.key).collect();
            assert!(!selected.is_empty());
            // Every selected key, its children, parent and eastern neighbour: both sides of every
            // border.
            let around = |key: &ChunkKey| {
                let east = ChunkKey::new(key.level(), key.x() + 1, key.z()).ok();
                key.children()
                    .into_iter()
                    .flatten()
                    .chain(key.parent())
                    .chain(east)
                    .chain([*key])
                    .collect::<Vec<_>>()
            };
            for key in selected.iter().flat_map(around) {
                assert_eq!(
                    is_needed(&land(), &viewer, key),
                    selected.contains(&key),
                    "{key} at {distance_m} m"
                );
            }
        }
    }

    #[test]
    fn a_chunk_is_unexpected_unless_requested_or_in_view() {
        let now = Instant::now();
        let mut expected = ExpectedChunks::new(land(), MAX_VIEWS);
        expected.add_view(&view(1, 0, 2000));
        let far = key(0, 30_000, 30_000);
        assert_eq!(expected.receive(far, now), ChunkStatus::Unexpected);
        expected.add_request(0, far, now);
        let later = now + Duration::from_millis(7);
        assert_eq!(expected.receive(far, later), ChunkStatus::Requested(Duration::from_millis(7)));
        assert_eq!(expected.receive(far, later), ChunkStatus::Unexpected, "one request is one chunk");
        let near = lod::select(&land(), &view(1, 0, 2000).viewer(), 1)[0].key;
        assert_eq!(expected.receive(near, now), ChunkStatus::InView);
    }

    #[test]
    fn older_views_count_until_a_newer_one_is_settled() {
        let now = Instant::now();
        let mut expected = ExpectedChunks::new(land(), MAX_VIEWS);
        let (old, new) = (view(1, 0, 300), view(2, 1, 300));
        let of_old = lod::select(&land(), &old.viewer(), usize::MAX).last().unwrap().key;
        assert!(!is_needed(&land(), &new.viewer(), of_old));
        expected.add_view(&old);
        expected.add_view(&new);
        assert_eq!(expected.receive(of_old, now), ChunkStatus::InView);
        expected.settled(2);
        assert_eq!(expected.receive(of_old, now), ChunkStatus::Unexpected);
    }

    #[test]
    fn only_keys_outside_of_views_and_requests_can_be_requested() {
        let now = Instant::now();
        let mut expected = ExpectedChunks::new(land(), MAX_VIEWS);
        expected.add_view(&view(1, 0, 2000));
        let near = lod::select(&land(), &view(1, 0, 2000).viewer(), 1)[0].key;
        let far = key(0, 30_000, 30_000);
        assert!(!expected.can_request(near));
        assert!(expected.can_request(far));
        expected.add_request(0, far, now);
        assert!(!expected.can_request(far), "already open");
    }

    #[test]
    fn two_requests_for_a_chunk_are_answered_separately() {
        let now = Instant::now();
        let mut expected = ExpectedChunks::new(land(), MAX_VIEWS);
        let far = key(0, 30_000, 30_000);
        expected.add_request(0, far, now);
        expected.add_request(1, far, now + Duration::from_millis(5));
        assert_eq!(expected.open_requests(), 2);
        let later = now + Duration::from_millis(9);
        assert_eq!(expected.receive(far, later), ChunkStatus::Requested(Duration::from_millis(9)));
        assert_eq!(expected.receive(far, later), ChunkStatus::Requested(Duration::from_millis(4)));
        assert_eq!((expected.receive(far, later), expected.open_requests()), (ChunkStatus::Unexpected, 0));
    }

    #[test]
    fn refusals_close_requests_by_key_or_by_id() {
        let mut expected = ExpectedChunks::new(land(), MAX_VIEWS);
        expected.add_request(5, key(0, 1, 1), Instant::now());
        expected.add_request(6, key(0, 2, 2), Instant::now());
        let refusal = |id, key: Option<ChunkKey>| Refused {
            id,
            key: key.map(Into::into),
            reason: RefusalReason::Overloaded,
            detail: "".into(),
        };
        expected.refused(&refusal(5, Some(key(0, 1, 1))));
        assert_eq!(expected.open_requests(), 1);
        expected.refused(&refusal(6, None));
        assert_eq!(expected.open_requests(), 0);
    }

    #[test]
    fn remembered_views_are_bounded_and_the_last_is_the_current_one() {
        let mut expected = ExpectedChunks::new(land(), MAX_VIEWS);
        let (near, far) = (view(1, 0, 2000), view(2, 1, 300));
        let of_near = lod::select(&land(), &near.viewer(), 1)[0].key;
        expected.add_view(&near);
        assert!(expected.is_in_view(of_near));
        expected.add_view(&far);
        assert!(!expected.is_in_view(of_near));
        for id in 0..1000 {
            expected.add_view(&view(id, 0, 2000));
        }
        assert_eq!(expected.views.len(), MAX_VIEWS);
    }
}
