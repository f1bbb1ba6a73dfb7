//! Who waits for what, and whose turn it is. Plain data under one lock: no threads, no clock, no
//! generation.
//!
//! One job per key however many ask; a job belongs to the queue, never to an asker. Between flows
//! (a session, a download) turns go round by cost: surplus round robin (Shreedhar and Varghese,
//! "Efficient fair queueing using deficit round robin", SIGCOMM 1995, with the variant that lets a
//! flow overdraw its turn by one job and pays it back in the next). Within a flow the most urgent
//! key comes first, among equals the oldest. So a flow with a thousand keys waiting gets as much
//! work done as one with two.
//!
//! A flow that was idle has its first turn before all others (the new queues of FQ-CoDel, RFC 8290,
//! section 4.2), so that a client that asks for little does not wait for a whole round of clients
//! that ask for much. It counts as idle only when a round has passed it without work and without
//! debt.

use super::Done;
use super::views::ViewJob;
use protocol::Delivery;
use protocol::server::Wanted;
use rustc_hash::FxHashMap;
use std::cmp::Reverse;
use std::collections::hash_map::Entry;
use std::collections::{BinaryHeap, VecDeque};
use std::time::{Duration, Instant};
use terrain::ChunkKey;
use tokio::sync::mpsc::UnboundedSender;

/// Names an asker for as long as it lives.
pub type FlowId = u64;

/// Stale entries that a flow may have besides one for each of its waiters before they are swept
/// out.
const STALE_ENTRIES: usize = 64;

/// See the module.
#[derive(Debug)]
pub struct Queue {
    /// Jobs that may wait or run. One more is refused.
    limit: usize,
    jobs: FxHashMap<ChunkKey, Job>,
    /// Jobs that no thread has taken.
    waiting: usize,
    /// Flows with something to run. A flow is dropped when it has nothing left.
    flows: FxHashMap<FlowId, Flow>,
    /// Flows that were idle before and had no turn since; they come first.
    new_turns: VecDeque<FlowId>,
    /// Other flows, next turn first. A flow stands in one of both at most once.
    turns: VecDeque<FlowId>,
    /// Orders equals by age.
    next_number: u64,
    /// Threads that are taking jobs.
    pub runners: usize,
}

#[derive(Debug)]
struct Job {
    is_running: bool,
    /// Estimated, microseconds.
    cost_us: i64,
    /// One per asking. Bounded by the sessions' job windows and the HTTP connections.
    waiters: Vec<Waiter>,
}

/// One asking for one frame.
#[derive(Debug)]
pub struct Waiter {
    /// Who.
    pub flow: FlowId,
    /// What, with its urgency.
    pub wanted: Wanted,
    /// In which form.
    pub delivery: Delivery,
    /// Since when.
    pub since: Instant,
    /// Where the answer goes.
    pub answers: UnboundedSender<Vec<Done>>,
}

#[derive(Debug, Default)]
struct Flow {
    /// Most urgent first. Holds stale entries of jobs that another flow's turn has run; they are
    /// skipped when popped and swept out when there are many.
    entries: BinaryHeap<(u64, Reverse<u64>, ChunkKey)>,
    /// A view whose chunks are to be selected. It comes before the chunks, since it decides which
    /// are needed.
    view: Option<ViewJob>,
    /// Whether a thread runs the flow's view.
    is_selecting: bool,
    /// Whether it stands in [`Queue::new_turns`] or [`Queue::turns`].
    has_turn: bool,
    /// Microseconds of work left in this turn; below zero what was overdrawn.
    credit_us: i64,
}

impl Flow {
    fn is_runnable(&self) -> bool {
        !self.entries.is_empty() || self.view.is_some()
    }
}

/// What became of an asking.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Asked {
    /// A new job waits.
    Queued,
    /// Joined to a job that waits or runs.
    Joined,
    /// Too many jobs.
    Full,
}

/// What a thread does next.
#[derive(Debug, Default)]
pub struct Turn {
    /// A view to select chunks for, with the microseconds that the turn allows.
    pub view: Option<(FlowId, ViewJob, i64)>,
    /// Jobs to run, all of one flow's turn.
    pub keys: Vec<ChunkKey>,
    /// Askings that waited beyond the deadline; to be refused.
    pub expired: Vec<Waiter>,
    /// Jobs dropped because nobody waits for them any more.
    pub dropped: u64,
}

impl Queue {
    /// An empty queue for at most `limit` jobs.
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

    /// Jobs that wait or run.
    #[must_use]
    pub fn jobs(&self) -> usize {
        self.jobs.len()
    }

