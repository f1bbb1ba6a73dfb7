//! Requests of one client of the service: a session or a download.
//!
//! Every request has exactly one result or is cancelled. Dropping a flow cancels its requests.

use super::queue::{Charge, Enqueued, FlowId, FlowPath, FrameRequest};
use super::result::{Completion, FrameResult, GenerationError};
use super::runner;
use super::shared::Shared;
use super::threads::Threads;
use super::views::ViewJob;
use crate::chunk_id::ChunkId;
use crate::limits::rate_limit::TokenBucket;
use crate::memory::room::ViewRoom;
use crate::traces::{self, RequestTrace};
use bytes::Bytes;
use protocol::Delivery;
use protocol::server::ChunkRequest;
use protocol::server::ViewSelection;
use std::sync::Arc;
use std::time::{Duration, Instant};
use terrain::{ChunkKey, Land};
use tokio::sync::mpsc::{UnboundedReceiver, UnboundedSender, unbounded_channel};
use tokio::sync::oneshot;

/// A result for a flow.
#[derive(Debug)]
pub enum FlowEvent {
    /// Results of chunk requests.
    Chunks(Vec<Completion>),
    /// A finished selection.
    View(Box<ViewSelection>),
    /// The selection panicked; the panic was logged.
    ViewFailed,
}

/// The state of a flow that takes the turns of others.
#[derive(Debug)]
struct Download {
    /// Its own number.
    id: FlowId,
    /// Chunks that it has requested: one, or those of a tile.
    requested: Vec<ChunkId>,
}

/// One client of the service. The threads are shared fairly between flows.
pub struct Flow {
    pub(super) shared: Arc<Shared>,
    threads: Arc<Threads>,
    /// Whose turns it takes: its own, or those of all downloads of a client network.
    turns: FlowPath,
    /// Of an HTTP request. Boxed: sessions have none.
    download: Option<Box<Download>>,
    /// Cloned into every request.
    pub(super) sender: UnboundedSender<Vec<Completion>>,
    /// Holds at most one result per request, so the caller's bound on requests bounds it.
    pub(super) receiver: UnboundedReceiver<Vec<Completion>>,
    /// Receives the selection of the view job in flight; a session has one at a time. Not a queue:
    /// its first block has places for 32 selections, 25 KiB, and an idle flow would hold it too.
    selection: Option<oneshot::Receiver<ViewSelection>>,
    /// Requests without a received result, a view job included.
    open: u32,
    /// Whether it is counted as the flow of a paused session.
    is_paused: bool,
    /// Whether it takes no frame in the fast encoding.
    must_be_compact: bool,
    /// Charged for generation and bytes sent. The caller checks it before a request.
    bucket: TokenBucket,
}

impl Flow {
    pub(super) fn new(
        shared: Arc<Shared>,
        threads: Arc<Threads>,
        id: FlowId,
        turns: FlowPath,
        bucket: TokenBucket,
    ) -> Self {
        let (sender, receiver) = unbounded_channel();
        Self {
            shared,
            threads,
            turns,
            download: (turns.flow != id).then(|| Box::new(Download { id, requested: Vec::new() })),
            sender,
            receiver,
            selection: None,
            open: 0,
            is_paused: false,
            must_be_compact: false,
            bucket,
        }
    }

    /// The flow, with compact frames only: the same bytes whenever and wherever they are encoded.
    #[must_use]
    pub fn compact(mut self) -> Self {
        self.must_be_compact = true;
        self
    }

    /// One frame, for a client that requests no other. Dropping the future cancels the request.
    ///
    /// # Errors
    /// See [`GenerationError`].
    pub async fn frame(self, chunk: ChunkRequest, delivery: Delivery) -> Result<Bytes, GenerationError> {
        let id = self.shared.current(chunk.key);
        self.frame_of(id, chunk, delivery).await
    }

    /// As [`Flow::frame`], of the land that the seed makes, whatever changed the chunk since.
    ///
    /// # Errors
    /// See [`GenerationError`].
    pub async fn base_frame(self, chunk: ChunkRequest, delivery: Delivery) -> Result<Bytes, GenerationError> {
        self.frame_of(ChunkId::base(chunk.key), chunk, delivery).await
    }

