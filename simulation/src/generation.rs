//! The queue of generation as the server has it: one job a key, flows in turns by cost, a view
//! before the chunks of its flow.

use protocol::server::{ChunkRequest, ViewSelection};
use rustc_hash::FxHashMap;
use std::cmp::Reverse;
use std::collections::{BinaryHeap, VecDeque};
use std::time::Duration;
use terrain::ChunkKey;

/// Quantum of a turn: that of the server.
const QUANTUM: Duration = Duration::from_micros(160);

/// A request that waits for a chunk.
#[derive(Clone, Copy, Debug)]
pub struct Waiting {
    /// Number of the session.
    pub session: usize,
    /// What it asked for.
    pub request: ChunkRequest,
    /// When, virtual time.
    pub since: Duration,
}

#[derive(Debug, Default)]
struct Flow {
    view: Option<ViewSelection>,
    /// Priority, age, key. Jobs that ran in another flow's turn are passed over.
    entries: BinaryHeap<(u64, Reverse<u64>, ChunkKey)>,
    has_turn: bool,
    /// Nanoseconds; negative for a debt.
    credit: i64,
}

#[derive(Debug)]
struct Job {
    is_running: bool,
    waiting: Vec<Waiting>,
}

/// What a turn does.
#[derive(Debug)]
pub enum Turn {
    /// Selects a view of a session.
    View(usize, Box<ViewSelection>),
    /// Makes these chunks.
    Chunks(Vec<ChunkKey>),
}

/// See the module.
#[derive(Debug, Default)]
pub struct Queue {
    flows: FxHashMap<usize, Flow>,
    turns: VecDeque<usize>,
    jobs: FxHashMap<ChunkKey, Job>,
    queued: usize,
    number: u64,
}

impl Queue {
    /// Jobs that no processor has begun.
    #[must_use]
    pub const fn queued(&self) -> usize {
        self.queued
    }

    /// Whether a turn would find work.
    #[must_use]
    pub fn has_work(&self) -> bool {
        !self.turns.is_empty()
    }

    /// Flows with work.
    #[must_use]
    pub fn flows(&self) -> usize {
        self.flows.len()
    }

    /// Adds a view of a session, which has no other.
    pub fn add_view(&mut self, session: usize, view: ViewSelection) {
        self.flows.entry(session).or_default().view = Some(view);
        self.add_turn(session);
    }

    /// Adds a request.
    pub fn add(&mut self, waiting: Waiting) {
        let key = waiting.request.key;
        let queued = &mut self.queued;
        let job = self.jobs.entry(key).or_insert_with(|| {
            *queued += 1;
            Job { is_running: false, waiting: Vec::new() }
        });
        job.waiting.push(waiting);
        if !job.is_running {
            let entry = (waiting.request.priority, Reverse(self.number), key);
            self.number += 1;
            self.flows.entry(waiting.session).or_default().entries.push(entry);
            self.add_turn(waiting.session);
        }
    }

    /// Removes a request that waits, unless its job runs.
    pub fn cancel(&mut self, session: usize, key: ChunkKey) -> Option<ChunkRequest> {
        let job = self.jobs.get_mut(&key).filter(|job| !job.is_running)?;
        let index = job.waiting.iter().position(|waiting| waiting.session == session)?;
        let cancelled = job.waiting.swap_remove(index).request;
        if job.waiting.is_empty() {
            self.jobs.remove(&key);
            self.queued -= 1;
        }
        Some(cancelled)
    }

