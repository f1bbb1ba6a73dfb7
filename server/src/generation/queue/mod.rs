//! The fair queue. Plain data under one lock: no threads, no clock, no generation.
//!
//! `jobs` holds one job per chunk for any number of requests; this file decides whose jobs run
//! next. Sites (all clients that may be one customer's) take turns by cost, and in the turns of a
//! site its flows (sessions and downloads): surplus round robin, the variant of deficit round robin
//! (Shreedhar and Varghese, "Efficient fair queueing using deficit round robin", SIGCOMM 1995) in
//! which a turn may be overdrawn by one job, which is paid back in the next. Within a flow the
//! highest priority comes first, among equals the oldest request. So a flow with a thousand keys
//! gets the same share of the threads as one with two, and a site with a hundred sessions the same
//! as one with one.
//!
//! A cost is first an estimate; when the work has ended, the difference to what it took is charged.
//! `rotation` has the order of turns. Sites and flows are idle after a round without work and
//! without debt.

mod jobs;
mod rotation;
mod site;

pub use jobs::{Charge, Enqueued, FlowId, FlowPath, FrameRequest, MissingFrame, Payment, SiteId};

use super::views::ViewJob;
use crate::chunk_id::ChunkId;
use jobs::Jobs;
use protocol::server::ChunkRequest;
use rotation::Rotation;
use rustc_hash::FxHashMap;
use site::{Site, TurnLimits};
use std::time::Duration;
use tokio::time::Instant;
use tracing::Span;

/// The flow of all jobs where turns are turned off. Flows are numbered from 0.
const ALL_FLOWS: FlowPath = FlowPath { site: SiteId::MAX, flow: FlowId::MAX };

/// See the module.
#[derive(Debug)]
pub struct Queue {
    jobs: Jobs,
    /// Whether all jobs run in the order of their requests: for measurements.
    is_first_in_first_out: bool,
    /// Active sites. A site is removed when it becomes idle.
    sites: FxHashMap<SiteId, Site>,
    turns: Rotation<SiteId>,
    /// Orders equal priorities by age.
    next_number: u64,
    /// Threads that take turns.
    pub runners: usize,
    /// Whether no view goes on.
    has_stopped_views: bool,
    /// Views whose turns came meanwhile. At most one for each session.
    stopped_views: Vec<(FlowPath, Box<ViewJob>)>,
}

/// Work for a thread.
#[derive(Debug, Default)]
pub struct Turn {
    /// The flow whose turn it is.
    pub path: FlowPath,
    /// The cost charged to it for the jobs, microseconds.
    pub expected_us: i64,
    /// A view to select, with the turn's budget in microseconds.
    pub view: Option<(Box<ViewJob>, i64)>,
    /// Jobs to run, all of one flow.
    pub chunks: Vec<ChunkId>,
    /// The spans of those that are traced.
    pub traced: Vec<(ChunkId, Span)>,
    /// Requests over the deadline; to be rejected.
    pub expired: Vec<FrameRequest>,
    /// Jobs dropped because they had no requests any more.
    pub cancelled: u64,
    /// The advance charges of dropped jobs; to be refunded.
    pub refunds: Vec<Charge>,
}

impl Turn {
    /// Whether there is work to do. The caller of [`Queue::take`] ends such a turn.
    #[must_use]
    pub const fn has_work(&self) -> bool {
        self.view.is_some() || !self.chunks.is_empty()
    }
}