    async fn frame_of(
        mut self,
        id: ChunkId,
        chunk: ChunkRequest,
        delivery: Delivery,
    ) -> Result<Bytes, GenerationError> {
        if let Some(frame) = self.cached_frame(id, delivery) {
            traces::current().record("origin", "memory");
            return Ok(frame);
        }
        self.request_frame(id, chunk, delivery);
        // One request, one result.
        self.completions().await.pop().map_or(Err(GenerationError::Failed), |(_, result)| result)
    }

    /// The cached frame of a key for a delivery, charged by its bytes.
    #[must_use]
    pub fn cached(&self, key: ChunkKey, delivery: Delivery) -> Option<Bytes> {
        self.cached_frame(self.shared.current(key), delivery)
    }

    fn cached_frame(&self, id: ChunkId, delivery: Delivery) -> Option<Bytes> {
        let frame = self.shared.cached(id, delivery, self.must_be_compact)?;
        self.charge_bytes(frame.len());
        Some(frame)
    }

    /// The bucket that is charged.
    #[must_use]
    pub const fn bucket(&self) -> &TokenBucket {
        &self.bucket
    }

    fn charge_bytes(&self, bytes: usize) {
        if self.bucket.is_limited() {
            self.bucket.charge_bytes(bytes, tokio::time::Instant::now());
        }
    }

    /// Requests a frame of the chunk that the key names now. [`Flow::completions`] returns exactly
    /// one result, unless the request is cancelled.
    pub fn request(&mut self, chunk: ChunkRequest, delivery: Delivery) {
        self.request_frame(self.shared.current(chunk.key), chunk, delivery);
    }

    fn request_frame(&mut self, id: ChunkId, chunk: ChunkRequest, delivery: Delivery) {
        self.add_open(1);
        let Shared { frames, metrics, costs, .. } = &*self.shared;
        let trace = RequestTrace::current();
        let mut queue = self.shared.lock();
        // Under the lock: a job leaves the queue only after its frames are in the cache.
        if let Some(frame) = frames.get(id, delivery, || self.must_be_compact || queue.jobs() == 0) {
            metrics.generation.cache_hits.inc();
            trace.chunk.record("origin", "memory");
            self.complete(chunk, Ok(frame));
            return;
        }
        let (since, sender) = (Instant::now(), self.sender.clone());
        let must_be_compact = self.must_be_compact;
        let (flow, turns, bucket) = (self.id(), self.turns, self.bucket.clone());
        let request =
            FrameRequest { flow, turns, chunk, id, delivery, must_be_compact, bucket, since, sender, trace };
        if let Some(download) = &mut self.download {
            download.requested.push(id);
        }
        let cost_us = costs.expected_us(chunk.key);
        let enqueued = queue.enqueue(request, cost_us);
        if enqueued == Enqueued::NewJob {
            metrics.generation.pending_jobs.set(queue.jobs() as i64);
            runner::start(&self.shared, &self.threads, &mut queue);
        }
        drop(queue);
        match enqueued {
            // Another encoding that it causes is charged when it is made.
            Enqueued::Coalesced => {
                metrics.generation.coalesced.inc();
            }
            Enqueued::Full => {
                metrics.generation.rejected.inc();
                self.complete(chunk, Err(GenerationError::Overloaded));
            }
            Enqueued::NewJob => {
                metrics.generation.enqueued.inc();
                // Charged in advance, so that jobs in flight are paid for, and refunded if the job
                // is not run. Without the lock of the queue: the table of buckets may be swept.
                if self.bucket.is_limited() {
                    self.bucket.charge_chunk(cost_us, tokio::time::Instant::now());
                }
            }
        }
    }

    /// Selects a view's chunks on the generation threads, in this flow's turns. One at a time;
    /// [`Flow::next_event`] returns the selection.
    pub fn select(&mut self, selection: ViewSelection, land: Land, room: Option<ViewRoom>) {
        self.add_open(1);
        let (completion, receiver) = oneshot::channel();
        self.selection = Some(receiver);
        let (bucket, spent) = (self.bucket.clone(), Duration::ZERO);
        let job = ViewJob { selection, land, bucket, spent, room, completion };
        let mut queue = self.shared.lock();
        queue.add_view(self.turns, job);
        runner::start(&self.shared, &self.threads, &mut queue);
    }

