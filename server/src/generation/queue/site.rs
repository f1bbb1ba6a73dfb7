//! The flows of one site and their turns.

use super::jobs::{FlowId, Jobs, Started};
use super::rotation::Rotation;
use super::{FlowPath, Turn};
use crate::chunk_id::ChunkId;
use crate::generation::views::ViewJob;
use rustc_hash::FxHashMap;
use std::cmp::Reverse;
use std::collections::{BinaryHeap, HashSet};
use std::time::Duration;
use tokio::time::Instant;

/// Entries of a flow before stale ones are removed.
pub const STALE_ENTRIES: usize = 64;

/// Limits that all turns of a queue share.
#[derive(Clone, Copy, Debug)]
pub struct TurnLimits {
    /// Work of a turn, microseconds.
    pub quantum_us: i64,
    /// Longest wait of an explicit request.
    pub deadline: Duration,
    /// The time of the turn.
    pub now: Instant,
}

/// Work left in a turn, and threads that are busy with it.
#[derive(Debug, Default)]
pub struct Account {
    /// Whether it is in its rotation.
    pub has_turn: bool,
    /// Microseconds of work left in this turn; negative for a debt.
    pub credit_us: i64,
    /// Turns that a thread executes.
    pub running: usize,
}

impl Account {
    /// Of one that was idle.
    fn in_rotation() -> Self {
        Self { has_turn: true, ..Self::default() }
    }

    /// Begins a turn; whether there is credit for work.
    pub fn begin(&mut self, quantum_us: i64) -> bool {
        self.has_turn = false;
        // Work that took less than expected may have left more.
        self.credit_us = self.credit_us.min(quantum_us);
        if self.credit_us <= 0 {
            self.credit_us += quantum_us;
        }
        self.credit_us > 0
    }

    /// Gives a thread work that is expected to take a time.
    const fn start(&mut self, expected_us: i64) {
        self.credit_us -= expected_us;
        self.running += 1;
    }

    /// Charges work, or returns what was charged too much.
    pub const fn charge(&mut self, us: i64) {
        self.credit_us -= us;
    }

    /// Ends the work of a thread, which took longer than expected.
    pub const fn end(&mut self, more_us: i64) {
        self.running = self.running.saturating_sub(1);
        self.charge(more_us);
    }

    /// Rounds in which it has no credit.
    const fn rounds_of_debt(&self, quantum_us: i64) -> i64 {
        -self.credit_us / quantum_us
    }
}

/// Skips the rounds in which all that have work are in debt; debts may be of thousands of turns.
/// The iterator yields whether one has work, and its account.
pub fn skip_rounds<'a>(accounts: impl Iterator<Item = (bool, &'a mut Account)>, quantum_us: i64) {
    let mut accounts: Vec<_> = accounts.collect();
    let of_runnable = accounts.iter().filter(|(is_runnable, _)| *is_runnable);
    let rounds = of_runnable.map(|(_, account)| account.rounds_of_debt(quantum_us)).min().unwrap_or_default();
    for (_, account) in &mut accounts {
        if account.credit_us < 0 {
            account.credit_us = (account.credit_us + rounds.max(0) * quantum_us).min(0);
        }
    }
}

/// The flows of a site that are active.
#[derive(Debug, Default)]
pub struct Site {
    /// Its turns among the sites.
    pub account: Account,
    /// Whether its turn goes on with another flow.
    pub goes_on: bool,
    flows: FxHashMap<FlowId, Flow>,
    turns: Rotation<FlowId>,
    /// Entries and views of all flows.
    queued: usize,
}

#[derive(Debug, Default)]
struct Flow {
    account: Account,
    /// Highest priority first. Includes stale entries of jobs that ran in another flow's turn; they
    /// are skipped when popped and removed when there are many.
    entries: BinaryHeap<(u64, Reverse<u64>, ChunkId)>,
    /// A view to select. It comes before the chunks, since it decides which are needed.
    view: Option<Box<ViewJob>>,
}

impl Flow {
    fn is_runnable(&self) -> bool {
        !self.entries.is_empty() || self.view.is_some()
    }

    /// Leaves the first entry of each job that waits: a chunk that was cancelled and requested
    /// again has several.
    fn remove_stale(&mut self, jobs: &Jobs) {
        let mut seen = HashSet::new();
        let entries = std::mem::take(&mut self.entries).into_sorted_vec().into_iter().rev();
        let is_first = |(_, _, chunk): &(_, _, ChunkId)| jobs.is_waiting(*chunk) && seen.insert(*chunk);
        self.entries = entries.filter(is_first).collect();
    }
}

impl Site {
    /// One that was idle.
    pub fn in_rotation() -> Self {
        Self { account: Account::in_rotation(), ..Self::default() }
    }

    /// Whether a flow has work.
    pub const fn is_runnable(&self) -> bool {
        self.queued > 0
    }

    /// Whether a flow that was idle has the next turn.
    pub fn is_next_new(&self) -> bool {
        self.turns.is_next_new()
    }

    /// The flow, added if it was idle.
    fn active_flow(&mut self, id: FlowId) -> &mut Flow {
        let turns = &mut self.turns;
        self.flows.entry(id).or_insert_with(|| {
            turns.push_new(id);
            Flow { account: Account::in_rotation(), ..Flow::default() }
        })
    }

