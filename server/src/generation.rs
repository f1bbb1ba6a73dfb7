//! The generation service: one job per key however many ask, on a pool of compute threads behind a bounded, fair queue.
//!
//! A chunk has one frame per delivery. A job makes the chunk once and encodes only the frames that somebody waits for: a
//! server whose clients all regenerate spends neither time nor cache on exact frames a hundred times the size. When another
//! delivery of a cached chunk is asked for later, the heights are made again but the error, the costly part, is taken from the
//! cached frame.
//!
//! Askers are [`Flow`]s: a session is one, a download another. A thread takes one flow's turn at a time ([`queue`]), which is several
//! cheap chunks or one dear one, and answers it as a whole, so that a session wakes and writes once for all of them. A job belongs
//! to the service, never to the asker, so an asker that vanishes harms nobody else; a queued job that nobody waits for any more is
//! dropped unrun. Finished frames go into a byte-weighed cache before the job disappears, so a key is never made twice at the same
//! time.

pub mod cost;
pub mod queue;

use crate::metrics::Metrics;
use crate::source::ChunkSource;
use bytes::Bytes;
use cost::Costs;
use protocol::chunk_codec::Effort;
use protocol::server::Wanted;
use protocol::{Delivery, chunk_codec};
use queue::{Asked, FlowId, Queue, Waiter};
use quick_cache::Weighter;
use quick_cache::sync::Cache;
use rayon::{ThreadPool, ThreadPoolBuildError, ThreadPoolBuilder};
use rustc_hash::FxHashMap;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::atomic::{AtomicU64, AtomicUsize, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};
use terrain::{Chunk, ChunkKey, WorldDigest};
use thiserror::Error;
use tokio::sync::mpsc::{UnboundedReceiver, UnboundedSender, unbounded_channel};

/// Time in which every waiting flow should have had a turn, microseconds of work.
const ROUND_US: i64 = 4000;

/// Bounds of the work that a flow gets done in one turn, microseconds. At least two cheap chunks or so, since each turn wakes a session
/// and makes it write; at most some ten, since they are answered together.
const QUANTUM_US: (i64, i64) = (80, 400);

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
    /// Jobs that may wait or run. Asking for one more is refused with [`GenerationError::Overloaded`].
    pub jobs: usize,
    /// Longest wait of a request. One that has waited longer is refused instead of made: its asker has moved on.
    pub deadline: Duration,
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

/// An answer with the asking that it answers.
pub type Done = (Wanted, Answer);