impl Queue {
    /// An empty queue of at most `limit` jobs.
    #[must_use]
    pub fn new(limit: usize) -> Self {
        Self {
            jobs: Jobs::new(limit),
            is_first_in_first_out: false,
            sites: FxHashMap::default(),
            turns: Rotation::default(),
            next_number: 0,
            runners: 0,
            has_stopped_views: false,
            stopped_views: Vec::new(),
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
        let (path, chunk, priority) = (request.turns, request.id, request.chunk.priority);
        let enqueued = self.jobs.add(request, cost_us);
        // A coalesced job gets an entry in this flow too: the flow with the earlier turn runs it,
        // and it stays queued if the other flow ends.
        if enqueued != Enqueued::Full && self.jobs.is_waiting(chunk) {
            self.add_entry(path, priority, chunk);
        }
        enqueued
    }

    /// Adds a view job. A flow has one at a time.
    pub fn add_view(&mut self, path: FlowPath, view: ViewJob) {
        self.active_site(path.site).add_view(path.flow, Box::new(view));
        self.add_turn(path.site);
    }

    /// Stops all views, or has them go on. While they are stopped their flows have turns for
    /// chunks. Returns how many go on.
    pub fn stop_views(&mut self, is_stopped: bool) -> usize {
        self.has_stopped_views = is_stopped;
        if is_stopped {
            return 0;
        }
        let views = std::mem::take(&mut self.stopped_views);
        let count = views.len();
        for (path, view) in views {
            self.active_site(path.site).add_view(path.flow, view);
            self.add_turn(path.site);
        }
        count
    }

    /// The stopped views of sessions that have ended. They hold memory: the caller drops them
    /// without the lock of the queue.
    pub fn take_ended_views(&mut self) -> Vec<Box<ViewJob>> {
        let ended = self.stopped_views.extract_if(.., |(_, view)| view.completion.is_closed());
        ended.map(|(_, view)| view).collect()
    }

    /// Whether views are stopped.
    #[must_use]
    pub const fn has_stopped_views(&self) -> bool {
        self.has_stopped_views
    }

    /// Views that are stopped.
    #[cfg(test)]
    pub fn stopped_views(&self) -> usize {
        self.stopped_views.len()
    }

    /// Ends a turn without work on its view if views are stopped: the view waits until they go on.
    /// Gives the view back otherwise.
    pub fn keep_stopped(&mut self, path: FlowPath, view: Box<ViewJob>) -> Option<Box<ViewJob>> {
        if !self.has_stopped_views {
            return Some(view);
        }
        self.stopped_views.push((path, view));
        self.end_turn(path, 0, None);
        None
    }

    /// Ends a turn that took `more_us` microseconds longer than was charged, with the view that is
    /// to be continued. The view of a removed flow is dropped.
    pub fn end_turn(&mut self, path: FlowPath, more_us: i64, view: Option<Box<ViewJob>>) {
        if let Some(site) = self.sites.get_mut(&path.site) {
            site.end_turn(path.flow, more_us, view);
            self.add_turn(path.site);
        }
    }

    /// Charges work that was done in the turn of another flow.
    pub fn charge(&mut self, path: FlowPath, us: i64) {
        self.active_site(path.site).charge(path.flow, us);
    }

    /// The site, added if it was idle.
    fn active_site(&mut self, id: SiteId) -> &mut Site {
        let turns = &mut self.turns;
        self.sites.entry(id).or_insert_with(|| {
            turns.push_new(id);
            Site::in_rotation()
        })
    }

    /// Puts a site behind the others, unless it is in the round.
    fn add_turn(&mut self, id: SiteId) {
        let Some(site) = self.sites.get_mut(&id) else { return };
        if !std::mem::replace(&mut site.account.has_turn, true) {
            self.turns.push(id);
        }
    }

    fn add_entry(&mut self, path: FlowPath, priority: u64, chunk: ChunkId) {
        let (path, priority) = if self.is_first_in_first_out { (ALL_FLOWS, 0) } else { (path, priority) };
        let number = self.next_number;
        self.next_number += 1;
        self.active_site(path.site);
        let Self { sites, jobs, .. } = self;
        let Some(site) = sites.get_mut(&path.site) else { return };
        site.add_entry(path.flow, priority, number, chunk, jobs);
        self.add_turn(path.site);
    }

    /// The next turn: jobs of about `quantum_us` of work, at least one if any is queued. Explicit
    /// requests older than `deadline` are removed; requests of views stay, since a client does not
    /// repeat an unchanged view.
    pub fn take(&mut self, quantum_us: i64, deadline: Duration, now: Instant) -> Turn {
        let limits = TurnLimits { quantum_us, deadline, now };
        let (mut turn, mut without_work) = (Turn::default(), 0);
        while let Some(id) = self.turns.next() {
            let Some(site) = self.sites.get_mut(&id) else { continue };
            let was_runnable = site.is_runnable();
            if was_runnable && !std::mem::take(&mut site.goes_on) {
                self.turns.count_work();
            }
            if site.account.begin(quantum_us) && was_runnable {
                site.take(id, &mut self.jobs, limits, &mut turn);
            }
            // A view is charged only when it has ended, and might take the turns of all threads.
            if turn.view.is_none() && site.is_runnable() && site.account.credit_us > 0 {
                (site.goes_on, site.account.has_turn) = (true, true);
                self.turns.push_front(id);
            } else if was_runnable || site.account.credit_us < 0 {
                // An idle site stays for a round: otherwise it would become a new site at once.
                self.add_turn(id);
            } else if site.account.running == 0 {
                // An idle site accumulates no credit.
                self.sites.remove(&id);
            }
            if turn.has_work() {
                return turn;
            }
            without_work += 1;
            if without_work > self.turns.len() {
                self.skip_rounds(quantum_us);
                without_work = 0;
            }
        }
        turn
    }

    /// Ends the rounds in which all sites that have work pay their debts; where none has work,
    /// those of all.
    fn skip_rounds(&mut self, quantum_us: i64) {
        if self.sites.values().any(Site::is_runnable) {
            let accounts = self.sites.values_mut().map(|site| (site.is_runnable(), &mut site.account));
            site::skip_rounds(accounts, quantum_us);
            return;
        }
        self.turns.clear();
        self.sites.retain(|_, site| {
            site.pay_debts();
            (site.account.has_turn, site.account.credit_us) = (false, 0);
            site.account.running > 0
        });
    }

    /// Whether a flow that was idle has the next turn: of the site whose turn it is, or of a site
    /// that was idle.
    #[must_use]
    pub fn is_next_new(&self, site: SiteId) -> bool {
        self.turns.is_next_new() || self.sites.get(&site).is_some_and(Site::is_next_new)
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
        for (path, priority) in again {
            self.add_entry(path, priority, chunk);
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
    pub fn remove_flow(&mut self, path: FlowPath) -> (u64, Vec<Charge>) {
        let Some(site) = self.sites.get_mut(&path.site) else { return (0, Vec::new()) };
        let chunks = site.remove_flow(path.flow);
        self.cancel_all(path.flow, &chunks)
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
