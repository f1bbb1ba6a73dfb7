//! The streamer: moves chunks from a stream into the cache, sends the view, and detects a complete
//! view. It has no clock: the caller passes the time.

use crate::cache::{ChunkCache, Resident, vertical_scale};
use crate::lod::{Fading, Selection, select_at};
use crate::stream::chunk_stream::{ChunkStream, StreamEvent};
use crate::view::ViewParams;
use protocol::view::View;
use std::collections::HashSet;
use std::time::Duration;
use terrain::{ChunkKey, WorldDigest};

/// Least interval between two views of a moving camera.
const VIEW_INTERVAL: Duration = Duration::from_millis(100);

/// Factor of the tolerance each time the budget cannot hold the view.
const TOLERANCE_STEP: f64 = 1.25;

/// At this scale a whole island is a few chunks.
const MAX_TOLERANCE_SCALE: f64 = 1000.0;

/// Time before the tolerance is raised again: chunks requested with the old one are still arriving.
const TOLERANCE_INTERVAL: Duration = Duration::from_millis(400);

/// Time before a refused view is sent again while nothing changes: the server may have had no room
/// for it.
const REFUSED_INTERVAL: Duration = Duration::from_secs(5);

/// Most missed chunks that are remembered: bad or refused ones, requested again. With more, a view
/// that lacks chunks can be mistaken for a cache that is too small. The tolerance is raised then,
/// and lowered only while a complete view draws less than a quarter of the capacity.
const MAX_MISSED: usize = 1024;

/// State of the connection.
#[derive(Clone, Debug, PartialEq)]
pub enum Link {
    /// No session yet.
    Connecting,
    /// In a session with this server.
    Connected(String),
    /// Between sessions.
    Waiting {
        /// End of the last session.
        cause: String,
        /// Time of the next attempt.
        retry_at: Duration,
    },
    /// Given up: another attempt cannot help.
    GivenUp(String),
}

/// Milestones, as times since the start.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Milestones {
    /// The first chunk arrived.
    pub first_chunk: Option<Duration>,
    /// The first complete view was ready to be drawn.
    pub complete_view: Option<Duration>,
}

/// Connects a chunk stream to the chunk cache.
#[derive(Debug)]
pub struct WorldStreamer<F> {
    stream: F,
    cache: ChunkCache,
    digest: Option<WorldDigest>,
    link: Link,
    failures: u32,
    /// Why the last sent view was refused.
    refusal: Option<String>,
    /// Chunks that were bad or refused and have not come since. At most [`MAX_MISSED`]; the server
    /// chooses the keys.
    missed: HashSet<ChunkKey>,
    last_miss: Option<String>,
    sent: Option<(View, Duration)>,
    next_view: u32,
    settled: Option<u32>,
    tolerance_scale: f64,
    raised_at: Duration,
    milestones: Milestones,
    fade: Duration,
    vertical_scale: i32,
}

impl<F: ChunkStream> WorldStreamer<F> {
    /// A streamer over a cache of `capacity` chunks.
    #[must_use]
    pub fn new(stream: F, capacity: u32) -> Self {
        Self {
            stream,
            cache: ChunkCache::new(capacity),
            digest: None,
            link: Link::Connecting,
            failures: 0,
            refusal: None,
            missed: HashSet::new(),
            last_miss: None,
            sent: None,
            next_view: 1,
            settled: None,
            tolerance_scale: 1.0,
            raised_at: Duration::ZERO,
            milestones: Milestones::default(),
            fade: Duration::ZERO,
            vertical_scale: vertical_scale::ONE,
        }
    }

    /// Fades finer chunks in over this time.
    #[must_use]
    pub fn fading(self, lasts: Duration) -> Self {
        Self { fade: lasts, ..self }
    }

    /// Scales all heights by this factor, 0.25 to 4.
    #[must_use]
    pub fn with_vertical_scale(mut self, times: f64) -> Self {
        self.vertical_scale = (times.clamp(0.25, 4.0) * f64::from(vertical_scale::ONE)).round() as i32;
        self.cache.set_vertical_scale(self.vertical_scale);
        self
    }

