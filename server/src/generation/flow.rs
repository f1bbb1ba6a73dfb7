//! Asking: what a session or a download holds of the service.
//!
//! Every asking has exactly one answer or is withdrawn. A flow that is dropped withdraws
//! everything.

use super::queue::{Asked, FlowId, Waiter};
use super::views::ViewJob;
use super::{Answer, Done, Generation, GenerationError, Shared};
use crate::purse::Purse;
use bytes::Bytes;
use protocol::Delivery;
use protocol::server::Wanted;
use protocol::view_selection::ViewSelection;
use std::sync::atomic::Ordering;
use std::time::{Duration, Instant};
use terrain::{ChunkKey, Land};
use tokio::sync::mpsc::{UnboundedReceiver, UnboundedSender, unbounded_channel};

/// What a flow has asked for and got.
#[derive(Debug)]
pub enum FlowAnswer {
    /// Chunks, or why they cannot be had.
    Chunks(Vec<Done>),
    /// A finished selection.
    View(Box<ViewSelection>),
}

/// One asker: a session or a download. Work is shared fairly between flows.
pub struct Flow {
    service: Generation,
    id: FlowId,
    /// Cloned into every asking.
    answers: UnboundedSender<Vec<Done>>,
    /// Holds at most one answer for each asking, so whoever bounds the askings bounds this.
    answered: UnboundedReceiver<Vec<Done>>,
    /// Where finished view selections arrive: at most one, since a session has one at a time.
    selections: (UnboundedSender<ViewSelection>, UnboundedReceiver<ViewSelection>),
    /// Askings without an answer taken, a view among them.
    open: usize,
    /// Whether a view is being selected.
    is_selecting: bool,
    /// Who pays for what is made and sent. Looking whether there is anything in it is the asker's
    /// part.
    purse: Purse,
}

impl Flow {
    pub(super) fn new(service: Generation, id: FlowId, purse: Purse) -> Self {
        let (answers, answered) = unbounded_channel();
        let selections = unbounded_channel();
        Self { service, id, answers, answered, selections, open: 0, is_selecting: false, purse }
    }

    /// One frame for an asker that wants no other. Dropping the future withdraws the interest.
    ///
    /// # Errors
    /// See [`GenerationError`].
    pub async fn frame(mut self, wanted: Wanted, delivery: Delivery) -> Result<Bytes, GenerationError> {
        if let Some(frame) = self.cached(wanted.key, delivery) {
            return Ok(frame);
        }
        self.ask(wanted, delivery);
        // One asking, one answer.
        self.answers().await.pop().map_or(Err(GenerationError::Failed), |(_, answer)| answer)
    }

    /// As [`Generation::cached`], paid for.
    #[must_use]
    pub fn cached(&self, key: ChunkKey, delivery: Delivery) -> Option<Bytes> {
        let frame = self.service.cached(key, delivery)?;
        self.pay_bytes(frame.len());
        Some(frame)
    }

    /// Who pays.
    #[must_use]
    pub const fn purse(&self) -> &Purse {
        &self.purse
    }

    fn pay_bytes(&self, bytes: usize) {
        if self.purse.is_limited() {
            self.purse.pay_bytes(bytes, tokio::time::Instant::now());
        }
    }

    /// Asks for a frame. The answer, exactly one, comes from [`Flow::answers`], unless the asking
    /// is withdrawn.
    pub fn ask(&mut self, wanted: Wanted, delivery: Delivery) {
        self.opened(1);
        let Shared { frames, metrics, costs, .. } = &*self.service.shared;
        metrics.requested.inc();
        let mut queue = self.service.shared.lock();
        // Under the lock: a job leaves the queue only after its frames are in the cache.
        if let Some(frame) = frames.get(wanted.key, delivery, || queue.jobs() == 0) {
            metrics.cache_hits.inc();
            self.answer_now(wanted, Ok(frame));
            return;
        }
        let (since, answers) = (Instant::now(), self.answers.clone());
        let waiter = Waiter { flow: self.id, wanted, delivery, since, answers };
        let cost_us = costs.expected_us(wanted.key);
        match queue.ask(waiter, cost_us) {
            Asked::Joined => {
                metrics.coalesced.inc();
            }
            Asked::Full => {
                metrics.shed.inc();
                self.answer_now(wanted, Err(GenerationError::Overloaded));
            }
            Asked::Queued => {
                // Beforehand, so that what is under way is paid for. Who joins causes no work.
                if self.purse.is_limited() {
                    self.purse.pay_work(cost_us, tokio::time::Instant::now());
                }
                metrics.queue.set(queue.jobs() as i64);
                self.service.start_runner(&mut queue);
            }
        }
    }

    /// Selects a view's chunks on the generation threads, in this flow's turns. One at a time: the
    /// selection comes from [`Flow::next_answer`].
    pub fn select(&mut self, selection: ViewSelection, land: Land) {
        self.opened(1);
        self.is_selecting = true;
        let (purse, answers) = (self.purse.clone(), self.selections.0.clone());
        let job = ViewJob { selection, land, purse, spent: Duration::ZERO, answers };
        let mut queue = self.service.shared.lock();
        queue.add_view(self.id, job);
        self.service.start_runner(&mut queue);
    }

    /// Waits for chunks or for the selection under way; for ever while nothing is asked. Cancel
    /// safe.
    pub async fn next_answer(&mut self) -> FlowAnswer {
        tokio::select! {
            Some(selection) = self.selections.1.recv() => {
                self.closed(1);
                self.is_selecting = false;
                FlowAnswer::View(Box::new(selection))
            }
            Some(done) = self.answered.recv() => {
                self.take(&done);
                FlowAnswer::Chunks(done)
            }
            // Unreachable: this flow holds both senders itself.
            else => std::future::pending().await,
        }
    }

