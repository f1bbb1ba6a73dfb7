//! The generation service: one job per key however many ask, on a pool of compute threads behind a
//! bounded, fair queue.
//!
//! A chunk has one frame per delivery. A job makes the chunk once and encodes only the frames that
//! somebody waits for: a server whose clients all regenerate spends neither time nor cache on exact
//! frames a hundred times the size. When another delivery of a cached chunk is asked for later, the
//! heights are made again but the error, the costly part, is taken from the cached frame.
//!
//! Askers are [`Flow`]s: a session is one, a download another. A thread takes one flow's turn at a
//! time ([`queue`]), which is several cheap chunks or one dear one, and answers it as a whole, so
//! that a session wakes and writes once for all of them. A job belongs to the service, never to the
//! asker, so an asker that vanishes harms nobody else; a queued job that nobody waits for any more
//! is dropped unrun. What is not in memory may be on disk ([`crate::disk`]): a job looks there
//! first. Finished frames go into a byte-weighed cache before the job disappears, so a key is never
//! made twice at the same time.
//!
//! Reading order: [`flow`] (asking), [`queue`] (whose turn it is), [`cost`] (what a turn is
//! measured in), `runner` (making), [`views`] (selecting), [`frames`] (what is made already). This
//! file owns what they share.

pub mod cost;
pub mod flow;
pub mod frames;
#[cfg(test)]
mod gated;
pub mod queue;
mod runner;
pub mod views;

pub use flow::{Flow, FlowAnswer};

use crate::disk::Disk;
use crate::metrics::Metrics;
use crate::purse::Purse;
use crate::source::ChunkSource;
use bytes::Bytes;
use cost::Costs;
use frames::Frames;
use protocol::Delivery;
use protocol::server::Wanted;
use queue::Queue;
use rayon::{ThreadPool, ThreadPoolBuildError, ThreadPoolBuilder};
use std::sync::atomic::{AtomicU64, AtomicUsize, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;
use terrain::{ChunkKey, WorldDigest};
use thiserror::Error;

/// Why a frame cannot be had now.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Error)]
pub enum GenerationError {
    /// The queue is full, or the asking waited in it for too long.
    #[error("the server is overloaded, ask again later")]
    Overloaded,
    /// The job panicked; the panic was contained and logged.
    #[error("the chunk could not be generated")]
    Failed,
}

/// How much the service may take on.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Limits {
    /// Compute threads, at least 1.
    pub threads: usize,
    /// Memory for frames, bytes.
    pub cache_bytes: u64,
    /// Jobs that may wait or run. Asking for one more is refused with
    /// [`GenerationError::Overloaded`].
    pub jobs: usize,
    /// Longest wait of a request. One that has waited longer is refused instead of made: its asker
    /// has moved on.
    pub deadline: Duration,
}

/// Makes, caches and shares chunk frames.
#[derive(Clone)]
pub struct Generation {
    shared: Arc<Shared>,
    pool: Arc<ThreadPool>,
}

type Answer = Result<Bytes, GenerationError>;

/// An answer with the asking that it answers.
pub type Done = (Wanted, Answer);

struct Shared {
    source: Box<dyn ChunkSource>,
    world: WorldDigest,
    frames: Frames,
    /// What is looked at before a chunk is made, and where it goes after.
    disk: Option<Disk>,
    /// A std mutex: held for map operations only, never across an await or a generation.
    queue: Mutex<Queue>,
    costs: Costs,
    limits: Limits,
    next_flow: AtomicU64,
    /// Flows that wait for something: those that share the threads, whether or not a thread has
    /// just emptied their queue.
    open_flows: AtomicUsize,
    metrics: Arc<Metrics>,
}

