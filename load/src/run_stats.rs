//! What all clients count: the measured ones by parts of the run, the slow and the silent ones
//! apart.

use crate::config::LoadConfig;
use crate::counters::{Counters, get};
use crate::phases::{Phase, phases};
use crate::timeline::{Second, Timeline};
use std::sync::Arc;
use std::time::Duration;

/// Live counts of a run. Time zero is when it is made.
#[derive(Debug)]
pub struct Tally {
    /// The run second by second.
    pub(crate) timeline: Arc<Timeline>,
    /// The parts of the run and what is counted in each.
    pub(crate) phases: Vec<(Phase, Arc<Counters>)>,
    /// Of clients that read slowly.
    pub(crate) slow: Arc<Counters>,
    /// Of clients that say nothing.
    pub(crate) silent: Arc<Counters>,
}

/// Where a run is, for whoever watches it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Progress {
    /// Time since its start.
    pub elapsed: Duration,
    /// The part that it is in, or `pause` before the next.
    pub phase: &'static str,
    /// Chunks so far.
    pub chunks: u64,
    /// Mismatches and dropped sessions so far.
    pub faults: u64,
    /// The last whole second.
    pub last: Option<Second>,
}

impl Tally {
    /// Counts of a run that begins now.
    #[must_use]
    pub fn new(config: &LoadConfig) -> Self {
        let timeline = Arc::new(Timeline::starting_now());
        let counters = || Arc::new(Counters::telling(Arc::clone(&timeline)));
        let phases = phases(config.warm_up_s, config.seconds).into_iter().map(|phase| (phase, counters()));
        let (phases, slow, silent) = (phases.collect(), Arc::default(), Arc::default());
        Self { timeline, phases, slow, silent }
    }

    /// Length of the run, its pause included.
    #[must_use]
    pub fn lasts(&self) -> Duration {
        self.phases.last().map_or(Duration::ZERO, |(phase, _)| phase.ends())
    }

    /// Where the run is.
    #[must_use]
    pub fn progress(&self) -> Progress {
        let elapsed = self.timeline.elapsed();
        let phase = self.phases.iter().map(|(phase, _)| phase).find(|phase| elapsed < phase.ends());
        let phase = phase.or(self.phases.last().map(|(phase, _)| phase));
        let all = || self.phases.iter().map(|(_, counters)| counters);
        Progress {
            elapsed,
            phase: phase.map_or("", |phase| if elapsed < phase.begins { "pause" } else { phase.name }),
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
    async fn progress_names_the_part_that_a_run_is_in() {
        let address = "ws://127.0.0.1:1/v1/stream".parse().unwrap();
        let tally = Tally::new(&LoadConfig { warm_up_s: 3, seconds: 5, ..LoadConfig::new(address) });
        let mut names = Vec::new();
        for _ in 0..tally.lasts().as_secs() + 2 {
            names.push(tally.progress().phase);
            advance(Duration::from_secs(1)).await;
        }
        names.dedup();
        assert_eq!(names, ["cold", "pause", "warm"]);
    }
}