    fn opened(&mut self, count: usize) {
        if self.open == 0 && count > 0 {
            self.service.shared.open_flows.fetch_add(1, Ordering::Relaxed);
        }
        self.open += count;
    }

    fn closed(&mut self, count: usize) {
        self.open -= count;
        if self.open == 0 && count > 0 {
            self.service.shared.open_flows.fetch_sub(1, Ordering::Relaxed);
        }
    }

    fn answer_now(&self, wanted: Wanted, answer: Answer) {
        // The receiver is in this very flow.
        let _ = self.answers.send(vec![(wanted, answer)]);
    }

    /// Waits for the next answers, at least one; for ever while nothing is asked. Cancel safe.
    pub async fn answers(&mut self) -> Vec<Done> {
        loop {
            if let Some(done) = self.answered.recv().await {
                self.take(&done);
                return done;
            }
            // Unreachable: this flow holds a sender itself.
            std::future::pending::<()>().await;
        }
    }

    /// The next answers if they are there.
    pub fn try_answers(&mut self) -> Option<Vec<Done>> {
        let done = self.answered.try_recv().ok()?;
        self.take(&done);
        Some(done)
    }

    /// Answers are taken, and paid for by their bytes.
    fn take(&mut self, done: &[Done]) {
        self.closed(done.len());
        self.pay_bytes(done.iter().filter_map(|(_, answer)| answer.as_ref().ok()).map(Bytes::len).sum());
    }

    /// Chunks asked for without an answer taken.
    #[must_use]
    pub const fn open(&self) -> usize {
        self.open - self.is_selecting as usize
    }

    /// Withdraws the askings for a key that no thread has taken up, and returns them; the others
    /// will be answered.
    pub fn withdraw(&mut self, key: ChunkKey) -> Vec<Wanted> {
        let withdrawn = self.service.shared.lock().withdraw(self.id, key);
        self.closed(withdrawn.len());
        self.service.shared.metrics.cancelled.inc_by(withdrawn.len() as u64);
        withdrawn
    }
}

impl Drop for Flow {
    fn drop(&mut self) {
        if self.open > 0 {
            let dropped = self.service.shared.lock().forget(self.id);
            self.service.shared.metrics.cancelled.inc_by(dropped);
            self.closed(self.open);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::generation::gated::{ask, bench, key, wanted};

    #[tokio::test]
    async fn a_flow_gets_its_most_urgent_chunk_first_and_every_asking_is_answered_once() {
        let bench = bench(1 << 20, 10);
        let mut flow = bench.service.flow();
        flow.ask(wanted(key(0), 0), Delivery::Exact);
        // Let the only thread take the first job, so that the order of the rest is the queue's.
        while !bench.service.shared.lock().is_running(key(0)) {
            tokio::task::yield_now().await;
        }
        for (x, priority) in [(1, 10), (2, 30), (3, 20), (1, 40)] {
            flow.ask(wanted(key(x), priority), Delivery::Exact);
        }
        assert_eq!(flow.open(), 5);
        for _ in 0..4 {
            bench.permit.send(()).unwrap();
        }
        let mut answers = Vec::new();
        while flow.open() > 0 {
            for (wanted, answer) in flow.answers().await {
                assert!(answer.is_ok());
                answers.push(wanted.key.x());
            }
        }
        answers.sort_unstable();
        assert_eq!(answers, [0, 1, 1, 2, 3]);
        assert_eq!(bench.made.try_iter().collect::<Vec<_>>(), [0, 1, 2, 3].map(key));
    }

    #[tokio::test]
    async fn a_hundred_thousand_askers_that_hang_up_harm_nobody() {
        let bench = bench(1 << 20, 10);
        let blocker = ask(&bench.service, key(0), 1).await;
        while !bench.service.shared.lock().is_running(key(0)) {
            tokio::task::yield_now().await;
        }
        let mut patient = bench.service.flow();
        patient.ask(wanted(key(1), 1), Delivery::Exact);
        for _ in 0..100_000 {
            let mut flow = bench.service.flow();
            flow.ask(wanted(key(1), 1), Delivery::Exact);
            flow.ask(wanted(key(2), 1), Delivery::Exact);
        }
        bench.permit.send(()).unwrap();
        bench.permit.send(()).unwrap();
        assert!(patient.answers().await[0].1.is_ok());
        assert!(blocker.await.unwrap().is_ok());
        assert_eq!(bench.made.try_iter().collect::<Vec<_>>(), [0, 1].map(key));
        assert_eq!(bench.metrics.cancelled.get(), 100_000);
        drop(patient);
        assert_eq!(bench.service.shared.open_flows.load(Ordering::Relaxed), 0);
    }

    #[tokio::test]
    async fn a_withdrawn_asking_is_not_answered_and_not_made() {
        let bench = bench(1 << 20, 10);
        let mut flow = bench.service.flow();
        flow.ask(wanted(key(0), 9), Delivery::Exact);
        while !bench.service.shared.lock().is_running(key(0)) {
            tokio::task::yield_now().await;
        }
        flow.ask(wanted(key(1), 1), Delivery::Exact);
        assert_eq!(flow.withdraw(key(0)), [], "it is being made");
        assert_eq!(flow.withdraw(key(1)), [wanted(key(1), 1)]);
        bench.permit.send(()).unwrap();
        assert_eq!(flow.answers().await[0].0.key, key(0));
        assert_eq!((flow.open(), flow.try_answers().is_none()), (0, true));
    }
}
