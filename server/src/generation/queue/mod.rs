//! The fair queue. Plain data under one lock: no threads, no clock, no generation.
//!
//! `jobs` holds one job per chunk for any number of requests; this file decides whose jobs run
//! next. Flows (sessions and downloads) take turns by cost: surplus round robin, the variant of
//! deficit round robin (Shreedhar and Varghese, "Efficient fair queueing using deficit round
//! robin", SIGCOMM 1995) in which a flow may overdraw its turn by one job and pays it back in the
//! next. Within a flow the highest priority comes first, among equals the oldest request. So a flow
//! with a thousand keys gets the same share of the threads as one with two.
//!
//! A flow that was idle has its first turn before all others (the new queues of FQ-CoDel, RFC 8290,
//! section 4.2), so that a light client does not wait for a round of heavy ones. A flow is idle
//! after a round without work and without debt. Flows that come while a round lasts are first too, but
//! no more of them than half of the turns with work in the round before: those that come without end
//! must not keep the others from theirs.

mod jobs;

pub use jobs::{Charge, Enqueued, FlowId, FrameRequest, MissingFrame};

use super::views::ViewJob;
use crate::chunk_id::ChunkId;
use jobs::{Jobs, Started};
use protocol::server::ChunkRequest;
use rustc_hash::FxHashMap;
use std::cmp::Reverse;
use std::collections::{BinaryHeap, VecDeque};
use std::time::{Duration, Instant};
use tracing::Span;

/// Entries of a flow before stale ones are removed.
const STALE_ENTRIES: usize = 64;

/// The flow of all jobs where turns are turned off. Flows are numbered from 0.
const ALL_FLOWS: FlowId = FlowId::MAX;

/// See the module.
#[derive(Debug)]
pub struct Queue {
    jobs: Jobs,
    /// Whether all jobs run in the order of their requests: for measurements.
    is_first_in_first_out: bool,
    /// Active flows. A flow is removed when it becomes idle.
    flows: FxHashMap<FlowId, Flow>,
    /// Flows that were idle and have had no turn since; they come first.
    new_turns: VecDeque<FlowId>,
    /// Other flows, next turn first. A flow is at most once in `new_turns` and `turns` together.
    turns: VecDeque<FlowId>,
    round: Round,
    /// Orders equal priorities by age.
    next_number: u64,
    /// Threads that take turns.
    pub runners: usize,
}

/// Turns that are left in a round.
#[derive(Debug, Default)]
struct Round {
    first: usize,
    others: usize,
    /// Turns of this round that had work.
    worked: usize,
}

#[derive(Debug, Default)]
struct Flow {
    /// Highest priority first. Includes stale entries of jobs that ran in another flow's turn; they
    /// are skipped when popped and removed when there are many.
    entries: BinaryHeap<(u64, Reverse<u64>, ChunkId)>,
    /// A view to select. It comes before the chunks, since it decides which are needed.
    view: Option<Box<ViewJob>>,
    /// Whether a thread runs the flow's view job.
    is_selecting: bool,
    /// Whether it is in [`Queue::new_turns`] or [`Queue::turns`].
    has_turn: bool,
    /// Microseconds of work left in this turn; negative for a debt.
    credit_us: i64,
}

impl Flow {
    fn is_runnable(&self) -> bool {
        !self.entries.is_empty() || self.view.is_some()
    }
}

/// Work for a thread.
#[derive(Debug, Default)]
pub struct Turn {
    /// A view to select, with the turn's budget in microseconds.
    pub view: Option<(FlowId, Box<ViewJob>, i64)>,
    /// Jobs to run, all of one flow.
    pub chunks: Vec<ChunkId>,
    /// The spans of those that are traced.
    pub traced: Vec<(ChunkId, Span)>,
    /// Requests over the deadline; to be rejected.
    pub expired: Vec<FrameRequest>,
    /// Jobs dropped because they had no requests any more.
    pub cancelled: u64,
    /// What was charged for jobs that were dropped; to be refunded.
    pub refunds: Vec<Charge>,
}

impl Queue {
    /// An empty queue of at most `limit` jobs.
    #[must_use]
    pub fn new(limit: usize) -> Self {
        Self {
            jobs: Jobs::new(limit),
            is_first_in_first_out: false,
            flows: FxHashMap::default(),
            new_turns: VecDeque::new(),
            turns: VecDeque::new(),
            round: Round::default(),
            next_number: 0,
            runners: 0,
        }
    }

    /// The queue without turns: jobs run in the order of their requests. For measurements of what
    /// turns are worth.
    #[must_use]
    pub fn first_in_first_out(self) -> Self {
        Self { is_first_in_first_out: true, ..self }
    }