    /// Puts a flow behind the others, unless it is in the round.
    fn add_turn(&mut self, id: FlowId) {
        let Some(flow) = self.flows.get_mut(&id) else { return };
        if !std::mem::replace(&mut flow.account.has_turn, true) {
            self.turns.push(id);
        }
    }

    /// Adds a view to a flow.
    pub fn add_view(&mut self, id: FlowId, view: Box<ViewJob>) {
        let before = self.active_flow(id).view.replace(view);
        self.queued += usize::from(before.is_none());
        self.add_turn(id);
    }

    /// Adds a job to a flow. `number` orders equal priorities.
    pub fn add_entry(&mut self, id: FlowId, priority: u64, number: u64, chunk: ChunkId, jobs: &Jobs) {
        let flow = self.active_flow(id);
        let before = flow.entries.len();
        if before >= STALE_ENTRIES && before > 2 * jobs.len() {
            flow.remove_stale(jobs);
        }
        let removed = before - flow.entries.len();
        flow.entries.push((priority, Reverse(number), chunk));
        self.queued = self.queued + 1 - removed;
        self.add_turn(id);
    }

    /// Ends a turn of a flow that took longer than expected, with the view that is left of it.
    pub fn end_turn(&mut self, id: FlowId, more_us: i64, view: Option<Box<ViewJob>>) {
        self.account.end(more_us);
        let Some(flow) = self.flows.get_mut(&id) else { return };
        flow.account.end(more_us);
        if let Some(view) = view {
            self.add_view(id, view);
        }
        // It may be in debt, and leaves after a round without work.
        self.add_turn(id);
    }

    /// Charges work of a flow in the turn of another one.
    pub fn charge(&mut self, id: FlowId, us: i64) {
        self.account.charge(us);
        self.active_flow(id).account.charge(us);
    }

    /// Removes a flow; its jobs.
    pub fn remove_flow(&mut self, id: FlowId) -> Vec<ChunkId> {
        let Some(flow) = self.flows.remove(&id) else { return Vec::new() };
        if flow.account.has_turn {
            self.turns.remove(id);
        }
        self.queued -= flow.entries.len() + usize::from(flow.view.is_some());
        flow.entries.into_iter().map(|(_, _, chunk)| chunk).collect()
    }

    /// Ends the rounds in which flows without work pay their debts, where no flow has work: there
    /// may be thousands of both.
    pub fn pay_debts(&mut self) {
        debug_assert!(!self.flows.values().any(Flow::is_runnable), "no flow has work");
        self.turns.clear();
        self.flows.retain(|_, flow| {
            (flow.account.has_turn, flow.account.credit_us) = (false, 0);
            flow.account.running > 0
        });
    }

    /// The turn of the next flow that has work.
    pub fn take(&mut self, site: u64, jobs: &mut Jobs, limits: TurnLimits, turn: &mut Turn) {
        let mut without_work = 0;
        while self.is_runnable()
            && let Some(id) = self.turns.next()
        {
            if without_work > self.turns.len() {
                let accounts = self.flows.values_mut().map(|flow| (flow.is_runnable(), &mut flow.account));
                skip_rounds(accounts, limits.quantum_us);
                without_work = 0;
            }
            without_work += 1;
            let Some(flow) = self.flows.get_mut(&id) else { continue };
            let was_runnable = flow.is_runnable();
            if was_runnable {
                self.turns.count_work();
            }
            let mut expected_us = 0;
            if flow.account.begin(limits.quantum_us) {
                turn.view = flow.view.take().map(|view| (view, flow.account.credit_us));
                self.queued -= usize::from(turn.view.is_some());
            }
            while turn.view.is_none()
                && flow.account.credit_us > expected_us
                && let Some((_, _, chunk)) = flow.entries.pop()
            {
                self.queued -= 1;
                match jobs.start(chunk, limits.deadline, limits.now, &mut turn.expired, &mut turn.traced) {
                    Some(Started::Running { cost_us }) => {
                        expected_us += cost_us;
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
            let has_work = turn.has_work();
            if has_work {
                flow.account.start(expected_us);
                self.account.start(expected_us);
                (turn.path, turn.expected_us) = (FlowPath { site, flow: id }, expected_us);
            }
            if was_runnable || flow.account.credit_us < 0 {
                // An empty flow stays for a round: otherwise it would become a new flow at once.
                self.add_turn(id);
            } else if flow.account.running == 0 {
                // An idle flow accumulates no credit.
                self.flows.remove(&id);
            }
            if has_work {
                return;
            }
        }
    }

    /// Active flows.
    #[cfg(test)]
    pub fn flows(&self) -> usize {
        self.flows.len()
    }

    /// Views that wait.
    #[cfg(test)]
    pub fn waiting_views(&self) -> usize {
        self.flows.values().filter(|flow| flow.view.is_some()).count()
    }

    /// Entries of the flow that has the most.
    #[cfg(test)]
    pub fn most_entries(&self) -> usize {
        self.flows.values().map(|flow| flow.entries.len()).max().unwrap_or_default()
    }
}
