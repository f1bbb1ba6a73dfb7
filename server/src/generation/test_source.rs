//! A chunk source under the control of a test, and a service over it.

use super::{FrameResult, Generation, Limits};
use crate::chunk_id::ChunkId;
use crate::metrics::Metrics;
use crate::source::ChunkSource;
use protocol::message::{ClientMessage, Hello};
use protocol::server::{ChunkRequest, ServerOffer, ServerSession, ViewSelection};
use protocol::view::View;
use protocol::{Delivery, chunk_codec};
use std::sync::{Arc, Mutex, mpsc};
use std::time::Duration;
use terrain::constants::VERTEX_COUNT;
use terrain::{Chunk, ChunkKey, GrassSeed, Land, WorldDigest};

/// A source that waits for a permit before each chunk and reports the chunk.
pub struct GatedSource {
    pub permits: Mutex<mpsc::Receiver<()>>,
    pub generated: Mutex<mpsc::Sender<ChunkKey>>,
}

impl ChunkSource for GatedSource {
    fn world(&self) -> WorldDigest {
        WorldDigest([7; 32])
    }

    /// A flat chunk; its error shows whether one was known.
    fn chunk(&self, ChunkId { key, .. }: ChunkId, known_error: Option<u32>) -> Chunk {
        self.permits.lock().unwrap().recv().unwrap();
        assert_ne!(key, self::key(666), "this key panics");
        self.generated.lock().unwrap().send(key).unwrap();
        let grass = GrassSeed { seed: 0, palette: 0, density: Box::new([0; 256]) };
        let error = known_error.map_or(MEASURED, |error| error + 1);
        Chunk::from_parts(key, Box::new([0; VERTEX_COUNT]), error, grass)
    }
}

/// Error of a chunk generated without a known error.
pub const MEASURED: u32 = 70;

/// Length of the exact frame of a flat chunk.
pub fn flat_frame_bytes() -> usize {
    let grass = GrassSeed { seed: 0, palette: 0, density: Box::new([0; 256]) };
    let chunk = Chunk::from_parts(key(1), Box::new([0; VERTEX_COUNT]), MEASURED, grass);
    chunk_codec::encode(&chunk, &WorldDigest([7; 32])).len()
}

pub fn key(x: i32) -> ChunkKey {
    ChunkKey::new(0, x, 0).unwrap()
}

pub fn chunk_request(key: ChunkKey, priority: u64) -> ChunkRequest {
    ChunkRequest { key, request: None, priority }
}

/// The selection of a small view of world 1. That of view 666 panics when it is run.
pub fn view_selection(id: u32) -> ViewSelection {
    let land = Land::new(1);
    let offer = ServerOffer { land, digest: land.digest(), token: None, software: String::new() };
    let mut session = ServerSession::new(offer, 1);
    let hello = Hello { digest: None, delivery: Delivery::Exact, token: None, software: String::new() };
    let view = View { eye: [0; 3], tolerance_q4: 16, ..test_support::view(id, 500) };
    for message in [ClientMessage::Hello(hello), ClientMessage::View(view)] {
        let frame = protocol::control::encode(&message).unwrap();
        session.receive(protocol::DataFrame::Binary(&frame)).unwrap();
    }
    session.take_view().unwrap()
}

/// A service with one thread over a [`GatedSource`].
pub struct Fixture {
    pub service: Generation,
    pub metrics: Arc<Metrics>,
    pub permit: mpsc::Sender<()>,
    pub generated: mpsc::Receiver<ChunkKey>,
}

pub fn fixture(cache_bytes: u64, limit: usize) -> Fixture {
    fixture_with_deadline(cache_bytes, limit, Duration::from_secs(3600))
}

pub fn fixture_with_deadline(cache_bytes: u64, limit: usize, deadline: Duration) -> Fixture {
    let (permit, permits) = mpsc::channel();
    let (sender, generated) = mpsc::channel();
    let source = GatedSource { permits: Mutex::new(permits), generated: Mutex::new(sender) };
    let metrics = Arc::new(Metrics::default());
    let limits = Limits { threads: 1, cache_bytes, jobs: limit, deadline, without: None };
    let service = Generation::new(source, limits, Arc::clone(&metrics)).unwrap();
    Fixture { service, metrics, permit, generated }
}

/// Starts an exact request and waits until the service has registered it.
pub async fn request(
    service: &Generation,
    key: ChunkKey,
    priority: u64,
) -> tokio::task::JoinHandle<FrameResult> {
    request_delivery(service, key, Delivery::Exact, priority).await
}

/// As [`request`], for a delivery.
pub async fn request_delivery(
    service: &Generation,
    key: ChunkKey,
    delivery: Delivery,
    priority: u64,
) -> tokio::task::JoinHandle<FrameResult> {
    let (metrics, service) = (Arc::clone(&service.shared.metrics), service.clone());
    let before = metrics.generation.frame_requests();
    let task =
        tokio::spawn(async move { service.flow().frame(chunk_request(key, priority), delivery).await });
    while metrics.generation.frame_requests() == before {
        tokio::task::yield_now().await;
    }
    task
}