struct Shared {
    source: Box<dyn ChunkSource>,
    world: WorldDigest,
    cache: Cache<FrameId, Bytes, FrameWeight>,
    /// A std mutex: held for map operations only, never across an await or a generation.
    queue: Mutex<Queue>,
    costs: Costs,
    limits: Limits,
    next_flow: AtomicU64,
    /// Flows that wait for something: those that share the threads, whether or not a thread has just emptied their queue.
    open_flows: AtomicUsize,
    metrics: Arc<Metrics>,
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
    /// A service over a source.
    ///
    /// # Errors
    /// The system refuses to start threads.
    pub fn new(
        source: impl ChunkSource,
        limits: Limits,
        metrics: Arc<Metrics>,
    ) -> Result<Self, ThreadPoolBuildError> {
        let pool = ThreadPoolBuilder::new()
            .num_threads(limits.threads)
            .thread_name(|n| format!("generate-{n}"))
            .build()?;
        // About 4 KiB an exact frame; the estimate only sizes the first tables.
        let cache =
            Cache::with_weighter((limits.cache_bytes / 4096) as usize, limits.cache_bytes, FrameWeight);
        let shared = Shared {
            world: source.world(),
            source: Box::new(source),
            cache,
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
        let frame = self.shared.cache.get(&(key, delivery))?;
        self.shared.metrics.requested.inc();
        self.shared.metrics.cache_hits.inc();
        Some(frame)
    }

    /// A new asker. Dropping it withdraws everything that it waits for.
    #[must_use]
    pub fn flow(&self) -> Flow {
        let (answers, answered) = unbounded_channel();
        let id = self.shared.next_flow.fetch_add(1, Ordering::Relaxed);
        Flow { service: self.clone(), id, answers, answered, open: 0 }
    }

    /// One frame for an asker that wants no other. Dropping the future withdraws the interest.
    ///
    /// # Errors
    /// See [`GenerationError`].
    pub async fn frame(&self, wanted: Wanted, delivery: Delivery) -> Result<Bytes, GenerationError> {
        if let Some(frame) = self.cached(wanted.key, delivery) {
            return Ok(frame);
        }
        let mut flow = self.flow();
        flow.ask(wanted, delivery);
        // One asking, one answer.
        flow.answers().await.pop().map_or(Err(GenerationError::Failed), |(_, answer)| answer)
    }

    /// Further requests of one flow that can be made within the deadline, as far as the recent past tells. What exceeds it is
    /// better refused at once than after a wait.
    #[must_use]
    pub fn allowance(&self) -> usize {
        let Limits { threads, deadline, .. } = self.shared.limits;
        // Nothing waits: whatever the estimate, there is no reason to refuse.
        if self.shared.lock().waiting() == 0 {
            return usize::MAX;
        }
        // Half of it: the other half is for what the estimate leaves out, sessions that write and machines that are shared.
        self.shared.costs.within(deadline / 2, threads, self.shared.open_flows.load(Ordering::Relaxed))
    }

    /// Share of the queue in use, 0 to 1.
    #[must_use]
    pub fn load(&self) -> f64 {
        let (jobs, limit) = (self.shared.lock().jobs(), self.shared.limits.jobs);
        // A queue that takes nothing is full.
        if jobs >= limit { 1.0 } else { jobs as f64 / limit as f64 }
    }
}

/// One asker: a session or a download. Work is shared fairly between flows.
pub struct Flow {
    service: Generation,
    id: FlowId,
    /// Cloned into every asking.
    answers: UnboundedSender<Vec<Done>>,
    /// Holds at most one answer for each asking, so whoever bounds the askings bounds this.
    answered: UnboundedReceiver<Vec<Done>>,
    /// Askings without an answer taken.
    open: usize,
}

impl Flow {
    /// Asks for a frame. The answer, exactly one, comes from [`Flow::answers`], unless the asking is withdrawn.
    pub fn ask(&mut self, wanted: Wanted, delivery: Delivery) {
        self.opened(1);
        let Shared { cache, metrics, costs, limits, .. } = &*self.service.shared;
        metrics.requested.inc();
        let mut queue = self.service.shared.lock();
        // Under the lock: a job leaves the queue only after its frames are in the cache.
        if let Some(frame) = cache.get(&(wanted.key, delivery)) {
            metrics.cache_hits.inc();
            self.answer_now(wanted, Ok(frame));
            return;
        }
        let (since, answers) = (Instant::now(), self.answers.clone());
        let waiter = Waiter { flow: self.id, wanted, delivery, since, answers };
        match queue.ask(waiter, costs.expected_us(wanted.key)) {
            Asked::Joined => {
                metrics.coalesced.inc();
            }
            Asked::Full => {
                metrics.shed.inc();
                self.answer_now(wanted, Err(GenerationError::Overloaded));
            }
            Asked::Queued => {
                metrics.queue.set(queue.jobs() as i64);
                if queue.runners < limits.threads {
                    // A runner takes turns until nothing waits, so there are never more of them than threads.
                    queue.runners += 1;
                    let shared = Arc::clone(&self.service.shared);
                    self.service.pool.spawn(move || shared.run());
                }
            }
        }
    }

    fn opened(&mut self, count: usize) {
        if self.open == 0 && count > 0 {
            self.service.shared.open_flows.fetch_add(1, Ordering::Relaxed);
        }
        self.open += count;
    }