    /// Jobs that wait for a thread.
    #[must_use]
    pub const fn waiting(&self) -> usize {
        self.waiting
    }

    /// Whether a thread has the job of a key.
    #[must_use]
    pub fn is_running(&self, key: ChunkKey) -> bool {
        self.jobs.get(&key).is_some_and(|job| job.is_running)
    }

    /// Adds an asking.
    pub fn ask(&mut self, waiter: Waiter, cost_us: i64) -> Asked {
        let (flow, Wanted { key, priority, .. }) = (waiter.flow, waiter.wanted);
        let n_jobs = self.jobs.len();
        let (asked, runs) = match self.jobs.entry(key) {
            Entry::Occupied(mut job) => {
                let job = job.get_mut();
                job.waiters.push(waiter);
                (Asked::Joined, job.is_running)
            }
            Entry::Vacant(_) if n_jobs >= self.limit => return Asked::Full,
            Entry::Vacant(place) => {
                place.insert(Job { is_running: false, cost_us, waiters: vec![waiter] });
                self.waiting += 1;
                (Asked::Queued, false)
            }
        };
        // A joined job gets an entry in this flow too: whichever flow's turn comes first runs it,
        // and it goes on if the other leaves.
        if !runs {
            self.add_entry(flow, priority, key);
        }
        asked
    }

    /// Adds a flow's view. A flow has one at a time.
    pub fn add_view(&mut self, id: FlowId, view: ViewJob) {
        self.active_flow(id).view = Some(view);
        self.add_turn(id);
    }

    /// Takes back a view after a turn that took `spent_us`, to be continued; or none if it is done.
    /// A view of a flow that has gone is dropped.
    pub fn return_view(&mut self, id: FlowId, view: Option<ViewJob>, spent_us: i64) {
        let Some(flow) = self.flows.get_mut(&id) else { return };
        flow.credit_us -= spent_us;
        flow.is_selecting = false;
        if view.is_some() {
            flow.view = view;
        }
        self.add_turn(id);
    }

    /// Views that wait for a turn.
    #[cfg(test)]
    pub fn waiting_views(&self) -> usize {
        self.flows.values().filter(|flow| flow.view.is_some()).count()
    }

    /// The flow, created if it was idle.
    fn active_flow(&mut self, id: FlowId) -> &mut Flow {
        let new_turns = &mut self.new_turns;
        self.flows.entry(id).or_insert_with(|| {
            new_turns.push_back(id);
            Flow { has_turn: true, ..Flow::default() }
        })
    }

    /// Puts a flow behind the others, unless it has its place.
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

