//! One client as those of the load test: it follows a path, sends views, and asks for single chunks
//! to measure latency.

use crate::config::Plan;
use bytes::Bytes;
use load::expected::{ExpectedChunks, MAX_VIEWS};
use load::held::HeldChunks;
use load::keys::Keys;
use load::path::FlightPath;
use load::session::view_of;
use protocol::client::{ClientConfig, ClientSession, Event};
use protocol::{DataFrame, Delivery};
use rustc_hash::FxHashMap;
use std::collections::VecDeque;
use std::time::Duration;
use terrain::hash::mix;
use terrain::{ChunkKey, Land, Start};
use tokio::time::Instant;

/// Credit window, probes and their tries, as in the load test.
const WINDOW: u32 = 64;
const MAX_PROBES: usize = 64;
const PROBE_TRIES: usize = 8;
const AHEAD_S: f64 = 20.0;

/// Time between two probes.
pub const PROBE_PERIOD: Duration = Duration::from_millis(250);

/// What a frame meant for the counts.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Received {
    /// A chunk in so many bytes; with the latency if it answers a probe.
    Chunk(usize, Option<Duration>),
    /// Views are complete, after these times for the newest.
    Settled(Duration),
    /// A refusal.
    Refused,
    /// A frame that our own server must not send.
    Wrong,
    /// Anything else.
    Other,
}

/// See the module.
#[derive(Debug)]
pub struct Client {
    session: ClientSession,
    land: Land,
    path: FlightPath,
    keys: Keys,
    expected: ExpectedChunks,
    held: HeldChunks,
    /// Start of the path.
    epoch: Duration,
    view_distance_m: u32,
    period: Duration,
    next_view: u32,
    next_key: u32,
    /// Views that are not complete, oldest first, with their times.
    views: VecDeque<(u32, Duration)>,
    /// Probes without an answer.
    probes: FxHashMap<ChunkKey, Duration>,
    /// Stands for the times that the list of expected chunks counts, which are not used.
    clock: Instant,
    /// When the link has brought all that was sent.
    pub link_free: Duration,
}

impl Client {
    /// Client `index` of the plan, which connects now.
    #[must_use]
    pub fn new(plan: &Plan, land: Land, start: Start, index: u32, now: Duration) -> Self {
        let path = FlightPath::new(plan.path, plan.seed, index, start);
        let session = ClientSession::new(ClientConfig {
            digest: None,
            delivery: Delivery::Exact,
            token: None,
            software: load::SOFTWARE.into(),
            window: WINDOW,
        });
        Self {
            session,
            land,
            path,
            keys: Keys::new(plan.path, plan.seed, index, path),
            expected: ExpectedChunks::new(land, MAX_VIEWS),
            held: HeldChunks::default(),
            epoch: now,
            view_distance_m: plan.view_distance_m,
            period: Duration::from_millis(250 + u64::from(mix(index) % 250)),
            next_view: 0,
            next_key: 0,
            views: VecDeque::new(),
            probes: FxHashMap::default(),
            clock: Instant::now(),
            link_free: now,
        }
    }

    /// Time between two views.
    #[must_use]
    pub const fn period(&self) -> Duration {
        self.period
    }

    /// Frames to send now.
    pub fn sent(&mut self) -> Vec<Bytes> {
        std::iter::from_fn(|| self.session.poll_transmit()).collect()
    }

    /// Sends the view of the pose at this time.
    pub fn view(&mut self, now: Duration) {
        let pose = self.path.pose(&self.land, (now - self.epoch).as_secs_f64());
        let view = view_of(self.next_view, &pose, self.view_distance_m);
        self.views.push_back((view.id, now));
        self.next_view += 1;
        self.expected.add_view(&view);
        self.session.set_view(view);
    }

    /// Asks for a chunk ahead that no view brings.
    pub fn probe(&mut self, now: Duration) {
        if self.probes.len() >= MAX_PROBES {
            return;
        }
        let ahead_s = (now - self.epoch).as_secs_f64() + AHEAD_S;
        let candidate = (0..PROBE_TRIES)
            .map(|_| {
                self.next_key += 1;
                self.keys.key(self.next_key - 1, ahead_s)
            })
            .find(|key| {
                !self.held.contains(*key) && !self.probes.contains_key(key) && self.expected.can_request(*key)
            });
        if let Some(key) = candidate {
            let id = self.session.request(&[key]);
            self.expected.add_request(id, key, self.clock);
            self.probes.insert(key, now);
        }
    }

    /// The waits of the probes that have no answer now.
    pub fn unanswered(&self, now: Duration) -> impl Iterator<Item = Duration> {
        self.probes.values().map(move |since| now - *since)
    }

    /// Processes a frame of the server.
    pub fn receive(&mut self, frame: &Bytes, now: Duration) -> Received {
        match self.session.receive(DataFrame::Binary(frame)) {
            Ok(Event::Chunk { chunk, bytes, .. }) => {
                let key = chunk.key;
                let since = self.probes.remove(&key);
                if since.is_some() {
                    self.expected.receive(key, self.clock);
                }
                self.held.insert(key, bytes);
                if let Some(key) = self.held.release(|key| !self.expected.is_in_view(*key)) {
                    self.session.release(&[key]);
                }
                Received::Chunk(bytes, since.map(|since| now - since))
            }
            Ok(Event::Settled(settled)) => {
                self.expected.settled(settled.view);
                let mut newest = None;
                while let Some((id, since)) = self.views.front().copied()
                    && id <= settled.view
                {
                    newest = Some(since);
                    self.views.pop_front();
                }
                newest.map_or(Received::Other, |since| Received::Settled(now - since))
            }
            Ok(Event::Refused(refused)) => {
                self.expected.refused(&refused);
                if let Some(Ok(key)) = refused.key.map(protocol::message::WireKey::check) {
                    self.probes.remove(&key);
                }
                Received::Refused
            }
            Ok(Event::Welcome(_) | Event::Draining { .. }) => Received::Other,
            Err(_) => Received::Wrong,
        }
    }
}
