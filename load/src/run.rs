//! A whole run: every client through every part, the unpleasant ones beside them.

use crate::client::{self, Task};
use crate::config::LoadConfig;
use crate::counters::Counters;
use crate::dial::{Dial, Tcp};
use crate::http::Visited;
use crate::path::PathKind;
use crate::regeneration::Regeneration;
use crate::report::Report;
use crate::tally::Tally;
use crate::{silent, slow};
use std::sync::Arc;
use std::time::Duration;
use tokio::task::JoinSet;
use tokio::time::{Instant, sleep_until};

/// Time over which slow and silent clients come.
const COMING: Duration = Duration::from_secs(1);

/// Runs a load test to its end. Never fails: whatever goes wrong is counted, and the report's
/// verdict says so.
pub async fn run(config: LoadConfig) -> Report {
    let tally = Arc::new(Tally::new(&config));
    run_counting(config, tally).await
}

/// As [`run`], counting into a tally that was made for this configuration and that the caller can
/// watch meanwhile.
pub async fn run_counting(config: LoadConfig, tally: Arc<Tally>) -> Report {
    let dial = Tcp::to(&config.connect);
    run_over(dial, config, tally).await
}

/// As [`run_counting`], over other connections than TCP.
pub async fn run_over<D: Dial>(dial: D, config: LoadConfig, tally: Arc<Tally>) -> Report {
    let (regeneration, comparing) = Regeneration::start();
    let started = Instant::now();
    let shared = Arc::new(Shared { config, dial, tally, started });
    let mut clients = JoinSet::new();
    for index in 0..shared.config.clients {
        clients.spawn(measured(Arc::clone(&shared), regeneration.clone(), index));
    }
    for index in 0..shared.config.slow {
        clients.spawn(slowly(Arc::clone(&shared), regeneration.clone(), index));
    }
    for index in 0..shared.config.silent {
        clients.spawn(silently(Arc::clone(&shared), regeneration.clone(), index));
    }
    while let Some(joined) = clients.join_next().await {
        if let Err(error) = joined {
            // A panic in one client is a fault of this program; it must not pass for a good
            // session.
            shared.fault().dropped(&format!("a client task failed: {error}"));
        }
    }
    let took = started.elapsed();
    drop(regeneration);
    if let Err(error) = comparing.await {
        shared.fault().mismatch(&format!("comparing with local generation failed: {error}"));
    }
    Report::new(&shared.config, &shared.tally, took)
}

/// What all clients of a run share.
struct Shared<D> {
    config: LoadConfig,
    dial: D,
    tally: Arc<Tally>,
    started: Instant,
}

impl<D> Shared<D> {
    /// Where this program's own faults are counted.
    fn fault(&self) -> &Counters {
        self.tally.phases.last().map_or(&self.tally.slow, |(_, counters)| counters)
    }

    /// A client whose figures are kept apart: it is there through the whole run.
    fn aside<'a>(
        &'a self,
        (index, n): (u32, u32),
        counters: &'a Arc<Counters>,
        regeneration: &'a Regeneration,
    ) -> Task<'a, D> {
        let coming = COMING.min(self.tally.lasts() / 5) / n.max(1);
        Task {
            // Paths of their own.
            index: index.wrapping_add(1 << 24),
            config: &self.config,
            dial: &self.dial,
            counters,
            regeneration,
            epoch: self.started + coming * index,
            end: self.started + self.tally.lasts(),
            reads: None,
        }
    }
}

async fn measured<D: Dial>(shared: Arc<Shared<D>>, regeneration: Regeneration, index: u32) {
    let Shared { config, dial, tally, started } = &*shared;
    let mut visited = Visited::default();
    for (phase, counters) in &tally.phases {
        let at_once = config.path == PathKind::Spawn;
        let epoch = *started + phase.begin_of(index, config.clients, at_once);
        let end = *started + phase.ends();
        sleep_until(epoch).await;
        let regeneration = &regeneration;
        let task = Task { index, config, dial, counters, regeneration, epoch, end, reads: None };
        client::run(&task, &mut visited).await;
    }
}

async fn slowly<D: Dial>(shared: Arc<Shared<D>>, regeneration: Regeneration, index: u32) {
    let reads = Some(shared.config.slow_bytes_per_s);
    let task = shared.aside((index, shared.config.slow), &shared.tally.slow, &regeneration);
    sleep_until(task.epoch).await;
    slow::run(&Task { reads, ..task }).await;
}

async fn silently<D: Dial>(shared: Arc<Shared<D>>, regeneration: Regeneration, index: u32) {
    let task = shared.aside((index, shared.config.silent), &shared.tally.silent, &regeneration);
    sleep_until(task.epoch).await;
    silent::run(&task).await;
}