    fn closed(&mut self, count: usize) {
        self.open -= count;
        if self.open == 0 && count > 0 {
            self.service.shared.open_flows.fetch_sub(1, Ordering::Relaxed);
        }
    }

    fn answer_now(&self, wanted: Wanted, answer: Answer) {
        // The receiver is in this very flow.
        let _ = self.answers.send(vec![(wanted, answer)]);
    }

    /// Waits for the next answers, at least one; for ever while nothing is asked. Cancel safe.
    pub async fn answers(&mut self) -> Vec<Done> {
        loop {
            if let Some(done) = self.answered.recv().await {
                self.closed(done.len());
                return done;
            }
            // Unreachable: this flow holds a sender itself.
            std::future::pending::<()>().await;
        }
    }

    /// The next answers if they are there.
    pub fn try_answers(&mut self) -> Option<Vec<Done>> {
        let done = self.answered.try_recv().ok()?;
        self.closed(done.len());
        Some(done)
    }

    /// Askings without an answer taken.
    #[must_use]
    pub const fn open(&self) -> usize {
        self.open
    }

    /// Withdraws the askings for a key that no thread has taken up, and returns them; the others will be answered.
    pub fn withdraw(&mut self, key: ChunkKey) -> Vec<Wanted> {
        let withdrawn = self.service.shared.lock().withdraw(self.id, key);
        self.closed(withdrawn.len());
        self.service.shared.metrics.cancelled.inc_by(withdrawn.len() as u64);
        withdrawn
    }
}

impl Drop for Flow {
    fn drop(&mut self) {
        if self.open > 0 {
            let dropped = self.service.shared.lock().forget(self.id);
            self.service.shared.metrics.cancelled.inc_by(dropped);
            self.closed(self.open);
        }
    }
}

/// What a runner holds of a job between making and answering.
struct Made {
    key: ChunkKey,
    answers: Vec<(Delivery, Answer)>,
}

impl Made {
    fn has(&self, delivery: Delivery) -> bool {
        self.answers.iter().any(|(made, _)| *made == delivery)
    }
}

impl Shared {
    /// Takes turns until nothing waits.
    fn run(&self) {
        let deadline = self.limits.deadline;
        loop {
            let turn = {
                let mut queue = self.lock();
                let turn = queue.take(self.quantum_us(), deadline, Instant::now());
                if turn.keys.is_empty() {
                    queue.runners -= 1;
                }
                self.metrics.queue.set(queue.jobs() as i64);
                turn
            };
            self.metrics.cancelled.inc_by(turn.dropped);
            self.metrics.expired.inc_by(turn.expired.len() as u64);
            for waiter in turn.expired {
                // An asker that left in the meantime is no error; the same below.
                let _ = waiter.answers.send(vec![(waiter.wanted, Err(GenerationError::Overloaded))]);
            }
            if turn.keys.is_empty() {
                return;
            }
            let made: Vec<Made> = turn.keys.into_iter().map(|key| self.run_job(key)).collect();
            self.answer(&made);
        }
    }

    /// Few flows get long turns, which cost less; many get short ones, so that none waits long for its own.
    fn quantum_us(&self) -> i64 {
        let flows = self.open_flows.load(Ordering::Relaxed).max(1) as i64;
        (ROUND_US / flows).clamp(QUANTUM_US.0, QUANTUM_US.1)
    }

    /// Makes what is asked for of a chunk; who asks for another form meanwhile is served by a further round.
    fn run_job(&self, key: ChunkKey) -> Made {
        // Dropped at the end of this job, so that the next one finds its memory warm.
        let mut chunk = None;
        let mut made = Made { key, answers: Vec::with_capacity(1) };
        while let Some(delivery) = { self.lock().missing(key, |delivery| made.has(delivery)) } {
            let answer = self.make(key, delivery, &mut chunk);
            made.answers.push((delivery, answer));
        }
        made
    }

