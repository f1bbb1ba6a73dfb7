//! When a client does what: in a closed loop after its answers, in an open loop at random times
//! that are fixed before the run, else at fixed intervals.
//!
//! A schedule outlives sessions: an action that was due while a client was disconnected is done
//! after it has reconnected, and counts from when it was due.

use crate::arrivals::Arrivals;
use crate::config::LoadConfig;
use crate::expected::{MAX_OPEN_REQUESTS, MAX_VIEWS, MAX_VIEWS_SLOW};
use crate::mode::Mode;
use std::time::Duration;
use terrain::hash::mix;
use tokio::time::{Instant, Interval, MissedTickBehavior, interval_at, sleep_until};

/// Time between two probes of a client in view mode.
const PROBE_PERIOD: Duration = Duration::from_millis(250);

/// Requests outstanding of a client in explicit mode, in a closed loop.
const OUTSTANDING: usize = 16;

/// An action, with the time from which its latency counts.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Action {
    /// Send a view.
    View(Instant),
    /// Request one chunk that no view brings, to measure the latency.
    Probe(Instant),
    /// Request this many chunks by key.
    Request(Instant, usize),
}

/// The actions of one client in one phase.
#[derive(Debug)]
pub struct Schedule {
    pacing: Pacing,
    /// Chunks requested so far: the number of the next.
    requested: u32,
}

#[derive(Debug)]
enum Pacing {
    /// Views, and probes if any, at fixed intervals.
    Periodic { views: Interval, probes: Option<Interval> },
    /// Requests after answers, with this many outstanding.
    Closed { outstanding: usize },
    /// One action at each arrival.
    Open { arrivals: Arrivals, mode: Mode },
}

impl Schedule {
    /// The schedule of measured client `index` from `epoch` to `end`.
    #[must_use]
    pub fn new(config: &LoadConfig, index: u32, epoch: Instant, end: Instant) -> Self {
        let pacing = match (config.rate, config.mode) {
            (Some(rate), mode) => {
                let share = rate / f64::from(config.clients);
                Pacing::Open { arrivals: Arrivals::new(config.seed, index, share, epoch, end), mode }
            }
            (None, Mode::View) => Pacing::Periodic {
                views: views(index, epoch),
                probes: Some(steady(epoch + PROBE_PERIOD / 2, PROBE_PERIOD)),
            },
            (None, Mode::Explicit) => Pacing::Closed { outstanding: OUTSTANDING },
            (None, Mode::Http) => Pacing::Closed { outstanding: 1 },
        };
        Self { pacing, requested: 0 }
    }

    /// Views only, for a slow client.
    #[must_use]
    pub fn views_only(index: u32, epoch: Instant) -> Self {
        Self { pacing: Pacing::Periodic { views: views(index, epoch), probes: None }, requested: 0 }
    }

    /// Whether requests do not wait for answers.
    #[must_use]
    pub const fn is_open(&self) -> bool {
        matches!(self.pacing, Pacing::Open { .. })
    }

    /// Whether every answer is followed by a request at once.
    #[must_use]
    pub const fn is_closed(&self) -> bool {
        matches!(self.pacing, Pacing::Closed { .. })
    }

    /// Whether poses count as outstanding until their views are complete.
    #[must_use]
    pub const fn waits_for_views(&self) -> bool {
        matches!(self.pacing, Pacing::Open { .. } | Pacing::Periodic { probes: None, .. })
    }