    /// The next turn, and the requests that waited longer than the deadline. `cost` is that of a
    /// job.
    pub fn turn(
        &mut self,
        now: Duration,
        deadline: Duration,
        cost: impl Fn(ChunkKey) -> Duration,
    ) -> (Option<Turn>, Vec<Waiting>) {
        let (mut keys, mut expired) = (Vec::new(), Vec::new());
        let quantum = QUANTUM.as_nanos() as i64;
        while let Some(session) = self.turns.pop_front() {
            let Some(flow) = self.flows.get_mut(&session) else { continue };
            flow.has_turn = false;
            if flow.credit <= 0 {
                flow.credit += quantum;
            }
            if let Some(view) = flow.view.take() {
                self.add_turn(session);
                return (Some(Turn::View(session, Box::new(view))), expired);
            }
            while flow.credit > 0 {
                let Some((_, _, key)) = flow.entries.pop() else { break };
                let Some(job) = self.jobs.get_mut(&key).filter(|job| !job.is_running) else { continue };
                let is_late = |waiting: &mut Waiting| {
                    waiting.request.request.is_some() && now > waiting.since + deadline
                };
                expired.extend(job.waiting.extract_if(.., is_late));
                self.queued -= 1;
                if job.waiting.is_empty() {
                    self.jobs.remove(&key);
                    continue;
                }
                job.is_running = true;
                flow.credit -= cost(key).as_nanos() as i64;
                keys.push(key);
            }
            if flow.entries.is_empty() && flow.credit >= 0 {
                self.flows.remove(&session);
            } else {
                self.add_turn(session);
            }
            if !keys.is_empty() {
                return (Some(Turn::Chunks(keys)), expired);
            }
        }
        (None, expired)
    }

    /// A chunk is made: who waits for it.
    pub fn made(&mut self, key: ChunkKey) -> Vec<Waiting> {
        self.jobs.remove(&key).map(|job| job.waiting).unwrap_or_default()
    }

    fn add_turn(&mut self, session: usize) {
        if let Some(flow) = self.flows.get_mut(&session)
            && !std::mem::replace(&mut flow.has_turn, true)
        {
            self.turns.push_back(session);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const COST: Duration = Duration::from_micros(100);

    fn waiting(session: usize, x: i32, request: Option<u32>) -> Waiting {
        let key = ChunkKey::new(0, x, 0).unwrap();
        Waiting { session, request: ChunkRequest { key, request, priority: 1 }, since: Duration::ZERO }
    }

    fn keys(queue: &mut Queue, now: Duration) -> (Vec<i32>, usize) {
        let (turn, expired) = queue.turn(now, Duration::from_millis(500), |_| COST);
        let Some(Turn::Chunks(keys)) = turn else { return (Vec::new(), expired.len()) };
        (keys.iter().map(|key| key.x()).collect(), expired.len())
    }

    #[test]
    fn flows_take_turns_and_a_key_is_one_job() {
        let mut queue = Queue::default();
        (0..6).for_each(|x| queue.add(waiting(0, x, None)));
        queue.add(waiting(1, 0, None));
        queue.add(waiting(1, 9, None));
        assert_eq!(queue.queued(), 7);
        assert_eq!(keys(&mut queue, COST).0, [0, 1]);
        assert_eq!(keys(&mut queue, COST).0, [9], "0 runs in the other flow's turn");
        assert_eq!(queue.made(ChunkKey::new(0, 0, 0).unwrap()).len(), 2);
        assert_eq!(keys(&mut queue, COST).0, [2, 3]);
        assert_eq!(keys(&mut queue, COST).0, [4], "what the turn before overdrew is paid");
        assert_eq!(keys(&mut queue, COST).0, [5]);
        assert_eq!(keys(&mut queue, COST), (vec![], 0));
    }

    #[test]
    fn requests_expire_and_views_do_not() {
        let mut queue = Queue::default();
        queue.add(waiting(0, 1, Some(7)));
        queue.add(waiting(0, 2, None));
        assert_eq!(keys(&mut queue, Duration::from_secs(1)), (vec![2], 1));
        queue.add(waiting(0, 3, None));
        assert!(queue.cancel(0, ChunkKey::new(0, 3, 0).unwrap()).is_some());
        assert!(queue.cancel(0, ChunkKey::new(0, 2, 0).unwrap()).is_none(), "it runs");
        assert_eq!(queue.queued(), 0);
    }
}
