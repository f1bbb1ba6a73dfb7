//! Times that the work of a server and of a client takes on one processor.

use load::path::{FlightPath, PathKind};
use load::session::view_of;
use protocol::chunk_codec::{self, Effort};
use protocol::client::{ClientConfig, ClientSession};
use protocol::server::{ServerOffer, ServerSession};
use protocol::{DataFrame, Delivery};
use serde::de::Error;
use serde::{Deserialize, Deserializer, Serialize};
use std::time::{Duration, Instant};
use terrain::constants::TOP_LEVEL;
use terrain::{ChunkKey, Land};

/// Levels of chunks.
pub const LEVELS: usize = TOP_LEVEL as usize + 1;

/// Views that are measured.
const VIEWS: u32 = 64;

/// How often a chunk is timed.
const REPEATS: usize = 3;

/// Microseconds of processor time, each 0 to 60,000,000 ([`Costs::check`]).
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Costs {
    /// A chunk of each level, generated and encoded; level 0 first. A list without some levels is
    /// an error where it is read: a guess for them would pass for a measured cost.
    #[serde(deserialize_with = "of_all_levels")]
    pub chunk_us: [f64; LEVELS],
    /// A chunk of level 0 in the fast encoding.
    pub fast_chunk_us: f64,
    /// The selection of a view's chunks, whose errors are known.
    pub view_us: f64,
    /// A message of a client.
    pub receive_us: f64,
    /// A write to a client, beside its bytes.
    pub write_us: f64,
    /// A KiB of a chunk that is sent.
    pub kib_us: f64,
    /// A chunk that a client of the load test receives, decodes, verifies and counts.
    pub client_chunk_us: f64,
}

/// A list with a number for each level.
fn of_all_levels<'de, D: Deserializer<'de>>(from: D) -> Result<[f64; LEVELS], D::Error> {
    let list = Vec::deserialize(from)?;
    let length = list.len();
    let why = |_| D::Error::custom(format!("chunk_us has {length} costs in place of {LEVELS}, one a level"));
    list.try_into().map_err(why)
}

/// Largest cost in a file, microseconds: a minute.
const MAX_COST_US: f64 = 60e6;

impl Costs {
    /// Checks the range of every cost.
    ///
    /// # Errors
    /// One line: a cost is not 0 to 60,000,000 microseconds.
    pub fn check(&self) -> Result<(), String> {
        let Self { chunk_us, fast_chunk_us, view_us, receive_us, write_us, kib_us, client_chunk_us } = self;
        let single = [
            ("fast_chunk_us", fast_chunk_us),
            ("view_us", view_us),
            ("receive_us", receive_us),
            ("write_us", write_us),
            ("kib_us", kib_us),
            ("client_chunk_us", client_chunk_us),
        ];
        let mut costs = chunk_us.iter().map(|us| ("chunk_us", us)).chain(single);
        // A NaN is in no range.
        match costs.find(|(_, us)| !(0.0..=MAX_COST_US).contains(*us)) {
            None => Ok(()),
            Some((name, us)) => Err(format!("{name} is {us}; a cost is 0 to {MAX_COST_US} microseconds")),
        }
    }
}

impl Default for Costs {
    /// Of an AMD EPYC, on one of two cores that other programs used too. Chunks and views are what
    /// [`Costs::measure`] found; messages, writes and clients are what is left of the processor
    /// time of a server and of the load test with 100 flying clients (docs/scale.md).
    fn default() -> Self {
        Self {
            chunk_us: [
                28.0, 33.0, 46.0, 77.0, 148.0, 123.0, 127.0, 126.0, 136.0, 225.0, 441.0, 1133.0, 3343.0,
                5051.0, 7287.0, 7287.0, 3522.0,
            ],
            fast_chunk_us: 24.0,
            view_us: 64.0,
            receive_us: 30.0,
            write_us: 40.0,
            kib_us: 0.36,
            client_chunk_us: 100.0,
        }
    }
}

impl Costs {
    /// Of a chunk that is generated.
    #[must_use]
    pub fn chunk(&self, key: ChunkKey, effort: Effort) -> Duration {
        let us = match effort {
            Effort::Fast => self.fast_chunk_us,
            Effort::Compact => self.chunk_us[usize::from(key.level())],
        };
        micros(us)
    }

