//! A client that reads slowly: a viewer on a bad link, or an attack that costs its owner nothing.
//!
//! It looks like any other viewer and verifies what it gets; only its reading is bounded, and it
//! grants all the credit there can be, so that the server may have much to say to it. The server
//! may end it, and that is no fault: how many were ended and why is what is counted. None comes
//! back.

use crate::agenda::Agenda;
use crate::client::{End, Task};
use crate::dial::Dial;
use crate::session;

/// Runs one until the server or the run ends it.
pub async fn run<D: Dial>(task: &Task<'_, D>) {
    let mut agenda = Agenda::watching(task.index, task.epoch);
    match session::run(task, &mut agenda).await {
        End::Finished => task.counters.stayed(),
        End::NotAdmitted { problem, .. } => task.counters.refused(&problem),
        End::Lost(problem) => task.counters.closed(&problem),
        End::Wrong(problem) => {
            task.counters.mismatch(&problem);
            task.counters.closed(&problem);
        }
    }
}
