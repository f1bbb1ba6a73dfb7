//! The generation service: one job per key however many ask, on a pool of compute threads behind a bounded queue.
//!
//! A job belongs to the service, never to the asker, so an asker that vanishes harms nobody else; a queued job
//! that nobody waits for any more is dropped unrun. Finished frames go into a byte-weighed cache before the job
//! disappears, so a key is never made twice at the same time.

use crate::metrics::Metrics;
use crate::source::ChunkSource;
use bytes::Bytes;
use quick_cache::Weighter;
use quick_cache::sync::Cache;
use rayon::{ThreadPool, ThreadPoolBuildError, ThreadPoolBuilder};
use rustc_hash::FxHashMap;
use std::collections::BinaryHeap;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Instant;
use terrain::ChunkKey;
use thiserror::Error;
use tokio::sync::oneshot;

/// Why a frame cannot be had now.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Error)]
pub enum GenerationError {
    /// The queue is full.
    #[error("the generation queue is full, ask again later")]
    Overloaded,
    /// The job panicked; the panic was contained and logged.
    #[error("the chunk could not be generated")]
    Failed,
}

/// Makes, caches and shares chunk frames.
#[derive(Clone)]
pub struct Generation {
    shared: Arc<Shared>,
    pool: Arc<ThreadPool>,
}

struct Shared {
    source: Box<dyn ChunkSource>,
    cache: Cache<ChunkKey, Bytes, FrameWeight>,
    /// A std mutex: held for map operations only, never across an await or a generation.
    queue: Mutex<Queue>,
    /// Jobs that may be queued or running. Asking for one more is refused with [`GenerationError::Overloaded`].
    limit: usize,
    metrics: Arc<Metrics>,
}

#[derive(Default)]
struct Queue {
    jobs: FxHashMap<ChunkKey, Job>,
    /// Most urgent first. May hold stale entries of jobs that were raised or taken; they are skipped when popped and
    /// swept out when they outnumber the jobs.
    order: BinaryHeap<(u64, ChunkKey)>,
}

struct Job {
    priority: u64,
    running: bool,
    /// One per asker. Bounded by the sessions' job windows and the HTTP connections.
    waiters: Vec<oneshot::Sender<Result<Bytes, GenerationError>>>,
}

#[derive(Clone)]
struct FrameWeight;

impl Weighter<ChunkKey, Bytes> for FrameWeight {
    fn weight(&self, _key: &ChunkKey, frame: &Bytes) -> u64 {
        // The key, the handle and the map's own share, besides the bytes.
        frame.len() as u64 + 128
    }
}

impl Generation {
    /// A service over a source with `threads` compute threads, a cache of `cache_bytes` and at most `limit` jobs.
    ///
    /// # Errors
    /// The system refuses to start threads.
    pub fn new(
        source: impl ChunkSource,
        threads: usize,
        cache_bytes: u64,
        limit: usize,
        metrics: Arc<Metrics>,
    ) -> Result<Self, ThreadPoolBuildError> {
        let pool =
            ThreadPoolBuilder::new().num_threads(threads).thread_name(|n| format!("generate-{n}")).build()?;
        // About 5 KiB a frame; the estimate only sizes the first tables.
        let cache = Cache::with_weighter((cache_bytes / 5120) as usize, cache_bytes, FrameWeight);
        let queue = Mutex::default();
        let shared = Shared { source: Box::new(source), cache, queue, limit, metrics };
        Ok(Self { shared: Arc::new(shared), pool: Arc::new(pool) })
    }

    /// The frame of a key if it is cached; counts as a request only when it is.
    #[must_use]
    pub fn cached(&self, key: ChunkKey) -> Option<Bytes> {
        let frame = self.shared.cache.get(&key)?;
        self.shared.metrics.requested.inc();
        self.shared.metrics.cache_hits.inc();
        Some(frame)
    }

    /// The frame of a key, made if need be. Dropping the future withdraws the interest.
    ///
    /// # Errors
    /// See [`GenerationError`].
    pub async fn frame(&self, key: ChunkKey, priority: u64) -> Result<Bytes, GenerationError> {
        match self.enqueue(key, priority)? {
            Asked::Cached(frame) => Ok(frame),
            // The sender is dropped unsent only if the pool is torn down.
            Asked::Waiting(result) => result.await.unwrap_or(Err(GenerationError::Failed)),
        }
    }

