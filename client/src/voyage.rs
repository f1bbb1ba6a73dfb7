//! The driver: moves chunks from a feed into the world, tells the feed what is seen, and knows when
//! the view is complete. No clock of its own: the caller says what time it is.

use crate::feed::{Feed, FeedEvent};
use crate::frame::Shot;
use crate::world::{Fading, Resident, Selection, World, select_at, stretch};
use protocol::view::View;
use std::time::Duration;
use terrain::{ChunkKey, WorldDigest};

/// A moving camera would send a view every frame; the server needs no more than this.
const VIEW_INTERVAL: Duration = Duration::from_millis(100);

/// Each time that the budget cannot hold the view, its tolerance is multiplied by this.
const STRAIN_STEP: f64 = 1.25;

/// Beyond this even a whole island is a few chunks.
const MAX_STRAIN: f64 = 1000.0;

/// Time for a strained tolerance to show its effect before it is strained again: chunks that were
/// asked for with the old one are still arriving.
const STRAIN_INTERVAL: Duration = Duration::from_millis(400);

/// How the feed is doing.
#[derive(Clone, Debug, PartialEq)]
pub enum Link {
    /// No session yet.
    Connecting,
    /// In a session with this server.
    Connected(String),
    /// Between sessions.
    Waiting {
        /// What ended the last one.
        cause: String,
        /// When the next attempt is made.
        retry_at: Duration,
    },
    /// Given up: another attempt cannot help.
    Refused(String),
}

/// When things were reached, since the start.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Milestones {
    /// The first chunk arrived.
    pub first_chunk: Option<Duration>,
    /// The first complete view was ready to be drawn.
    pub complete_view: Option<Duration>,
}

/// A feed, a world and what links them.
#[derive(Debug)]
pub struct Voyage<F> {
    feed: F,
    world: World,
    digest: Option<WorldDigest>,
    link: Link,
    failures: u32,
    refusal: Option<String>,
    sent: Option<(View, Duration)>,
    next_view: u32,
    settled: Option<u32>,
    strain: f64,
    strained_at: Duration,
    milestones: Milestones,
    fade: Duration,
    stretch: i32,
}

impl<F: Feed> Voyage<F> {
    /// A voyage with room for `capacity` chunks.
    #[must_use]
    pub fn new(feed: F, capacity: u32) -> Self {
        Self {
            feed,
            world: World::new(capacity),
            digest: None,
            link: Link::Connecting,
            failures: 0,
            refusal: None,
            sent: None,
            next_view: 1,
            settled: None,
            strain: 1.0,
            strained_at: Duration::ZERO,
            milestones: Milestones::default(),
            fade: Duration::ZERO,
            stretch: stretch::ONE,
        }
    }

    /// The voyage with finer land that grows out of coarser land for so long, instead of appearing.
    #[must_use]
    pub fn fading(self, lasts: Duration) -> Self {
        Self { fade: lasts, ..self }
    }

    /// The voyage over land that is drawn so many times as high as it is, 0.25 to 4.
    #[must_use]
    pub fn stretched(mut self, times: f64) -> Self {
        self.stretch = (times.clamp(0.25, 4.0) * f64::from(stretch::ONE)).round() as i32;
        self.world.set_stretch(self.stretch);
        self
    }

    /// Takes up to `limit` events, says what is seen, and chooses what to draw. `upload` is called
    /// for every chunk that got a slot; `now` counts from the start of the program.
    pub fn update(
        &mut self,
        shot: &Shot,
        now: Duration,
        limit: usize,
        mut upload: impl FnMut(&Resident),
    ) -> Selection {
        for _ in 0..limit {
            let Some(event) = self.feed.poll() else { break };
            self.take(event, now, &mut upload);
        }
        let said = self.say_what_is_seen(shot, now);
        let viewer = self.judging(shot).viewer();
        let selection = select_at(&mut self.world, &viewer, Fading { now, lasts: self.fade });
        if said && self.is_settled() {
            if !selection.is_complete() {
                // All was sent, so what is wanting was evicted since.
                self.strain_more(now);
            } else {
                self.milestones.complete_view.get_or_insert(now);
                // A budget that is mostly idle can afford more of what was asked for.
                if self.strain > 1.0 && selection.drawn.len() * 4 < self.world.capacity() as usize {
                    self.strain = (self.strain / STRAIN_STEP).max(1.0);
                }
            }
        }
        selection
    }

