//! When a client does what: in a closed loop as its answers come, in an open loop at times fixed
//! beforehand.
//!
//! It outlives sessions: what was due while a client was thrown out is done when it is back, and
//! counts from when it was due.

use crate::arrivals::Arrivals;
use crate::config::LoadConfig;
use crate::interest::{MAX_OPEN_REQUESTS, MAX_VIEWS, MAX_VIEWS_SLOW};
use crate::mode::Mode;
use std::time::Duration;
use terrain::hash::mix;
use tokio::time::{Instant, Interval, MissedTickBehavior, interval_at, sleep_until};

/// Time between two requests of a client that mostly looks.
const PROBE_PERIOD: Duration = Duration::from_millis(250);

/// Chunks that a client which asks by key has open in a closed loop.
const OUTSTANDING: usize = 16;

/// Something to do, and since when it counts.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Errand {
    /// Say what is seen.
    Look(Instant),
    /// Ask for one chunk to see how long it takes, besides what is seen.
    Probe(Instant),
    /// Ask for so many chunks by key.
    Ask(Instant, usize),
}

/// One client's errands in one part of a run.
#[derive(Debug)]
pub struct Agenda {
    pacing: Pacing,
    /// Chunks asked for so far: the number of the next.
    asked: u32,
}

#[derive(Debug)]
enum Pacing {
    /// Looks, and probes where there are any.
    Clock { views: Interval, probes: Option<Interval> },
    /// Asks as soon as answers come, with so many open.
    Eager { outstanding: usize },
    /// Does one thing at each arrival.
    Open { arrivals: Arrivals, mode: Mode },
}

impl Agenda {
    /// The errands of measured client `index` between an epoch and an end.
    #[must_use]
    pub fn new(config: &LoadConfig, index: u32, epoch: Instant, end: Instant) -> Self {
        let pacing = match (config.rate, config.mode) {
            (Some(rate), mode) => {
                let share = rate / f64::from(config.clients);
                Pacing::Open { arrivals: Arrivals::new(config.seed, index, share, epoch, end), mode }
            }
            (None, Mode::View) => Pacing::Clock {
                views: views(index, epoch),
                probes: Some(steady(epoch + PROBE_PERIOD / 2, PROBE_PERIOD)),
            },
            (None, Mode::Explicit) => Pacing::Eager { outstanding: OUTSTANDING },
            (None, Mode::Http) => Pacing::Eager { outstanding: 1 },
        };
        Self { pacing, asked: 0 }
    }

    /// Nothing but looks, by one who reads slowly.
    #[must_use]
    pub fn watching(index: u32, epoch: Instant) -> Self {
        Self { pacing: Pacing::Clock { views: views(index, epoch), probes: None }, asked: 0 }
    }

    /// Whether what is asked does not wait for answers.
    #[must_use]
    pub const fn is_open(&self) -> bool {
        matches!(self.pacing, Pacing::Open { .. })
    }

    /// Whether poses count as outstanding until their views are complete.
    #[must_use]
    pub const fn waits_for_views(&self) -> bool {
        matches!(self.pacing, Pacing::Open { .. } | Pacing::Clock { probes: None, .. })
    }

    /// The next thing to do, with so many answers outstanding. Waits until it is due and, where a
    /// bound is reached, for ever: call again when an answer has come. Dropping it loses nothing.
    pub async fn next(&mut self, outstanding: usize) -> Errand {
        match &mut self.pacing {
            // As in an open loop: no view is forgotten that may still be served.
            Pacing::Clock { probes: None, .. } if outstanding >= MAX_VIEWS_SLOW - 1 => {
                std::future::pending().await
            }
            Pacing::Clock { views, probes: None } => {
                views.tick().await;
                Errand::Look(Instant::now())
            }
            Pacing::Clock { views, probes: Some(probes) } => tokio::select! {
                _ = views.tick() => Errand::Look(Instant::now()),
                _ = probes.tick() => Errand::Probe(Instant::now()),
            },
            Pacing::Eager { outstanding: most } if outstanding < *most => {
                Errand::Ask(Instant::now(), *most - outstanding)
            }
            Pacing::Eager { .. } => std::future::pending().await,
            Pacing::Open { arrivals, mode } => {
                // A view that may still be served must not be forgotten, so fewer may be open than
                // are remembered.
                let most = if *mode == Mode::View { MAX_VIEWS - 1 } else { MAX_OPEN_REQUESTS };
                let Some(at) = arrivals.next().filter(|_| outstanding < most) else {
                    return std::future::pending().await;
                };
                sleep_until(at).await;
                arrivals.advance();
                if *mode == Mode::View { Errand::Look(at) } else { Errand::Ask(at, 1) }
            }
        }
    }

