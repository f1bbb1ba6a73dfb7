//! One replica with its clients: events in the order of their virtual times.

use crate::client::{Client, PROBE_PERIOD, Received};
use crate::config::Plan;
use crate::costs::micros;
use crate::frames::Frames;
use crate::generation::{Queue, Turn, Waiting};
use crate::processors::{Begun, Processors};
use crate::report::Report;
use bytes::Bytes;
use load::session::MIN_ABANDONED_WAIT;
use protocol::DataFrame;
use protocol::chunk_codec::{Effort, MAGIC};
use protocol::message::RefusalReason;
use protocol::server::{Next, ServerOffer, ServerSession, ViewSelection};
use rustc_hash::{FxHashMap, FxHasher};
use std::cmp::Ordering;
use std::collections::{BinaryHeap, VecDeque};
use std::hash::{Hash, Hasher};
use std::time::Duration;
use terrain::{ChunkKey, Start};

/// Chunks of a session in generation: as in the server.
const JOB_WINDOW: usize = 16;

/// Cached chunks before a write: likewise.
const BATCH: usize = 64;

/// Longest wait of a requested chunk: likewise.
const DEADLINE: Duration = Duration::from_millis(500);

/// The backlog from which level 0 is encoded fast: likewise.
const FAST_FROM: Duration = Duration::from_millis(4);

/// Window of the moving average of the costs of jobs: one job weighs 1/32.
const MEAN_WINDOW: f64 = 32.0;

/// Frames that a client of the load test processes before it lets others go on.
const CLIENT_STEP: usize = 16;

/// Time between the connections of two clients, unless the run is short: as in the load test.
const RAMP_STEP: Duration = Duration::from_millis(10);

/// Delays of the network between the start of a connection and the first message at the server, and
/// the Welcome at the client.
const HANDSHAKE: [u32; 2] = [3, 4];

#[derive(Debug)]
enum Event {
    Connect(usize),
    View(usize),
    Probe(usize),
    AtServer(usize, Vec<Bytes>),
    AtClient(usize, Vec<Bytes>),
    Done(Work),
    Selected(usize, Box<ViewSelection>),
    Made(Vec<(ChunkKey, Effort)>),
}

/// What a processor does beside generation.
#[derive(Debug)]
enum Work {
    Receive(usize, Vec<Bytes>),
    Write(usize, Vec<Bytes>),
    Client(usize, Vec<Bytes>),
}

/// The server's side of a session.
#[derive(Debug)]
struct Session {
    machine: ServerSession,
    in_flight: usize,
    is_writing: bool,
    /// There may be more to send after the write.
    has_more: bool,
    inbox: Inbox,
}

/// Frames of one session in their order: two processors must not handle them at once.
#[derive(Debug, Default)]
struct Inbox {
    frames: VecDeque<Bytes>,
    is_busy: bool,
}

impl Inbox {
    /// Adds frames. The next ones to handle, unless a processor is at it.
    fn add(&mut self, frames: Vec<Bytes>, most: usize) -> Option<Vec<Bytes>> {
        self.frames.extend(frames);
        if self.is_busy { None } else { self.next(most) }
    }

    /// After the last ones were handled: the next.
    fn next(&mut self, most: usize) -> Option<Vec<Bytes>> {
        self.is_busy = !self.frames.is_empty();
        self.is_busy.then(|| self.frames.drain(..most.min(self.frames.len())).collect())
    }
}

/// An event with its time; among equal times the earlier scheduled one comes first.
#[derive(Debug)]
struct Scheduled {
    at: Duration,
    number: u64,
    event: Event,
}

impl PartialEq for Scheduled {
    fn eq(&self, other: &Self) -> bool {
        self.number == other.number
    }
}

impl Eq for Scheduled {}

impl PartialOrd for Scheduled {
    fn partial_cmp(&self, other: &Self) -> Option<Ordering> {
        Some(self.cmp(other))
    }
}

impl Ord for Scheduled {
    /// Reversed: a heap gives the largest first.
    fn cmp(&self, other: &Self) -> Ordering {
        (other.at, other.number).cmp(&(self.at, self.number))
    }
}

/// See the module.
#[derive(Debug)]
pub struct Replica<'a> {
    plan: &'a Plan,
    frames: &'a Frames,
    start: Start,
    offer: ServerOffer,
    /// Index of its first client in the plan.
    first: u32,
    now: Duration,
    events: BinaryHeap<Scheduled>,
    number: u64,
    clients: Vec<Option<Client>>,
    /// Where the clients' work takes time: what they have not handled.
    at_clients: Vec<Inbox>,
    sessions: Vec<Option<Session>>,
    queue: Queue,
    processors: Processors<Work>,
    /// Chunks that it has made, with their encoding. Never evicted.
    cached: FxHashMap<ChunkKey, Effort>,
    /// Mean cost of a job.
    mean: Duration,
    report: Report,
}