impl Shared {
    fn lock(&self) -> MutexGuard<'_, Queue> {
        // No code under the lock can panic half-way through a change, so a poisoned queue is still
        // sound.
        self.queue.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Generation {
    /// A service over a source, with memory only.
    ///
    /// # Errors
    /// The system refuses to start threads.
    pub fn new(
        source: impl ChunkSource,
        limits: Limits,
        metrics: Arc<Metrics>,
    ) -> Result<Self, ThreadPoolBuildError> {
        Self::with_disk(source, limits, None, metrics)
    }

    /// As [`Generation::new`]; what memory lacks is looked for on a disk, if there is one, before
    /// it is made.
    ///
    /// # Errors
    /// The system refuses to start threads.
    pub fn with_disk(
        source: impl ChunkSource,
        limits: Limits,
        disk: Option<Disk>,
        metrics: Arc<Metrics>,
    ) -> Result<Self, ThreadPoolBuildError> {
        let pool = ThreadPoolBuilder::new()
            .num_threads(limits.threads)
            .thread_name(|n| format!("generate-{n}"))
            .build()?;
        let shared = Shared {
            world: source.world(),
            source: Box::new(source),
            frames: Frames::new(limits.cache_bytes),
            disk,
            queue: Mutex::new(Queue::new(limits.jobs)),
            costs: Costs::default(),
            limits,
            next_flow: AtomicU64::new(0),
            open_flows: AtomicUsize::new(0),
            metrics,
        };
        Ok(Self { shared: Arc::new(shared), pool: Arc::new(pool) })
    }

    /// The frame of a key for a delivery if it is cached; counts as a request only when it is.
    #[must_use]
    pub fn cached(&self, key: ChunkKey, delivery: Delivery) -> Option<Bytes> {
        let is_time = || self.shared.lock().jobs() == 0;
        let frame = self.shared.frames.get(key, delivery, is_time)?;
        self.shared.metrics.requested.inc();
        self.shared.metrics.cache_hits.inc();
        Some(frame)
    }

    /// Starts a thread's work unless all threads are at work.
    fn start_runner(&self, queue: &mut Queue) {
        if queue.runners < self.shared.limits.threads {
            // A runner takes turns until nothing waits, so there are never more of them than
            // threads.
            queue.runners += 1;
            let shared = Arc::clone(&self.shared);
            self.pool.spawn(move || shared.run());
        }
    }

    /// A new asker that nobody counts against. Dropping it withdraws everything that it waits for.
    #[must_use]
    pub fn flow(&self) -> Flow {
        self.flow_paid_by(Purse::default())
    }

    /// As [`Generation::flow`], paid for.
    #[must_use]
    pub fn flow_paid_by(&self, purse: Purse) -> Flow {
        Flow::new(self.clone(), self.shared.next_flow.fetch_add(1, Ordering::Relaxed), purse)
    }

    /// Further requests of one flow that can be made within the deadline, as far as the recent past
    /// tells. What exceeds it is better refused at once than after a wait.
    #[must_use]
    pub fn allowance(&self) -> usize {
        let Limits { threads, deadline, .. } = self.shared.limits;
        // Nothing waits: whatever the estimate, there is no reason to refuse.
        if self.shared.lock().waiting() == 0 {
            return usize::MAX;
        }
        // Half of it: the other half is for what the estimate leaves out, sessions that write and
        // machines that are shared.
        self.shared.costs.within(deadline / 2, threads, self.shared.open_flows.load(Ordering::Relaxed))
    }

    /// How many flows share a thread at the moment, at least 1.
    #[must_use]
    pub fn sharers(&self) -> usize {
        self.shared.open_flows.load(Ordering::Relaxed).div_ceil(self.shared.limits.threads).max(1)
    }

    /// Waits a little until what goes to disk is there, and lets go of the folder. For the end.
    pub async fn close(&self) {
        if let Some(disk) = &self.shared.disk {
            disk.close().await;
        }
    }

    /// Share of the queue in use, 0 to 1.
    #[must_use]
    pub fn load(&self) -> f64 {
        let (jobs, limit) = (self.shared.lock().jobs(), self.shared.limits.jobs);
        // A queue that takes nothing is full.
        if jobs >= limit { 1.0 } else { jobs as f64 / limit as f64 }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use gated::{ask, bench, flat_frame, key, wanted};

    #[tokio::test]
    async fn many_askers_of_one_key_share_one_job_even_when_the_first_vanishes() {
        let bench = bench(1 << 20, 10);
        let first = ask(&bench.service, key(1), 1).await;
        let mut others = Vec::new();
        for _ in 0..100 {
            others.push(ask(&bench.service, key(1), 1).await);
        }
        first.abort();
        bench.permit.send(()).unwrap();
        for other in others {
            assert_eq!(other.await.unwrap().unwrap().len(), flat_frame());
        }
        assert_eq!(bench.metrics.generated.get(), 1);
        assert!(bench.service.cached(key(1), Delivery::Exact).is_some());
    }

    #[tokio::test]
    async fn a_full_queue_refuses_and_a_queued_job_without_askers_never_runs() {
        let bench = bench(1 << 20, 2);
        let running = ask(&bench.service, key(0), 9).await;
        while !bench.service.shared.lock().is_running(key(0)) {
            tokio::task::yield_now().await;
        }
        let abandoned = ask(&bench.service, key(1), 1).await;
        assert_eq!(
            bench.service.flow().frame(wanted(key(2), 99), Delivery::Exact).await,
            Err(GenerationError::Overloaded)
        );
        assert_eq!(bench.metrics.shed.get(), 1);
        abandoned.abort();
        let _ = abandoned.await;
        bench.permit.send(()).unwrap();
        running.await.unwrap().unwrap();
        while bench.metrics.cancelled.get() == 0 {
            tokio::time::sleep(Duration::from_millis(1)).await;
        }
        assert_eq!(bench.metrics.generated.get(), 1);
        assert!(bench.service.load() < 0.01);
    }
}
