//! Execution of jobs on the generation threads: takes turns from the queue, reads frames from disk
//! or from the store or generates and encodes them, and sends the results.
//!
//! A panic during generation fails its own job only.

#[cfg(test)]
mod tests;

use super::cost::MAX_OUTLIER;
use super::queue::{Charge, FlowId, FlowPath, FrameRequest, MissingFrame, Payment, Queue};
use super::result::{Completion, FrameResult, GenerationError};
use super::shared::Shared;
use super::threads::{Executor, yield_after_views};
use super::views::ViewJob;
use super::work_time::WorkTime;
use crate::cache::memory::CachedFrame;
use crate::chunk_id::ChunkId;
use crate::mechanism::Mechanism;
use crate::traces::{self, part};
use bytes::Bytes;
use protocol::chunk_codec::Effort;
use protocol::{Delivery, chunk_codec};
use rustc_hash::FxHashMap;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::Arc;
use std::time::Duration;
use terrain::Chunk;
use tokio::sync::mpsc::UnboundedSender;
use tokio::time::Instant;
use tracing::Span;

/// Backlog of a thread above which cheap chunks have the fast encoding, microseconds of work.
const FAST_BACKLOG_US: i64 = 4000;

/// Quantum of a turn, microseconds: several cheap chunks, because each turn wakes a session and
/// causes a write, which costs about as much as a chunk. A client with many requests fills longer
/// turns and one with four does not, so they divide unused time less evenly.
const QUANTUM_US: i64 = 160;

/// Most that is charged for a piece of work: time in which the machine was suspended is not
/// charged.
const MAX_CHARGE: Duration = Duration::from_secs(1);

/// The frames of a finished job.
pub(super) struct GeneratedFrames {
    id: ChunkId,
    results: Vec<GeneratedFrame>,
    /// The time of the frame that was charged in advance, microseconds.
    advance_us: i64,
}

/// One of them.
struct GeneratedFrame {
    delivery: Delivery,
    is_fast_encoded: bool,
    result: FrameResult,
}

impl GeneratedFrames {
    /// The result that answers a request.
    fn of(&self, request: &FrameRequest) -> Option<&FrameResult> {
        let answers = |frame: &&GeneratedFrame| {
            frame.delivery == request.delivery && !(frame.is_fast_encoded && request.must_be_compact)
        };
        self.results.iter().find(answers).map(|frame| &frame.result)
    }
}

/// Where a frame comes from.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Origin {
    Disk,
    /// As the store has it.
    Store,
    /// Encoded from a chunk of the store.
    StoreEncoded,
    Made,
}

impl Origin {
    /// The name in traces.
    const fn name(self) -> &'static str {
        match self {
            Self::Disk => "disk",
            Self::Store | Self::StoreEncoded => "store",
            Self::Made => "made",
        }
    }
}

/// A chunk, and its exact frame if the store had it.
struct Found {
    chunk: Chunk,
    frame: Option<Bytes>,
    /// Time of its generation.
    generation: Duration,
}

/// Starts a runner unless all threads have one. A runner takes turns until the queue is empty, so
/// there are never more runners than threads.
pub fn start(shared: &Arc<Shared>, threads: &dyn Executor, queue: &mut Queue) {
    if queue.runners < shared.limits.threads {
        queue.runners += 1;
        let shared = Arc::clone(shared);
        threads.spawn(Box::new(move || shared.run_turn()));
    }
}

/// The charge for work, microseconds.
fn charged_us(spent: Duration) -> i64 {
    i64::try_from(spent.min(MAX_CHARGE).as_micros()).unwrap_or(i64::MAX)
}

/// What a job with this advance charge takes from its turn, microseconds: the turns of a whole site
/// must not wait for a thread that was interrupted. Processor time is no interruption: it counts as
/// a whole, so that a client cannot buy costly chunks for the estimate of the cheap ones of their
/// level.
fn turn_charge_us(advance_us: i64, spent: WorkTime) -> i64 {
    let longest = advance_us.saturating_mul(MAX_OUTLIER as i64).saturating_add(QUANTUM_US);
    charged_us(spent.clock).min(longest.max(charged_us(spent.processor)))
}