impl<'a> Replica<'a> {
    /// Replica `number` of a plan.
    #[must_use]
    pub fn new(plan: &'a Plan, frames: &'a Frames, start: Start, number: u32) -> Self {
        let first = number * plan.clients_per_replica;
        let n = plan.clients_per_replica.min(plan.clients - first);
        let mut replica = Self {
            plan,
            frames,
            start,
            offer: ServerOffer {
                land: frames.land(),
                digest: frames.world(),
                token: None,
                software: "tombolo-simulate".into(),
            },
            first,
            now: Duration::ZERO,
            events: BinaryHeap::new(),
            number: 0,
            clients: std::iter::repeat_with(|| None).take(n as usize).collect(),
            at_clients: std::iter::repeat_with(Inbox::default).take(n as usize).collect(),
            sessions: std::iter::repeat_with(|| None).take(n as usize).collect(),
            queue: Queue::default(),
            processors: Processors::new(plan.processors),
            cached: FxHashMap::default(),
            mean: Duration::from_micros(100),
            report: Report { clients: n.into(), replicas: 1, ..Report::default() },
        };
        let step = RAMP_STEP.min(plan.length / 5 / n.max(1));
        (0..n).for_each(|index| replica.at(step * index, Event::Connect(index as usize)));
        replica
    }

    /// Runs to the end of the plan.
    #[must_use]
    pub fn run(mut self) -> Report {
        while let Some(Scheduled { at, event, .. }) = self.events.pop()
            && at <= self.plan.length
        {
            self.now = at;
            self.report.events += 1;
            self.handle(event);
            self.begin_work();
        }
        self.count_unanswered();
        self.report
    }

    /// Counts probes without an answer at the end, as the load test does: the latest are cut off by
    /// the end, older ones wait for a server that is slow.
    fn count_unanswered(&mut self) {
        for wait in self.clients.iter().flatten().flat_map(|client| client.unanswered(self.plan.length)) {
            self.report.unanswered += 1;
            if wait >= MIN_ABANDONED_WAIT {
                self.report.latency.record(wait);
            }
        }
    }

    fn at(&mut self, at: Duration, event: Event) {
        self.events.push(Scheduled { at, number: self.number, event });
        self.number += 1;
    }

    fn after(&mut self, delay: Duration, event: Event) {
        self.at(self.now + delay, event);
    }

    fn handle(&mut self, event: Event) {
        let (kind, index) = match &event {
            Event::Connect(index) => (0, *index),
            Event::View(index) => (1, *index),
            Event::Probe(index) => (2, *index),
            Event::AtServer(index, _) => (3, *index),
            Event::AtClient(index, _) => (4, *index),
            Event::Done(Work::Receive(index, _)) => (5, *index),
            Event::Done(Work::Write(index, _)) => (6, *index),
            Event::Done(Work::Client(index, _)) => (7, *index),
            Event::Selected(index, _) => (8, *index),
            Event::Made(keys) => (9, keys.len()),
        };
        let mut trace = FxHasher::default();
        (self.report.trace, self.now.as_nanos() as u64, kind, index).hash(&mut trace);
        self.report.trace = trace.finish();
        match event {
            Event::Connect(index) => self.connect(index),
            Event::View(index) => {
                if let Some(client) = &mut self.clients[index] {
                    client.view(self.now);
                    let period = client.period();
                    self.send(index);
                    self.after(period, Event::View(index));
                }
            }
            Event::Probe(index) => {
                if let Some(client) = &mut self.clients[index] {
                    client.probe(self.now);
                    self.send(index);
                    self.after(PROBE_PERIOD, Event::Probe(index));
                }
            }
            Event::AtServer(index, frames) => {
                if let Some(session) = &mut self.sessions[index]
                    && let Some(frames) = session.inbox.add(frames, usize::MAX)
                {
                    self.processors.add(Work::Receive(index, frames));
                }
            }
            Event::AtClient(index, frames) if self.plan.is_shared => {
                if let Some(frames) = self.at_clients[index].add(frames, CLIENT_STEP) {
                    self.processors.add(Work::Client(index, frames));
                }
            }
            Event::AtClient(index, frames) => self.receive_at_client(index, &frames),
            Event::Done(work) => {
                self.processors.end();
                match work {
                    Work::Receive(index, frames) => {
                        self.receive(index, &frames);
                        let session = self.sessions[index].as_mut();
                        if let Some(frames) = session.and_then(|session| session.inbox.next(usize::MAX)) {
                            self.processors.add(Work::Receive(index, frames));
                        }
                    }
                    Work::Write(index, frames) => self.written(index, frames),
                    Work::Client(index, frames) => {
                        self.receive_at_client(index, &frames);
                        if let Some(frames) = self.at_clients[index].next(CLIENT_STEP) {
                            self.processors.add(Work::Client(index, frames));
                        }
                    }
                }
            }
            Event::Selected(index, view) => {
                self.processors.end_turn();
                self.select(index, *view);
            }
            Event::Made(keys) => {
                self.processors.end_turn();
                self.made(&keys);
            }
        }
    }

