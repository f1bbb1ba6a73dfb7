//! The fair queue. Plain data under one lock: no threads, no clock, no generation.
//!
//! One job per key for any number of requests; a job belongs to the queue, not to a flow. Flows
//! (sessions and downloads) take turns by cost: surplus round robin, the variant of deficit round
//! robin (Shreedhar and Varghese, "Efficient fair queueing using deficit round robin", SIGCOMM
//! 1995) in which a flow may overdraw its turn by one job and pays it back in the next. Within a
//! flow the highest priority comes first, among equals the oldest request. So a flow with a
//! thousand keys gets the same share of the threads as one with two.
//!
//! A flow that was idle has its first turn before all others (the new queues of FQ-CoDel, RFC 8290,
//! section 4.2), so that a light client does not wait for a round of heavy ones. A flow is idle
//! after a round without work and without debt.

use super::result::Completion;
use super::views::ViewJob;
use protocol::Delivery;
use protocol::server::ChunkRequest;
use rustc_hash::FxHashMap;
use std::cmp::Reverse;
use std::collections::hash_map::Entry;
use std::collections::{BinaryHeap, VecDeque};
use std::time::{Duration, Instant};
use terrain::ChunkKey;
use tokio::sync::mpsc::UnboundedSender;

/// Identifies a flow.
pub type FlowId = u64;

/// Entries of a flow before stale ones are removed.
const STALE_ENTRIES: usize = 64;

/// See the module.
#[derive(Debug)]
pub struct Queue {
    /// Jobs that may be queued or running. One more is rejected.
    limit: usize,
    jobs: FxHashMap<ChunkKey, Job>,
    /// Jobs that are not running.
    waiting: usize,
    /// Active flows. A flow is removed when it becomes idle.
    flows: FxHashMap<FlowId, Flow>,
    /// Flows that were idle and have had no turn since; they come first.
    new_turns: VecDeque<FlowId>,
    /// Other flows, next turn first. A flow is at most once in `new_turns` and `turns` together.
    turns: VecDeque<FlowId>,
    /// Orders equal priorities by age.
    next_number: u64,
    /// Threads that take turns.
    pub runners: usize,
}

#[derive(Debug)]
struct Job {
    is_running: bool,
    /// Estimated, microseconds.
    cost_us: i64,
    /// Bounded by the sessions' job windows and the HTTP connections.
    requests: Vec<FrameRequest>,
}

/// A request for one frame.
#[derive(Debug)]
pub struct FrameRequest {
    /// The flow that made it.
    pub flow: FlowId,
    /// Key, request number and priority.
    pub chunk: ChunkRequest,
    /// The delivery.
    pub delivery: Delivery,
    /// Whether only the compact encoding will do: an HTTP address has one representation.
    pub must_be_compact: bool,
    /// When it was made.
    pub since: Instant,
    /// Receives the result.
    pub sender: UnboundedSender<Vec<Completion>>,
}

#[derive(Debug, Default)]
struct Flow {
    /// Highest priority first. Includes stale entries of jobs that ran in another flow's turn; they
    /// are skipped when popped and removed when there are many.
    entries: BinaryHeap<(u64, Reverse<u64>, ChunkKey)>,
    /// A view to select. It comes before the chunks, since it decides which are needed.
    view: Option<ViewJob>,
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

/// Result of adding a request.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Enqueued {
    /// A new job is queued.
    NewJob,
    /// The request joined a queued or running job.
    Coalesced,
    /// The queue is full; the request was rejected.
    Full,
}

/// Work for a thread.
#[derive(Debug, Default)]
pub struct Turn {
    /// A view to select, with the turn's budget in microseconds.
    pub view: Option<(FlowId, ViewJob, i64)>,
    /// Jobs to run, all of one flow.
    pub keys: Vec<ChunkKey>,
    /// Requests over the deadline; to be rejected.
    pub expired: Vec<FrameRequest>,
    /// Jobs dropped because they had no requests any more.
    pub cancelled: u64,
}

impl Queue {
    /// An empty queue of at most `limit` jobs.
    #[must_use]
    pub fn new(limit: usize) -> Self {
        Self {
            limit,
            jobs: FxHashMap::default(),
            waiting: 0,
            flows: FxHashMap::default(),
            new_turns: VecDeque::new(),
            turns: VecDeque::new(),
            next_number: 0,
            runners: 0,
        }
    }

    /// Jobs queued or running.
    #[must_use]
    pub fn jobs(&self) -> usize {
        self.jobs.len()
    }

    /// Jobs queued.
    #[must_use]
    pub const fn waiting(&self) -> usize {
        self.waiting
    }

