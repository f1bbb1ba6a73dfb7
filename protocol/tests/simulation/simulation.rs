//! The events of one simulation, in virtual time: clients, links, one server, faults.

use crate::client::Client;
use crate::generation::{Generation, MAX_JOBS};
use crate::link::Link;
use crate::plant::Plant;
use crate::server::ServerEnd;
use crate::truth;
use protocol::message::RefusalReason;
use protocol::{DataFrame, limits};
use std::cmp::Reverse;
use std::collections::{BTreeMap, BTreeSet, BinaryHeap};
use terrain::ChunkKey;
use test_support::Random;

/// Clients of a simulation.
const CLIENTS: u32 = 4;

/// When faults and random actions end, milliseconds.
const FAULTS_END: u64 = 12_000;

/// By then every view is complete.
const END: u64 = FAULTS_END + 60_000;

/// Frames that wait for the client beyond which a session is not read.
const BACKLOG: usize = 64;

/// Most frames that may wait: the backlog, the answers to one message, chunks in generation, and
/// one batch.
const MAX_BACKLOG: usize = BACKLOG + limits::MAX_KEYS + 16 + 16 + 8;

/// An event at a time.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
enum Event {
    Connect(u32),
    Act(u32),
    LookAgain(u32),
    ToServer(u32),
    ToClient(u32),
    Selected(u32),
    Generated(u64),
    Fault,
    LastView(u32),
    LastCancel(u32),
}

/// One connection.
#[derive(Debug)]
struct Connection {
    client: u32,
    up: Link,
    down: Link,
    server: ServerEnd,
}

pub struct Simulation {
    now: u64,
    order: u64,
    events: BinaryHeap<Reverse<(u64, u64, Event)>>,
    random: Random,
    plant: Plant,
    clients: Vec<Client>,
    connections: BTreeMap<u32, Connection>,
    next_connection: u32,
    generation: Generation,
    cached: BTreeSet<(ChunkKey, &'static str)>,
    slow_until: u64,
    failing_until: u64,
    trace: blake3::Hasher,
}

/// Runs the simulation of a seed. Returns the digest of all its events.
///
/// # Errors
/// A violated invariant, with the time.
pub fn run(seed: u64, plant: Plant) -> Result<String, String> {
    let mut random = Random(seed);
    let clients = (0..CLIENTS).map(|number| Client::new(number, &mut random)).collect();
    let mut simulation = Simulation {
        now: 0,
        order: 0,
        events: BinaryHeap::new(),
        random,
        plant,
        clients,
        connections: BTreeMap::new(),
        next_connection: 0,
        generation: Generation::default(),
        cached: BTreeSet::new(),
        slow_until: 0,
        failing_until: 0,
        trace: blake3::Hasher::new(),
    };
    for client in 0..CLIENTS {
        let start = simulation.random.ms(0..300);
        simulation.at(start, Event::Connect(client));
        simulation.at(start + 1, Event::Act(client));
        simulation.at(FAULTS_END + 1, Event::LastView(client));
    }
    simulation.at(500, Event::Fault);
    simulation.run().map_err(|error| format!("at {} ms: {error}", simulation.now))?;
    Ok(simulation.trace.finalize().to_hex().to_string())
}

impl Simulation {
    fn at(&mut self, time: u64, event: Event) {
        self.order += 1;
        self.events.push(Reverse((time.max(self.now), self.order, event)));
    }

    fn run(&mut self) -> Result<(), String> {
        while let Some(Reverse((time, _, event))) = self.events.pop() {
            self.now = time;
            if time > END {
                return Err("events go on long after the last action".into());
            }
            self.trace.update(format!("{time} {event:?};").as_bytes());
            self.perform(event)?;
        }
        for (number, client) in self.clients.iter().enumerate() {
            client.check_complete().map_err(|error| format!("client {number} at rest: {error}"))?;
        }
        Ok(())
    }