    /// The next flow's turn: jobs of about `quantum_us` of work, at least one if any waits.
    /// Explicit askings older than `deadline` are taken off; what views need stays, since a view
    /// that does not change is not said again.
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
                turn.expired.extend(job.waiters.extract_if(.., |waiter| {
                    waiter.wanted.request.is_some() && now.duration_since(waiter.since) > deadline
                }));
                job.waiters.retain(|waiter| !waiter.answers.is_closed());
                if job.waiters.is_empty() {
                    self.jobs.remove(&key);
                    self.waiting -= 1;
                    turn.dropped += u64::from(turn.expired.len() == before);
                    continue;
                }
                job.is_running = true;
                self.waiting -= 1;
                flow.credit_us -= job.cost_us;
                turn.keys.push(key);
            }
            if was_runnable || flow.credit_us < 0 {
                // One that has nothing more stays for a round: otherwise it would be a new flow at
                // once.
                self.add_turn(id);
            } else if !flow.is_selecting {
                // An idle flow saves nothing up.
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

    /// A delivery that somebody waits for and that is not among those made; none if all are.
    #[must_use]
    pub fn missing(&self, key: ChunkKey, made: impl Fn(Delivery) -> bool) -> Option<Delivery> {
        let job = self.jobs.get(&key)?;
        job.waiters.iter().map(|waiter| waiter.delivery).find(|delivery| !made(*delivery))
    }

    /// Takes the askers of a job off that wait for one of the deliveries made. The job is gone if
    /// that was all; otherwise it waits again.
    pub fn finish(&mut self, key: ChunkKey, made: impl Fn(Delivery) -> bool) -> Vec<Waiter> {
        let Some(mut job) = self.jobs.remove(&key) else { return Vec::new() };
        if job.waiters.iter().all(|waiter| made(waiter.delivery)) {
            return job.waiters;
        }
        // Somebody asked for another form after the last look. Rare, so making the chunk again is
        // right.
        let answered = job.waiters.extract_if(.., |waiter| made(waiter.delivery)).collect();
        let again: Vec<_> = job.waiters.iter().map(|waiter| (waiter.flow, waiter.wanted.priority)).collect();
        job.is_running = false;
        self.jobs.insert(key, job);
        self.waiting += 1;
        for (flow, priority) in again {
            self.add_entry(flow, priority, key);
        }
        answered
    }

    /// Withdraws a flow's askings for a key unless a thread has the job already. Returns what was
    /// withdrawn.
    pub fn withdraw(&mut self, flow: FlowId, key: ChunkKey) -> Vec<Wanted> {
        let Some(job) = self.jobs.get_mut(&key).filter(|job| !job.is_running) else { return Vec::new() };
        let withdrawn =
            job.waiters.extract_if(.., |waiter| waiter.flow == flow).map(|waiter| waiter.wanted).collect();
        if job.waiters.is_empty() {
            self.jobs.remove(&key);
            self.waiting -= 1;
        }
        withdrawn
    }

    /// Forgets a flow that has gone, with everything that only it waited for. Returns the number of
    /// jobs dropped.
    pub fn forget(&mut self, id: FlowId) -> u64 {
        let Some(flow) = self.flows.remove(&id) else { return 0 };
        if flow.has_turn {
            self.new_turns.retain(|other| *other != id);
            self.turns.retain(|other| *other != id);
        }
        let before = self.jobs.len();
        for (_, _, key) in flow.entries {
            self.withdraw(id, key);
        }
        (before - self.jobs.len()) as u64
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::purse::Purse;
    use protocol::message::{ClientMessage, Hello};
    use protocol::server::{ServerOffer, ServerSession};
    use protocol::view::View;
    use tokio::sync::mpsc::{UnboundedReceiver, unbounded_channel};

    const QUANTUM: i64 = 100;
    const PATIENT: Duration = Duration::from_secs(3600);

    fn key(x: i32) -> ChunkKey {
        ChunkKey::new(0, x, 0).unwrap()
    }

    /// A view that nobody runs.
    fn view() -> ViewJob {
        let land = terrain::Land::new(1);
        let offer = ServerOffer { land, digest: land.digest(), token: None, software: String::new() };
        let mut session = ServerSession::new(offer, 1);
        let hello = Hello { digest: None, delivery: Delivery::Exact, token: None, software: String::new() };
        let view = View {
            id: 1,
            eye: [0; 3],
            velocity: [0; 3],
            yaw_mdeg: 0,
            pitch_mdeg: 0,
            fov_mdeg: 60_000,
            viewport: [640, 360],
            tolerance_q4: 16,
            distance_m: 500,
        };
        for message in [ClientMessage::Hello(hello), ClientMessage::View(view)] {
            session.receive(protocol::Incoming::Binary(&protocol::control::encode(&message).unwrap())).unwrap();
        }
        let selection = session.take_view().unwrap();
        let (answers, _) = unbounded_channel();
        ViewJob { selection, land, purse: Purse::default(), spent: Duration::ZERO, answers }
    }

    struct Bench {
        queue: Queue,
        now: Instant,
        /// Kept open, as long as the test does not drop them.
        receivers: FxHashMap<FlowId, UnboundedReceiver<Vec<Done>>>,
    }

    impl Bench {
        fn new(limit: usize) -> Self {
            Self { queue: Queue::new(limit), now: Instant::now(), receivers: FxHashMap::default() }
        }

        fn ask(&mut self, flow: FlowId, x: i32, priority: u64, cost_us: i64) -> Asked {
            self.ask_for(Delivery::Exact, flow, x, priority, cost_us, Some(0))
        }

        fn ask_for(
            &mut self,
            delivery: Delivery,
            flow: FlowId,
            x: i32,
            priority: u64,
            cost_us: i64,
            request: Option<u32>,
        ) -> Asked {
            let (answers, receiver) = unbounded_channel();
            self.receivers.insert(flow * 1_000_000 + x as u64, receiver);
            let wanted = Wanted { key: key(x), request, priority };
            self.queue.ask(Waiter { flow, wanted, delivery, since: self.now, answers }, cost_us)
        }

        /// Runs one turn to its end and says which chunks it made.
        fn turn(&mut self) -> Vec<i32> {
            let keys = self.queue.take(QUANTUM, PATIENT, self.now).keys;
            for key in &keys {
                self.queue.finish(*key, |_| true);
            }
            keys.iter().map(|key| key.x()).collect()
        }
    }

    #[test]
    fn a_flow_with_a_thousand_keys_gets_the_same_share_as_one_with_few() {
        let mut bench = Bench::new(10_000);
        for x in 0..1000 {
            bench.ask(1, x, u64::MAX, 10);
        }
        for x in 1000..1030 {
            bench.ask(2, x, 5, 10);
        }
        let done: Vec<i32> = (0..6).flat_map(|_| bench.turn()).collect();
        let polite = done.iter().filter(|x| **x >= 1000).count();
        assert_eq!((done.len(), polite), (60, 30), "{done:?}");
    }

    #[test]
    fn shares_are_by_cost_and_an_overdraft_is_paid_back() {
        let mut bench = Bench::new(10_000);
        for x in 0..100 {
            bench.ask(1, x, 1, 70);
            bench.ask(2, 1000 + x, 1, 350);
        }
        let (mut cheap_us, mut dear_us) = (0, 0);
        for _ in 0..70 {
            for x in bench.turn() {
                if x < 1000 { cheap_us += 70 } else { dear_us += 350 }
            }
        }
        let ratio = f64::from(cheap_us) / f64::from(dear_us);
        assert!((0.9..1.1).contains(&ratio), "{cheap_us} against {dear_us}");
    }

    #[test]
    fn a_flow_that_was_idle_comes_before_a_round_of_busy_ones_and_cannot_have_that_twice_in_a_round() {
        let mut bench = Bench::new(10_000);
        for flow in 1..=50 {
            for x in 0..20 {
                bench.ask(flow, flow as i32 * 100 + x, 1, 100);
            }
        }
        // Their first turns: all are in the round then.
        for _ in 0..60 {
            bench.turn();
        }
        bench.ask(99, 7, 1, 10);
        assert_eq!(bench.turn(), [7]);
        // It comes back at once, again and again: from now on it waits as long as all others.
        let mut others = 0;
        for _ in 0..5 {
            bench.ask(99, 8, 1, 10);
            while bench.turn() != [8] {
                others += 1;
            }
        }
        assert!(others >= 4 * 49, "{others} turns of others");
    }

    #[test]
    fn a_debt_of_a_view_is_paid_by_rounds_even_if_nothing_else_of_its_flow_waits() {
        let mut bench = Bench::new(10_000);
        let mut turns_of_other = 0;
        for _ in 0..10 {
            bench.queue.add_view(1, view());
            for x in 0..1000 {
                bench.ask(2, x, 1, 100);
            }
            loop {
                let turn = bench.queue.take(QUANTUM, PATIENT, bench.now);
                if let Some((flow, _, budget_us)) = turn.view {
                    assert!(flow == 1 && budget_us > 0);
                    // It takes ten turns' worth.
                    bench.queue.return_view(1, None, 10 * QUANTUM);
                    break;
                }
                turn.keys.iter().for_each(|key| drop(bench.queue.finish(*key, |_| true)));
                turns_of_other += 1;
            }
        }
        assert!(turns_of_other >= 9 * 9, "{turns_of_other} turns of the other flow");
        // The control: nobody else waits, and the debt delays nothing.
        let mut alone = Bench::new(10);
        for _ in 0..10 {
            alone.queue.add_view(1, view());
            assert!(alone.queue.take(QUANTUM, PATIENT, alone.now).view.is_some());
            alone.queue.return_view(1, None, 10 * QUANTUM);
        }
        assert_eq!(alone.queue.take(QUANTUM, PATIENT, alone.now).keys, []);
        assert_eq!((alone.queue.flows.len(), alone.queue.waiting_views()), (0, 0));
    }

    #[test]
    fn a_view_that_comes_back_unfinished_waits_for_the_next_turn_and_one_of_a_gone_flow_is_dropped() {
        let mut bench = Bench::new(10);
        bench.queue.add_view(1, view());
        bench.queue.add_view(2, view());
        let mut order = Vec::new();
        for _ in 0..6 {
            let (flow, job, _) = bench.queue.take(QUANTUM, PATIENT, bench.now).view.unwrap();
            order.push(flow);
            bench.queue.return_view(flow, Some(job), QUANTUM);
        }
        assert_eq!(order, [1, 2, 1, 2, 1, 2]);
        let (flow, job, _) = bench.queue.take(QUANTUM, PATIENT, bench.now).view.unwrap();
        bench.queue.forget(flow);
        bench.queue.return_view(flow, Some(job), QUANTUM);
        bench.queue.forget(2);
        assert!(bench.queue.take(QUANTUM, PATIENT, bench.now).view.is_none());
        assert_eq!(bench.queue.flows.len(), 0);
    }

    #[test]
    fn within_a_flow_the_most_urgent_comes_first_and_the_oldest_among_equals() {
        let mut bench = Bench::new(100);
        for (x, priority) in [(1, 10), (2, 30), (3, 20), (4, 30)] {
            bench.ask(1, x, priority, 1000);
        }
        let order: Vec<i32> =
            std::iter::from_fn(|| Some(bench.turn()).filter(|turn| !turn.is_empty())).flatten().collect();
        assert_eq!(order, [2, 4, 3, 1]);
        assert_eq!((bench.queue.jobs(), bench.queue.flows.len(), bench.queue.waiting()), (0, 0, 0));
    }

    #[test]
    fn an_asker_that_leaves_takes_only_its_own_jobs_along() {
        let mut bench = Bench::new(100);
        bench.ask(1, 1, 1, 10);
        bench.ask(1, 2, 1, 10);
        assert_eq!(bench.ask(2, 2, 1, 10), Asked::Joined);
        assert_eq!(bench.queue.forget(1), 1);
        assert_eq!(bench.turn(), [2]);
    }

    #[test]
    fn what_is_withdrawn_does_not_run_and_what_runs_cannot_be_withdrawn() {
        let mut bench = Bench::new(100);
        bench.ask(1, 1, 9, 1000);
        bench.ask(1, 2, 5, 1000);
        assert_eq!(bench.queue.take(1, PATIENT, bench.now).keys, [key(1)]);
        assert_eq!(bench.queue.withdraw(1, key(1)), []);
        assert_eq!(bench.queue.withdraw(2, key(2)), [], "another flow's");
        assert_eq!(bench.queue.withdraw(1, key(2)).len(), 1);
        assert_eq!(bench.turn(), [0; 0]);
        assert_eq!((bench.queue.jobs(), bench.queue.finish(key(1), |_| true).len()), (1, 1));
    }

    #[test]
    fn a_job_whose_askers_hung_up_is_dropped_unrun() {
        let mut bench = Bench::new(100);
        bench.ask(1, 1, 1, 10);
        bench.receivers.clear();
        let turn = bench.queue.take(QUANTUM, PATIENT, bench.now);
        assert_eq!((turn.keys.len(), turn.dropped, bench.queue.jobs()), (0, 1, 0));
    }

    #[test]
    fn requests_beyond_the_deadline_are_taken_off_and_what_views_need_stays() {
        let mut bench = Bench::new(100);
        bench.ask_for(Delivery::Exact, 1, 1, 1, 10, Some(4));
        bench.ask_for(Delivery::Exact, 1, 2, 1, 10, None);
        let deadline = Duration::from_secs(1);
        let turn = bench.queue.take(QUANTUM, deadline, bench.now + Duration::from_secs(2));
        assert_eq!(turn.expired.iter().map(|waiter| waiter.wanted.request).collect::<Vec<_>>(), [Some(4)]);
        assert_eq!((turn.keys, turn.dropped), (vec![key(2)], 0));
    }

    #[test]
    fn a_full_queue_refuses_other_keys_and_lets_known_ones_join() {
        let mut bench = Bench::new(1);
        assert_eq!(bench.ask(1, 1, 1, 10), Asked::Queued);
        assert_eq!(bench.ask(2, 2, 1, 10), Asked::Full);
        assert_eq!(bench.ask(2, 1, 1, 10), Asked::Joined);
        assert_eq!(bench.queue.jobs(), 1);
    }

    #[test]
    fn a_form_that_was_asked_for_at_the_last_moment_is_made_by_a_further_turn() {
        let mut bench = Bench::new(10);
        bench.ask(1, 1, 1, 10);
        assert_eq!(bench.queue.take(QUANTUM, PATIENT, bench.now).keys, [key(1)]);
        bench.ask_for(Delivery::SeedOnly, 2, 1, 1, 10, None);
        assert_eq!(bench.queue.missing(key(1), |made| made == Delivery::Exact), Some(Delivery::SeedOnly));
        assert_eq!(bench.queue.finish(key(1), |made| made == Delivery::Exact).len(), 1);
        assert_eq!(bench.turn(), [1]);
        assert_eq!(bench.queue.jobs(), 0);
    }

    #[test]
    fn stale_entries_do_not_pile_up() {
        let mut bench = Bench::new(10_000);
        bench.ask(1, 0, 0, 10);
        for x in 1..5000 {
            // Flow 1 joins what flow 2's urgent turn runs.
            bench.ask(2, x, 9, 1000);
            bench.ask(1, x, 0, 1000);
            while bench.queue.jobs() > 1 {
                let Some(key) = bench.queue.take(1, PATIENT, bench.now).keys.first().copied() else { break };
                bench.queue.finish(key, |_| true);
            }
        }
        let most = bench.queue.flows.values().map(|flow| flow.entries.len()).max();
        assert!(most <= Some(2 * STALE_ENTRIES), "{most:?}");
    }
}
