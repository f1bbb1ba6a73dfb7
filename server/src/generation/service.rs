//! The handle of the generation service.

use super::active::ActiveFlows;
use super::cost::JobCosts;
use super::flow::Flow;
use super::queue::{FlowId, FlowPath, Queue};
use super::runner;
use super::shared::{Limits, Shared};
use super::threads::{Executor, Mutex, Threads};
use super::work_time::{SystemClock, WorkClock};
use crate::cache::disk::Disk;
use crate::cache::memory::FrameCache;
use crate::limits::rate_limit::TokenBucket;
use crate::mechanism::Mechanism;
use crate::memory::heaps;
use crate::metrics::Metrics;
use crate::source::ChunkSource;
use crate::store::Store;
use bytes::Bytes;
use futures_util::future::{OptionFuture, join};
use protocol::Delivery;
use rayon::ThreadPoolBuildError;
use std::net::IpAddr;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::{Duration, Instant};
use terrain::ChunkKey;

/// Generates, caches and shares chunk frames. Clones share one service.
#[derive(Clone)]
pub struct Generation {
    pub(super) shared: Arc<Shared>,
    threads: Arc<dyn Executor>,
}

impl Generation {
    /// A service over a source, with a memory cache only.
    ///
    /// # Errors
    /// The system cannot start threads.
    pub fn new(
        source: impl ChunkSource,
        limits: Limits,
        metrics: Arc<Metrics>,
    ) -> Result<Self, ThreadPoolBuildError> {
        Self::with_disk(source, limits, None, metrics)
    }

    /// As [`Generation::new`], with a disk cache that is read before a chunk is generated.
    ///
    /// # Errors
    /// The system cannot start threads.
    pub fn with_disk(
        source: impl ChunkSource,
        limits: Limits,
        disk: Option<Disk>,
        metrics: Arc<Metrics>,
    ) -> Result<Self, ThreadPoolBuildError> {
        Self::with_stores(source, limits, disk, None, metrics)
    }

    /// As [`Generation::with_disk`], with a shared store that is read after the disk cache.
    ///
    /// # Errors
    /// The system cannot start threads.
    pub fn with_stores(
        source: impl ChunkSource,
        limits: Limits,
        disk: Option<Disk>,
        store: Option<Store>,
        metrics: Arc<Metrics>,
    ) -> Result<Self, ThreadPoolBuildError> {
        let threads = Arc::new(Threads::start(limits.threads)?);
        Ok(Self::with_parts(source, limits, (disk, store), threads, SystemClock::default(), metrics))
    }

    /// A service with a memory cache only, whose turns run on an executor with a clock: for
    /// simulations. At most `limits.threads` runners at once.
    #[must_use]
    pub fn on(
        threads: Arc<dyn Executor>,
        clock: impl WorkClock,
        source: impl ChunkSource,
        limits: Limits,
        metrics: Arc<Metrics>,
    ) -> Self {
        Self::with_parts(source, limits, (None, None), threads, clock, metrics)
    }

    fn with_parts(
        source: impl ChunkSource,
        limits: Limits,
        (disk, store): (Option<Disk>, Option<Store>),
        threads: Arc<dyn Executor>,
        clock: impl WorkClock,
        metrics: Arc<Metrics>,
    ) -> Self {
        let queue = Queue::new(limits.jobs);
        let has_turns = limits.without != Some(Mechanism::Turns);
        let queue = if has_turns { queue } else { queue.first_in_first_out() };
        let shared = Shared {
            world: source.world(),
            source: Box::new(source),
            frames: FrameCache::new(limits.cache_bytes),
            disk,
            store,
            queue: Mutex::new(queue),
            costs: JobCosts::default(),
            clock: Box::new(clock),
            limits,
            next_flow: AtomicU64::new(0),
            active: ActiveFlows::default(),
            paused: ActiveFlows::default(),
            metrics,
        };
        Self { shared: Arc::new(shared), threads }
    }

