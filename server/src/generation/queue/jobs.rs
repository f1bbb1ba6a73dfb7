//! The table of generation jobs: one job per chunk for any number of requests. A job belongs to the
//! table, not to a flow, and knows nothing of turns.

use crate::chunk_id::ChunkId;
use crate::generation::result::Completion;
use crate::limits::rate_limit::TokenBucket;
use crate::traces::RequestTrace;
use protocol::Delivery;
use protocol::server::ChunkRequest;
use std::collections::HashMap;
use std::collections::hash_map::Entry;
use std::time::Duration;
use tokio::sync::mpsc::UnboundedSender;
use tokio::time::Instant;
use tracing::Span;

/// Identifies a flow.
pub type FlowId = u64;

/// Identifies a site: all clients that may be one customer's, or one flow.
pub type SiteId = u64;

/// Whose turns work takes: those of a flow among the flows of its site, and these of the site among
/// all sites.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub struct FlowPath {
    /// The site.
    pub site: SiteId,
    /// The flow.
    pub flow: FlowId,
}

/// A request for one frame.
#[derive(Debug)]
pub struct FrameRequest {
    /// The flow that made it.
    pub flow: FlowId,
    /// The flow whose turns it takes: the same, or that of all downloads of a client network.
    pub turns: FlowPath,
    /// Key, request number and priority.
    pub chunk: ChunkRequest,
    /// The chunk: the key in the edition of the time of the request.
    pub id: ChunkId,
    /// The delivery.
    pub delivery: Delivery,
    /// Whether only the compact encoding will do: an HTTP address has one representation.
    pub must_be_compact: bool,
    /// Charged for what the request causes.
    pub bucket: TokenBucket,
    /// When it was made.
    pub since: Instant,
    /// Receives the result.
    pub sender: UnboundedSender<Vec<Completion>>,
    /// Its spans.
    pub trace: RequestTrace,
}

/// Result of adding a request.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Enqueued {
    /// A new job is queued.
    NewJob,
    /// The request joined a queued or running job.
    Coalesced,
    /// The table is full; the request was rejected.
    Full,
}

/// The advance charge of a client for a job.
#[derive(Debug)]
pub struct Charge {
    bucket: TokenBucket,
    cost_us: i64,
}

impl Charge {
    /// Returns it. Not under the lock of the queue, here and below: the table of buckets has a lock
    /// of its own.
    pub fn refund(self) {
        self.bucket.refund(self.cost_us, Instant::now());
    }

    /// The charged cost, microseconds.
    #[must_use]
    pub const fn cost_us(&self) -> i64 {
        self.cost_us
    }

    /// Charges what the job took in place of what was expected, microseconds.
    pub fn settle(self, spent_us: i64) {
        self.bucket.settle_chunk(self.cost_us, spent_us, Instant::now());
    }
}

/// A frame that a running job lacks.
#[derive(Debug)]
pub struct MissingFrame {
    /// The delivery.
    pub delivery: Delivery,
    /// Whether it must have the compact encoding.
    pub must_be_compact: bool,
    /// Its payment.
    pub payment: Payment,
}

/// The payment of a frame.
#[derive(Debug)]
pub enum Payment {
    /// The first frame of a job was charged in advance, and belongs to the turn in which it runs.
    Advance(Charge),
    /// Another one is charged to the request that causes it.
    Request(FlowPath, TokenBucket),
}

/// Result of starting a queued job.
#[derive(Debug)]
pub enum Started {
    /// It is running.
    Running {
        /// Its estimated cost, microseconds.
        cost_us: i64,
    },
    /// It was removed: all its requests had expired.
    Expired(Option<Charge>),
    /// It was removed: the flows of all its requests had ended.
    Cancelled(Option<Charge>),
}

/// See the module.
#[derive(Debug)]
pub struct Jobs {
    /// Jobs that may be queued or running. One more is rejected.
    limit: usize,
    /// Clients choose the keys: the randomly keyed hash of std has no collisions that they could
    /// prepare.
    by_id: HashMap<ChunkId, Job>,
    /// Jobs that are not running.
    waiting: usize,
}

#[derive(Debug)]
struct Job {
    is_running: bool,
    /// Estimated, microseconds.
    cost_us: i64,
    /// The advance charge of its first frame; none once that is being made.
    advance: Option<Charge>,
    /// Bounded by the sessions' job windows and the HTTP connections.
    requests: Vec<FrameRequest>,
}

impl Jobs {
    /// An empty table of at most `limit` jobs.
    #[must_use]
    pub fn new(limit: usize) -> Self {
        Self { limit, by_id: HashMap::default(), waiting: 0 }
    }

    /// Jobs queued or running.
    #[must_use]
    pub fn len(&self) -> usize {
        self.by_id.len()
    }

    /// Jobs queued.
    #[must_use]
    pub const fn waiting(&self) -> usize {
        self.waiting
    }

    /// Whether the job of a chunk is running.
    #[must_use]
    pub fn is_running(&self, id: ChunkId) -> bool {
        self.by_id.get(&id).is_some_and(|job| job.is_running)
    }