    fn take(&mut self, event: FeedEvent, now: Duration, upload: &mut impl FnMut(&Resident)) {
        match event {
            FeedEvent::Connected { world, world_seed, server } => {
                if self.digest.is_some_and(|known| known != world) {
                    // Another world: nothing that is here belongs to it.
                    self.world = World::new(self.world.capacity());
                    self.world.set_stretch(self.stretch);
                }
                self.digest = Some(world);
                self.world.set_seed(world_seed);
                self.link = Link::Connected(server);
                self.failures = 0;
                let keys: Vec<ChunkKey> = self.world.keys().collect();
                if !keys.is_empty() {
                    self.feed.holding(&keys);
                }
                self.sent = None;
            }
            FeedEvent::Chunk(chunk) => {
                self.milestones.first_chunk.get_or_insert(now);
                let key = chunk.key;
                let arrival = self.world.insert(stretch::stretched(*chunk, self.stretch));
                if let (Some(_), Some(resident)) = (arrival.slot, self.world.get(key)) {
                    upload(resident);
                }
                if !arrival.evicted.is_empty() {
                    self.feed.release(&arrival.evicted);
                }
                if arrival.starved {
                    self.strain_more(now);
                }
            }
            FeedEvent::Settled { view } => self.settled = Some(view),
            FeedEvent::Refused { detail } => self.refusal = Some(detail),
            FeedEvent::Disconnected { cause, retry } => {
                self.failures += 1;
                self.sent = None;
                self.link = match retry {
                    Some(delay) => Link::Waiting { cause, retry_at: now + delay },
                    None => Link::Refused(cause),
                };
            }
        }
    }

    /// The budget is too small: coarser everywhere instead of an endless exchange of chunks.
    fn strain_more(&mut self, now: Duration) {
        if now >= self.strained_at + STRAIN_INTERVAL {
            self.strain = (self.strain * STRAIN_STEP).min(MAX_STRAIN);
            self.strained_at = now;
        }
    }

    /// Sends the view if it is news. True if the server knows exactly what is seen now.
    fn say_what_is_seen(&mut self, shot: &Shot, now: Duration) -> bool {
        if !matches!(self.link, Link::Connected(_)) {
            return false;
        }
        let mut view = self.judging(shot).view(self.next_view);
        if let Some((sent, at)) = &self.sent {
            let same = View { id: view.id, velocity: view.velocity, ..*sent } == view;
            let elapsed = now.saturating_sub(*at);
            if same || elapsed < VIEW_INTERVAL {
                return same;
            }
            let seconds = elapsed.as_secs_f64().max(0.001);
            view.velocity = [0, 1, 2].map(|axis| {
                let moved = f64::from(view.eye[axis]) - f64::from(sent.eye[axis]);
                (moved / seconds) as i32
            });
        }
        self.next_view = self.next_view.wrapping_add(1);
        self.feed.set_view(view);
        self.world.view_said();
        self.sent = Some((view, now));
        true
    }

    /// The shot by whose tolerance chunks are chosen: errors grow with the land, and the server
    /// knows the land as it is.
    fn judging(&self, shot: &Shot) -> Shot {
        let times = f64::from(self.stretch) / f64::from(stretch::ONE);
        Shot { tolerance_px: self.tolerance_px(shot) / times.max(1.0), ..*shot }
    }

    /// Whether the server has sent everything for what was last said to be seen.
    #[must_use]
    pub fn is_settled(&self) -> bool {
        self.sent.as_ref().is_some_and(|(view, _)| self.settled == Some(view.id))
    }

    /// Tolerated screen error in pixels: what is asked for, or more while the budget is too small
    /// for it.
    #[must_use]
    pub fn tolerance_px(&self, shot: &Shot) -> f64 {
        shot.tolerance_px * self.strain
    }

    /// The resident chunks.
    #[must_use]
    pub fn world(&self) -> &World {
        &self.world
    }

    /// The feed.
    #[must_use]
    pub fn feed(&self) -> &F {
        &self.feed
    }

    /// The session's state.
    #[must_use]
    pub fn link(&self) -> &Link {
        &self.link
    }

    /// Sessions that failed since the last one that succeeded.
    #[must_use]
    pub fn failures(&self) -> u32 {
        self.failures
    }

    /// What the server last refused, if anything.
    #[must_use]
    pub fn refusal(&self) -> Option<&str> {
        self.refusal.as_deref()
    }