    /// The cached frame of a key for a delivery; counts a request only on a hit.
    #[must_use]
    pub fn cached(&self, key: ChunkKey, delivery: Delivery) -> Option<Bytes> {
        self.shared.cached(self.shared.current(key), delivery, false)
    }

    /// A new flow of a site of its own, without a rate limit. Dropping it cancels its requests.
    #[must_use]
    pub fn flow(&self) -> Flow {
        self.session(None, TokenBucket::default())
    }

    /// A flow of a session, with its work charged to a token bucket: one of its client's site.
    /// Without a client it is a site of its own.
    #[must_use]
    pub fn session(&self, client: Option<IpAddr>, bucket: TokenBucket) -> Flow {
        let id = self.next_flow();
        let site = client.map_or(id, |client| self.shared.active.site_of(client));
        self.flow_with(id, FlowPath { site, flow: id }, bucket)
    }

    /// A flow of an HTTP request: all of a client network take the turns of one flow.
    #[must_use]
    pub fn download(&self, client: Option<IpAddr>, bucket: TokenBucket) -> Flow {
        let id = self.next_flow();
        let own = FlowPath { site: id, flow: id };
        let turns = client.map_or(own, |client| self.shared.active.downloads_of(client));
        self.flow_with(id, turns, bucket)
    }

    fn next_flow(&self) -> FlowId {
        self.shared.next_flow.fetch_add(1, Ordering::Relaxed)
    }

    fn flow_with(&self, id: FlowId, turns: FlowPath, bucket: TokenBucket) -> Flow {
        Flow::new(Arc::clone(&self.shared), Arc::clone(&self.threads), id, turns, bucket)
    }

    /// Further requests that a flow can complete within the deadline, by the recent job costs.
    /// The caller rejects the rest at once, which is better than after a wait.
    #[must_use]
    pub fn allowance(&self, flow: &Flow) -> usize {
        let Limits { threads, deadline, .. } = self.shared.limits;
        // An empty queue is no reason to reject, regardless of the estimate.
        if self.shared.lock().waiting() == 0 {
            return usize::MAX;
        }
        // Half of the deadline: the estimate leaves out the time of writes and of other processes.
        self.shared.costs.jobs_within(deadline / 2, threads, self.shared.active.shares(flow.turns()))
    }

    /// Longest wait of an explicit request.
    #[must_use]
    pub fn deadline(&self) -> Duration {
        self.shared.limits.deadline
    }

    /// Equal shares of a thread of which a flow has one, at least 1: by the flows with requests or
    /// by those of paused sessions, whichever is more.
    #[must_use]
    pub fn sharers(&self, flow: &Flow) -> usize {
        let Shared { active, paused, limits, .. } = &*self.shared;
        active.shares(flow.turns()).max(paused.shares(flow.turns())).div_ceil(limits.threads)
    }

    /// Stops the selection of views, whose tables take memory, or has it go on. Drops those of
    /// sessions that have ended. Returns how many go on.
    pub fn stop_views(&self, is_stopped: bool) -> usize {
        let mut queue = self.shared.lock();
        let ended = queue.take_ended_views();
        let count = queue.stop_views(is_stopped);
        for _ in 0..count.min(self.shared.limits.threads) {
            runner::start(&self.shared, &*self.threads, &mut queue);
        }
        drop(queue);
        drop(ended);
        count
    }

    /// Drops all frames that are cached in memory.
    pub fn clear_cache(&self) {
        self.shared.frames.clear();
    }

    /// Has each generation thread return the free pages of its heap after its turn, if that is
    /// requested.
    pub fn return_pages(&self) {
        self.threads.broadcast(|| _ = heaps::return_if_requested());
    }

    /// Waits a bounded time for the pending writes and releases the folder of the disk cache. For
    /// shutdown.
    pub async fn close(&self) {
        let disk = OptionFuture::from(self.shared.disk.as_ref().map(Disk::close));
        let store = OptionFuture::from(self.shared.store.as_ref().map(Store::close));
        join(disk, store).await;
    }