    fn enqueue(&self, key: ChunkKey, priority: u64) -> Result<Asked, GenerationError> {
        let Shared { cache, metrics, limit, .. } = &*self.shared;
        metrics.requested.inc();
        let mut queue = self.shared.lock();
        // Under the lock: a job leaves the map only after its frame is in the cache.
        if let Some(frame) = cache.get(&key) {
            metrics.cache_hits.inc();
            return Ok(Asked::Cached(frame));
        }
        let (waiter, result) = oneshot::channel();
        if let Some(job) = queue.jobs.get_mut(&key) {
            job.waiters.push(waiter);
            metrics.coalesced.inc();
            if !job.running && priority > job.priority {
                job.priority = priority;
                queue.push(priority, key);
            }
            return Ok(Asked::Waiting(result));
        }
        if queue.jobs.len() >= *limit {
            metrics.shed.inc();
            return Err(GenerationError::Overloaded);
        }
        queue.jobs.insert(key, Job { priority, running: false, waiters: vec![waiter] });
        queue.push(priority, key);
        metrics.queue.set(queue.jobs.len() as i64);
        drop(queue);
        // One pool task per job, but each takes whatever is most urgent when it starts.
        let shared = Arc::clone(&self.shared);
        self.pool.spawn(move || shared.run_most_urgent());
        Ok(Asked::Waiting(result))
    }

    /// Share of the queue in use, 0 to 1.
    #[must_use]
    pub fn load(&self) -> f64 {
        self.shared.lock().jobs.len() as f64 / self.shared.limit as f64
    }
}

enum Asked {
    Cached(Bytes),
    Waiting(oneshot::Receiver<Result<Bytes, GenerationError>>),
}

impl Shared {
    fn run_most_urgent(&self) {
        let Some(key) = self.take() else { return };
        let started = Instant::now();
        let result = catch_unwind(AssertUnwindSafe(|| self.source.frame(key)));
        let result = match result {
            Ok(frame) => {
                self.metrics.generation_seconds.observe(started.elapsed().as_secs_f64());
                self.metrics.generated.inc();
                self.cache.insert(key, frame.clone());
                Ok(frame)
            }
            Err(_) => {
                self.metrics.failed.inc();
                tracing::error!(%key, "generation panicked");
                Err(GenerationError::Failed)
            }
        };
        let job = {
            let mut queue = self.lock();
            let job = queue.jobs.remove(&key);
            self.metrics.queue.set(queue.jobs.len() as i64);
            job
        };
        for waiter in job.into_iter().flat_map(|job| job.waiters) {
            // An asker that left in the meantime is no error.
            let _ = waiter.send(result.clone());
        }
    }

    /// Takes the most urgent job that somebody waits for and drops those that nobody does.
    fn take(&self) -> Option<ChunkKey> {
        let mut queue = self.lock();
        while let Some((_, key)) = queue.order.pop() {
            let Some(job) = queue.jobs.get_mut(&key).filter(|job| !job.running) else { continue };
            job.waiters.retain(|waiter| !waiter.is_closed());
            if job.waiters.is_empty() {
                queue.jobs.remove(&key);
                self.metrics.cancelled.inc();
                self.metrics.queue.set(queue.jobs.len() as i64);
                continue;
            }
            job.running = true;
            return Some(key);
        }
        None
    }

