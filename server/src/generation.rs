//! The generation service: one job per key however many ask, on a pool of compute threads behind a bounded queue.
//!
//! A chunk has one frame per delivery. A job makes the chunk once and encodes only the frames that somebody waits for: a
//! server whose clients all regenerate spends neither time nor cache on exact frames a hundred times the size. When another
//! delivery of a cached chunk is asked for later, the heights are made again but the error, the costly part, is taken from the
//! cached frame.
//!
//! A job belongs to the service, never to the asker, so an asker that vanishes harms nobody else; a queued job
//! that nobody waits for any more is dropped unrun. Finished frames go into a byte-weighed cache before the job
//! disappears, so a key is never made twice at the same time.

use crate::metrics::Metrics;
use crate::source::ChunkSource;
use bytes::Bytes;
use protocol::chunk_codec::Effort;
use protocol::{Delivery, chunk_codec};
use quick_cache::Weighter;
use quick_cache::sync::Cache;
use rayon::{ThreadPool, ThreadPoolBuildError, ThreadPoolBuilder};
use rustc_hash::FxHashMap;
use std::collections::BinaryHeap;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Instant;
use terrain::{Chunk, ChunkKey, WorldDigest};
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

/// What a frame is cached under.
type FrameId = (ChunkKey, Delivery);

type Answer = Result<Bytes, GenerationError>;

struct Shared {
    source: Box<dyn ChunkSource>,
    world: WorldDigest,
    cache: Cache<FrameId, Bytes, FrameWeight>,
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
    waiters: Vec<Waiter>,
}

struct Waiter {
    delivery: Delivery,
    answer: oneshot::Sender<Answer>,
}

#[derive(Clone)]
struct FrameWeight;

impl Weighter<FrameId, Bytes> for FrameWeight {
    fn weight(&self, _id: &FrameId, frame: &Bytes) -> u64 {
        // The key, the handle and the map's own share, besides the bytes; for a seed-only frame most of it.
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
        // About 4 KiB an exact frame; the estimate only sizes the first tables.
        let cache = Cache::with_weighter((cache_bytes / 4096) as usize, cache_bytes, FrameWeight);
        let queue = Mutex::default();
        let world = source.world();
        let shared = Shared { source: Box::new(source), world, cache, queue, limit, metrics };
        Ok(Self { shared: Arc::new(shared), pool: Arc::new(pool) })
    }

    /// The frame of a key for a delivery if it is cached; counts as a request only when it is.
    #[must_use]
    pub fn cached(&self, key: ChunkKey, delivery: Delivery) -> Option<Bytes> {
        let frame = self.shared.cache.get(&(key, delivery))?;
        self.shared.metrics.requested.inc();
        self.shared.metrics.cache_hits.inc();
        Some(frame)
    }

    /// The frame of a key for a delivery, made if need be. Dropping the future withdraws the interest.
    ///
    /// # Errors
    /// See [`GenerationError`].
    pub async fn frame(
        &self,
        key: ChunkKey,
        delivery: Delivery,
        priority: u64,
    ) -> Result<Bytes, GenerationError> {
        match self.enqueue(key, delivery, priority)? {
            Asked::Cached(frame) => Ok(frame),
            // The sender is dropped unsent only if the pool is torn down.
            Asked::Waiting(result) => result.await.unwrap_or(Err(GenerationError::Failed)),
        }
    }

    fn enqueue(&self, key: ChunkKey, delivery: Delivery, priority: u64) -> Result<Asked, GenerationError> {
        let Shared { cache, metrics, limit, .. } = &*self.shared;
        metrics.requested.inc();
        let mut queue = self.shared.lock();
        // Under the lock: a job leaves the map only after its frames are in the cache.
        if let Some(frame) = cache.get(&(key, delivery)) {
            metrics.cache_hits.inc();
            return Ok(Asked::Cached(frame));
        }
        let (answer, result) = oneshot::channel();
        let waiter = Waiter { delivery, answer };
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
    Waiting(oneshot::Receiver<Answer>),
}

impl Shared {
    fn run_most_urgent(&self) {
        let Some(key) = self.take() else { return };
        // Made by the first delivery, shared by the others. Who asks while a frame is being encoded finds the job still here
        // and is served by a further round.
        let mut chunk = None;
        while let Some((delivery, waiters)) = self.next_delivery(key) {
            let answer = self.make(key, delivery, &mut chunk);
            for waiter in waiters {
                // An asker that left in the meantime is no error.
                let _ = waiter.answer.send(answer.clone());
            }
        }
    }

    /// Encodes a frame and caches it; makes the chunk before that if this is the first of its frames.
    fn make(&self, key: ChunkKey, delivery: Delivery, chunk: &mut Option<Chunk>) -> Answer {
        let (started, is_first) = (Instant::now(), chunk.is_none());
        // A queue that is half full is a server that falls behind: its time is worth more than the bytes.
        let effort = if self.lock().jobs.len() * 2 > self.limit { Effort::Fast } else { Effort::Compact };
        let encoded = catch_unwind(AssertUnwindSafe(|| {
            let chunk = chunk.get_or_insert_with(|| self.source.chunk(key, self.known_error(key)));
            chunk_codec::encode_with(delivery, effort, chunk, &self.world)
        }));
        let Ok(frame) = encoded else {
            self.metrics.failed.inc();
            tracing::error!(%key, %delivery, "generation panicked");
            return Err(GenerationError::Failed);
        };
        if is_first {
            self.metrics.generation_seconds.observe(started.elapsed().as_secs_f64());
            self.metrics.generated.inc();
        }
        self.cache.insert((key, delivery), frame.clone());
        Ok(frame)
    }