impl Shared {
    /// Runs the next turn. False if the queue is empty: the runner has ended.
    pub(super) fn run_turn(&self) -> bool {
        let deadline = self.limits.deadline;
        let turn = {
            let mut queue = self.lock();
            let turn = queue.take(QUANTUM_US, deadline, Instant::now());
            if !turn.has_work() {
                queue.runners -= 1;
            }
            self.metrics.generation.pending_jobs.set(queue.jobs() as i64);
            turn
        };
        self.metrics.generation.jobs_cancelled.inc_by(turn.cancelled);
        self.metrics.generation.jobs_expired.inc_by(turn.expired.len() as u64);
        for request in turn.expired {
            // The flow may have ended in the meantime; likewise below.
            let _ = request.sender.send(vec![(request.chunk, Err(GenerationError::Overloaded))]);
        }
        turn.refunds.into_iter().for_each(Charge::refund);
        if let Some((view, budget_us)) = turn.view {
            self.select_view(turn.path, view, budget_us);
            return true;
        }
        if turn.chunks.is_empty() {
            return false;
        }
        let run = |id| {
            let span = turn.traced.iter().find(|(traced, _)| *traced == id).map(|(_, span)| span);
            let _entered = span.map(Span::enter);
            self.run_job(id)
        };
        let finished: Vec<GeneratedFrames> = turn.chunks.into_iter().map(run).collect();
        // Before the sessions learn of it: a span that is open when the process ends is lost.
        drop(turn.traced);
        let spent_us: i64 = finished.iter().map(|frames| frames.advance_us).sum();
        self.send_results(&finished, |queue| {
            queue.end_turn(turn.path, spent_us - turn.expected_us, None);
        });
        true
    }

    /// Continues a view within its budget, or until a newly active flow waits: that flow has the
    /// next turn, and a view can stop between any two steps. Where views are stopped it waits. A
    /// finished selection is sent to its session; an unfinished one waits for the flow's next turn.
    /// A panic fails this view only.
    fn select_view(&self, path: FlowPath, job: Box<ViewJob>, budget_us: i64) {
        let Some(mut job) = self.lock().keep_stopped(path, job) else { return };
        let must_stop = || {
            let queue = self.lock();
            queue.is_next_new(path.site) || queue.has_stopped_views()
        };
        let Ok((is_done, spent)) =
            catch_unwind(AssertUnwindSafe(|| job.run(&*self.clock, budget_us, must_stop)))
        else {
            self.metrics.generation.jobs_failed.inc();
            tracing::error!(view = ?job.selection.view(), "view selection panicked");
            self.lock().end_turn(path, budget_us, None);
            // Dropped with the job: the session learns of it.
            return;
        };
        self.metrics.generation.view_busy_seconds.inc_by(spent.as_secs_f64());
        let spent_us = charged_us(spent);
        job.bucket.charge_work(spent_us, Instant::now());
        if is_done {
            self.metrics.generation.view_seconds.observe(job.spent.as_secs_f64());
            self.lock().end_turn(path, spent_us, None);
            // The session may have ended.
            let ViewJob { completion, selection, .. } = *job;
            let _ = completion.send(selection);
        } else {
            self.lock().end_turn(path, spent_us, Some(job));
        }
        if self.limits.without != Some(Mechanism::ViewYields) {
            yield_after_views(spent);
        }
    }

    /// Encodes the requested deliveries of a chunk, those requested meanwhile included.
    pub(super) fn run_job(&self, id: ChunkId) -> GeneratedFrames {
        // Dropped at the end of this job, so that the next one reuses its memory.
        let mut chunk = None;
        let mut finished = GeneratedFrames { id, results: Vec::with_capacity(1), advance_us: 0 };
        let missing = |finished: &GeneratedFrames| {
            self.lock().missing_frame(id, |request| finished.of(request).is_some())
        };
        while let Some(MissingFrame { delivery, must_be_compact, payment }) = missing(&finished) {
            let started = WorkTime::now(&*self.clock);
            let effort = if must_be_compact { Effort::Compact } else { self.effort(id) };
            let frame = self.frame(id, delivery, effort, &mut chunk);
            let spent = started.elapsed(&*self.clock);
            let spent_us = charged_us(spent.clock);
            match payment {
                Payment::Advance(charge) => {
                    finished.advance_us = turn_charge_us(charge.cost_us(), spent);
                    charge.settle(spent_us);
                }
                Payment::Request(path, bucket) => {
                    self.lock().charge(path, spent_us);
                    bucket.charge_work(spent_us, Instant::now());
                }
            }
            finished.results.push(frame);
        }
        finished
    }