    fn lock(&self) -> MutexGuard<'_, Queue> {
        // No code under the lock can panic half-way through a change, so a poisoned queue is still sound.
        self.queue.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Queue {
    fn push(&mut self, priority: u64, key: ChunkKey) {
        if self.order.len() > 2 * self.jobs.len() + 64 {
            let jobs = &self.jobs;
            self.order.retain(|(priority, key)| {
                jobs.get(key).is_some_and(|job| !job.running && job.priority == *priority)
            });
        }
        self.order.push((priority, key));
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::sync::mpsc;
    use std::time::Duration;

    /// A source that waits for a permit before each frame and reports what it made.
    struct Gated {
        permits: Mutex<mpsc::Receiver<()>>,
        made: Mutex<mpsc::Sender<ChunkKey>>,
    }

    impl ChunkSource for Gated {
        fn frame(&self, key: ChunkKey) -> Bytes {
            self.permits.lock().unwrap().recv().unwrap();
            assert_ne!(key, self::key(666), "this key panics");
            self.made.lock().unwrap().send(key).unwrap();
            Bytes::from(vec![0; 100])
        }
    }

    fn key(x: i32) -> ChunkKey {
        ChunkKey::new(0, x, 0).unwrap()
    }

    struct Bench {
        service: Generation,
        metrics: Arc<Metrics>,
        permit: mpsc::Sender<()>,
        made: mpsc::Receiver<ChunkKey>,
    }

    fn bench(cache_bytes: u64, limit: usize) -> Bench {
        let (permit, permits) = mpsc::channel();
        let (made_sender, made) = mpsc::channel();
        let source = Gated { permits: Mutex::new(permits), made: Mutex::new(made_sender) };
        let metrics = Arc::new(Metrics::default());
        let service = Generation::new(source, 1, cache_bytes, limit, Arc::clone(&metrics)).unwrap();
        Bench { service, metrics, permit, made }
    }

    /// Starts asking and waits until the service has taken note.
    async fn ask(
        service: &Generation,
        key: ChunkKey,
        priority: u64,
    ) -> tokio::task::JoinHandle<Result<Bytes, GenerationError>> {
        let (before, service) = (service.shared.metrics.requested.get(), service.clone());
        let metrics = Arc::clone(&service.shared.metrics);
        let task = tokio::spawn(async move { service.frame(key, priority).await });
        while metrics.requested.get() == before {
            tokio::task::yield_now().await;
        }
        task
    }

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
            assert_eq!(other.await.unwrap().unwrap().len(), 100);
        }
        assert_eq!(bench.metrics.generated.get(), 1);
        assert!(bench.service.cached(key(1)).is_some());
    }

    #[tokio::test]
    async fn the_most_urgent_job_runs_first_and_an_asker_can_raise_one() {
        let bench = bench(1 << 20, 10);
        let mut asked = vec![ask(&bench.service, key(0), 0).await];
        // Let the only thread take the first job, so that the order of the rest is the queue's.
        while bench.service.shared.lock().jobs.get(&key(0)).is_some_and(|job| !job.running) {
            tokio::task::yield_now().await;
        }
        for (x, priority) in [(1, 10), (2, 30), (3, 20), (1, 40)] {
            asked.push(ask(&bench.service, key(x), priority).await);
        }
        for _ in 0..4 {
            bench.permit.send(()).unwrap();
        }
        for task in asked {
            task.await.unwrap().unwrap();
        }
        assert_eq!(bench.made.try_iter().collect::<Vec<_>>(), [0, 1, 2, 3].map(key));
    }

    #[tokio::test]
    async fn a_full_queue_refuses_and_a_queued_job_without_askers_never_runs() {
        let bench = bench(1 << 20, 2);
        let running = ask(&bench.service, key(0), 9).await;
        while bench.service.shared.lock().jobs.values().all(|job| !job.running) {
            tokio::task::yield_now().await;
        }
        let abandoned = ask(&bench.service, key(1), 1).await;
        assert_eq!(bench.service.frame(key(2), 99).await, Err(GenerationError::Overloaded));
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

    #[tokio::test]
    async fn a_panic_fails_its_own_job_only() {
        let bench = bench(1 << 20, 10);
        let bad = ask(&bench.service, key(666), 2).await;
        let good = ask(&bench.service, key(1), 1).await;
        bench.permit.send(()).unwrap();
        bench.permit.send(()).unwrap();
        assert_eq!(bad.await.unwrap(), Err(GenerationError::Failed));
        assert!(good.await.unwrap().is_ok());
        assert_eq!(bench.metrics.failed.get(), 1);
    }

    #[tokio::test]
    async fn the_cache_stays_within_its_bytes() {
        let bench = bench(10 * 228, 100);
        for x in 0..50 {
            bench.permit.send(()).unwrap();
            bench.service.frame(key(x), 1).await.unwrap();
        }
        assert!(bench.service.shared.cache.weight() <= 10 * 228);
        assert!(bench.service.shared.cache.len() < 50);
    }
}