    /// The mean times of this machine for what the crates of the protocol and the land do, over the
    /// views of a flight and their chunks. What needs sockets keeps its built-in value.
    #[must_use]
    pub fn measure(world_seed: u64) -> Self {
        let land = Land::new(world_seed);
        let flight = Flight::new(land);
        let (world, mut costs) = (land.digest(), Self::default());
        let encoded = |keys: &[ChunkKey], effort| {
            let make = |key| chunk_codec::encode_with(Delivery::Exact, effort, &land.chunk(key), &world);
            mean(keys.iter().map(|key| timed(|| make(*key))))
        };
        for level in 0..=TOP_LEVEL {
            let mut keys: Vec<_> = flight.chunks.iter().filter(|key| key.level() == level).copied().collect();
            if keys.is_empty() {
                // Those around the start, where the flight needs none.
                let key = ChunkKey::containing(level, land.start().x, land.start().z);
                let around = (-2..=2).flat_map(|z| (-2..=2).map(move |x| (x, z)));
                keys.extend(around.filter_map(|(x, z)| key.neighbour(x, z)));
            }
            let before = costs.chunk_us[usize::from(level)];
            costs.chunk_us[usize::from(level)] = encoded(&keys, Effort::Compact).unwrap_or(before);
        }
        let fine: Vec<_> = flight.chunks.iter().filter(|key| key.level() == 0).copied().collect();
        costs.fast_chunk_us = encoded(&fine, Effort::Fast).unwrap_or(costs.fast_chunk_us);
        costs.view_us = mean(flight.view_us.into_iter()).unwrap_or(costs.view_us);
        costs
    }
}

/// What one client needs on its path, with the times of its views.
struct Flight {
    chunks: Vec<ChunkKey>,
    view_us: Vec<f64>,
}

impl Flight {
    fn new(land: Land) -> Self {
        let mut flight = Self { chunks: Vec::new(), view_us: Vec::new() };
        // The second time errors of chunks are known, which a server measures once.
        (0..2).for_each(|_| flight.fly(land));
        flight
    }

    fn fly(&mut self, land: Land) {
        *self = Self { chunks: Vec::new(), view_us: Vec::new() };
        let offer = ServerOffer { land, digest: land.digest(), token: None, software: String::new() };
        let mut server = ServerSession::new(offer.clone(), 1);
        let mut client = ClientSession::new(ClientConfig {
            digest: None,
            delivery: Delivery::Exact,
            token: None,
            software: String::new(),
            window: 64,
        });
        let path = FlightPath::new(PathKind::Fly, 1, 0, land.start());
        for id in 0..VIEWS {
            client.set_view(view_of(id, &path.pose(&land, f64::from(id) / 3.0), 2000));
            exchange(&mut client, &mut server);
            let Some(mut view) = server.take_view() else { continue };
            let started = Instant::now();
            while !view.step(&land, 256) {}
            self.view_us.push(started.elapsed().as_secs_f64() * 1e6);
            server.apply_view(view);
            while let Some((request, _)) = server.next_chunk() {
                self.chunks.push(request.key);
                server.deliver(request, chunk_codec::encode(&land.chunk(request.key), &offer.digest));
                exchange(&mut client, &mut server);
            }
        }
    }
}

/// Messages both ways. Both ends are ours, and what they send is valid.
fn exchange(client: &mut ClientSession, server: &mut ServerSession) {
    while let Some(frame) = server.poll_transmit() {
        let _ = client.receive(DataFrame::Binary(&frame));
    }
    while let Some(frame) = client.poll_transmit() {
        let _ = server.receive(DataFrame::Binary(&frame));
    }
}

/// The shortest of several times that some work took, microseconds: other programs only add to it.
fn timed<T>(mut work: impl FnMut() -> T) -> f64 {
    let once = |_| {
        let started = Instant::now();
        let _done = std::hint::black_box(work());
        started.elapsed().as_secs_f64() * 1e6
    };
    (0..REPEATS).map(once).fold(f64::INFINITY, f64::min)
}

/// The mean without the largest fiftieth, which are interruptions; none of no times.
fn mean(times: impl Iterator<Item = f64>) -> Option<f64> {
    let mut times: Vec<f64> = times.collect();
    times.sort_by(f64::total_cmp);
    times.truncate(times.len() - times.len() / 50);
    (!times.is_empty()).then(|| times.iter().sum::<f64>() / times.len() as f64)
}

/// A duration of microseconds; none of an invalid number.
#[must_use]
pub fn micros(us: f64) -> Duration {
    Duration::try_from_secs_f64(us / 1e6).unwrap_or_default()
}