    /// Jobs queued or running.
    #[must_use]
    pub fn jobs(&self) -> usize {
        self.jobs.len()
    }

    /// Jobs queued.
    #[must_use]
    pub const fn waiting(&self) -> usize {
        self.jobs.waiting()
    }

    /// Whether the job of a chunk is running.
    #[must_use]
    pub fn is_running(&self, chunk: ChunkId) -> bool {
        self.jobs.is_running(chunk)
    }

    /// Adds a request. The caller charges the cost of a new job to the bucket of the request.
    pub fn enqueue(&mut self, request: FrameRequest, cost_us: i64) -> Enqueued {
        let (flow, chunk, priority) = (request.turns, request.id, request.chunk.priority);
        let enqueued = self.jobs.add(request, cost_us);
        // A coalesced job gets an entry in this flow too: the flow with the earlier turn runs it,
        // and it stays queued if the other flow ends.
        if enqueued != Enqueued::Full && self.jobs.is_waiting(chunk) {
            self.add_entry(flow, priority, chunk);
        }
        enqueued
    }

    /// Adds a view job. A flow has one at a time.
    pub fn add_view(&mut self, id: FlowId, view: ViewJob) {
        self.active_flow(id).view = Some(Box::new(view));
        self.add_turn(id);
    }

    /// Returns a view job after a turn that took `spent_us`, to be continued; none if it is done.
    /// The view of a removed flow is dropped.
    pub fn return_view(&mut self, id: FlowId, view: Option<Box<ViewJob>>, spent_us: i64) {
        let Some(flow) = self.flows.get_mut(&id) else { return };
        flow.credit_us -= spent_us;
        flow.is_selecting = false;
        if view.is_some() {
            flow.view = view;
        }
        self.add_turn(id);
    }

    /// View jobs queued.
    #[cfg(test)]
    pub fn waiting_views(&self) -> usize {
        self.flows.values().filter(|flow| flow.view.is_some()).count()
    }

    /// The flow, added if it was idle.
    fn active_flow(&mut self, id: FlowId) -> &mut Flow {
        let new_turns = &mut self.new_turns;
        self.flows.entry(id).or_insert_with(|| {
            new_turns.push_back(id);
            Flow { has_turn: true, ..Flow::default() }
        })
    }

    /// Puts a flow behind the others, unless it is in the round.
    fn add_turn(&mut self, id: FlowId) {
        let Some(flow) = self.flows.get_mut(&id) else { return };
        if !std::mem::replace(&mut flow.has_turn, true) {
            self.turns.push_back(id);
        }
    }

    fn add_entry(&mut self, id: FlowId, priority: u64, chunk: ChunkId) {
        let (id, priority) = if self.is_first_in_first_out { (ALL_FLOWS, 0) } else { (id, priority) };
        let number = self.next_number;
        self.next_number += 1;
        self.active_flow(id);
        self.add_turn(id);
        let Self { flows, jobs, .. } = self;
        let Some(flow) = flows.get_mut(&id) else { return };
        if flow.entries.len() >= STALE_ENTRIES && flow.entries.len() > 2 * jobs.len() {
            flow.entries.retain(|(_, _, chunk)| jobs.is_waiting(*chunk));
        }
        flow.entries.push((priority, Reverse(number), chunk));
    }

    /// The next flow's turn: jobs of about `quantum_us` of work, at least one if any is queued.
    /// Explicit requests older than `deadline` are removed; requests of views stay, since a client
    /// does not repeat an unchanged view.
    pub fn take(&mut self, quantum_us: i64, deadline: Duration, now: Instant) -> Turn {
        let mut turn = Turn::default();
        let (mut without_work, mut to_see) = (0, 0);
        while let Some(id) = self.next_turn() {
            let Some(flow) = self.flows.get_mut(&id) else { continue };
            flow.has_turn = false;
            let was_runnable = flow.is_runnable();
            self.round.worked += usize::from(was_runnable);
            if flow.credit_us <= 0 {
                flow.credit_us += quantum_us;
            }
            if flow.credit_us > 0
                && let Some(view) = flow.view.take()
            {
                flow.is_selecting = true;
                turn.view = Some((id, view, flow.credit_us));
                if flow.is_runnable() {
                    self.add_turn(id);
                }
                return turn;
            }
            while flow.credit_us > 0 {
                let Some((_, _, chunk)) = flow.entries.pop() else { break };
                match self.jobs.start(chunk, deadline, now, &mut turn.expired, &mut turn.traced) {
                    Some(Started::Running { cost_us }) => {
                        flow.credit_us -= cost_us;
                        turn.chunks.push(chunk);
                    }
                    Some(Started::Cancelled(charge)) => {
                        turn.cancelled += 1;
                        turn.refunds.extend(charge);
                    }
                    Some(Started::Expired(charge)) => turn.refunds.extend(charge),
                    None => {}
                }
            }
            if was_runnable || flow.credit_us < 0 {
                // An empty flow stays for a round: otherwise it would become a new flow at once.
                self.add_turn(id);
            } else if !flow.is_selecting {
                // An idle flow accumulates no credit.
                self.flows.remove(&id);
            }
            if !turn.chunks.is_empty() {
                return turn;
            }
            without_work = if was_runnable { 0 } else { without_work + 1 };
            if without_work == 1 {
                to_see = self.new_turns.len() + self.turns.len();
            }
            if without_work > to_see {
                self.pay_debts();
            }
        }
        turn
    }