    /// Handles up to `limit` events, sends the view and selects chunks. `upload` is called for
    /// every chunk that got a slot; `now` counts from the start of the program.
    pub fn update(
        &mut self,
        view: &ViewParams,
        now: Duration,
        limit: usize,
        mut upload: impl FnMut(&Resident),
    ) -> Selection {
        for _ in 0..limit {
            let Some(event) = self.stream.poll() else { break };
            self.handle(event, now, &mut upload);
        }
        let is_sent = self.send_view(view, now);
        let viewer = self.tolerated(view).viewer();
        let served = vertical_scale::served(&viewer, self.vertical_scale);
        // Chunks that have left the view are not requested again.
        self.missed.retain(|key| key.level() <= served.top_level() && served.sees(*key));
        let selection = select_at(&mut self.cache, &viewer, Fading { now, lasts: self.fade });
        if is_sent && self.is_settled() {
            if !selection.is_complete() {
                // Everything was sent, so missing chunks have been evicted since, or were bad and
                // come again.
                if self.missed.is_empty() {
                    self.raise_tolerance(now);
                }
            } else {
                self.missed.clear();
                self.milestones.complete_view.get_or_insert(now);
                // Less than a quarter of the slots is drawn: there is room for more detail.
                if self.tolerance_scale > 1.0 && selection.drawn.len() * 4 < self.cache.capacity() as usize {
                    self.tolerance_scale = (self.tolerance_scale / TOLERANCE_STEP).max(1.0);
                }
            }
        }
        selection
    }

    fn handle(&mut self, event: StreamEvent, now: Duration, upload: &mut impl FnMut(&Resident)) {
        match event {
            StreamEvent::Connected { world, world_seed, server } => {
                if self.digest.is_some_and(|known| known != world) {
                    // Chunks of another world are invalid.
                    self.cache = ChunkCache::new(self.cache.capacity());
                    self.cache.set_vertical_scale(self.vertical_scale);
                }
                self.digest = Some(world);
                self.cache.set_world(world_seed, world);
                self.link = Link::Connected(server);
                self.failures = 0;
                self.missed.clear();
                let keys: Vec<ChunkKey> = self.cache.keys().collect();
                if !keys.is_empty() {
                    self.stream.holding(&keys);
                }
                self.sent = None;
            }
            StreamEvent::Chunk(chunk) => {
                self.milestones.first_chunk.get_or_insert(now);
                let key = chunk.key;
                self.missed.remove(&key);
                let arrival = self.cache.insert(*chunk);
                if let (Some(_), Some(resident)) = (arrival.slot, self.cache.get(key)) {
                    upload(resident);
                }
                if !arrival.evicted.is_empty() {
                    self.stream.release(&arrival.evicted);
                }
                if arrival.thrashing {
                    self.raise_tolerance(now);
                }
            }
            StreamEvent::Settled { view } => {
                self.settled = Some(view);
                if self.is_settled() {
                    self.refusal = None;
                }
            }
            StreamEvent::Missed { key, detail } => {
                self.missed.extend(key.filter(|_| self.missed.len() < MAX_MISSED));
                self.last_miss = Some(detail);
            }
            StreamEvent::Refused { view, detail } => {
                // The view that was sent after a refused one may be accepted.
                if view.is_none() || view == self.last_view() {
                    self.refusal = Some(detail);
                }
            }
            StreamEvent::Disconnected { cause, retry } => {
                self.failures += 1;
                self.sent = None;
                self.link = match retry {
                    Some(delay) => Link::Waiting { cause, retry_at: now + delay },
                    None => Link::GivenUp(cause),
                };
            }
        }
    }

    /// The budget is too small: raises the tolerance instead of evicting and reloading forever.
    fn raise_tolerance(&mut self, now: Duration) {
        if now >= self.raised_at + TOLERANCE_INTERVAL {
            self.tolerance_scale = (self.tolerance_scale * TOLERANCE_STEP).min(MAX_TOLERANCE_SCALE);
            self.raised_at = now;
        }
    }