    fn perform(&mut self, event: Event) -> Result<(), String> {
        match event {
            Event::Connect(client) => self.connect(client)?,
            Event::Act(client) if self.now < FAULTS_END => {
                self.clients[client as usize].act(&mut self.random);
                let next = self.now + self.random.ms(20..600);
                self.at(next, Event::Act(client));
                self.send_up(client);
            }
            Event::Act(_) => {}
            Event::LastView(client) => {
                let cancels = self.now + self.random.ms(1..300);
                self.clients[client as usize].look(&mut self.random);
                self.clients[client as usize].request_needed(&mut self.random);
                self.at(cancels, Event::LastCancel(client));
                self.send_up(client);
            }
            Event::LastCancel(client) => {
                self.clients[client as usize].cancel_last();
                self.send_up(client);
            }
            Event::LookAgain(client) => {
                self.clients[client as usize].look_again();
                self.send_up(client);
            }
            Event::ToServer(number) => self.read(number)?,
            Event::ToClient(number) => self.arrive(number)?,
            Event::Selected(number) => {
                if let Some(connection) = self.connections.get_mut(&number)
                    && let Some(selection) = connection.server.selection.take()
                {
                    connection.server.session.apply_view(selection);
                    self.pump(number)?;
                }
            }
            Event::Generated(job) => self.generated(job)?,
            Event::Fault => self.fault(),
        }
        Ok(())
    }

    fn connect(&mut self, client: u32) -> Result<(), String> {
        let number = self.next_connection;
        self.next_connection += 1;
        let mut link = || Link::new(self.random.ms(1..120));
        let (up, down) = (link(), link());
        self.connections.insert(number, Connection { client, up, down, server: ServerEnd::new(number) });
        self.clients[client as usize].connect(self.plant);
        self.send_up(client);
        Ok(())
    }

    /// The number of a client's connection.
    fn connection_of(&self, client: u32) -> Option<u32> {
        self.connections.iter().find(|(_, connection)| connection.client == client).map(|(number, _)| *number)
    }

    /// Sends what a client has to send.
    fn send_up(&mut self, client: u32) {
        let Some(number) = self.connection_of(client) else { return };
        while let Some(frame) = self.clients[client as usize].poll_transmit() {
            let connection = self.connections.get_mut(&number).expect("found above");
            let at = connection.up.send(self.now, frame);
            self.at(at, Event::ToServer(number));
        }
    }

    /// The server reads one frame, unless too much waits to be written.
    fn read(&mut self, number: u32) -> Result<(), String> {
        let Some(connection) = self.connections.get_mut(&number) else { return Ok(()) };
        if connection.down.len() > BACKLOG && self.plant != Plant::NoBackpressure {
            // Read when the client has received something.
            return Ok(());
        }
        let Some(frame) = connection.up.receive(self.now) else {
            // Delayed by a stall.
            if let Some(at) = connection.up.next_arrival() {
                self.at(at, Event::ToServer(number));
            }
            return Ok(());
        };
        let session = &mut connection.server.session;
        session.receive(DataFrame::Binary(&frame)).map_err(|fault| format!("the server: {fault}"))?;
        let waiting = session.waiting_requests();
        if waiting > limits::MAX_PENDING_REQUESTS || session.credits() > limits::MAX_CREDITS {
            return Err(format!("{waiting} requests wait, {} credits", session.credits()));
        }
        self.pump(number)
    }

    /// The next frame reaches the client.
    fn arrive(&mut self, number: u32) -> Result<(), String> {
        let Some(connection) = self.connections.get_mut(&number) else { return Ok(()) };
        let Some(frame) = connection.down.receive(self.now) else {
            if let Some(at) = connection.down.next_arrival() {
                self.at(at, Event::ToClient(number));
            }
            return Ok(());
        };
        let client = connection.client;
        self.trace.update(&frame[..frame.len().min(60)]);
        let (client, number_of_client) = (&mut self.clients[client as usize], client);
        client.receive(&frame).map_err(|error| format!("client {number_of_client}: {error}"))?;
        if std::mem::take(&mut client.wants_view_again) {
            self.at(self.now + 150, Event::LookAgain(number_of_client));
        }
        self.send_up(number_of_client);
        // The session may be read again.
        self.at(self.now, Event::ToServer(number));
        self.pump(number)
    }

