//! Live statistics of a run: measured clients by phase, slow and silent clients separately.

use crate::config::LoadConfig;
use crate::counters::{Counters, get};
use crate::phases::{Phase, phases};
use crate::timeline::{Second, Timeline};
use std::sync::Arc;
use std::sync::atomic::AtomicU64;
use std::time::{Duration, SystemTime, UNIX_EPOCH};

/// Live statistics of a run. Time zero is their creation.
#[derive(Debug)]
pub struct RunStats {
    /// Time zero by the system's clock, since 1970-01-01 UTC.
    pub(crate) started_unix: Duration,
    /// The run second by second.
    pub(crate) timeline: Arc<Timeline>,
    /// The phases with their counters.
    pub(crate) phases: Vec<(Phase, Arc<Counters>)>,
    /// Measured clients that ended without ever having had a session.
    pub(crate) never_connected: AtomicU64,
    /// Slow clients.
    pub(crate) slow: Arc<Counters>,
    /// Silent clients.
    pub(crate) silent: Arc<Counters>,
}

/// Progress of a run.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Progress {
    /// Time since the start.
    pub elapsed: Duration,
    /// The current phase, or `pause` before the next.
    pub phase: &'static str,
    /// Chunks so far.
    pub chunks: u64,
    /// Mismatches and dropped sessions so far.
    pub faults: u64,
    /// The last whole second.
    pub last: Option<Second>,
}

impl RunStats {
    /// Statistics of a run that starts now.
    #[must_use]
    pub fn new(config: &LoadConfig) -> Self {
        let timeline = Arc::new(Timeline::starting_now());
        let counters = || Arc::new(Counters::with_timeline(Arc::clone(&timeline)));
        let phases = phases(config.warm_up_s, config.seconds).into_iter().map(|phase| (phase, counters()));
        let (phases, slow, silent) = (phases.collect(), Arc::default(), Arc::default());
        // Before 1970 only if the clock is wrong; then all its times are.
        let started_unix = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default();
        Self { started_unix, timeline, phases, never_connected: AtomicU64::new(0), slow, silent }
    }

    /// Length of the run, including the pause.
    #[must_use]
    pub fn duration(&self) -> Duration {
        self.phases.last().map_or(Duration::ZERO, |(phase, _)| phase.end())
    }

    /// The progress.
    #[must_use]
    pub fn progress(&self) -> Progress {
        let elapsed = self.timeline.elapsed();
        let phase = self.phases.iter().map(|(phase, _)| phase).find(|phase| elapsed < phase.end());
        let phase = phase.or(self.phases.last().map(|(phase, _)| phase));
        let all = || self.phases.iter().map(|(_, counters)| counters);
        Progress {
            elapsed,
            phase: phase.map_or("", |phase| if elapsed < phase.start { "pause" } else { phase.name }),
            chunks: all().map(|counters| get(&counters.chunks)).sum(),
            faults: all().map(|counters| get(&counters.mismatches) + get(&counters.dropped)).sum(),
            last: self.timeline.last(),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use tokio::time::advance;

    #[tokio::test(start_paused = true)]
    async fn progress_has_the_current_phase() {
        let address = "ws://127.0.0.1:1/v1/stream".parse().unwrap();
        let stats = RunStats::new(&LoadConfig { warm_up_s: 3, seconds: 5, ..LoadConfig::new(address) });
        let mut names = Vec::new();
        for _ in 0..stats.duration().as_secs() + 2 {
            names.push(stats.progress().phase);
            advance(Duration::from_secs(1)).await;
        }
        names.dedup();
        assert_eq!(names, ["cold", "pause", "warm"]);
    }
}
