//! A whole run: every measured client through every phase, slow and silent clients beside them.

use crate::client::{self, Outcome};
use crate::config::LoadConfig;
use crate::counters::Counters;
use crate::dial::{Dial, Network};
use crate::http::EtagCache;
use crate::path::PathKind;
use crate::regeneration::Regeneration;
use crate::report::Report;
use crate::run_stats::RunStats;
use crate::task::Task;
use crate::world::FirstWorld;
use crate::{silent, slow};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;
use tokio::task::JoinSet;
use tokio::time::{Instant, sleep_until};
use tokio_util::sync::CancellationToken;

/// Time over which slow and silent clients connect.
const BACKGROUND_RAMP: Duration = Duration::from_secs(1);

/// Runs a load test. Never fails: faults are counted and decide the verdict of the report.
pub async fn run(config: LoadConfig) -> Report {
    let stats = Arc::new(RunStats::new(&config));
    run_counting(config, stats, CancellationToken::new()).await
}

/// As [`run`], with statistics of this configuration that the caller can read during the run, and a
/// token that ends it early.
pub async fn run_counting(config: LoadConfig, stats: Arc<RunStats>, interrupt: CancellationToken) -> Report {
    let dial = Network::to(&config.connect, config.tls.clone());
    run_over(dial, config, stats, interrupt).await
}

/// As [`run_counting`], over other connections than the network's.
pub async fn run_over<D: Dial>(
    dial: D,
    config: LoadConfig,
    stats: Arc<RunStats>,
    interrupt: CancellationToken,
) -> Report {
    let (regeneration, comparing) = Regeneration::start();
    let started = Instant::now();
    let world = FirstWorld::default();
    let shared = Arc::new(Shared { config, dial, stats, started, world, interrupt });
    let mut clients = JoinSet::new();
    for index in 0..shared.config.clients {
        clients.spawn(run_measured(Arc::clone(&shared), regeneration.clone(), index));
    }
    for index in 0..shared.config.slow {
        clients.spawn(run_slow(Arc::clone(&shared), regeneration.clone(), index));
    }
    for index in 0..shared.config.silent {
        clients.spawn(run_silent(Arc::clone(&shared), regeneration.clone(), index));
    }
    let mut interrupted = None;
    loop {
        tokio::select! {
            // In this order: clients may end at once after an interrupt.
            biased;
            () = shared.interrupt.cancelled(), if interrupted.is_none() => {
                interrupted = Some(started.elapsed());
            }
            joined = clients.join_next() => match joined {
                Some(Ok(())) => {}
                // A panic is a fault of this program and must not count as a good session.
                Some(Err(error)) => shared.own_faults().dropped(&format!("a client task failed: {error}")),
                None => break,
            },
        }
    }
    // Without the closing of sessions after an interrupt, which is no load.
    let took = interrupted.unwrap_or_else(|| started.elapsed());
    drop(regeneration);
    if let Err(error) = comparing.await {
        shared.own_faults().mismatch(&format!("comparing with local generation failed: {error}"));
    }
    let report = Report::new(&shared.config, &shared.stats, took);
    Report { interrupted: interrupted.is_some(), ..report }
}

/// State that all clients of a run share.
struct Shared<D> {
    config: LoadConfig,
    dial: D,
    stats: Arc<RunStats>,
    started: Instant,
    world: FirstWorld,
    interrupt: CancellationToken,
}

impl<D> Shared<D> {
    /// Counters for faults of this program.
    fn own_faults(&self) -> &Counters {
        self.stats.phases.last().map_or(&self.stats.slow, |(_, counters)| counters)
    }

    /// The task of a slow or silent client, which runs through all phases.
    fn background_task<'a>(
        &'a self,
        (index, n): (u32, u32),
        counters: &'a Arc<Counters>,
        regeneration: &'a Regeneration,
        had_session: &'a AtomicBool,
        interrupt: &'a CancellationToken,
    ) -> Task<'a, D> {
        let step = BACKGROUND_RAMP.min(self.stats.duration() / 5) / n.max(1);
        Task {
            // Other paths than the measured clients.
            index: index.wrapping_add(1 << 24),
            config: &self.config,
            dial: &self.dial,
            counters,
            regeneration,
            epoch: self.started + step * index,
            end: self.started + self.stats.duration(),
            interrupt,
            read_rate: None,
            world: &self.world,
            had_session,
        }
    }
}

async fn run_measured<D: Dial>(shared: Arc<Shared<D>>, regeneration: Regeneration, index: u32) {
    let had_session = AtomicBool::new(false);
    run_phases(&shared, &regeneration, index, &had_session).await;
    if !had_session.into_inner() {
        shared.stats.never_connected.fetch_add(1, Ordering::Relaxed);
    }
}

async fn run_phases<D: Dial>(
    shared: &Shared<D>,
    regeneration: &Regeneration,
    index: u32,
    had_session: &AtomicBool,
) {
    let Shared { config, dial, stats, started, world, interrupt } = shared;
    let interrupt = &interrupt.child_token();
    let mut etags = EtagCache::default();
    for (phase, counters) in &stats.phases {
        let at_once = config.path == PathKind::Spawn;
        let epoch = *started + phase.client_start(index, config.clients, at_once);
        let end = *started + phase.end();
        let task = Task {
            index,
            config,
            dial,
            counters,
            regeneration,
            epoch,
            end,
            interrupt,
            read_rate: None,
            world,
            had_session,
        };
        let is_due = task.until(end, sleep_until(epoch)).await.is_some();
        if !is_due || client::run(&task, &mut etags).await == Outcome::GiveUp {
            return;
        }
    }
}

async fn run_slow<D: Dial>(shared: Arc<Shared<D>>, regeneration: Regeneration, index: u32) {
    let read_rate = Some(shared.config.slow_bytes_per_s);
    let (number, had_session) = ((index, shared.config.slow), AtomicBool::new(false));
    let interrupt = shared.interrupt.child_token();
    let task = shared.background_task(number, &shared.stats.slow, &regeneration, &had_session, &interrupt);
    if task.until(task.end, sleep_until(task.epoch)).await.is_some() {
        slow::run(&Task { read_rate, ..task }).await;
    }
}

async fn run_silent<D: Dial>(shared: Arc<Shared<D>>, regeneration: Regeneration, index: u32) {
    let (number, had_session) = ((index, shared.config.silent), AtomicBool::new(false));
    let interrupt = shared.interrupt.child_token();
    let task = shared.background_task(number, &shared.stats.silent, &regeneration, &had_session, &interrupt);
    if task.until(task.end, sleep_until(task.epoch)).await.is_some() {
        silent::run(&task).await;
    }
}
