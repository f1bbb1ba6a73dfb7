//! A source that tests hold back and watch, and a service over it.

use super::{Answer, Generation, Limits};
use crate::metrics::Metrics;
use crate::source::ChunkSource;
use protocol::server::Wanted;
use protocol::{Delivery, chunk_codec};
use std::sync::{Arc, Mutex, mpsc};
use std::time::Duration;
use terrain::constants::VERTEX_COUNT;
use terrain::{Chunk, ChunkKey, GrassSeed, WorldDigest};

/// A source that waits for a permit before each frame and reports what it made.
pub struct Gated {
    pub permits: Mutex<mpsc::Receiver<()>>,
    pub made: Mutex<mpsc::Sender<ChunkKey>>,
}

impl ChunkSource for Gated {
    fn world(&self) -> WorldDigest {
        WorldDigest([7; 32])
    }

    /// A flat chunk; its error tells whether one was known.
    fn chunk(&self, key: ChunkKey, known_error: Option<u32>) -> Chunk {
        self.permits.lock().unwrap().recv().unwrap();
        assert_ne!(key, self::key(666), "this key panics");
        self.made.lock().unwrap().send(key).unwrap();
        let grass = GrassSeed { seed: 0, palette: 0, density: Box::new([0; 256]) };
        let error = known_error.map_or(MEASURED, |error| error + 1);
        Chunk::from_parts(key, Box::new([0; VERTEX_COUNT]), error, grass)
    }
}

/// Error of a chunk that was made without a known one.
pub const MEASURED: u32 = 70;

/// Length of the exact frame of a flat chunk.
pub fn flat_frame() -> usize {
    let grass = GrassSeed { seed: 0, palette: 0, density: Box::new([0; 256]) };
    let chunk = Chunk::from_parts(key(1), Box::new([0; VERTEX_COUNT]), MEASURED, grass);
    chunk_codec::encode(&chunk, &WorldDigest([7; 32])).len()
}

pub fn key(x: i32) -> ChunkKey {
    ChunkKey::new(0, x, 0).unwrap()
}

pub fn wanted(key: ChunkKey, priority: u64) -> Wanted {
    Wanted { key, request: None, priority }
}

pub struct Bench {
    pub service: Generation,
    pub metrics: Arc<Metrics>,
    pub permit: mpsc::Sender<()>,
    pub made: mpsc::Receiver<ChunkKey>,
}

pub fn bench(cache_bytes: u64, limit: usize) -> Bench {
    let (permit, permits) = mpsc::channel();
    let (made_sender, made) = mpsc::channel();
    let source = Gated { permits: Mutex::new(permits), made: Mutex::new(made_sender) };
    let metrics = Arc::new(Metrics::default());
    let limits = Limits { threads: 1, cache_bytes, jobs: limit, deadline: Duration::from_secs(3600) };
    let service = Generation::new(source, limits, Arc::clone(&metrics)).unwrap();
    Bench { service, metrics, permit, made }
}

/// Starts asking and waits until the service has taken note.
pub async fn ask(service: &Generation, key: ChunkKey, priority: u64) -> tokio::task::JoinHandle<Answer> {
    ask_for(service, key, Delivery::Exact, priority).await
}

/// As [`ask`], for a delivery.
pub async fn ask_for(
    service: &Generation,
    key: ChunkKey,
    delivery: Delivery,
    priority: u64,
) -> tokio::task::JoinHandle<Answer> {
    let (before, service) = (service.shared.metrics.requested.get(), service.clone());
    let metrics = Arc::clone(&service.shared.metrics);
    let task = tokio::spawn(async move { service.flow().frame(wanted(key, priority), delivery).await });
    while metrics.requested.get() == before {
        tokio::task::yield_now().await;
    }
    task
}