    /// Sends the view if it changed, if the eye came to rest, or if the server refused this view at
    /// least [`REFUSED_INTERVAL`] ago. True if the server has the current view.
    fn send_view(&mut self, view: &ViewParams, now: Duration) -> bool {
        if !matches!(self.link, Link::Connected(_)) {
            return false;
        }
        let mut view = self.tolerated(view).protocol_view(self.next_view);
        let served = vertical_scale::served(&view.viewer(), self.vertical_scale);
        view.eye[1] = served.eye.1;
        view.tolerance_q4 = served.tolerance_q4 as u16;
        if let Some((sent, at)) = &self.sent {
            let same = View { id: view.id, velocity: view.velocity, ..*sent } == view;
            let elapsed = now.saturating_sub(*at);
            let is_refused = self.refusal.is_some() && elapsed >= REFUSED_INTERVAL;
            // The server prefetches along the velocity: it must learn that the eye stands.
            if (same && sent.velocity == [0; 3] && !is_refused) || elapsed < VIEW_INTERVAL {
                return same;
            }
            let seconds = elapsed.as_secs_f64().max(0.001);
            view.velocity = [0, 1, 2].map(|axis| {
                let moved = f64::from(view.eye[axis]) - f64::from(sent.eye[axis]);
                (moved / seconds) as i32
            });
        }
        self.next_view = self.next_view.wrapping_add(1);
        self.stream.set_view(view);
        self.cache.view_sent();
        self.sent = Some((view, now));
        // Its answer is still to come, in a new session too.
        self.refusal = None;
        true
    }

    /// Id of the last view that was sent in this session.
    fn last_view(&self) -> Option<u32> {
        self.sent.as_ref().map(|(view, _)| view.id)
    }

    /// The view with the tolerance for chunk selection.
    fn tolerated(&self, view: &ViewParams) -> ViewParams {
        ViewParams { tolerance_px: self.tolerance_px(view), ..*view }
    }

    /// Whether the server has sent or refused every chunk of the last sent view, or knows it as
    /// held.
    #[must_use]
    pub fn is_settled(&self) -> bool {
        self.settled.is_some() && self.settled == self.last_view()
    }

    /// Tolerated screen error, pixels: the requested one, or more while the budget is too small.
    #[must_use]
    pub fn tolerance_px(&self, view: &ViewParams) -> f64 {
        view.tolerance_px * self.tolerance_scale
    }

    /// The chunk cache.
    #[must_use]
    pub fn cache(&self) -> &ChunkCache {
        &self.cache
    }

    /// The chunk stream.
    #[must_use]
    pub fn stream(&self) -> &F {
        &self.stream
    }

    /// Digest of the world, once a server announced one.
    #[must_use]
    pub fn world(&self) -> Option<WorldDigest> {
        self.digest
    }

    /// State of the connection.
    #[must_use]
    pub fn link(&self) -> &Link {
        &self.link
    }

    /// Sessions that failed since the last success.
    #[must_use]
    pub fn failures(&self) -> u32 {
        self.failures
    }

    /// Chunks that were bad or refused and have not come since.
    #[must_use]
    pub fn missed(&self) -> usize {
        self.missed.len()
    }

    /// Error of the last bad or refused chunk, if any.
    #[must_use]
    pub fn last_miss(&self) -> Option<&str> {
        self.last_miss.as_deref()
    }

    /// Why the server refused the last sent view, if it did.
    #[must_use]
    pub fn refusal(&self) -> Option<&str> {
        self.refusal.as_deref()
    }