    /// Whether the job of a key is running.
    #[must_use]
    pub fn is_running(&self, key: ChunkKey) -> bool {
        self.jobs.get(&key).is_some_and(|job| job.is_running)
    }

    /// Adds a request.
    pub fn enqueue(&mut self, request: FrameRequest, cost_us: i64) -> Enqueued {
        let (flow, ChunkRequest { key, priority, .. }) = (request.flow, request.chunk);
        let n_jobs = self.jobs.len();
        let (enqueued, is_running) = match self.jobs.entry(key) {
            Entry::Occupied(mut job) => {
                let job = job.get_mut();
                job.requests.push(request);
                (Enqueued::Coalesced, job.is_running)
            }
            Entry::Vacant(_) if n_jobs >= self.limit => return Enqueued::Full,
            Entry::Vacant(entry) => {
                entry.insert(Job { is_running: false, cost_us, requests: vec![request] });
                self.waiting += 1;
                (Enqueued::NewJob, false)
            }
        };
        // A coalesced job gets an entry in this flow too: the flow with the earlier turn runs it,
        // and it stays queued if the other flow ends.
        if !is_running {
            self.add_entry(flow, priority, key);
        }
        enqueued
    }

    /// Adds a view job. A flow has one at a time.
    pub fn add_view(&mut self, id: FlowId, view: ViewJob) {
        self.active_flow(id).view = Some(view);
        self.add_turn(id);
    }

    /// Returns a view job after a turn that took `spent_us`, to be continued; none if it is done.
    /// The view of a removed flow is dropped.
    pub fn return_view(&mut self, id: FlowId, view: Option<ViewJob>, spent_us: i64) {
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

    fn add_entry(&mut self, id: FlowId, priority: u64, key: ChunkKey) {
        let number = self.next_number;
        self.next_number += 1;
        self.active_flow(id);
        self.add_turn(id);
        let Self { flows, jobs, .. } = self;
        let Some(flow) = flows.get_mut(&id) else { return };
        if flow.entries.len() >= STALE_ENTRIES && flow.entries.len() > 2 * jobs.len() {
            flow.entries.retain(|(_, _, key)| jobs.get(key).is_some_and(|job| !job.is_running));
        }
        flow.entries.push((priority, Reverse(number), key));
    }

    /// The next flow's turn: jobs of about `quantum_us` of work, at least one if any is queued.
    /// Explicit requests older than `deadline` are removed; requests of views stay, since a client
    /// does not repeat an unchanged view.
    pub fn take(&mut self, quantum_us: i64, deadline: Duration, now: Instant) -> Turn {
        let mut turn = Turn::default();
        while let Some(id) = self.next_turn() {
            let Some(flow) = self.flows.get_mut(&id) else { continue };
            flow.has_turn = false;
            let was_runnable = flow.is_runnable();
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
                let Some((_, _, key)) = flow.entries.pop() else { break };
                let Some(job) = self.jobs.get_mut(&key).filter(|job| !job.is_running) else { continue };
                let before = turn.expired.len();
                turn.expired.extend(job.requests.extract_if(.., |request| {
                    request.chunk.request.is_some() && now.duration_since(request.since) > deadline
                }));
                job.requests.retain(|request| !request.sender.is_closed());
                if job.requests.is_empty() {
                    self.jobs.remove(&key);
                    self.waiting -= 1;
                    turn.cancelled += u64::from(turn.expired.len() == before);
                    continue;
                }
                job.is_running = true;
                self.waiting -= 1;
                flow.credit_us -= job.cost_us;
                turn.keys.push(key);
            }
            if was_runnable || flow.credit_us < 0 {
                // An empty flow stays for a round: otherwise it would become a new flow at once.
                self.add_turn(id);
            } else if !flow.is_selecting {
                // An idle flow accumulates no credit.
                self.flows.remove(&id);
            }
            if !turn.keys.is_empty() {
                return turn;
            }
        }
        turn
    }

    fn next_turn(&mut self) -> Option<FlowId> {
        self.new_turns.pop_front().or_else(|| self.turns.pop_front())
    }

    /// The delivery of a request for which `is_encoded` is false, and whether it must be compact;
    /// none if there is no such request.
    #[must_use]
    pub fn missing_frame(
        &self,
        key: ChunkKey,
        is_encoded: impl Fn(&FrameRequest) -> bool,
    ) -> Option<(Delivery, bool)> {
        let missing = self.jobs.get(&key)?.requests.iter().find(|request| !is_encoded(request))?;
        Some((missing.delivery, missing.must_be_compact))
    }