    fn connect(&mut self, index: usize) {
        let land = self.frames.land();
        let number = self.first + index as u32;
        self.clients[index] = Some(Client::new(self.plan, land, self.start, number, self.now));
        let machine = ServerSession::new(self.offer.clone(), number.into());
        let inbox = Inbox::default();
        self.sessions[index] =
            Some(Session { machine, in_flight: 0, is_writing: false, has_more: false, inbox });
        let [at_server, at_client] = HANDSHAKE.map(|delays| self.plan.delay * delays);
        let frames = self.clients[index].as_mut().map(Client::sent).unwrap_or_default();
        self.after(at_server, Event::AtServer(index, frames));
        self.after(at_client, Event::View(index));
        self.after(at_client.max(PROBE_PERIOD / 2), Event::Probe(index));
    }

    /// Sends what a client has to send.
    fn send(&mut self, index: usize) {
        let frames = self.clients[index].as_mut().map(Client::sent).unwrap_or_default();
        if !frames.is_empty() {
            self.after(self.plan.delay, Event::AtServer(index, frames));
        }
    }

    fn receive_at_client(&mut self, index: usize, frames: &[Bytes]) {
        let Some(client) = &mut self.clients[index] else { return };
        for frame in frames {
            match client.receive(frame, self.now) {
                Received::Chunk(bytes, latency) => {
                    self.report.chunks += 1;
                    self.report.bytes += bytes as u64;
                    latency.into_iter().for_each(|latency| self.report.latency.record(latency));
                }
                Received::Settled(took) => {
                    self.report.settled += 1;
                    self.report.settling.record(took);
                }
                Received::Refused => self.report.refused += 1,
                Received::Wrong => self.report.wrong += 1,
                Received::Other => {}
            }
        }
        self.send(index);
    }

    /// Handles the messages of a client.
    fn receive(&mut self, index: usize, frames: &[Bytes]) {
        let allowance = self.allowance();
        let Some(session) = &mut self.sessions[index] else { return };
        let admitted = session.machine.waiting_requests();
        for frame in frames {
            self.report.wrong += u64::from(session.machine.receive(DataFrame::Binary(frame)).is_err());
        }
        self.cancel_stale(index);
        self.pump(index);
        let Some(session) = &mut self.sessions[index] else { return };
        if session.in_flight >= JOB_WINDOW {
            session.machine.shed(allowance.max(admitted));
            self.pump(index);
        }
    }

    /// Requests that generation can finish for each flow within half of the deadline.
    fn allowance(&self) -> usize {
        let share = DEADLINE.as_secs_f64() / 2.0 * self.plan.processors as f64;
        (share / self.mean.as_secs_f64() / self.queue.flows().max(1) as f64) as usize
    }

    fn cancel_stale(&mut self, index: usize) {
        let Some(session) = &mut self.sessions[index] else { return };
        for key in session.machine.take_stale() {
            if let Some(request) = self.queue.cancel(index, key) {
                session.in_flight -= 1;
                session.machine.withdraw(request);
            }
        }
    }

    /// Requests chunks and begins a write, as a round of the server's loop.
    fn pump(&mut self, index: usize) {
        let Self { sessions, queue, cached, frames, now, .. } = self;
        let Some(session) = &mut sessions[index] else { return };
        if session.is_writing {
            session.has_more = true;
            return;
        }
        if let Some(view) = session.machine.take_view() {
            queue.add_view(index, view);
        }
        let (mut batch, mut has_more) = (0, false);
        while session.in_flight < JOB_WINDOW {
            if batch == BATCH {
                has_more = true;
                break;
            }
            let ready = |key, _| cached.get(&key).map(|effort| frames.get(key, *effort));
            match session.machine.next_chunk_with(ready) {
                Next::Nothing => break,
                Next::Delivered => batch += 1,
                Next::Generate(request, _) => {
                    session.in_flight += 1;
                    queue.add(Waiting { session: index, request, since: *now });
                }
            }
        }
        let written: Vec<_> = std::iter::from_fn(|| session.machine.poll_transmit()).collect();
        if !written.is_empty() {
            (session.is_writing, session.has_more) = (true, has_more);
            self.processors.add(Work::Write(index, written));
        }
    }