    /// Waits for chunks or for the selection in flight; forever without requests. Cancel safe.
    pub async fn next_event(&mut self) -> FlowEvent {
        tokio::select! {
            selection = received(&mut self.selection) => {
                self.selection = None;
                self.remove_open(1);
                selection.map_or(FlowEvent::ViewFailed, |selection| FlowEvent::View(Box::new(selection)))
            }
            Some(done) = self.receiver.recv() => {
                self.receive(&done);
                FlowEvent::Chunks(done)
            }
        }
    }

    fn add_open(&mut self, count: u32) {
        if self.open == 0 && count > 0 {
            self.shared.active.add(self.turns);
        }
        self.open += count;
    }

    fn remove_open(&mut self, count: u32) {
        self.open -= count;
        if self.open == 0 && count > 0 {
            self.shared.active.remove(self.turns);
        }
    }

    /// Records whether the session of this flow is paused.
    pub fn set_paused(&mut self, is_paused: bool) {
        match (self.is_paused, is_paused) {
            (false, true) => self.shared.paused.add(self.turns),
            (true, false) => self.shared.paused.remove(self.turns),
            _ => {}
        }
        self.is_paused = is_paused;
    }

    pub(super) fn id(&self) -> FlowId {
        self.download.as_ref().map_or(self.turns.flow, |download| download.id)
    }

    /// Whose turns it takes.
    pub(super) const fn turns(&self) -> FlowPath {
        self.turns
    }

    fn complete(&self, chunk: ChunkRequest, result: FrameResult) {
        // This flow holds the receiver.
        let _ = self.sender.send(vec![(chunk, result)]);
    }

    /// Waits for the next results, at least one; forever without requests. Cancel safe.
    pub async fn completions(&mut self) -> Vec<Completion> {
        loop {
            if let Some(done) = self.receiver.recv().await {
                self.receive(&done);
                return done;
            }
            // Unreachable: this flow holds a sender.
            std::future::pending::<()>().await;
        }
    }

    /// The next results if they are available.
    pub fn try_completions(&mut self) -> Option<Vec<Completion>> {
        let done = self.receiver.try_recv().ok()?;
        self.receive(&done);
        Some(done)
    }

    /// Closes requests and charges their bytes.
    fn receive(&mut self, done: &[Completion]) {
        self.remove_open(done.len() as u32);
        self.charge_bytes(done.iter().filter_map(|(_, result)| result.as_ref().ok()).map(Bytes::len).sum());
    }

    /// Chunk requests without a received result.
    #[must_use]
    pub const fn in_flight(&self) -> usize {
        (self.open - self.selection.is_some() as u32) as usize
    }

    /// Cancels the requests for the chunk that a key names now, if its job is not running, and
    /// returns them. The others will complete, those for earlier editions included.
    pub fn cancel(&mut self, key: ChunkKey) -> Vec<ChunkRequest> {
        let (cancelled, charge) = self.shared.lock().cancel(self.id(), self.shared.current(key));
        charge.into_iter().for_each(Charge::refund);
        self.remove_open(cancelled.len() as u32);
        self.shared.metrics.generation.jobs_cancelled.inc_by(cancelled.len() as u64);
        cancelled
    }
}

/// Waits for the selection in flight; forever without one. None if its job panicked.
async fn received(selection: &mut Option<oneshot::Receiver<ViewSelection>>) -> Option<ViewSelection> {
    match selection {
        Some(receiver) => receiver.await.ok(),
        None => std::future::pending().await,
    }
}