    /// Removes and returns the requests of a job that `is_encoded` has frames for. The job is
    /// removed if no request is left; otherwise it is queued again.
    pub fn finish(&mut self, key: ChunkKey, is_encoded: impl Fn(&FrameRequest) -> bool) -> Vec<FrameRequest> {
        let Some(mut job) = self.jobs.remove(&key) else { return Vec::new() };
        if job.requests.iter().all(&is_encoded) {
            return job.requests;
        }
        // Another delivery was requested after the last check. Rare, so the chunk is generated
        // again.
        let finished = job.requests.extract_if(.., |request| is_encoded(request)).collect();
        let again: Vec<_> =
            job.requests.iter().map(|request| (request.flow, request.chunk.priority)).collect();
        job.is_running = false;
        self.jobs.insert(key, job);
        self.waiting += 1;
        for (flow, priority) in again {
            self.add_entry(flow, priority, key);
        }
        finished
    }

    /// Cancels and returns a flow's requests for a key, unless the job is running.
    pub fn cancel(&mut self, flow: FlowId, key: ChunkKey) -> Vec<ChunkRequest> {
        let Some(job) = self.jobs.get_mut(&key).filter(|job| !job.is_running) else { return Vec::new() };
        let cancelled = job
            .requests
            .extract_if(.., |request| request.flow == flow)
            .map(|request| request.chunk)
            .collect();
        if job.requests.is_empty() {
            self.jobs.remove(&key);
            self.waiting -= 1;
        }
        cancelled
    }

