//! State of the generation service, shared by its threads and its flows.

use super::active::ActiveFlows;
use super::cost::JobCosts;
use super::queue::Queue;
use super::threads::{Mutex, MutexGuard};
use super::work_time::WorkClock;
use crate::cache::disk::Disk;
use crate::cache::memory::FrameCache;
use crate::chunk_id::ChunkId;
use crate::mechanism::Mechanism;
use crate::metrics::Metrics;
use crate::source::ChunkSource;
use crate::store::Store;
use bytes::Bytes;
use protocol::Delivery;
use std::sync::atomic::AtomicU64;
use std::sync::{Arc, PoisonError};
use std::time::Duration;
use terrain::{ChunkKey, WorldDigest};

/// Limits of the service.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Limits {
    /// Compute threads, at least 1.
    pub threads: usize,
    /// Memory for frames, bytes.
    pub cache_bytes: u64,
    /// Jobs that may be queued or running. A request for one more is rejected with
    /// [`super::GenerationError::Overloaded`].
    pub jobs: usize,
    /// Longest wait of an explicit request. An older one is rejected instead of generated: its
    /// client no longer needs it.
    pub deadline: Duration,
    /// The mechanism that is turned off, for measurements.
    pub without: Option<Mechanism>,
}

/// See the module.
pub struct Shared {
    pub source: Box<dyn ChunkSource>,
    pub world: WorldDigest,
    pub frames: FrameCache,
    /// Read before a chunk is generated, written after.
    pub disk: Option<Disk>,
    /// Read before a chunk that is expensive is made, written after.
    pub store: Option<Store>,
    /// A std mutex: held for map operations only, never across an await or a generation.
    pub queue: Mutex<Queue>,
    pub costs: JobCosts,
    /// What work is measured by.
    pub clock: Box<dyn WorkClock>,
    pub limits: Limits,
    pub next_flow: AtomicU64,
    /// Flows with requests in flight: those that share the threads, whether or not their queue is
    /// empty at the moment.
    pub active: ActiveFlows,
    /// Flows of paused sessions. They share the threads too, with or without requests: otherwise
    /// each of many sessions that send nothing but refused views would get a whole share.
    pub paused: ActiveFlows,
    pub metrics: Arc<Metrics>,
}

impl Shared {
    pub fn lock(&self) -> MutexGuard<'_, Queue> {
        // No code under the lock panics in the middle of a change, so a poisoned queue is
        // consistent.
        self.queue.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// The chunk that a key names now.
    pub fn current(&self, key: ChunkKey) -> ChunkId {
        ChunkId { key, edition: self.source.edition(key) }
    }

    /// The cached frame of a chunk for a delivery; counts a request only on a hit. A fast-encoded
    /// frame is no hit if the frame `must_be_compact`, or if the server is idle.
    pub fn cached(&self, id: ChunkId, delivery: Delivery, must_be_compact: bool) -> Option<Bytes> {
        let is_idle = || must_be_compact || self.lock().jobs() == 0;
        let frame = self.frames.get(id, delivery, is_idle)?;
        self.metrics.generation.cache_hits.inc();
        Some(frame)
    }
}
