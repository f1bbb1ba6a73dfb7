//! Times that the work of a server and of a client takes on one processor.

use load::path::{FlightPath, PathKind};
use load::session::view_of;
use protocol::chunk_codec::{self, Effort};
use protocol::client::{ClientConfig, ClientSession};
use protocol::server::{ServerOffer, ServerSession};
use protocol::{DataFrame, Delivery};
use serde::{Deserialize, Serialize};
use std::time::{Duration, Instant};
use terrain::constants::TOP_LEVEL;
use terrain::{ChunkKey, Land};

/// Chunks of one level that are measured.
const SAMPLES: i32 = 24;

/// Views that are measured.
const VIEWS: u32 = 64;

/// Microseconds of processor time.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Costs {
    /// A chunk of each level, generated and encoded; level 0 first.
    pub chunk_us: Vec<f64>,
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
    /// A chunk that a client of the load test decodes, verifies and counts.
    pub client_chunk_us: f64,
}

impl Default for Costs {
    /// Measured; see docs/scale.md.
    fn default() -> Self {
        let mut chunk_us = vec![1000.0; usize::from(TOP_LEVEL) + 1];
        chunk_us[0] = 200.0;
        Self {
            chunk_us,
            fast_chunk_us: 150.0,
            view_us: 400.0,
            receive_us: 6.0,
            write_us: 12.0,
            kib_us: 0.36,
            client_chunk_us: 120.0,
        }
    }
}

impl Costs {
    /// Of a chunk that is generated.
    #[must_use]
    pub fn chunk(&self, key: ChunkKey, effort: Effort) -> Duration {
        let us = match effort {
            Effort::Fast => self.fast_chunk_us,
            Effort::Compact => self.chunk_us.get(usize::from(key.level())).copied().unwrap_or(1000.0),
        };
        micros(us)
    }

    /// The median times of this machine for what the crates of the protocol and the land do. What
    /// only a server with its sockets does keeps its built-in value.
    #[must_use]
    pub fn measure(world_seed: u64) -> Self {
        let (land, mut costs) = (Land::new(world_seed), Self::default());
        let world = land.digest();
        for level in 0..=TOP_LEVEL {
            let keys = (-SAMPLES / 2..SAMPLES / 2).filter_map(|n| ChunkKey::new(level, n, 1 - n).ok());
            let timed = keys.map(|key| {
                timed(|| chunk_codec::encode_with(Delivery::Exact, Effort::Compact, &land.chunk(key), &world))
            });
            costs.chunk_us[usize::from(level)] = median(timed.collect());
        }
        let fine = (0..SAMPLES).filter_map(|n| ChunkKey::new(0, n, -n).ok()).collect::<Vec<_>>();
        let fast = fine.iter().map(|key| {
            timed(|| chunk_codec::encode_with(Delivery::Exact, Effort::Fast, &land.chunk(*key), &world))
        });
        costs.fast_chunk_us = median(fast.collect());
        costs.view_us = median(views(land));
        costs.client_chunk_us = median(decoded(land, &fine));
        costs
    }
}

/// Times of the selection of views along a path, each a second time: the first measures errors.
fn views(land: Land) -> Vec<f64> {
    let offer = ServerOffer { land, digest: land.digest(), token: None, software: String::new() };
    let path = FlightPath::new(PathKind::Fly, 1, 0, land.start());
    let select = |id: u32| {
        let (mut server, mut client) = welcomed(&offer);
        client.set_view(view_of(id, &path.pose(&land, f64::from(id) / 3.0), 2000));
        exchange(&mut client, &mut server);
        let mut selection = server.take_view();
        timed(|| while selection.as_mut().is_some_and(|view| !view.step(&land, 256)) {})
    };
    (0..VIEWS).for_each(|id| _ = select(id));
    (0..VIEWS).map(select).collect()
}

/// Times in which a client decodes and verifies chunks.
fn decoded(land: Land, keys: &[ChunkKey]) -> Vec<f64> {
    let offer = ServerOffer { land, digest: land.digest(), token: None, software: String::new() };
    let (mut server, mut client) = welcomed(&offer);
    while let Some(frame) = server.poll_transmit() {
        let _ = client.receive(DataFrame::Binary(&frame));
    }
    let frames: Vec<_> =
        keys.iter().map(|key| chunk_codec::encode(&land.chunk(*key), &offer.digest)).collect();
    frames.iter().map(|frame| timed(|| client.receive(DataFrame::Binary(frame)))).collect()
}

/// A session after its handshake, the Welcome not yet received.
fn welcomed(offer: &ServerOffer) -> (ServerSession, ClientSession) {
    let mut server = ServerSession::new(offer.clone(), 1);
    let mut client = ClientSession::new(ClientConfig {
        digest: None,
        delivery: Delivery::Exact,
        token: None,
        software: String::new(),
        window: 64,
    });
    exchange(&mut client, &mut server);
    (server, client)
}

fn exchange(client: &mut ClientSession, server: &mut ServerSession) {
    while let Some(frame) = client.poll_transmit() {
        // Frames of our own client are valid.
        let _ = server.receive(DataFrame::Binary(&frame));
    }
}

/// Processor time of some work, microseconds.
fn timed<T>(work: impl FnOnce() -> T) -> f64 {
    let before = processor_ns();
    let started = Instant::now();
    let _done = std::hint::black_box(work());
    match (before, processor_ns()) {
        (Some(before), Some(after)) => (after - before) / 1e3,
        _ => started.elapsed().as_secs_f64() * 1e6,
    }
}

/// Processor time of this thread so far, nanoseconds; none where the system does not say.
fn processor_ns() -> Option<f64> {
    std::fs::read_to_string("/proc/thread-self/schedstat").ok()?.split_whitespace().next()?.parse().ok()
}

fn median(mut times: Vec<f64>) -> f64 {
    times.sort_by(f64::total_cmp);
    times.get(times.len() / 2).copied().unwrap_or(f64::NAN)
}

/// A duration of microseconds; none of an invalid number.
#[must_use]
pub fn micros(us: f64) -> Duration {
    Duration::try_from_secs_f64(us / 1e6).unwrap_or_default()
}