    /// Removes a flow and the jobs that only it requested. Returns the number of these jobs.
    pub fn remove_flow(&mut self, id: FlowId) -> u64 {
        let Some(flow) = self.flows.remove(&id) else { return 0 };
        if flow.has_turn {
            self.new_turns.retain(|other| *other != id);
            self.turns.retain(|other| *other != id);
        }
        let before = self.jobs.len();
        for (_, _, key) in flow.entries {
            self.cancel(id, key);
        }
        (before - self.jobs.len()) as u64
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::generation::test_source::view_selection;
    use crate::limits::rate_limit::TokenBucket;
    use tokio::sync::mpsc::{UnboundedReceiver, unbounded_channel};

    const QUANTUM: i64 = 100;
    const NO_DEADLINE: Duration = Duration::from_secs(3600);

    fn key(x: i32) -> ChunkKey {
        ChunkKey::new(0, x, 0).unwrap()
    }

    /// A view job that is never run.
    fn view() -> ViewJob {
        let (completion, _) = unbounded_channel();
        ViewJob {
            selection: view_selection(1),
            land: terrain::Land::new(1),
            bucket: TokenBucket::default(),
            spent: Duration::ZERO,
            completion,
        }
    }

    struct Fixture {
        queue: Queue,
        now: Instant,
        /// Open until the test drops them.
        receivers: FxHashMap<FlowId, UnboundedReceiver<Vec<Completion>>>,
    }

    impl Fixture {
        fn new(limit: usize) -> Self {
            Self { queue: Queue::new(limit), now: Instant::now(), receivers: FxHashMap::default() }
        }

        fn request(&mut self, flow: FlowId, x: i32, priority: u64, cost_us: i64) -> Enqueued {
            self.request_delivery(Delivery::Exact, flow, x, priority, cost_us, Some(0))
        }

        fn request_delivery(
            &mut self,
            delivery: Delivery,
            flow: FlowId,
            x: i32,
            priority: u64,
            cost_us: i64,
            request: Option<u32>,
        ) -> Enqueued {
            let (sender, receiver) = unbounded_channel();
            self.receivers.insert(flow * 1_000_000 + x as u64, receiver);
            let chunk = ChunkRequest { key: key(x), request, priority };
            self.queue.enqueue(
                FrameRequest { flow, chunk, delivery, must_be_compact: false, since: self.now, sender },
                cost_us,
            )
        }

        /// Runs one turn to its end and returns its chunks.
        fn turn(&mut self) -> Vec<i32> {
            let keys = self.queue.take(QUANTUM, NO_DEADLINE, self.now).keys;
            for key in &keys {
                self.queue.finish(*key, |_| true);
            }
            keys.iter().map(|key| key.x()).collect()
        }
    }

    #[test]
    fn a_flow_with_many_keys_gets_the_same_share_as_one_with_few() {
        let mut fixture = Fixture::new(10_000);
        for x in 0..1000 {
            fixture.request(1, x, u64::MAX, 10);
        }
        for x in 1000..1030 {
            fixture.request(2, x, 5, 10);
        }
        let done: Vec<i32> = (0..6).flat_map(|_| fixture.turn()).collect();
        let light = done.iter().filter(|x| **x >= 1000).count();
        assert_eq!((done.len(), light), (60, 30), "{done:?}");
    }

    #[test]
    fn shares_follow_the_cost_and_an_overdraft_is_paid_back() {
        let mut fixture = Fixture::new(10_000);
        for x in 0..100 {
            fixture.request(1, x, 1, 70);
            fixture.request(2, 1000 + x, 1, 350);
        }
        let (mut cheap_us, mut expensive_us) = (0, 0);
        for _ in 0..70 {
            for x in fixture.turn() {
                if x < 1000 { cheap_us += 70 } else { expensive_us += 350 }
            }
        }
        let ratio = f64::from(cheap_us) / f64::from(expensive_us);
        assert!((0.9..1.1).contains(&ratio), "{cheap_us} against {expensive_us}");
    }

    #[test]
    fn an_idle_flow_is_first_but_only_once_per_round() {
        let mut fixture = Fixture::new(10_000);
        for flow in 1..=50 {
            for x in 0..20 {
                fixture.request(flow, flow as i32 * 100 + x, 1, 100);
            }
        }
        // After their first turns all flows are in the round.
        for _ in 0..60 {
            fixture.turn();
        }
        fixture.request(99, 7, 1, 10);
        assert_eq!(fixture.turn(), [7]);
        // It returns at once, repeatedly: from now on it waits as long as all others.
        let mut others = 0;
        for _ in 0..5 {
            fixture.request(99, 8, 1, 10);
            while fixture.turn() != [8] {
                others += 1;
            }
        }
        assert!(others >= 4 * 49, "{others} turns of others");
    }

    #[test]
    fn the_debt_of_a_view_is_paid_in_rounds_without_other_work() {
        let mut fixture = Fixture::new(10_000);
        let mut turns_of_other = 0;
        for _ in 0..10 {
            fixture.queue.add_view(1, view());
            for x in 0..1000 {
                fixture.request(2, x, 1, 100);
            }
            loop {
                let turn = fixture.queue.take(QUANTUM, NO_DEADLINE, fixture.now);
                if let Some((flow, _, budget_us)) = turn.view {
                    assert!(flow == 1 && budget_us > 0);
                    // It costs ten quanta.
                    fixture.queue.return_view(1, None, 10 * QUANTUM);
                    break;
                }
                turn.keys.iter().for_each(|key| drop(fixture.queue.finish(*key, |_| true)));
                turns_of_other += 1;
            }
        }
        assert!(turns_of_other >= 9 * 9, "{turns_of_other} turns of the other flow");
        // The control: without other flows the debt delays nothing.
        let mut alone = Fixture::new(10);
        for _ in 0..10 {
            alone.queue.add_view(1, view());
            assert!(alone.queue.take(QUANTUM, NO_DEADLINE, alone.now).view.is_some());
            alone.queue.return_view(1, None, 10 * QUANTUM);
        }
        assert_eq!(alone.queue.take(QUANTUM, NO_DEADLINE, alone.now).keys, []);
        assert_eq!((alone.queue.flows.len(), alone.queue.waiting_views()), (0, 0));
    }

    #[test]
    fn an_unfinished_view_waits_for_the_next_turn() {
        let mut fixture = Fixture::new(10);
        fixture.queue.add_view(1, view());
        fixture.queue.add_view(2, view());
        let mut order = Vec::new();
        for _ in 0..6 {
            let (flow, job, _) = fixture.queue.take(QUANTUM, NO_DEADLINE, fixture.now).view.unwrap();
            order.push(flow);
            fixture.queue.return_view(flow, Some(job), QUANTUM);
        }
        assert_eq!(order, [1, 2, 1, 2, 1, 2]);
        let (flow, job, _) = fixture.queue.take(QUANTUM, NO_DEADLINE, fixture.now).view.unwrap();
        fixture.queue.remove_flow(flow);
        fixture.queue.return_view(flow, Some(job), QUANTUM);
        fixture.queue.remove_flow(2);
        assert!(fixture.queue.take(QUANTUM, NO_DEADLINE, fixture.now).view.is_none());
        assert_eq!(fixture.queue.flows.len(), 0);
    }

    #[test]
    fn within_a_flow_order_is_by_priority_then_age() {
        let mut fixture = Fixture::new(100);
        for (x, priority) in [(1, 10), (2, 30), (3, 20), (4, 30)] {
            fixture.request(1, x, priority, 1000);
        }
        let order: Vec<i32> =
            std::iter::from_fn(|| Some(fixture.turn()).filter(|turn| !turn.is_empty())).flatten().collect();
        assert_eq!(order, [2, 4, 3, 1]);
        assert_eq!((fixture.queue.jobs(), fixture.queue.flows.len(), fixture.queue.waiting()), (0, 0, 0));
    }

    #[test]
    fn a_removed_flow_removes_only_its_own_jobs() {
        let mut fixture = Fixture::new(100);
        fixture.request(1, 1, 1, 10);
        fixture.request(1, 2, 1, 10);
        assert_eq!(fixture.request(2, 2, 1, 10), Enqueued::Coalesced);
        assert_eq!(fixture.queue.remove_flow(1), 1);
        assert_eq!(fixture.turn(), [2]);
    }

    #[test]
    fn a_cancelled_job_does_not_run_and_a_running_one_continues() {
        let mut fixture = Fixture::new(100);
        fixture.request(1, 1, 9, 1000);
        fixture.request(1, 2, 5, 1000);
        assert_eq!(fixture.queue.take(1, NO_DEADLINE, fixture.now).keys, [key(1)]);
        assert_eq!(fixture.queue.cancel(1, key(1)), []);
        assert_eq!(fixture.queue.cancel(2, key(2)), [], "another flow's");
        assert_eq!(fixture.queue.cancel(1, key(2)).len(), 1);
        assert_eq!(fixture.turn(), [0; 0]);
        assert_eq!((fixture.queue.jobs(), fixture.queue.finish(key(1), |_| true).len()), (1, 1));
    }

    #[test]
    fn a_job_without_receivers_is_cancelled() {
        let mut fixture = Fixture::new(100);
        fixture.request(1, 1, 1, 10);
        fixture.receivers.clear();
        let turn = fixture.queue.take(QUANTUM, NO_DEADLINE, fixture.now);
        assert_eq!((turn.keys.len(), turn.cancelled, fixture.queue.jobs()), (0, 1, 0));
    }

    #[test]
    fn explicit_requests_expire_and_requests_of_views_do_not() {
        let mut fixture = Fixture::new(100);
        fixture.request_delivery(Delivery::Exact, 1, 1, 1, 10, Some(4));
        fixture.request_delivery(Delivery::Exact, 1, 2, 1, 10, None);
        let deadline = Duration::from_secs(1);
        let turn = fixture.queue.take(QUANTUM, deadline, fixture.now + Duration::from_secs(2));
        assert_eq!(turn.expired.iter().map(|request| request.chunk.request).collect::<Vec<_>>(), [Some(4)]);
        assert_eq!((turn.keys, turn.cancelled), (vec![key(2)], 0));
    }

    #[test]
    fn a_full_queue_rejects_new_keys_and_coalesces_known_ones() {
        let mut fixture = Fixture::new(1);
        assert_eq!(fixture.request(1, 1, 1, 10), Enqueued::NewJob);
        assert_eq!(fixture.request(2, 2, 1, 10), Enqueued::Full);
        assert_eq!(fixture.request(2, 1, 1, 10), Enqueued::Coalesced);
        assert_eq!(fixture.queue.jobs(), 1);
    }

    #[test]
    fn a_late_request_for_another_delivery_queues_the_job_again() {
        let mut fixture = Fixture::new(10);
        fixture.request(1, 1, 1, 10);
        assert_eq!(fixture.queue.take(QUANTUM, NO_DEADLINE, fixture.now).keys, [key(1)]);
        fixture.request_delivery(Delivery::SeedOnly, 2, 1, 1, 10, None);
        assert_eq!(
            fixture.queue.missing_frame(key(1), |request| request.delivery == Delivery::Exact),
            Some((Delivery::SeedOnly, false))
        );
        assert_eq!(fixture.queue.finish(key(1), |request| request.delivery == Delivery::Exact).len(), 1);
        assert_eq!(fixture.turn(), [1]);
        assert_eq!(fixture.queue.jobs(), 0);
    }

    #[test]
    fn stale_entries_are_bounded() {
        let mut fixture = Fixture::new(10_000);
        fixture.request(1, 0, 0, 10);
        for x in 1..5000 {
            // Flow 1 requests the same key as flow 2, whose job runs first.
            fixture.request(2, x, 9, 1000);
            fixture.request(1, x, 0, 1000);
            while fixture.queue.jobs() > 1 {
                let Some(key) = fixture.queue.take(1, NO_DEADLINE, fixture.now).keys.first().copied() else {
                    break;
                };
                fixture.queue.finish(key, |_| true);
            }
        }
        let most = fixture.queue.flows.values().map(|flow| flow.entries.len()).max();
        assert!(most <= Some(2 * STALE_ENTRIES), "{most:?}");
    }
}