    /// Encodes a frame and caches it; makes the chunk before that if this is the first of its frames.
    fn make(&self, key: ChunkKey, delivery: Delivery, chunk: &mut Option<Chunk>) -> Answer {
        let (started, is_first) = (Instant::now(), chunk.is_none());
        // A queue that is half full is a server that falls behind: its time is worth more than the bytes.
        let effort = if self.lock().jobs() * 2 > self.limits.jobs { Effort::Fast } else { Effort::Compact };
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
            let took = started.elapsed();
            self.costs.learn(key, took);
            self.metrics.generation_seconds.observe(took.as_secs_f64());
            self.metrics.generated.inc();
        }
        self.cache.insert((key, delivery), frame.clone());
        Ok(frame)
    }

    /// Answers a whole turn: each asker once, however many chunks it gets, since every answer may wake a session and cause a write.
    fn answer(&self, turn: &[Made]) {
        let mut askers: FxHashMap<FlowId, (UnboundedSender<Vec<Done>>, Vec<Done>)> = FxHashMap::default();
        {
            let mut queue = self.lock();
            for made in turn {
                for waiter in queue.finish(made.key, |delivery| made.has(delivery)) {
                    let answer = made.answers.iter().find(|(delivery, _)| *delivery == waiter.delivery);
                    let answer = answer.map_or(Err(GenerationError::Failed), |(_, answer)| answer.clone());
                    let (_, answers) = askers.entry(waiter.flow).or_insert((waiter.answers, Vec::new()));
                    answers.push((waiter.wanted, answer));
                }
            }
            self.metrics.queue.set(queue.jobs() as i64);
        }
        for (asker, answers) in askers.into_values() {
            let _ = asker.send(answers);
        }
    }

    /// The error of a chunk that was made before and is still cached for some delivery.
    fn known_error(&self, key: ChunkKey) -> Option<u32> {
        // A peek: this use of a frame is no reason to keep it.
        let frame = [Delivery::Exact, Delivery::SeedOnly]
            .into_iter()
            .find_map(|delivery| self.cache.peek(&(key, delivery)))?;
        chunk_codec::error(&frame)
    }

    fn lock(&self) -> MutexGuard<'_, Queue> {
        // No code under the lock can panic half-way through a change, so a poisoned queue is still sound.
        self.queue.lock().unwrap_or_else(PoisonError::into_inner)
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