    /// The next action, with `outstanding` answers outstanding. Waits until it is due; at the limit
    /// of outstanding requests it never returns, so call it again after an answer. Cancel-safe.
    pub async fn next(&mut self, outstanding: usize) -> Action {
        match &mut self.pacing {
            // As in an open loop: a view that may still be served must be remembered.
            Pacing::Periodic { probes: None, .. } if outstanding >= MAX_VIEWS_SLOW - 1 => {
                std::future::pending().await
            }
            Pacing::Periodic { views, probes: None } => Action::View(views.tick().await),
            Pacing::Periodic { views, probes: Some(probes) } => tokio::select! {
                // From when they were due. Actions missed beside that are neither sent nor counted.
                due = views.tick() => Action::View(due),
                due = probes.tick() => Action::Probe(due),
            },
            Pacing::Closed { outstanding: most } if outstanding < *most => {
                Action::Request(Instant::now(), *most - outstanding)
            }
            Pacing::Closed { .. } => std::future::pending().await,
            Pacing::Open { arrivals, mode } => {
                // A view that may still be served must be remembered, so fewer may be outstanding
                // than are remembered.
                let most = if *mode == Mode::View { MAX_VIEWS - 1 } else { MAX_OPEN_REQUESTS };
                let Some(at) = arrivals.next().filter(|_| outstanding < most) else {
                    return std::future::pending().await;
                };
                sleep_until(at).await;
                arrivals.advance();
                if *mode == Mode::View { Action::View(at) } else { Action::Request(at, 1) }
            }
        }
    }

    /// Whether an open loop has no further action. Always false in a closed loop.
    #[must_use]
    pub fn is_done(&self) -> bool {
        matches!(&self.pacing, Pacing::Open { arrivals, .. } if arrivals.next().is_none())
    }

    /// The number of the next chunk to request.
    pub const fn next_number(&mut self) -> u32 {
        let number = self.requested;
        self.requested = self.requested.wrapping_add(1);
        number
    }

    /// The times at which an open loop should have acted and did not.
    pub fn remaining(mut self) -> impl Iterator<Item = Instant> {
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

/// 2 to 4 views a second, not in step between clients.
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
    async fn a_late_action_of_an_open_loop_counts_from_its_due_time() {
        let epoch = Instant::now();
        let end = epoch + Duration::from_secs(10);
        let mut schedule = Schedule::new(&config(Mode::Explicit, Some(5.0)), 0, epoch, end);
        let due: Vec<_> =
            Schedule::new(&config(Mode::Explicit, Some(5.0)), 0, epoch, end).remaining().collect();
        advance(Duration::from_secs(4)).await;
        let late = due.iter().take_while(|at| **at < epoch + Duration::from_secs(4)).count();
        assert!(late > 5);
        for at in &due[..late] {
            assert_eq!(schedule.next(0).await, Action::Request(*at, 1));
            assert_eq!(Instant::now(), epoch + Duration::from_secs(4), "late actions are done at once");
        }
        assert_eq!(schedule.next(0).await, Action::Request(due[late], 1));
        // Timers count in milliseconds.
        assert!(due[late].elapsed() <= Duration::from_millis(2), "later ones in time");
        assert_eq!(schedule.remaining().collect::<Vec<_>>(), due[late + 1..]);
    }

    #[tokio::test(start_paused = true)]
    async fn a_closed_loop_waits_for_answers_an_open_one_only_at_its_limit() {
        let epoch = Instant::now();
        let end = epoch + Duration::from_secs(3600);
        let mut closed = Schedule::new(&config(Mode::Http, None), 0, epoch, end);
        assert_eq!(closed.next(0).await, Action::Request(epoch, 1));
        assert!(timeout(Duration::from_secs(60), closed.next(1)).await.is_err() && !closed.is_done());
        let mut open = Schedule::new(&config(Mode::View, Some(5.0)), 0, epoch, end);
        assert!(matches!(open.next(MAX_VIEWS - 2).await, Action::View(_)));
        let next = open.arrivals();
        assert!(timeout(Duration::from_secs(60), open.next(MAX_VIEWS - 1)).await.is_err());
        assert_eq!(open.next(0).await, Action::View(next), "a delayed action is not lost");
    }

    impl Schedule {
        fn arrivals(&self) -> Instant {
            let Pacing::Open { arrivals, .. } = &self.pacing else { panic!("no open loop") };
            arrivals.next().unwrap()
        }
    }
}
