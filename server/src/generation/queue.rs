//! Who waits for what, and whose turn it is. Plain data under one lock: no threads, no clock, no generation.
//!
//! One job per key however many ask; a job belongs to the queue, never to an asker. Between flows (a session, a download) turns go
//! round by cost: surplus round robin (Shreedhar and Varghese, "Efficient fair queueing using deficit round robin", SIGCOMM 1995,
//! with the variant that lets a flow overdraw its turn by one job and pays it back in the next). Within a flow the most urgent key
//! comes first, among equals the oldest. So a flow with a thousand keys waiting gets as much work done as one with two.

use super::Done;
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

/// Stale entries that a flow may have besides one for each of its waiters before they are swept out.
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
    /// The same flows, next turn first.
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
    /// Most urgent first. Holds stale entries of jobs that another flow's turn has run; they are skipped when popped and
    /// swept out when there are many.
    entries: BinaryHeap<(u64, Reverse<u64>, ChunkKey)>,
    /// Microseconds of work left in this turn; below zero what was overdrawn.
    credit_us: i64,
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
        // A joined job gets an entry in this flow too: whichever flow's turn comes first runs it, and it goes on if the other leaves.
        if !runs {
            self.add_entry(flow, priority, key);
        }
        asked
    }

    fn add_entry(&mut self, id: FlowId, priority: u64, key: ChunkKey) {
        let number = self.next_number;
        self.next_number += 1;
        let Self { flows, turns, jobs, .. } = self;
        let flow = flows.entry(id).or_insert_with(|| {
            turns.push_back(id);
            Flow::default()
        });
        if flow.entries.len() >= STALE_ENTRIES && flow.entries.len() > 2 * jobs.len() {
            flow.entries.retain(|(_, _, key)| jobs.get(key).is_some_and(|job| !job.is_running));
        }
        flow.entries.push((priority, Reverse(number), key));
    }

    /// The next flow's turn: jobs of about `quantum_us` of work, at least one if any waits. Explicit askings older than `deadline`
    /// are taken off; what views need stays, since a view that does not change is not said again.
    pub fn take(&mut self, quantum_us: i64, deadline: Duration, now: Instant) -> Turn {
        let mut turn = Turn::default();
        while let Some(id) = self.turns.pop_front() {
            let Some(flow) = self.flows.get_mut(&id) else { continue };
            if flow.credit_us <= 0 {
                flow.credit_us += quantum_us;
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
            if flow.entries.is_empty() {
                // An idle flow saves nothing up, and its debt of at most one job is forgiven.
                self.flows.remove(&id);
            } else {
                self.turns.push_back(id);
            }
            if !turn.keys.is_empty() {
                return turn;
            }
        }
        turn
    }

    /// A delivery that somebody waits for and that is not among those made; none if all are.
    #[must_use]
    pub fn missing(&self, key: ChunkKey, made: impl Fn(Delivery) -> bool) -> Option<Delivery> {
        let job = self.jobs.get(&key)?;
        job.waiters.iter().map(|waiter| waiter.delivery).find(|delivery| !made(*delivery))
    }

    /// Takes the askers of a job off that wait for one of the deliveries made. The job is gone if that was all; otherwise it waits
    /// again.
    pub fn finish(&mut self, key: ChunkKey, made: impl Fn(Delivery) -> bool) -> Vec<Waiter> {
        let Some(mut job) = self.jobs.remove(&key) else { return Vec::new() };
        if job.waiters.iter().all(|waiter| made(waiter.delivery)) {
            return job.waiters;
        }
        // Somebody asked for another form after the last look. Rare, so making the chunk again is right.
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

    /// Withdraws a flow's askings for a key unless a thread has the job already. Returns what was withdrawn.
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

    /// Forgets a flow that has gone, with everything that only it waited for. Returns the number of jobs dropped.
    pub fn forget(&mut self, id: FlowId) -> u64 {
        let Some(flow) = self.flows.remove(&id) else { return 0 };
        self.turns.retain(|other| *other != id);
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
    use tokio::sync::mpsc::{UnboundedReceiver, unbounded_channel};

    const QUANTUM: i64 = 100;
    const PATIENT: Duration = Duration::from_secs(3600);

    fn key(x: i32) -> ChunkKey {
        ChunkKey::new(0, x, 0).unwrap()
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
