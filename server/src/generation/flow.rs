//! Requests of one client of the service: a session or a download.
//!
//! Every request has exactly one result or is cancelled. Dropping a flow cancels its requests.

use super::queue::{Charge, Enqueued, FlowId, FlowPath, FrameRequest};
use super::result::{Completion, FrameResult, GenerationError};
use super::runner;
use super::shared::Shared;
use super::threads::Executor;
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
use std::time::Duration;
use terrain::{ChunkKey, Land};
use tokio::sync::mpsc::{UnboundedReceiver, UnboundedSender, unbounded_channel};
use tokio::sync::oneshot::{self, error::TryRecvError};
use tokio::time::Instant;

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
    threads: Arc<dyn Executor>,
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
        threads: Arc<dyn Executor>,
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
            self.bucket.charge_bytes(bytes, Instant::now());
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
            runner::start(&self.shared, &*self.threads, &mut queue);
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
                    self.bucket.charge_chunk(cost_us, Instant::now());
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
        runner::start(&self.shared, &*self.threads, &mut queue);
    }

    /// Waits for chunks or for the selection in flight; forever without requests. Cancel safe.
    pub async fn next_event(&mut self) -> FlowEvent {
        tokio::select! {
            biased;
            selection = received(&mut self.selection) => self.selected(selection),
            Some(done) = self.receiver.recv() => {
                self.receive(&done);
                FlowEvent::Chunks(done)
            }
        }
    }

    /// The next event if there is one now.
    pub fn try_event(&mut self) -> Option<FlowEvent> {
        match self.selection.as_mut().map(oneshot::Receiver::try_recv) {
            Some(Ok(selection)) => Some(self.selected(Some(selection))),
            Some(Err(TryRecvError::Closed)) => Some(self.selected(None)),
            Some(Err(TryRecvError::Empty)) | None => self.try_completions().map(FlowEvent::Chunks),
        }
    }

    /// The end of the selection in flight; none if it panicked.
    fn selected(&mut self, selection: Option<ViewSelection>) -> FlowEvent {
        self.selection = None;
        self.remove_open(1);
        selection.map_or(FlowEvent::ViewFailed, |selection| FlowEvent::View(Box::new(selection)))
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
mod tests;