    /// Whether it is known which chunks the store has baked, as far as that is waited for.
    #[must_use]
    pub fn is_ready(&self) -> bool {
        self.shared.store.as_ref().is_none_or(|store| store.is_ready(Instant::now()))
    }

    /// Share of the queue in use, 0 to 1.
    #[must_use]
    pub fn load(&self) -> f64 {
        let (jobs, limit) = (self.shared.lock().jobs(), self.shared.limits.jobs);
        // A queue without capacity is full.
        if jobs >= limit { 1.0 } else { jobs as f64 / limit as f64 }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::chunk_id::ChunkId;
    use crate::generation::GenerationError;
    use crate::generation::test_source::{
        chunk_request, fixture, fixture_with_deadline, flat_frame_bytes, key, request,
    };

    #[tokio::test]
    async fn requests_of_one_key_share_a_job_even_if_the_first_is_aborted() {
        let fixture = fixture(1 << 20, 10);
        let first = request(&fixture.service, key(1), 1).await;
        let mut others = Vec::new();
        for _ in 0..100 {
            others.push(request(&fixture.service, key(1), 1).await);
        }
        first.abort();
        fixture.permit.send(()).unwrap();
        for other in others {
            assert_eq!(other.await.unwrap().unwrap().len(), flat_frame_bytes());
        }
        assert_eq!(fixture.metrics.generation.jobs_completed.get(), 1);
        assert!(fixture.service.cached(key(1), Delivery::Exact).is_some());
        fixture.service.clear_cache();
        assert!(fixture.service.cached(key(1), Delivery::Exact).is_none());
    }

    #[tokio::test]
    async fn a_full_queue_rejects_and_a_job_without_requests_never_runs() {
        let fixture = fixture(1 << 20, 2);
        let running = request(&fixture.service, key(0), 9).await;
        while !fixture.service.shared.lock().is_running(ChunkId::base(key(0))) {
            tokio::task::yield_now().await;
        }
        let abandoned = request(&fixture.service, key(1), 1).await;
        assert_eq!(
            fixture.service.flow().frame(chunk_request(key(2), 99), Delivery::Exact).await,
            Err(GenerationError::Overloaded)
        );
        assert_eq!(fixture.metrics.generation.rejected.get(), 1);
        abandoned.abort();
        let _ = abandoned.await;
        fixture.permit.send(()).unwrap();
        running.await.unwrap().unwrap();
        while fixture.metrics.generation.jobs_cancelled.get() == 0 {
            tokio::time::sleep(Duration::from_millis(1)).await;
        }
        assert_eq!(fixture.metrics.generation.jobs_completed.get(), 1);
        assert!(fixture.service.load() < 0.01);
    }

    /// Without a waiting request nothing is rejected; with one, as many are allowed as jobs end
    /// within half of the deadline, shared between the flows.
    #[tokio::test]
    async fn the_allowance_is_a_share_of_what_ends_within_half_of_the_deadline() {
        let fixture = fixture_with_deadline(1 << 20, 10, Duration::from_millis(500));
        let flow = fixture.service.flow();
        assert_eq!(fixture.service.allowance(&flow), usize::MAX);
        let running = request(&fixture.service, key(0), 9).await;
        while !fixture.service.shared.lock().is_running(ChunkId::base(key(0))) {
            tokio::task::yield_now().await;
        }
        assert_eq!(fixture.service.allowance(&flow), usize::MAX, "one is made, none waits");
        let waiting = request(&fixture.service, key(1), 1).await;
        // 250 ms of one thread, at the first estimate of 0.1 ms a job, for two flows.
        assert_eq!(fixture.service.allowance(&flow), 1250);
        for _ in 0..2 {
            fixture.permit.send(()).unwrap();
        }
        running.await.unwrap().unwrap();
        waiting.await.unwrap().unwrap();
    }
}