    /// Reads a frame from disk or from the store, or encodes it; the first encoded frame of a job
    /// generates the chunk.
    fn frame(
        &self,
        id: ChunkId,
        delivery: Delivery,
        effort: Effort,
        chunk: &mut Option<Chunk>,
    ) -> GeneratedFrame {
        let (started, is_first) = (self.clock.clock(), chunk.is_none());
        let result = catch_unwind(AssertUnwindSafe(|| {
            // With a chunk in memory, encoding is faster than reading.
            if chunk.is_none()
                && let Some(frame) = self.stored_frame(id, delivery)
            {
                return (frame, Origin::Disk, Duration::ZERO);
            }
            let (mut origin, mut made) = (Origin::Made, Duration::ZERO);
            if chunk.is_none() {
                let found = self.chunk(id, delivery);
                *chunk = Some(found.chunk);
                made = found.generation;
                if let Some(frame) = found.frame {
                    if delivery == Delivery::Exact {
                        return (frame, Origin::Store, made);
                    }
                    origin = Origin::StoreEncoded;
                }
            }
            let chunk = chunk.as_ref().expect("found or made");
            let _part = part!("encode");
            let started = self.clock.clock();
            let frame = chunk_codec::encode_with(delivery, effort, chunk, &self.world);
            (frame, origin, made + self.time_since(started))
        }));
        let Ok((frame, origin, made)) = result else {
            self.metrics.generation.jobs_failed.inc();
            tracing::error!(chunk = %id, %delivery, "generation panicked");
            let result = Err(GenerationError::Failed);
            return GeneratedFrame { delivery, is_fast_encoded: false, result };
        };
        let is_stored = matches!(origin, Origin::Disk | Origin::Store);
        if is_first {
            traces::current().record("origin", origin.name());
            // The cost of a job includes reads from disk and store.
            self.costs.record(id.key, self.time_since(started));
        }
        if is_first && origin == Origin::Made {
            self.metrics.generation.seconds.observe(made.as_secs_f64());
            self.metrics.generation.jobs_completed.inc();
        }
        // The seed-only delivery has one encoding.
        let is_fast_encoded = effort == Effort::Fast && delivery != Delivery::SeedOnly && !is_stored;
        if is_fast_encoded {
            self.metrics.generation.encoded_fast.inc();
        } else if !is_stored {
            self.metrics.generation.encoded_compact.inc();
        }
        self.frames.insert(id, delivery, CachedFrame { frame: frame.clone(), is_fast_encoded });
        if let Some(disk) = self.disk.as_ref().filter(|_| origin != Origin::Disk) {
            disk.write(id, delivery, frame.clone());
        }
        GeneratedFrame { delivery, is_fast_encoded, result: Ok(frame) }
    }

    /// A chunk. Where its error is known, or there is no store, the source generates it. Otherwise
    /// a chunk that is not cheap is read from the store; one that is cheap or not found is
    /// generated and written there. A cheap chunk is written, too: another replica may not have
    /// measured its error, for which it would take milliseconds.
    fn chunk(&self, id: ChunkId, delivery: Delivery) -> Found {
        let known_error = self.frames.known_error(id).or_else(|| self.stored_error(id, delivery));
        let Some(store) = self.store.as_ref().filter(|_| known_error.is_none()) else {
            return self.generate(id, known_error);
        };
        let is_cheap = self.source.is_cheap(id);
        if !is_cheap {
            let _part = part!("store");
            if let Some((chunk, frame)) = store.read(id) {
                return Found { chunk, frame: Some(frame), generation: Duration::ZERO };
            }
        }
        let found = self.generate(id, None);
        if !is_cheap {
            // The times of cheap chunks would make costly ones of their level look cheap too.
            store.made(id, found.generation);
        }
        store.write(id, || chunk_codec::encode(&found.chunk, &self.world));
        found
    }

