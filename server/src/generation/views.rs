//! The selection of views on the generation threads.
//!
//! A session's view is work like its chunks: it waits for the session's turn, runs for as long as
//! the turn allows, and is charged by the time it took. Threads that accept connections and answer
//! probes never run it.

use super::Shared;
use super::queue::FlowId;
use crate::purse::Purse;
use protocol::view_selection::ViewSelection;
use std::time::{Duration, Instant};
use terrain::Land;
use tokio::sync::mpsc::UnboundedSender;

/// Chunks examined between two looks at the clock: some 50 us.
const STEP_CHUNKS: usize = 256;

/// One session's view under selection.
#[derive(Debug)]
pub struct ViewJob {
    /// What is selected so far.
    pub selection: ViewSelection,
    /// The land that it is selected from.
    pub land: Land,
    /// The address that pays.
    pub purse: Purse,
    /// Time spent so far.
    pub spent: Duration,
    /// Where the finished selection goes.
    pub answers: UnboundedSender<ViewSelection>,
}

impl Shared {
    /// Continues a view for about `budget_us` microseconds. Sends it to its session when it is
    /// done; otherwise it waits for the next turn of its flow.
    pub(super) fn select_view(&self, flow: FlowId, mut job: ViewJob, budget_us: i64) {
        let started = Instant::now();
        let budget = Duration::from_micros(budget_us.max(0).unsigned_abs());
        let mut is_done = job.answers.is_closed();
        while !is_done && started.elapsed() < budget {
            is_done = job.selection.step(&job.land, STEP_CHUNKS);
        }
        let spent = started.elapsed();
        job.spent += spent;
        self.metrics.view_seconds.inc_by(spent.as_secs_f64());
        let spent_us = i64::try_from(spent.as_micros()).unwrap_or(i64::MAX);
        job.purse.pay_view(spent_us, tokio::time::Instant::now());
        if is_done {
            self.metrics.view_selection_seconds.observe(job.spent.as_secs_f64());
            self.lock().return_view(flow, None, spent_us);
            // A session that has ended needs no answer.
            let _ = job.answers.send(job.selection);
        } else {
            self.lock().return_view(flow, Some(job), spent_us);
        }
    }
}