impl Drop for Flow {
    fn drop(&mut self) {
        self.set_paused(false);
        if self.open > 0 {
            let (dropped, charges) = {
                let mut queue = self.shared.lock();
                match &self.download {
                    // Others take the same turns.
                    Some(download) => queue.cancel_all(self.id(), &download.requested),
                    None => queue.remove_flow(self.turns),
                }
            };
            charges.into_iter().for_each(Charge::refund);
            self.shared.metrics.generation.jobs_cancelled.inc_by(dropped);
            self.remove_open(self.open);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::generation::test_source::{
        chunk_request, fixture, fixture_with_deadline, flat_frame_bytes, key, request,
    };
    use crate::limits::rate_limit::RateLimiter;
    use protocol::delivery::Tolerance;
    use std::net::IpAddr;

    #[tokio::test]
    async fn the_highest_priority_comes_first_and_every_request_completes_once() {
        let fixture = fixture(1 << 20, 10);
        let mut flow = fixture.service.flow();
        flow.request(chunk_request(key(0), 0), Delivery::Exact);
        // The only thread takes the first job, so that the queue orders the rest.
        while !fixture.service.shared.lock().is_running(ChunkId::base(key(0))) {
            tokio::task::yield_now().await;
        }
        for (x, priority) in [(1, 10), (2, 30), (3, 20), (1, 40)] {
            flow.request(chunk_request(key(x), priority), Delivery::Exact);
        }
        assert_eq!(flow.in_flight(), 5);
        for _ in 0..4 {
            fixture.permit.send(()).unwrap();
        }
        let mut completed = Vec::new();
        while flow.in_flight() > 0 {
            for (chunk, result) in flow.completions().await {
                assert!(result.is_ok());
                completed.push(chunk.key.x());
            }
        }
        completed.sort_unstable();
        assert_eq!(completed, [0, 1, 1, 2, 3]);
        assert_eq!(fixture.generated.try_iter().collect::<Vec<_>>(), [0, 1, 2, 3].map(key));
    }

    #[tokio::test]
    async fn a_hundred_thousand_dropped_flows_affect_no_other_flow() {
        let fixture = fixture(1 << 20, 10);
        let blocker = request(&fixture.service, key(0), 1).await;
        while !fixture.service.shared.lock().is_running(ChunkId::base(key(0))) {
            tokio::task::yield_now().await;
        }
        let mut kept = fixture.service.flow();
        kept.request(chunk_request(key(1), 1), Delivery::Exact);
        for _ in 0..100_000 {
            let mut flow = fixture.service.flow();
            flow.request(chunk_request(key(1), 1), Delivery::Exact);
            flow.request(chunk_request(key(2), 1), Delivery::Exact);
        }
        fixture.permit.send(()).unwrap();
        fixture.permit.send(()).unwrap();
        assert!(kept.completions().await[0].1.is_ok());
        assert!(blocker.await.unwrap().is_ok());
        assert_eq!(fixture.generated.try_iter().collect::<Vec<_>>(), [0, 1].map(key));
        assert_eq!(fixture.metrics.generation.jobs_cancelled.get(), 100_000);
        drop(kept);
        assert_eq!(fixture.service.shared.active.len(), 0);
    }

    /// The turns of a client that asks by HTTP are those of one session, whatever the number of its
    /// requests.
    #[tokio::test]
    async fn all_downloads_of_a_network_take_the_turns_of_one_flow() {
        const SESSION: i32 = 20;
        let fixture = fixture(1 << 20, 1000);
        for client in [Some(IpAddr::from([10, 0, 0, 1])), None] {
            let x0 = if client.is_some() { 0 } else { 1000 };
            let blocker = request(&fixture.service, key(x0), 1).await;
            while !fixture.service.shared.lock().is_running(ChunkId::base(key(x0))) {
                tokio::task::yield_now().await;
            }
            let mut session = fixture.service.flow();
            for x in 900..900 + SESSION {
                session.request(chunk_request(key(x0 + x), 1), Delivery::Exact);
            }
            let mut downloads: Vec<Flow> = (1..=64)
                .map(|x| {
                    let mut flow = fixture.service.download(client, TokenBucket::default());
                    flow.request(chunk_request(key(x0 + x), 1), Delivery::Exact);
                    flow
                })
                .collect();
            let active = if client.is_some() { 3 } else { 66 };
            assert_eq!(fixture.service.shared.active.len(), active);
            // One that is dropped takes only its own request with it.
            drop(downloads.pop());
            for _ in 0..64 + SESSION {
                fixture.permit.send(()).unwrap();
            }
            assert!(blocker.await.unwrap().is_ok());
            while session.in_flight() > 0 {
                session.completions().await;
            }
            for mut flow in downloads {
                assert!(flow.completions().await[0].1.is_ok());
            }
            let generated: Vec<_> = fixture.generated.try_iter().collect();
            let last = generated.iter().rposition(|made| made.x() >= x0 + 900).unwrap();
            assert_eq!(generated.len(), 64 + SESSION as usize);
            // The control: requests without a network are flows of their own.
            assert_eq!(last < 50, client.is_some(), "{last}");
            assert_eq!(fixture.service.shared.active.len(), 0);
        }
    }

    /// Twenty sessions of one client are worth as many turns as the one of another, at which the
    /// twenty wait for their own.
    #[tokio::test]
    async fn all_sessions_of_a_site_have_together_the_share_of_one() {
        let fixture = fixture(1 << 20, 1000);
        for has_sites in [true, false] {
            let x0 = if has_sites { 0 } else { 10_000 };
            let client = |number| has_sites.then_some(IpAddr::from([10, 0, 0, number]));
            let blocker = request(&fixture.service, key(x0), 1).await;
            while !fixture.service.shared.lock().is_running(ChunkId::base(key(x0))) {
                tokio::task::yield_now().await;
            }
            let session = |number, xs: std::ops::Range<i32>| {
                let mut flow = fixture.service.session(client(number), TokenBucket::default());
                xs.for_each(|x| flow.request(chunk_request(key(x0 + x), 1), Delivery::Exact));
                flow
            };
            let mut flows: Vec<_> = (1..=20).map(|n| session(1, n * 10..n * 10 + 10)).collect();
            flows.push(session(2, 1000..1050));
            let shares = flows.last().map(|flow| fixture.service.shared.active.shares(flow.turns()));
            assert_eq!(shares, Some(if has_sites { 3 } else { 22 }), "the first request is a site, too");
            for _ in 0..251 {
                fixture.permit.send(()).unwrap();
            }
            assert!(blocker.await.unwrap().is_ok());
            for flow in &mut flows {
                while flow.in_flight() > 0 {
                    flow.completions().await;
                }
            }
            let generated: Vec<_> = fixture.generated.try_iter().collect();
            let last = generated.iter().rposition(|made| made.x() >= x0 + 1000).unwrap();
            // The control: sessions that are sites of their own.
            assert_eq!(last < 220, has_sites, "{last} of {}", generated.len());
        }
    }

    #[tokio::test]
    async fn a_paused_session_has_a_share_of_its_site() {
        let service = fixture(1 << 20, 10).service;
        let session = |site| service.session(Some(IpAddr::from([10, 0, 0, site])), TokenBucket::default());
        let mut many: Vec<_> = (0..10).map(|_| session(1)).collect();
        let mut other = session(2);
        assert_eq!(service.sharers(&other), 1);
        for _ in 0..2 {
            many.iter_mut().for_each(|flow| flow.set_paused(true));
            other.set_paused(true);
        }
        // Those of one site do not lengthen the pauses of another.
        assert_eq!((service.sharers(&many[0]), service.sharers(&other)), (11, 2));
        other.set_paused(false);
        assert_eq!((service.sharers(&many[0]), service.sharers(&other)), (10, 1));
        many.truncate(4);
        assert_eq!(service.sharers(&many[0]), 4, "an ended session is not paused");
        drop(many);
        assert_eq!(service.shared.paused.len(), 0);
    }

    #[tokio::test]
    async fn a_cancelled_request_is_neither_completed_nor_generated() {
        let fixture = fixture(1 << 20, 10);
        let mut flow = fixture.service.flow();
        flow.request(chunk_request(key(0), 9), Delivery::Exact);
        while !fixture.service.shared.lock().is_running(ChunkId::base(key(0))) {
            tokio::task::yield_now().await;
        }
        flow.request(chunk_request(key(1), 1), Delivery::Exact);
        assert_eq!(flow.cancel(key(0)), [], "its job is running");
        assert_eq!(flow.cancel(key(1)), [chunk_request(key(1), 1)]);
        fixture.permit.send(()).unwrap();
        assert_eq!(flow.completions().await[0].0.key, key(0));
        assert_eq!((flow.in_flight(), flow.try_completions().is_none()), (0, true));
    }

    #[tokio::test]
    async fn a_chunk_that_is_not_generated_costs_nothing() {
        let fixture = fixture_with_deadline(1 << 20, 100, Duration::ZERO);
        // It never refills.
        let bucket = RateLimiter::new(Some(0)).bucket(Some("10.0.0.1".parse().unwrap()));
        let blocker = request(&fixture.service, key(0), 9).await;
        while !fixture.service.shared.lock().is_running(ChunkId::base(key(0))) {
            tokio::task::yield_now().await;
        }
        let mut flow = fixture.service.session(None, bucket.clone());
        for x in 1..=4 {
            flow.request(ChunkRequest { request: Some(7), ..chunk_request(key(x), 1) }, Delivery::Exact);
        }
        let of_one = bucket.tokens() / 4.0;
        assert!(of_one < 0.0, "{of_one}");
        flow.cancel(key(1));
        assert!((bucket.tokens() - 3.0 * of_one).abs() < 1e-6, "a cancelled one");
        let mut other = fixture.service.session(None, bucket.clone());
        other.request(chunk_request(key(9), 1), Delivery::Exact);
        drop(other);
        assert!((bucket.tokens() - 3.0 * of_one).abs() < 1e-6, "one of a flow that ends");
        fixture.permit.send(()).unwrap();
        while flow.in_flight() > 0 {
            flow.completions().await;
        }
        assert_eq!(fixture.metrics.generation.jobs_expired.get(), 3);
        // The refund follows the rejection.
        while bucket.tokens() < 0.0 {
            tokio::task::yield_now().await;
        }
        assert!(bucket.tokens().abs() < 1e-6 && blocker.await.unwrap().is_ok());
    }

    #[tokio::test]
    async fn a_chunk_costs_what_it_took() {
        let fixture = fixture(1 << 20, 100);
        let bucket = RateLimiter::new(Some(0)).bucket(Some("10.0.0.1".parse().unwrap()));
        let mut flow = fixture.service.session(None, bucket.clone());
        flow.request(chunk_request(key(0), 1), Delivery::Exact);
        let expected = bucket.tokens();
        while !fixture.service.shared.lock().is_running(ChunkId::base(key(0))) {
            tokio::task::yield_now().await;
        }
        let (since, took) = (Instant::now(), Duration::from_millis(20));
        while since.elapsed() < took {
            tokio::task::yield_now().await;
        }
        fixture.permit.send(()).unwrap();
        flow.completions().await;
        let charged_us = -bucket.tokens();
        assert!(charged_us >= took.as_micros() as f64 && charged_us > -2.0 * expected, "{charged_us}");
    }

    #[tokio::test]
    async fn a_frame_from_the_cache_is_charged_by_its_bytes() {
        let fixture = fixture(1 << 20, 100);
        fixture.permit.send(()).unwrap();
        request(&fixture.service, key(0), 1).await.await.unwrap().unwrap();
        // It never refills.
        let bucket = RateLimiter::new(Some(0)).bucket(Some("10.0.0.1".parse().unwrap()));
        let mut flow = fixture.service.session(None, bucket.clone());
        let of_frame = flat_frame_bytes() as f64 / 1024.0;
        flow.request(chunk_request(key(0), 1), Delivery::Exact);
        flow.completions().await;
        assert!((bucket.tokens() + of_frame).abs() < 1e-6, "{} of {of_frame}", bucket.tokens());
        assert!(flow.cached(key(0), Delivery::Exact).is_some());
        assert!((bucket.tokens() + 2.0 * of_frame).abs() < 1e-6, "{} of {of_frame}", bucket.tokens());
        assert!(flow.cached(key(1), Delivery::Exact).is_none());
        assert!((bucket.tokens() + 2.0 * of_frame).abs() < 1e-6, "what is not cached is free");
    }

    #[tokio::test]
    async fn a_further_encoding_is_charged_to_the_flow_that_asks_for_it() {
        let fixture = fixture(1 << 20, 100);
        let limiter = RateLimiter::new(Some(0));
        let [one, other] =
            ["10.0.0.1", "10.0.0.2"].map(|address| limiter.bucket(Some(address.parse().unwrap())));
        let mut first = fixture.service.session(None, one);
        first.request(chunk_request(key(0), 1), Delivery::Exact);
        let mut second = fixture.service.session(None, other.clone());
        let mut charges = Vec::new();
        for delivery in [Delivery::Exact, Delivery::Quantised(Tolerance::COARSEST)] {
            second.request(chunk_request(key(0), 1), delivery);
            charges.push(other.tokens());
        }
        assert_eq!(charges, [0.0, 0.0]);
        fixture.permit.send(()).unwrap();
        while other.tokens() == 0.0 {
            tokio::task::yield_now().await;
        }
        assert_eq!(second.in_flight(), 2, "no bytes are charged yet");
        assert_eq!(fixture.metrics.generation.coalesced.get(), 2);
    }
}