    /// A write has ended: the link brings its bytes.
    fn written(&mut self, index: usize, frames: Vec<Bytes>) {
        let (Some(client), Some(session)) = (&mut self.clients[index], &mut self.sessions[index]) else {
            return;
        };
        let bytes: usize = frames.iter().map(Bytes::len).sum();
        let on_link = Duration::from_secs_f64(bytes as f64 / self.plan.link_bytes_per_s);
        client.link_free = client.link_free.max(self.now) + on_link;
        session.is_writing = false;
        let (at, has_more) = (client.link_free + self.plan.delay, session.has_more);
        self.at(at, Event::AtClient(index, frames));
        if has_more {
            self.pump(index);
        }
    }

    /// Applies a view. Its chunks are selected here, for real; the time that this takes was
    /// counted.
    fn select(&mut self, index: usize, mut view: ViewSelection) {
        let Some(session) = &mut self.sessions[index] else { return };
        while !view.step(&self.offer.land, 4096) {}
        session.machine.apply_view(view);
        self.report.views += 1;
        self.cancel_stale(index);
        self.pump(index);
    }

    /// Delivers chunks that were made.
    fn made(&mut self, keys: &[(ChunkKey, Effort)]) {
        let mut touched = Vec::new();
        for (key, effort) in keys {
            self.cached.insert(*key, *effort);
            self.report.made += 1;
            let frame = self.frames.get(*key, *effort);
            for waiting in self.queue.made(*key) {
                if let Some(session) = &mut self.sessions[waiting.session] {
                    session.in_flight -= 1;
                    session.machine.deliver(waiting.request, frame.clone());
                    touched.push(waiting.session);
                }
            }
        }
        touched.sort_unstable();
        touched.dedup();
        touched.into_iter().for_each(|index| self.pump(index));
    }

    fn begin_work(&mut self) {
        while let Some(begun) = self.processors.begin(self.queue.has_work()) {
            match begun {
                Begun::Work(work) => {
                    let cost = self.cost(&work);
                    self.report.processor_s += cost.as_secs_f64();
                    if matches!(work, Work::Client(..)) {
                        self.report.client_s += cost.as_secs_f64();
                    }
                    self.after(cost, Event::Done(work));
                }
                Begun::Turn => self.begin_turn(),
            }
        }
    }

    fn begin_turn(&mut self) {
        let costs = &self.plan.costs;
        let backlog = self.mean * self.queue.queued() as u32 / self.plan.processors as u32;
        let effort = |key: ChunkKey| {
            if key.level() == 0 && backlog > FAST_FROM { Effort::Fast } else { Effort::Compact }
        };
        let (turn, expired) = self.queue.turn(self.now, DEADLINE, |key| costs.chunk(key, effort(key)));
        for waiting in expired {
            if let Some(session) = &mut self.sessions[waiting.session] {
                session.in_flight -= 1;
                session.machine.fail(waiting.request, RefusalReason::Overloaded, "too late");
                self.pump(waiting.session);
            }
        }
        let (cost, event) = match turn {
            None => return self.processors.end_turn(),
            Some(Turn::View(index, view)) => (micros(costs.view_us), Event::Selected(index, view)),
            Some(Turn::Chunks(keys)) => {
                let keys: Vec<_> = keys.into_iter().map(|key| (key, effort(key))).collect();
                for (key, effort) in &keys {
                    let part = costs.chunk(*key, *effort).as_secs_f64() - self.mean.as_secs_f64();
                    self.mean = micros((self.mean.as_secs_f64() + part / MEAN_WINDOW) * 1e6);
                }
                let cost = keys.iter().map(|(key, effort)| costs.chunk(*key, *effort)).sum();
                (cost, Event::Made(keys))
            }
        };
        self.report.processor_s += cost.as_secs_f64();
        self.after(cost, event);
    }

    fn cost(&self, work: &Work) -> Duration {
        let costs = &self.plan.costs;
        micros(match work {
            Work::Receive(_, frames) => costs.receive_us * frames.len() as f64,
            Work::Write(_, frames) => {
                let bytes: usize = frames.iter().map(Bytes::len).sum();
                costs.write_us + costs.kib_us * bytes as f64 / 1024.0
            }
            Work::Client(_, frames) => {
                let chunks = frames.iter().filter(|frame| frame.starts_with(&MAGIC)).count();
                costs.client_chunk_us * chunks as f64
            }
        })
    }
}