    /// Whether the job of a chunk is queued.
    #[must_use]
    pub fn is_waiting(&self, id: ChunkId) -> bool {
        self.by_id.get(&id).is_some_and(|job| !job.is_running)
    }

    /// Adds a request to the job of its chunk, which may be new. The caller charges the cost of a
    /// new job to the bucket of the request.
    pub fn add(&mut self, request: FrameRequest, cost_us: i64) -> Enqueued {
        let n_jobs = self.by_id.len();
        match self.by_id.entry(request.id) {
            Entry::Occupied(mut job) => {
                job.get_mut().requests.push(request);
                Enqueued::Coalesced
            }
            Entry::Vacant(_) if n_jobs >= self.limit => Enqueued::Full,
            Entry::Vacant(entry) => {
                let advance = Some(Charge { bucket: request.bucket.clone(), cost_us });
                entry.insert(Job { is_running: false, cost_us, advance, requests: vec![request] });
                self.waiting += 1;
                Enqueued::NewJob
            }
        }
    }

    /// Starts a queued job; none if it is not queued. Explicit requests older than `deadline` move
    /// to `expired`; requests of views stay, since a client does not repeat an unchanged view. The
    /// span of the first traced request goes to `traced`.
    pub fn start(
        &mut self,
        id: ChunkId,
        deadline: Duration,
        now: Instant,
        expired: &mut Vec<FrameRequest>,
        traced: &mut Vec<(ChunkId, Span)>,
    ) -> Option<Started> {
        let job = self.by_id.get_mut(&id).filter(|job| !job.is_running)?;
        let before = expired.len();
        expired.extend(job.requests.extract_if(.., |request| {
            request.chunk.request.is_some() && now.duration_since(request.since) > deadline
        }));
        job.requests.retain(|request| !request.sender.is_closed());
        self.waiting -= 1;
        if job.requests.is_empty() {
            let advance = self.by_id.remove(&id).and_then(|job| job.advance);
            let has_expired = expired.len() > before;
            return Some(if has_expired { Started::Expired(advance) } else { Started::Cancelled(advance) });
        }
        job.is_running = true;
        job.requests.iter_mut().for_each(|request| request.trace.start());
        let chunks = job.requests.iter().map(|request| &request.trace.chunk);
        traced.extend(chunks.filter(|chunk| !chunk.is_disabled()).take(1).map(|chunk| (id, chunk.clone())));
        Some(Started::Running { cost_us: job.cost_us })
    }

    /// The frame of a request for which `is_encoded` is false; none if there is no such request.
    /// The first frame of a job was charged in advance; the client whose request causes another one
    /// pays for it.
    #[must_use]
    pub fn missing_frame(
        &mut self,
        id: ChunkId,
        is_encoded: impl Fn(&FrameRequest) -> bool,
    ) -> Option<MissingFrame> {
        let Job { requests, advance, .. } = self.by_id.get_mut(&id)?;
        let FrameRequest { delivery, must_be_compact, bucket, turns, .. } =
            requests.iter().find(|request| !is_encoded(request))?;
        let payment = advance.take().map(Payment::Advance);
        let payment = payment.unwrap_or_else(|| Payment::Request(*turns, bucket.clone()));
        Some(MissingFrame { delivery: *delivery, must_be_compact: *must_be_compact, payment })
    }

    /// Removes and returns the requests of a job that `is_encoded` has frames for. The job is
    /// removed if no request is left; otherwise it is queued again, and flow and priority of what
    /// is left are returned too.
    pub fn finish(
        &mut self,
        id: ChunkId,
        is_encoded: impl Fn(&FrameRequest) -> bool,
    ) -> (Vec<FrameRequest>, Vec<(FlowPath, u64)>) {
        let Some(mut job) = self.by_id.remove(&id) else { return (Vec::new(), Vec::new()) };
        if job.requests.iter().all(&is_encoded) {
            return (job.requests, Vec::new());
        }
        // Another delivery was requested after the last check. Rare, so the chunk is generated
        // again.
        let finished = job.requests.extract_if(.., |request| is_encoded(request)).collect();
        let again = job.requests.iter().map(|request| (request.turns, request.chunk.priority)).collect();
        job.is_running = false;
        self.by_id.insert(id, job);
        self.waiting += 1;
        (finished, again)
    }

    /// Cancels and returns a flow's requests for a chunk, unless the job is running, with what was
    /// charged for a job that is removed with them.
    pub fn cancel(&mut self, flow: FlowId, id: ChunkId) -> (Vec<ChunkRequest>, Option<Charge>) {
        let Some(job) = self.by_id.get_mut(&id).filter(|job| !job.is_running) else {
            return (Vec::new(), None);
        };
        let cancelled = job
            .requests
            .extract_if(.., |request| request.flow == flow)
            .map(|request| request.chunk)
            .collect();
        if !job.requests.is_empty() {
            return (cancelled, None);
        }
        self.waiting -= 1;
        (cancelled, self.by_id.remove(&id).and_then(|job| job.advance))
    }
}