    /// Whether an open loop has nothing more to do; a closed one always has.
    #[must_use]
    pub fn is_done(&self) -> bool {
        matches!(&self.pacing, Pacing::Open { arrivals, .. } if arrivals.next().is_none())
    }

    /// The number of the next chunk to ask for.
    pub const fn number(&mut self) -> u32 {
        let number = self.asked;
        self.asked = self.asked.wrapping_add(1);
        number
    }

    /// What an open loop should have done and did not, by when it was due.
    pub fn rest(mut self) -> impl Iterator<Item = Instant> {
        std::iter::from_fn(move || match &mut self.pacing {
            Pacing::Open { arrivals, .. } => {
                let at = arrivals.next()?;
                arrivals.advance();
                Some(at)
            }
            _ => None,
        })
    }
}

/// 2 to 4 views a second, and no two clients in step.
fn views(index: u32, epoch: Instant) -> Interval {
    steady(epoch, Duration::from_millis(250 + u64::from(mix(index) % 250)))
}

fn steady(from: Instant, period: Duration) -> Interval {
    let mut interval = interval_at(from, period);
    interval.set_missed_tick_behavior(MissedTickBehavior::Delay);
    interval
}

#[cfg(test)]
mod tests {
    use super::*;
    use tokio::time::{advance, timeout};

    fn config(mode: Mode, rate: Option<f64>) -> LoadConfig {
        let address = "ws://127.0.0.1:1/v1/stream".parse().unwrap();
        LoadConfig { clients: 1, mode, rate, ..LoadConfig::new(address) }
    }

    #[tokio::test(start_paused = true)]
    async fn a_late_errand_of_an_open_loop_counts_from_when_it_was_due() {
        let epoch = Instant::now();
        let end = epoch + Duration::from_secs(10);
        let mut agenda = Agenda::new(&config(Mode::Explicit, Some(5.0)), 0, epoch, end);
        let due: Vec<_> = Agenda::new(&config(Mode::Explicit, Some(5.0)), 0, epoch, end).rest().collect();
        advance(Duration::from_secs(4)).await;
        let late = due.iter().take_while(|at| **at < epoch + Duration::from_secs(4)).count();
        assert!(late > 5);
        for at in &due[..late] {
            assert_eq!(agenda.next(0).await, Errand::Ask(*at, 1));
            assert_eq!(Instant::now(), epoch + Duration::from_secs(4), "late ones are done at once");
        }
        assert_eq!(agenda.next(0).await, Errand::Ask(due[late], 1));
        // Timers count in milliseconds.
        assert!(due[late].elapsed() <= Duration::from_millis(2), "and those to come in time");
        assert_eq!(agenda.rest().collect::<Vec<_>>(), due[late + 1..]);
    }

    #[tokio::test(start_paused = true)]
    async fn a_closed_loop_waits_for_answers_and_an_open_one_only_at_its_bound() {
        let epoch = Instant::now();
        let end = epoch + Duration::from_secs(3600);
        let mut closed = Agenda::new(&config(Mode::Http, None), 0, epoch, end);
        assert_eq!(closed.next(0).await, Errand::Ask(epoch, 1));
        assert!(timeout(Duration::from_secs(60), closed.next(1)).await.is_err() && !closed.is_done());
        let mut open = Agenda::new(&config(Mode::View, Some(5.0)), 0, epoch, end);
        assert!(matches!(open.next(MAX_VIEWS - 2).await, Errand::Look(_)));
        let next = open.arrivals();
        assert!(timeout(Duration::from_secs(60), open.next(MAX_VIEWS - 1)).await.is_err());
        assert_eq!(open.next(0).await, Errand::Look(next), "what was held back is not lost");
    }

    impl Agenda {
        fn arrivals(&self) -> Instant {
            let Pacing::Open { arrivals, .. } = &self.pacing else { panic!("no open loop") };
            arrivals.next().unwrap()
        }
    }
}
