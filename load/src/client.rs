//! One measured client through one phase: it connects, follows its schedule, and reconnects when a
//! session is lost.

use crate::dial::Dial;
use crate::http::{self, EtagCache};
use crate::mode::Mode;
use crate::resume::Resumption;
use crate::schedule::Schedule;
use crate::session;
use crate::task::{GIVE_UP_AFTER, SessionEnd, Task};
use protocol::backoff::Backoff;
use std::time::Duration;
use tokio::time::{Instant, sleep};

/// First and longest delay before a client connects again.
const FIRST_DELAY: Duration = Duration::from_millis(250);
const MAX_DELAY: Duration = Duration::from_secs(5);

/// Whether a further phase makes sense.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Outcome {
    /// It does.
    Continue,
    /// The server is absent, or not the one that the run began with.
    GiveUp,
}

/// Runs a measured client to the end of its phase. The ETags are kept for the next phase.
pub async fn run<D: Dial>(task: &Task<'_, D>, etags: &mut EtagCache) -> Outcome {
    let mut schedule = Schedule::new(task.config, task.index, task.epoch, task.end);
    let mut backoff = Backoff::new(FIRST_DELAY, MAX_DELAY, task.delay_seed());
    let mut resumption = Resumption::default();
    let mut outcome = Outcome::Continue;
    loop {
        let started = Instant::now();
        let end = match task.config.mode {
            Mode::Http => http::run(task, &mut schedule, etags).await,
            Mode::View | Mode::Explicit => session::run(task, &mut schedule, &mut resumption).await,
        };
        let counters = task.counters;
        match end {
            SessionEnd::Finished => break,
            SessionEnd::Unreachable(problem) => {
                counters.refused(&problem);
                // A server that was there may come back.
                if !task.world.is_known() && task.epoch.elapsed() >= GIVE_UP_AFTER {
                    outcome = Outcome::GiveUp;
                    break;
                }
            }
            SessionEnd::OtherWorld(problem) => {
                counters.mismatch(&problem);
                counters.world_changed(&problem);
                outcome = Outcome::GiveUp;
                break;
            }
            SessionEnd::NotAdmitted { problem, retry } => {
                counters.refused(&problem);
                if !retry {
                    break;
                }
            }
            SessionEnd::Lost(problem) => counters.dropped(&problem),
            SessionEnd::Wrong(problem) => {
                counters.mismatch(&problem);
                counters.dropped(&problem);
            }
        }
        resumption.lost(counters);
        if started.elapsed() > MAX_DELAY {
            backoff.reset();
        }
        let announced = resumption.take_hint().unwrap_or_default();
        let delay = sleep(backoff.next_delay().max(announced));
        if task.until(task.end, delay).await.is_none() || Instant::now() >= task.end {
            break;
        }
    }
    let now = Instant::now();
    resumption.end(now, task.counters);
    for due in schedule.remaining() {
        match now.checked_duration_since(due) {
            Some(waited) => task.counters.unsent(waited),
            // The run ended before it was due.
            None if task.interrupt.is_cancelled() => break,
            // An action due after an early end has not waited. Those of the whole phase count,
            // also if the run is interrupted later.
            None => task.counters.skipped(),
        }
    }
    outcome
}