    /// What was reached when.
    #[must_use]
    pub fn milestones(&self) -> Milestones {
        self.milestones
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::camera::Lens;
    use crate::feed::{LocalFeed, Traffic};
    use std::collections::VecDeque;

    fn shot() -> Shot {
        Shot {
            pose: "0,200,0,0,-10".parse().unwrap(),
            lens: Lens { fov_deg: 60.0, width: 640, height: 360 },
            view_distance_m: 2000,
            tolerance_px: 4.0,
            time_s: 0.0,
            looks: crate::looks::Looks::default(),
        }
    }

    const AT: fn(u64) -> Duration = Duration::from_millis;

    #[test]
    fn a_view_becomes_complete_and_every_chunk_is_uploaded_once() {
        let mut voyage = Voyage::new(LocalFeed::new(1), 4000);
        let mut slots = std::collections::HashSet::new();
        let first = voyage.update(&shot(), AT(0), usize::MAX, |_| ());
        assert!(first.drawn.is_empty() && !voyage.is_settled());
        let second = voyage
            .update(&shot(), AT(1), usize::MAX, |chunk| assert!(slots.insert(chunk.slot), "slot twice"));
        assert!(second.is_complete() && voyage.is_settled());
        assert_eq!(slots.len(), voyage.world().len());
        assert_eq!(voyage.milestones(), Milestones { first_chunk: Some(AT(1)), complete_view: Some(AT(1)) });
    }

    #[test]
    fn a_budget_that_is_too_small_ends_in_a_coarser_complete_view() {
        let mut voyage = Voyage::new(LocalFeed::new(1), 100);
        let shot = Shot { tolerance_px: 0.5, ..shot() };
        let mut complete = false;
        for step in 0..200 {
            let selection = voyage.update(&shot, AT(step * 500), usize::MAX, |_| ());
            complete = voyage.is_settled() && selection.is_complete();
            assert!(voyage.world().len() <= 100);
            if complete {
                break;
            }
        }
        assert!(complete && voyage.tolerance_px(&shot) > 0.5);
    }

    /// A feed that plays a script and notes what it is told.
    #[derive(Default)]
    struct Script {
        events: VecDeque<FeedEvent>,
        views: Vec<View>,
        held: Vec<ChunkKey>,
    }

    impl Feed for Script {
        fn poll(&mut self) -> Option<FeedEvent> {
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

    fn connected(world: u8) -> FeedEvent {
        FeedEvent::Connected { world: WorldDigest([world; 32]), world_seed: 1, server: "test".into() }
    }

    #[test]
    fn after_a_lost_connection_the_world_stays_and_the_new_session_learns_what_is_held() {
        let chunk = Box::new(terrain::Land::new(1).chunk(ChunkKey::new(3, 0, 0).unwrap()));
        let lost = FeedEvent::Disconnected { cause: "gone".into(), retry: Some(AT(500)) };
        let mut voyage = Voyage::new(Script::default(), 10);
        voyage.feed.events.extend([connected(1), FeedEvent::Chunk(chunk.clone())]);
        voyage.update(&shot(), AT(0), 10, |_| ());
        voyage.feed.events.push_back(lost);
        voyage.update(&shot(), AT(1000), 10, |_| ());
        assert_eq!(voyage.world().keys().collect::<Vec<_>>(), [chunk.key], "keeps what it has");
        assert_eq!(voyage.link(), &Link::Waiting { cause: "gone".into(), retry_at: AT(1500) });
        voyage.feed.events.push_back(connected(1));
        voyage.update(&shot(), AT(1500), 10, |_| ());
        assert_eq!(voyage.feed.held, [chunk.key]);
        assert_eq!(voyage.feed.views.len(), 2, "the view is said again");

        voyage.feed.events.push_back(connected(2));
        voyage.update(&shot(), AT(2000), 10, |_| ());
        assert!(voyage.world().is_empty(), "another world's chunks are worth nothing");
    }

    #[test]
    fn a_still_camera_says_its_view_once_and_a_moving_one_at_most_ten_times_a_second() {
        let mut voyage = Voyage::new(Script::default(), 10);
        voyage.feed.events.push_back(connected(1));
        for millis in 0..1000 {
            voyage.update(&shot(), AT(millis), 10, |_| ());
        }
        assert_eq!(voyage.feed.views.len(), 1);
        for millis in 1000..2000 {
            let mut moving = shot();
            moving.pose.position_m.x += millis as f64 / 10.0;
            voyage.update(&moving, AT(millis), 10, |_| ());
        }
        assert!((9..=11).contains(&(voyage.feed.views.len() - 1)), "{}", voyage.feed.views.len());
        let last = voyage.feed.views[voyage.feed.views.len() - 1];
        assert!((last.velocity[0] - 100 * 256).abs() < 2000, "{}", last.velocity[0]);
    }
}