    /// Lets a session go on, and sends what it has.
    fn pump(&mut self, number: u32) -> Result<(), String> {
        let Some(connection) = self.connections.get_mut(&number) else { return Ok(()) };
        if connection.down.len() > BACKLOG && self.plant != Plant::NoBackpressure {
            return Ok(());
        }
        let round = connection.server.run(number, &mut self.generation, &self.cached, self.plant);
        for frame in round.frames {
            let is_twice = self.plant == Plant::FrameTwice && self.random.percent(2);
            let connection = self.connections.get_mut(&number).expect("found above");
            for _ in 0..=u32::from(is_twice) {
                let at = connection.down.send(self.now, frame.clone());
                self.order += 1;
                self.events.push(Reverse((at, self.order, Event::ToClient(number))));
            }
            if connection.down.len() > MAX_BACKLOG {
                return Err(format!("{} frames wait for one client", connection.down.len()));
            }
        }
        if round.begins_selection {
            let takes = self.random.ms(1..30);
            self.at(self.now + takes, Event::Selected(number));
        }
        self.start_jobs();
        if self.generation.len() > MAX_JOBS {
            return Err(format!("{} jobs", self.generation.len()));
        }
        if self.generation.has_duplicate() {
            return Err("two jobs generate one chunk".into());
        }
        Ok(())
    }

    fn start_jobs(&mut self) {
        let slowness = if self.now < self.slow_until { 20 } else { 1 };
        for (job, takes) in self.generation.start(&mut self.random, slowness) {
            self.at(self.now + takes, Event::Generated(job));
        }
    }

    fn generated(&mut self, job: u64) -> Result<(), String> {
        let Some(mut done) = self.generation.finish(job) else { return Ok(()) };
        let has_failed = self.now < self.failing_until && self.random.percent(30);
        if !has_failed && self.random.percent(90) {
            self.cached.insert((done.key, done.delivery.name()));
        }
        if self.plant == Plant::LostWaiter && done.waiters.len() > 1 {
            done.waiters.pop();
        }
        for (number, request) in done.waiters {
            let Some(connection) = self.connections.get_mut(&number) else { continue };
            connection.server.in_generation -= 1;
            if has_failed && self.plant == Plant::LostFailure {
                continue;
            }
            if has_failed {
                connection.server.session.fail(request, RefusalReason::Failed, "a fault");
            } else {
                let is_crossed = self.plant == Plant::CrossTalk && self.random.percent(3);
                let key = if is_crossed { neighbour(done.key) } else { done.key };
                connection.server.session.deliver(request, truth::frame(key, done.delivery));
            }
            self.pump(number)?;
        }
        self.start_jobs();
        Ok(())
    }

    /// One random fault, and the time of the next.
    fn fault(&mut self) {
        if self.now >= FAULTS_END {
            return;
        }
        let numbers: Vec<u32> = self.connections.keys().copied().collect();
        let lasts = self.random.ms(100..3000);
        let chosen = numbers.get(self.random.below(numbers.len().max(1))).copied().unwrap_or_default();
        match self.random.below(8) {
            0 | 1 if !numbers.is_empty() => self.cut(chosen),
            2 | 3 if !numbers.is_empty() => {
                let (until, is_up) = (self.now + lasts, self.random.percent(30));
                let connection = self.connections.get_mut(&chosen).expect("a present connection");
                let link = if is_up { &mut connection.up } else { &mut connection.down };
                link.stalled_until = until;
            }
            4 => self.slow_until = self.now + lasts,
            5 => self.failing_until = self.now + lasts,
            6 => {
                // A restart: nothing but the chunks on disk survives.
                self.generation = Generation::restarted(&self.generation);
                self.cached.retain(|(key, _)| key.level() > 1);
                numbers.iter().for_each(|number| self.cut(*number));
            }
            7 => {
                for number in &numbers {
                    let connection = self.connections.get_mut(number).expect("a present connection");
                    connection.server.session.drain(100);
                }
                self.generation = Generation::restarted(&self.generation);
                numbers.iter().for_each(|number| self.cut(*number));
            }
            _ => {}
        }
        let next = self.now + self.random.ms(100..1500);
        self.at(next, Event::Fault);
    }

    /// Ends a connection. Frames in transit are lost, and the client connects again.
    fn cut(&mut self, number: u32) {
        let Some(connection) = self.connections.remove(&number) else { return };
        let delay = self.clients[connection.client as usize].lose();
        self.at(self.now + delay, Event::Connect(connection.client));
    }
}

/// Another chunk of the same level.
fn neighbour(key: ChunkKey) -> ChunkKey {
    ChunkKey::new(key.level(), key.x() ^ 1, key.z()).unwrap_or(key)
}