    fn generate(&self, id: ChunkId, known_error: Option<u32>) -> Found {
        let _part = part!("generate");
        let started = self.clock.clock();
        let chunk = self.source.chunk(id, known_error);
        Found { chunk, frame: None, generation: self.time_since(started) }
    }

    /// The time since a reading of the clock.
    fn time_since(&self, started: Duration) -> Duration {
        self.clock.clock().saturating_sub(started)
    }

    /// The fast encoding for level 0 under backlog: bytes are cheaper than time then. Encoding is a
    /// small part of the cost of coarser chunks.
    fn effort(&self, id: ChunkId) -> Effort {
        let backlog_us = || self.lock().waiting() as i64 * self.costs.mean_us() / self.limits.threads as i64;
        let may_be_fast = id.key.level() == 0 && self.limits.without != Some(Mechanism::FastEffort);
        if may_be_fast && backlog_us() > FAST_BACKLOG_US { Effort::Fast } else { Effort::Compact }
    }

    /// A frame from disk.
    fn stored_frame(&self, id: ChunkId, delivery: Delivery) -> Option<Bytes> {
        let disk = self.disk.as_ref()?;
        let _part = part!("disk");
        disk.read(id, delivery, |frame| self.is_valid(id, delivery, frame))
    }

    /// The error of a chunk from its frame on disk of another delivery. Not from a quantised frame,
    /// whose error is larger.
    fn stored_error(&self, id: ChunkId, except: Delivery) -> Option<u32> {
        let others = [Delivery::Exact, Delivery::SeedOnly].into_iter().filter(|delivery| *delivery != except);
        let disk = self.disk.as_ref()?;
        let frame = others
            .into_iter()
            .find_map(|delivery| disk.peek(id, delivery, |frame| self.is_valid(id, delivery, frame)))?;
        chunk_codec::error(&frame)
    }

    /// Whether bytes are the frame of a chunk for a delivery.
    fn is_valid(&self, id: ChunkId, delivery: Delivery, frame: &[u8]) -> bool {
        match delivery {
            // Its digest covers the heights, which it does not contain. With the error known,
            // generating them is cheap, and the whole frame can be compared.
            Delivery::SeedOnly => chunk_codec::error(frame).is_some_and(|error| {
                let chunk = self.source.chunk(id, Some(error));
                chunk_codec::encode_for(delivery, &chunk, &self.world) == frame
            }),
            Delivery::Exact | Delivery::Quantised(_) | Delivery::Refined => {
                let found = chunk_codec::verify(frame, &self.world).ok();
                // An exact frame is valid in every delivery.
                found == Some((id.key, delivery)) || found == Some((id.key, Delivery::Exact))
            }
        }
    }

    /// Sends the results of a turn, which `end` ends: one message per flow, since each may wake a
    /// session and cause a write.
    pub(super) fn send_results(&self, turn: &[GeneratedFrames], end: impl FnOnce(&mut Queue)) {
        let mut flows: FxHashMap<FlowId, (UnboundedSender<Vec<Completion>>, Vec<Completion>)> =
            FxHashMap::default();
        {
            let mut queue = self.lock();
            end(&mut queue);
            for frames in turn {
                for request in queue.finish(frames.id, |request| frames.of(request).is_some()) {
                    let result = frames.of(&request).cloned().unwrap_or(Err(GenerationError::Failed));
                    let (_, completions) = flows.entry(request.flow).or_insert((request.sender, Vec::new()));
                    completions.push((request.chunk, result));
                }
            }
            self.metrics.generation.pending_jobs.set(queue.jobs() as i64);
        }
        for (sender, completions) in flows.into_values() {
            let _ = sender.send(completions);
        }
    }
}