    /// Milestones.
    #[must_use]
    pub fn milestones(&self) -> Milestones {
        self.milestones
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::camera::Projection;
    use crate::stream::{LocalStream, Traffic};
    use std::collections::VecDeque;

    fn view() -> ViewParams {
        ViewParams {
            pose: "0,200,0,0,-10".parse().unwrap(),
            projection: Projection { fov_deg: 60.0, width: 640, height: 360 },
            view_distance_m: 2000,
            tolerance_px: 4.0,
            time_s: 0.0,
            settings: crate::settings::RenderSettings::default(),
        }
    }

    const AT: fn(u64) -> Duration = Duration::from_millis;

    #[test]
    fn a_view_completes_and_each_chunk_is_uploaded_once() {
        let mut streamer = WorldStreamer::new(LocalStream::new(1), 4000);
        let mut slots = HashSet::new();
        let first = streamer.update(&view(), AT(0), usize::MAX, |_| ());
        assert!(first.drawn.is_empty() && !streamer.is_settled());
        let second = streamer
            .update(&view(), AT(1), usize::MAX, |chunk| assert!(slots.insert(chunk.slot), "slot twice"));
        assert!(second.is_complete() && streamer.is_settled());
        assert_eq!(slots.len(), streamer.cache().len());
        assert_eq!(
            streamer.milestones(),
            Milestones { first_chunk: Some(AT(1)), complete_view: Some(AT(1)) }
        );
    }

    #[test]
    fn a_small_budget_gives_a_coarser_complete_view() {
        let mut streamer = WorldStreamer::new(LocalStream::new(1), 100);
        let view = ViewParams { tolerance_px: 0.5, ..view() };
        let mut complete = false;
        for step in 0..200 {
            let selection = streamer.update(&view, AT(step * 500), usize::MAX, |_| ());
            complete = streamer.is_settled() && selection.is_complete();
            assert!(streamer.cache().len() <= 100);
            if complete {
                break;
            }
        }
        assert!(complete && streamer.tolerance_px(&view) > 0.5);
    }

    /// A stream that plays a script and records calls.
    #[derive(Default)]
    struct Script {
        events: VecDeque<StreamEvent>,
        views: Vec<View>,
        held: Vec<ChunkKey>,
    }

    impl ChunkStream for Script {
        fn poll(&mut self) -> Option<StreamEvent> {
            self.events.pop_front()
        }
        fn set_view(&mut self, view: View) {
            self.views.push(view);
        }
        fn release(&mut self, _: &[ChunkKey]) {}
        fn holding(&mut self, keys: &[ChunkKey]) {
            self.held.extend(keys);
        }
        fn delivery(&self) -> protocol::Delivery {
            protocol::Delivery::Exact
        }
        fn traffic(&self) -> Traffic {
            Traffic::default()
        }
    }

    fn connected(world: u8) -> StreamEvent {
        StreamEvent::Connected { world: WorldDigest([world; 32]), world_seed: 1, server: "test".into() }
    }

    #[test]
    fn chunks_survive_a_reconnect_and_are_reported() {
        let chunk = Box::new(terrain::Land::new(1).chunk(ChunkKey::new(3, 0, 0).unwrap()));
        let lost = StreamEvent::Disconnected { cause: "gone".into(), retry: Some(AT(500)) };
        let mut streamer = WorldStreamer::new(Script::default(), 10);
        streamer.stream.events.extend([connected(1), StreamEvent::Chunk(chunk.clone())]);
        streamer.update(&view(), AT(0), 10, |_| ());
        streamer.stream.events.push_back(lost);
        streamer.update(&view(), AT(1000), 10, |_| ());
        assert_eq!(streamer.cache().keys().collect::<Vec<_>>(), [chunk.key], "keeps its chunks");
        assert_eq!(streamer.link(), &Link::Waiting { cause: "gone".into(), retry_at: AT(1500) });
        streamer.stream.events.push_back(connected(1));
        streamer.update(&view(), AT(1500), 10, |_| ());
        assert_eq!(streamer.stream.held, [chunk.key]);
        assert_eq!(streamer.stream.views.len(), 2, "the view is sent again");

        streamer.stream.events.push_back(connected(2));
        streamer.update(&view(), AT(2000), 10, |_| ());
        assert!(streamer.cache().is_empty(), "chunks of another world are dropped");
    }

    #[test]
    fn a_chunk_that_was_bad_does_not_coarsen_the_view() {
        let tolerance_px = |is_bad: bool| {
            let mut streamer = WorldStreamer::new(Script::default(), 10);
            streamer.stream.events.push_back(connected(1));
            streamer.update(&view(), AT(0), 10, |_| ());
            if is_bad {
                let missed = StreamEvent::Missed { key: ChunkKey::new(3, 0, 0).ok(), detail: "bad".into() };
                streamer.stream.events.push_back(missed);
            }
            streamer.stream.events.push_back(StreamEvent::Settled { view: 1 });
            streamer.update(&view(), AT(500), 10, |_| ());
            assert_eq!((streamer.missed(), streamer.is_settled()), (usize::from(is_bad), true));
            streamer.tolerance_px(&view())
        };
        assert_eq!(tolerance_px(true), 4.0);
        // The control: what is missing otherwise was evicted.
        assert!(tolerance_px(false) > 4.0);
    }

    #[test]
    fn a_still_camera_sends_one_view_and_a_moving_one_ten_a_second() {
        let mut streamer = WorldStreamer::new(Script::default(), 10);
        streamer.stream.events.push_back(connected(1));
        for millis in 0..1000 {
            streamer.update(&view(), AT(millis), 10, |_| ());
        }
        assert_eq!(streamer.stream.views.len(), 1);
        for millis in 1000..2000 {
            let mut moving = view();
            moving.pose.position_m.x += millis as f64 / 10.0;
            streamer.update(&moving, AT(millis), 10, |_| ());
        }
        assert!((9..=11).contains(&(streamer.stream.views.len() - 1)), "{}", streamer.stream.views.len());
        let last = streamer.stream.views[streamer.stream.views.len() - 1];
        assert!((last.velocity[0] - 100 * 256).abs() < 2000, "{}", last.velocity[0]);
    }

    #[test]
    fn a_refused_view_is_sent_again_once_for_each_refusal() {
        let mut streamer = WorldStreamer::new(Script::default(), 10);
        streamer.stream.events.push_back(connected(1));
        streamer.update(&view(), AT(0), 10, |_| ());
        let refused = |view| StreamEvent::Refused { view: Some(view), detail: "no room".into() };
        // Whether the view counts as refused at the end, and the number of views sent until then.
        let mut run = |event: Option<StreamEvent>, millis: std::ops::Range<u64>| {
            streamer.stream.events.extend(event);
            for millis in millis.step_by(100) {
                streamer.update(&view(), AT(millis), 10, |_| ());
            }
            (streamer.refusal().is_some(), streamer.stream.views.len())
        };
        assert_eq!(run(Some(refused(1)), 100..5_000), (true, 1));
        assert_eq!(run(None, 5_000..6_000), (false, 2), "sent again, not answered yet");
        assert_eq!(run(Some(refused(2)), 6_000..10_000), (true, 2));
        assert_eq!(run(None, 10_000..30_000), (false, 3), "accepted, not settled yet");
        assert_eq!(run(Some(refused(2)), 30_000..40_000), (false, 3), "of an older view");
    }

    #[test]
    fn a_settled_view_and_a_new_session_end_a_refusal() {
        for (end, sent) in [(StreamEvent::Settled { view: 1 }, 1), (connected(1), 2)] {
            let mut streamer = WorldStreamer::new(Script::default(), 10);
            streamer.stream.events.push_back(connected(1));
            streamer.update(&view(), AT(0), 10, |_| ());
            // A chunk that is known to be missing: the settled view raises no tolerance.
            let missed = StreamEvent::Missed { key: ChunkKey::new(3, 0, 0).ok(), detail: "bad".into() };
            let refused = StreamEvent::Refused { view: None, detail: "no credit".into() };
            streamer.stream.events.extend([refused, missed]);
            streamer.update(&view(), AT(100), 10, |_| ());
            assert_eq!(streamer.refusal(), Some("no credit"));
            streamer.stream.events.push_back(end);
            for millis in (200..20_000).step_by(100) {
                streamer.update(&view(), AT(millis), 10, |_| ());
            }
            assert_eq!((streamer.refusal(), streamer.stream.views.len()), (None, sent));
        }
    }

    #[test]
    fn an_eye_that_stands_after_a_jump_sends_its_rest_once() {
        let mut streamer = WorldStreamer::new(Script::default(), 10);
        streamer.stream.events.push_back(connected(1));
        streamer.update(&view(), AT(0), 10, |_| ());
        let mut there = view();
        there.pose.position_m.x += 3000.0;
        for millis in 250..1200 {
            streamer.update(&there, AT(millis), 10, |_| ());
        }
        let sent: Vec<_> = streamer.stream.views.iter().map(|view| (view.eye[0], view.velocity)).collect();
        let units = 3000 * 256;
        assert_eq!(sent, [(0, [0; 3]), (units, [units * 4, 0, 0]), (units, [0; 3])]);
    }
}