    /// The error of a chunk that was made before and is still cached for some delivery.
    fn known_error(&self, key: ChunkKey) -> Option<u32> {
        // A peek: this use of a frame is no reason to keep it.
        let frame = [Delivery::Exact, Delivery::SeedOnly]
            .into_iter()
            .find_map(|delivery| self.cache.peek(&(key, delivery)))?;
        chunk_codec::error(&frame)
    }

    /// Takes those askers off a job that wait for the same delivery as its first. When nobody waits any more there is none,
    /// and the job is gone.
    fn next_delivery(&self, key: ChunkKey) -> Option<(Delivery, Vec<Waiter>)> {
        let mut queue = self.lock();
        let job = queue.jobs.get_mut(&key)?;
        let Some(delivery) = job.waiters.first().map(|waiter| waiter.delivery) else {
            queue.jobs.remove(&key);
            self.metrics.queue.set(queue.jobs.len() as i64);
            return None;
        };
        let waiters = std::mem::take(&mut job.waiters);
        let (now, later) = waiters.into_iter().partition(|waiter| waiter.delivery == delivery);
        job.waiters = later;
        Some((delivery, now))
    }

    /// Takes the most urgent job that somebody waits for and drops those that nobody does.
    fn take(&self) -> Option<ChunkKey> {
        let mut queue = self.lock();
        while let Some((_, key)) = queue.order.pop() {
            let Some(job) = queue.jobs.get_mut(&key).filter(|job| !job.running) else { continue };
            job.waiters.retain(|waiter| !waiter.answer.is_closed());
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
    use protocol::limits::SEED_ONLY_FRAME;
    use std::sync::mpsc;
    use std::time::Duration;
    use terrain::GrassSeed;
    use terrain::constants::VERTEX_COUNT;

    /// A source that waits for a permit before each frame and reports what it made.
    struct Gated {
        permits: Mutex<mpsc::Receiver<()>>,
        made: Mutex<mpsc::Sender<ChunkKey>>,
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
    const MEASURED: u32 = 70;

    /// Length of the exact frame of a flat chunk.
    fn flat_frame() -> usize {
        let grass = GrassSeed { seed: 0, palette: 0, density: Box::new([0; 256]) };
        let chunk = Chunk::from_parts(key(1), Box::new([0; VERTEX_COUNT]), MEASURED, grass);
        chunk_codec::encode(&chunk, &WorldDigest([7; 32])).len()
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
    async fn ask(service: &Generation, key: ChunkKey, priority: u64) -> tokio::task::JoinHandle<Answer> {
        ask_for(service, key, Delivery::Exact, priority).await
    }

    /// As [`ask`], for a delivery.
    async fn ask_for(
        service: &Generation,
        key: ChunkKey,
        delivery: Delivery,
        priority: u64,
    ) -> tokio::task::JoinHandle<Answer> {
        let (before, service) = (service.shared.metrics.requested.get(), service.clone());
        let metrics = Arc::clone(&service.shared.metrics);
        let task = tokio::spawn(async move { service.frame(key, delivery, priority).await });
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
            assert_eq!(other.await.unwrap().unwrap().len(), flat_frame());
        }
        assert_eq!(bench.metrics.generated.get(), 1);
        assert!(bench.service.cached(key(1), Delivery::Exact).is_some());
    }

    #[tokio::test]
    async fn both_deliveries_of_a_key_share_one_job_and_only_what_is_asked_for_is_encoded() {
        let bench = bench(1 << 20, 10);
        let exact = ask(&bench.service, key(1), 1).await;
        let seed = ask_for(&bench.service, key(1), Delivery::SeedOnly, 1).await;
        bench.permit.send(()).unwrap();
        assert_eq!(exact.await.unwrap().unwrap().len(), flat_frame());
        assert_eq!(seed.await.unwrap().unwrap().len(), SEED_ONLY_FRAME);
        assert_eq!(bench.metrics.generated.get(), 1);
        assert_eq!(bench.metrics.coalesced.get(), 1);

        bench.permit.send(()).unwrap();
        bench.service.frame(key(2), Delivery::SeedOnly, 1).await.unwrap();
        assert!(bench.service.cached(key(2), Delivery::SeedOnly).is_some());
        assert!(bench.service.cached(key(2), Delivery::Exact).is_none());
    }

    #[tokio::test]
    async fn another_delivery_of_a_cached_chunk_takes_the_error_from_the_cached_frame() {
        let bench = bench(1 << 20, 10);
        for (x, first, second) in
            [(1, Delivery::Exact, Delivery::SeedOnly), (2, Delivery::SeedOnly, Delivery::Exact)]
        {
            for (delivery, error) in [(first, MEASURED), (second, MEASURED + 1)] {
                bench.permit.send(()).unwrap();
                let frame = bench.service.frame(key(x), delivery, 1).await.unwrap();
                assert_eq!(chunk_codec::error(&frame), Some(error), "{delivery} of {x}");
                // Until the job is gone a further asker would share its chunk instead.
                while bench.service.load() > 0.0 {
                    tokio::task::yield_now().await;
                }
            }
        }
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
        assert_eq!(bench.service.frame(key(2), Delivery::Exact, 99).await, Err(GenerationError::Overloaded));
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
        let budget = 10 * (flat_frame() as u64 + 128);
        let bench = bench(budget, 100);
        for x in 0..50 {
            bench.permit.send(()).unwrap();
            bench.service.frame(key(x), Delivery::Exact, 1).await.unwrap();
        }
        assert!(bench.service.shared.cache.weight() <= budget);
        assert!(bench.service.shared.cache.len() < 50);
    }
}