    /// Ends the rounds in which flows without work pay their debts, where no flow has work: there may
    /// be thousands of both.
    fn pay_debts(&mut self) {
        debug_assert!(!self.flows.values().any(Flow::is_runnable), "each flow had a turn without work");
        self.new_turns.clear();
        self.turns.clear();
        self.flows.retain(|_, flow| {
            (flow.has_turn, flow.credit_us) = (false, 0);
            flow.is_selecting
        });
    }

    /// Whether a flow that was idle has the next turn.
    pub fn has_new_flow(&self) -> bool {
        let begins_round = self.round.others == 0 || self.turns.is_empty();
        !self.new_turns.is_empty() && (self.round.first > 0 || begins_round)
    }

    fn next_turn(&mut self) -> Option<FlowId> {
        if self.new_turns.is_empty() && self.turns.is_empty() {
            return None;
        }
        loop {
            if self.round.first > 0
                && let Some(id) = self.new_turns.pop_front()
            {
                self.round.first -= 1;
                return Some(id);
            }
            // Flows that have been removed have no turn.
            self.round.others = self.round.others.min(self.turns.len());
            if self.round.others > 0
                && let Some(id) = self.turns.pop_front()
            {
                self.round.others -= 1;
                return Some(id);
            }
            // One of the two has a turn for the flow that waits.
            let first = self.new_turns.len() + self.round.worked.div_ceil(2);
            self.round = Round { first, others: self.turns.len(), ..Round::default() };
        }
    }

    /// The frame of a request for which `is_encoded` is false; none if there is no such request.
    #[must_use]
    pub fn missing_frame(
        &mut self,
        chunk: ChunkId,
        is_encoded: impl Fn(&FrameRequest) -> bool,
    ) -> Option<MissingFrame> {
        self.jobs.missing_frame(chunk, is_encoded)
    }

    /// Removes and returns the requests of a job that `is_encoded` has frames for. The job is
    /// removed if no request is left; otherwise it is queued again.
    pub fn finish(
        &mut self,
        chunk: ChunkId,
        is_encoded: impl Fn(&FrameRequest) -> bool,
    ) -> Vec<FrameRequest> {
        let (finished, again) = self.jobs.finish(chunk, is_encoded);
        for (flow, priority) in again {
            self.add_entry(flow, priority, chunk);
        }
        finished
    }

    /// Cancels and returns a flow's requests for a chunk, unless the job is running, with what is
    /// to be refunded.
    pub fn cancel(&mut self, flow: FlowId, chunk: ChunkId) -> (Vec<ChunkRequest>, Option<Charge>) {
        self.jobs.cancel(flow, chunk)
    }

    /// Removes a flow and the jobs that only it requested. Returns the number of these jobs, and
    /// what is to be refunded.
    pub fn remove_flow(&mut self, id: FlowId) -> (u64, Vec<Charge>) {
        let Some(flow) = self.flows.remove(&id) else { return (0, Vec::new()) };
        if flow.has_turn {
            self.new_turns.retain(|other| *other != id);
            self.turns.retain(|other| *other != id);
        }
        let chunks: Vec<_> = flow.entries.into_iter().map(|(_, _, chunk)| chunk).collect();
        self.cancel_all(id, &chunks)
    }

    /// Cancels a flow's requests for chunks. Returns the number of jobs that only it requested, and
    /// what is to be refunded.
    pub fn cancel_all(&mut self, id: FlowId, chunks: &[ChunkId]) -> (u64, Vec<Charge>) {
        let before = self.jobs.len();
        let refunds = chunks.iter().filter_map(|chunk| self.cancel(id, *chunk).1).collect();
        ((before - self.jobs.len()) as u64, refunds)
    }
}

#[cfg(test)]
mod tests;