    fn wanted(key: ChunkKey, priority: u64) -> Wanted {
        Wanted { key, request: None, priority }
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
        let limits = Limits { threads: 1, cache_bytes, jobs: limit, deadline: Duration::from_secs(3600) };
        let service = Generation::new(source, limits, Arc::clone(&metrics)).unwrap();
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
        let task = tokio::spawn(async move { service.frame(wanted(key, priority), delivery).await });
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
        bench.service.frame(wanted(key(2), 1), Delivery::SeedOnly).await.unwrap();
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
                let frame = bench.service.frame(wanted(key(x), 1), delivery).await.unwrap();
                assert_eq!(chunk_codec::error(&frame), Some(error), "{delivery} of {x}");
                // Until the job is gone a further asker would share its chunk instead.
                while bench.service.load() > 0.0 {
                    tokio::task::yield_now().await;
                }
            }
        }
    }

    #[tokio::test]
    async fn a_flow_gets_its_most_urgent_chunk_first_and_every_asking_is_answered_once() {
        let bench = bench(1 << 20, 10);
        let mut flow = bench.service.flow();
        flow.ask(wanted(key(0), 0), Delivery::Exact);
        // Let the only thread take the first job, so that the order of the rest is the queue's.
        while !bench.service.shared.lock().is_running(key(0)) {
            tokio::task::yield_now().await;
        }
        for (x, priority) in [(1, 10), (2, 30), (3, 20), (1, 40)] {
            flow.ask(wanted(key(x), priority), Delivery::Exact);
        }
        assert_eq!(flow.open(), 5);
        for _ in 0..4 {
            bench.permit.send(()).unwrap();
        }
        let mut answers = Vec::new();
        while flow.open() > 0 {
            for (wanted, answer) in flow.answers().await {
                assert!(answer.is_ok());
                answers.push(wanted.key.x());
            }
        }
        answers.sort_unstable();
        assert_eq!(answers, [0, 1, 1, 2, 3]);
        assert_eq!(bench.made.try_iter().collect::<Vec<_>>(), [0, 1, 2, 3].map(key));
    }

    #[tokio::test]
    async fn a_hundred_thousand_askers_that_hang_up_harm_nobody() {
        let bench = bench(1 << 20, 10);
        let blocker = ask(&bench.service, key(0), 1).await;
        while !bench.service.shared.lock().is_running(key(0)) {
            tokio::task::yield_now().await;
        }
        let mut patient = bench.service.flow();
        patient.ask(wanted(key(1), 1), Delivery::Exact);
        for _ in 0..100_000 {
            let mut flow = bench.service.flow();
            flow.ask(wanted(key(1), 1), Delivery::Exact);
            flow.ask(wanted(key(2), 1), Delivery::Exact);
        }
        bench.permit.send(()).unwrap();
        bench.permit.send(()).unwrap();
        assert!(patient.answers().await[0].1.is_ok());
        assert!(blocker.await.unwrap().is_ok());
        assert_eq!(bench.made.try_iter().collect::<Vec<_>>(), [0, 1].map(key));
        assert_eq!(bench.metrics.cancelled.get(), 100_000);
        drop(patient);
        assert_eq!(bench.service.shared.open_flows.load(Ordering::Relaxed), 0);
    }

    #[tokio::test]
    async fn a_withdrawn_asking_is_not_answered_and_not_made() {
        let bench = bench(1 << 20, 10);
        let mut flow = bench.service.flow();
        flow.ask(wanted(key(0), 9), Delivery::Exact);
        while !bench.service.shared.lock().is_running(key(0)) {
            tokio::task::yield_now().await;
        }
        flow.ask(wanted(key(1), 1), Delivery::Exact);
        assert_eq!(flow.withdraw(key(0)), [], "it is being made");
        assert_eq!(flow.withdraw(key(1)), [wanted(key(1), 1)]);
        bench.permit.send(()).unwrap();
        assert_eq!(flow.answers().await[0].0.key, key(0));
        assert_eq!((flow.open(), flow.try_answers().is_none()), (0, true));
    }

    #[tokio::test]
    async fn a_request_that_waited_beyond_the_deadline_is_refused_and_not_made() {
        let (permit, permits) = mpsc::channel();
        let (made_sender, made) = mpsc::channel();
        let source = Gated { permits: Mutex::new(permits), made: Mutex::new(made_sender) };
        let limits = Limits { threads: 1, cache_bytes: 1 << 20, jobs: 10, deadline: Duration::ZERO };
        let metrics = Arc::new(Metrics::default());
        let service = Generation::new(source, limits, Arc::clone(&metrics)).unwrap();
        let mut flow = service.flow();
        // What a view needs has no deadline, and holds the thread.
        flow.ask(wanted(key(0), 9), Delivery::Exact);
        while !service.shared.lock().is_running(key(0)) {
            tokio::task::yield_now().await;
        }
        flow.ask(Wanted { request: Some(7), ..wanted(key(1), 9) }, Delivery::Exact);
        permit.send(()).unwrap();
        assert_eq!(flow.answers().await[0].0.key, key(0));
        assert_eq!(flow.answers().await[0].1, Err(GenerationError::Overloaded));
        assert_eq!((made.try_iter().count(), metrics.expired.get()), (1, 1));
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
            bench.service.frame(wanted(key(2), 99), Delivery::Exact).await,
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
            bench.service.frame(wanted(key(x), 1), Delivery::Exact).await.unwrap();
        }
        assert!(bench.service.shared.cache.weight() <= budget);
        assert!(bench.service.shared.cache.len() < 50);
    }
}
