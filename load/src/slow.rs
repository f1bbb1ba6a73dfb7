//! A slow client: a viewer on a bad link, or a cheap attack.
//!
//! It sends views like other clients and verifies chunks, but its read rate is limited, and it
//! grants the maximal credit, so that the server always has data to send. That the server closes
//! the connection is no fault; closes are counted by reason. A slow client does not reconnect.

use crate::dial::Dial;
use crate::resume::Resumption;
use crate::schedule::Schedule;
use crate::session;
use crate::task::{SessionEnd, Task};

/// Runs a slow client until the server closes the connection or the run ends.
pub async fn run<D: Dial>(task: &Task<'_, D>) {
    let mut schedule = Schedule::views_only(task.index, task.epoch);
    match session::run(task, &mut schedule, &mut Resumption::default()).await {
        SessionEnd::Finished => task.counters.stayed(),
        SessionEnd::NotAdmitted { problem, .. } | SessionEnd::Unreachable(problem) => {
            task.counters.refused(&problem);
        }
        SessionEnd::Lost(problem) => task.counters.closed(&problem),
        SessionEnd::Wrong(problem) | SessionEnd::OtherWorld(problem) => {
            task.counters.mismatch(&problem);
            task.counters.closed(&problem);
        }
    }
}
